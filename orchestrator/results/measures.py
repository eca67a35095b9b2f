"""Post-processing by name: what a config's `measures` section asks for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from pydantic import BaseModel, ValidationError

from ..base.errors import ConfigError, Problem, listed, nearest
from ..config import Config, validation_problems
from .recorders import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Measure(Protocol):
    """A way to look at results.

    Attributes:
        options: pydantic model of the options that the config gives. If it has a method `signals()`, the
            names that it returns are recorded whatever the config says; it is an error if they do not exist.
        units: optional; units of its numbers by their keys.
    """

    options: ClassVar[type[BaseModel]]

    def measure(self, results: Results, options: Any) -> dict[str, Any]:
        """Numbers by name: dicts, lists, numbers, texts and None, as JSON has them."""

    def figures(self, results: Results, options: Any) -> dict[str, Figure]:
        """Figures by file name without suffix, of `FIGURES`."""

    # Only where a report has more to say about it:

    def headline(self, measured: dict[str, Any]) -> str:
        """What `measure` found, in a sentence."""

    def scene(self, results: Results, options: Any) -> dict[str, Any] | None:
        """What moves, for the view of motion in a report: see `orchestrator.docking.scene`."""

    # Only where it knows more of the linear system than the FMUs state:

    def linear_point(self, prepared: Any, options: Any) -> Any:
        """Operating point and laws of instances: see `orchestrator.frequency.from_system.LinearPoint`."""

    def stability(
        self, prepared: Any, linear: Any, report: Mapping[str, Any], options: Any
    ) -> tuple[dict[str, Any], list[str]]:
        """What it adds to the report of `orchestrator stability`: numbers, and lines for terminals."""

    # Only where several runs can be compared:

    def comparison(self, runs: Mapping[str, tuple[Results, Any]]) -> dict[str, Figure]:
        """Figures by file name without suffix, of `COMPARISONS`; `runs` holds results and options by the
        system's name.
        """


# Numbers that are compared at a time, and the fewest rows: each costs a call for each signal.
_NUMBERS, _ROWS = 1 << 18, 256

# Name in configs -> where it lives; imported when asked for.
_MEASURES = {
    "docking": "orchestrator.docking.measures:DockingMeasure",
    "docking-space": "orchestrator.docking.space:SpaceMeasure",
}
# All that their figures are called, so that those of an earlier run can be cleared without importing them.
FIGURES = ("attitude", "contacts", "energy", "estimates", "forces", "positions", "rebounds")
COMPARISONS = ("comparison", "comparison-space")


@dataclass(frozen=True)
class ChosenMeasure:
    """A measure with its options."""

    name: str
    measure: Measure
    options: BaseModel

    def signals(self) -> tuple[str, ...]:
        """Names of the signals that are needed."""
        names = getattr(self.options, "signals", None)
        return tuple(names()) if callable(names) else ()


def measure_names() -> tuple[str, ...]:
    """Names of all measures."""
    return tuple(_MEASURES)


def measure_class(name: str) -> type[Measure]:
    """The class of a measure. Raises: KeyError if there is none of that name."""
    module, _, attribute = _MEASURES[name].partition(":")
    return getattr(import_module(module), attribute)


def choose_measures(config: Config) -> tuple[ChosenMeasure, ...]:
    """The measures of a config. Raises: ConfigError if one does not exist or its options are wrong."""
    chosen, problems = check_measures(config)
    if problems:
        raise ConfigError(problems)
    return tuple(chosen)


def check_measures(config: Config) -> tuple[list[ChosenMeasure], list[Problem]]:
    """The measures of a config with which nothing is wrong, and what is wrong with the others."""
    chosen, problems = [], []
    for name, options in config.model.measures.items():
        if name not in _MEASURES:
            names = measure_names()
            what = f"no measure {name!r}"
            place = config.places.text(("measures", name))
            problems.append(Problem(place, what, f"measures: {listed(names)}", nearest(name, names)))
            continue
        measure = measure_class(name)()
        try:
            chosen.append(ChosenMeasure(name, measure, measure.options.model_validate(options)))
        except ValidationError as error:
            problems += validation_problems(error, config.places, ("measures", name), measure.options)
    return chosen, problems


def changes(before: Any, after: Any) -> Any:
    """What each number of a measure changed by, in the measure's own shape.

    What is no number, or has no counterpart (a contact that only one of the runs has), becomes None.
    """
    if isinstance(before, Mapping):
        named = after if isinstance(after, Mapping) else {}
        return {key: changes(value, named.get(key)) for key, value in before.items()}
    if isinstance(before, list | tuple):
        other = after if isinstance(after, list | tuple) else ()
        return [changes(value, other[n] if n < len(other) else None) for n, value in enumerate(before)]
    if _is_number(before) and _is_number(after):
        return after - before
    return None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def signal_changes(results: Results, halved: Results) -> dict[str, dict[str, float | None]]:
    """Largest change of each signal at the instants that both runs share, in its unit and over its range.

    Args:
        results: of a run.
        halved: of the same run with half the step size, recorded at every instant of `results` and between.
    """
    names = list(results.signals)
    apart, low, high = np.zeros(len(names)), np.full(len(names), np.inf), np.full(len(names), -np.inf)
    rows = max(_NUMBERS // (len(names) + 1), _ROWS)
    for chunk, other in zip(results.chunks(rows), halved.chunks(2 * rows), strict=False):
        shared = min(
            chunk["time"].size, -(-other["time"].size // 2)
        )  # an FMU may have ended one of them before the other
        for index, name in enumerate(names):
            before = chunk[name][:shared].astype(float)
            after = other[name][::2][:shared].astype(float)
            apart[index] = max(apart[index], abs(after - before).max(initial=0.0))
            low[index], high[index] = min(low[index], before.min()), max(high[index], before.max())
    spread = high - low
    return {
        name: {"max_change": float(largest), "relative": float(largest / range) if range > 0.0 else None}
        for name, largest, range in zip(names, apart, spread, strict=True)
    }
