"""Stability over a range of one parameter of a config: the dominant root, and where stability changes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import ConfigError, Problem
from ..simulation.run import prepare
from .delay_system import Modes
from .from_system import linearise

__all__ = ["ParameterRange", "over_figure", "over_text", "parameter_range", "stability_over"]

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER})\s*([^\d.\s][^=]*?)?\s*\.\.\s*({_NUMBER})\s*(.*)\Z")
# A border is found to this share of the range.
_BORDER = 2e-4


@dataclass(frozen=True)
class ParameterRange:
    """Values of a parameter in one unit.

    Attributes:
        path: of the config, such as robot.tau_m.
        low, high: in `unit`.
        unit: empty for numbers without one.
        points: how many values are looked at, evenly spaced.
    """

    path: str
    low: float
    high: float
    unit: str
    points: int = 25

    def override(self, value: float) -> str:
        """The change of the config for a value."""
        return f"{self.path}={value!r} {self.unit}".rstrip()


def parameter_range(text: str, points: int = 25) -> ParameterRange:
    """Read PATH=LOW..HIGH UNIT, as robot.tau_m=1..8 ms.

    Raises: ConfigError.
    """
    path, _, values = text.partition("=")
    found = _RANGE.match(values.strip())
    problems = []
    if not path.strip() or found is None:
        allowed = "PATH=LOW..HIGH with a unit behind the numbers, as robot.tau_m='1..8 ms'"
        problems.append(Problem("--over", f"{text!r} is no range of a parameter", allowed))
    elif not float(found[1]) < float(found[3]):
        problems.append(Problem("--over", f"{text!r} is empty", "the first value has to be the smaller one"))
    elif found[2] and found[2].strip() != found[4].strip():
        problems.append(Problem("--over", f"{text!r} has two units", "both values take the unit of the last"))
    if points < 3:
        problems.append(Problem("--points", f"{points} is too few", "at least 3"))
    if problems or found is None:
        raise ConfigError(problems)
    return ParameterRange(path.strip(), float(found[1]), float(found[3]), found[4].strip(), points)


def stability_over(
    config: str | Path | Mapping[str, Any],
    over: ParameterRange,
    overrides: Iterable[str] = (),
    at_time: float | None = None,
) -> dict[str, Any]:
    """Dominant roots over a parameter, and the values at which the system becomes stable or unstable.

    Each border is found by bisection, to 0.02 % of the range. What changes twice between two neighbouring
    values goes unseen.

    Args:
        config, overrides: as for `prepare`.
        over: the parameter.
        at_time: see `linearise` [s].
    Returns: a dict with `parameter`, `unit`, `values`, `real`, `frequency` (of the dominant root, [1/s] and
        [Hz]), `unstable` and `borders`.
    Raises: ConfigError for a value that the config does not take.
    """
    overrides = tuple(overrides)

    def modes(value: float) -> Modes:
        return linearise(prepare(config, (*overrides, over.override(value))), at_time=at_time).modes()

    values = np.linspace(over.low, over.high, over.points)
    found = [modes(float(value)) for value in values]
    dominant = [_root(one) for one in found]
    unstable = [_unstable(one) for one in found]
    borders = []
    for place in np.flatnonzero(np.diff(unstable)):
        low, high, state = float(values[place]), float(values[place + 1]), unstable[place]
        while high - low > _BORDER * (over.high - over.low):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if _unstable(modes(middle)) == state else (low, middle)
        root = _root(modes(0.5 * (low + high)))
        borders.append(
            {
                "value": 0.5 * (low + high),
                "frequency": abs(root.imag) / (2 * np.pi),
                "unstable_above": not state,
            }
        )
    return {
        "parameter": over.path,
        "unit": over.unit,
        "values": values.tolist(),
        "real": [one.real for one in dominant],
        "frequency": [abs(one.imag) / (2 * np.pi) for one in dominant],
        "unstable": [bool(one) for one in unstable],
        "borders": borders,
    }


def _root(modes: Modes) -> complex:
    return modes.dominant.root if modes.dominant is not None else 0j


def _unstable(modes: Modes) -> bool:
    root = _root(modes)
    return root.real > 1e-9 * abs(root)


def over_text(report: dict[str, Any]) -> str:
    """The report in lines for terminals."""
    unit = f" {report['unit']}" if report["unit"] else ""
    low, high = report["values"][0], report["values"][-1]
    head = f"over {report['parameter']} from {low:g} to {high:g}{unit}: "
    if not report["borders"]:
        return head + ("unstable" if report["unstable"][0] else "stable") + " throughout"
    lines = [
        f"{'un' if one['unstable_above'] else ''}stable above {one['value']:.5g}{unit} "
        f"({one['frequency']:.4g} Hz)"
        for one in report["borders"]
    ]
    return head + "; ".join(lines)


def over_figure(report: dict[str, Any]) -> Any:
    """Real part and frequency of the dominant root over the parameter."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    upper.plot(report["values"], report["real"])
    upper.axhline(0.0, color="black", linewidth=0.8)
    upper.set_title("dominant root")
    upper.set_ylabel("real part [1/s]")
    lower.plot(report["values"], report["frequency"])
    lower.set_ylabel("frequency [Hz]")
    lower.set_xlabel(f"{report['parameter']} [{report['unit'] or '1'}]")
    for axes in (upper, lower):
        for one in report["borders"]:
            axes.axvline(one["value"], color="#D55E00", linewidth=0.8)
        axes.grid(alpha=0.3)
    return figure
