"""Stability over a range of one parameter of a config: the dominant root, and where stability changes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import ConfigError, Problem
from ..base.quantities import Measure, quantity
from ..base.units import parse_unit
from ..simulation.run import Prepared, prepare
from .from_system import linearise
from .modes import Modes
from .sampled_system import SampledSystem, sampled_system
from .step_report import resting_roots, with_step
from .trim import trim

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER})\s*([^\d.\s][^=]*?)?\s*\.\.\s*({_NUMBER})\s*(.*)\Z")
# A border is found to this share of the range.
_BORDER = 2e-4
STEP = "run.step_size"


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
    trimmed: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Dominant roots over a parameter, and the values at which the system becomes stable or unstable.

    Each border is found by bisection, to 0.02 % of the range. What changes twice between two neighbouring
    values goes unseen.

    Args:
        config, overrides: as for `prepare`.
        over: the parameter; also run.step_size, which the machine does not depend on.
        at_time: see `linearise` [s].
        trimmed: linear around the steady state that each value has, these states fixed; None: it is not.
    Returns: a dict with `parameter`, `unit`, `values`, and of the machine `real`, `frequency` (of the
        dominant root, [1/s] and [Hz]), `unstable` and `borders`; the same of the sampled system in `sampled`,
        or `refused` there.
    Raises: ConfigError for a value that the config does not take.
    """
    overrides = tuple(overrides)
    common = _at_point(prepare(config, overrides), trimmed) if over.path == STEP else None
    same = linearise(common, at_time=at_time) if common is not None else None

    @cache
    def at(value: float) -> tuple[Modes, SampledSystem | ConfigError]:
        if common is not None and same is not None:
            prepared, linear = _with_step(common, over, value), same
        else:
            prepared = _at_point(prepare(config, (*overrides, over.override(value))), trimmed)
            linear = linearise(prepared, at_time=at_time)
        modes = linear.modes()
        try:
            return modes, sampled_system(prepared, linear, resting_roots(modes))
        except ConfigError as error:
            return modes, error

    def machine(value: float) -> tuple[bool, complex]:
        modes = at(value)[0]
        return _unstable(modes), _root(modes)

    def sampled(value: float) -> tuple[bool, complex]:
        found = at(value)[1]
        if isinstance(found, ConfigError):
            raise found
        modes = found.modes(1)
        return found.unstable > 0, modes[0].root if modes else 0j

    values = np.linspace(over.low, over.high, over.points).tolist()
    report = {
        "parameter": over.path,
        "unit": over.unit,
        "values": values,
        **_followed(machine, values, _BORDER * (over.high - over.low)),
    }
    try:
        report["sampled"] = _followed(sampled, values, _BORDER * (over.high - over.low))
    except ConfigError as error:
        report["sampled"] = {"refused": "; ".join(one.what for one in error.problems)}
    return report


def _at_point(prepared: Prepared, fixed: Sequence[str] | None) -> Prepared:
    return prepared if fixed is None else trim(prepared, fixed).prepared


def _with_step(common: Prepared, over: ParameterRange, value: float) -> Prepared:
    """The system with another communication step, in the unit of the range."""
    found = quantity("", Measure("s", parse_unit("s")), f"{value!r} {over.unit}".rstrip(), over.path)
    if isinstance(found, Problem):
        raise ConfigError([found])
    return with_step(common, found)


def _followed(
    state: Callable[[float], tuple[bool, complex]], values: list[float], resolution: float
) -> dict[str, Any]:
    """Dominant roots at values, and borders between them, by bisection."""
    found = [state(one) for one in values]
    borders = []
    for place in range(len(values) - 1):
        low, high, unstable = values[place], values[place + 1], found[place][0]
        if found[place + 1][0] == unstable:
            continue
        while high - low > resolution:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if state(middle)[0] == unstable else (low, middle)
        root = state(0.5 * (low + high))[1]
        borders.append(
            {
                "value": 0.5 * (low + high),
                "frequency": abs(root.imag) / (2 * np.pi),
                "unstable_above": not unstable,
            }
        )
    return {
        "real": [root.real for _, root in found],
        "frequency": [abs(root.imag) / (2 * np.pi) for _, root in found],
        "unstable": [bool(one) for one, _ in found],
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
    sampled = report["sampled"]
    step = f"not known, {sampled['refused']}" if "refused" in sampled else _borders(sampled, unit)
    return (
        f"over {report['parameter']} from {low:g} to {high:g}{unit}: {_borders(report, unit)}\n"
        f"  as co-simulated: {step}"
    )


def _borders(report: dict[str, Any], unit: str) -> str:
    if not report["borders"]:
        return ("unstable" if report["unstable"][0] else "stable") + " throughout"
    return "; ".join(
        f"{'un' if one['unstable_above'] else ''}stable above {one['value']:.5g}{unit} "
        f"({one['frequency']:.4g} Hz)"
        for one in report["borders"]
    )


def over_figure(report: dict[str, Any]) -> Any:
    """Real part and frequency of the dominant root over the parameter."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    shown = {"machine": report, "co-simulated": report["sampled"]}
    for name, one in shown.items():
        if "refused" not in one:
            upper.plot(report["values"], one["real"], label=name)
            lower.plot(report["values"], one["frequency"])
    upper.legend()
    upper.axhline(0.0, color="black", linewidth=0.8)
    upper.set_title("dominant root")
    upper.set_ylabel("real part [1/s]")
    lower.set_ylabel("frequency [Hz]")
    lower.set_xlabel(f"{report['parameter']} [{report['unit'] or '1'}]")
    for axes in (upper, lower):
        for color, one in zip(("C0", "C1"), shown.values(), strict=True):
            for border in one.get("borders", ()):
                axes.axvline(border["value"], color=color, linewidth=0.8, linestyle="--")
        axes.grid(alpha=0.3)
    return figure
