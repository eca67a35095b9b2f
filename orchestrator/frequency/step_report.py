"""Stability of a system as its master steps it, beside that of the machine, and the largest stable step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from decimal import Context, Decimal
from fractions import Fraction
from typing import Any

import numpy as np

from ..base.errors import ConfigError
from ..simulation.grid import Grid
from ..simulation.run import Prepared, prepare
from .from_system import Linearised
from .modes import Mode, Modes
from .sampled_system import SampledSystem, sampled_system

# Ratio of neighbouring steps that are looked at, and to what share the border is found.
_RATIO = 2.0**0.25
_BORDER = 2e-4
# Real part of a root without damping, relative to the root.
_UNDAMPED = 1e-9
_FEW = 10


def at_step(
    prepared: Prepared, size: float, steps: int = _FEW, *, own: bool = False
) -> tuple[float, tuple[str, ...]]:
    """A step near a size that is short in decimals [s], and the overrides that make a run of such steps.

    Args:
        steps: how many; or more, so that instances with longer steps end theirs.
        own: whether instances' own steps change in the same ratio; else they stay.
    """
    ratios = {one.name: one.ratio for one in prepared.system.instances}
    parts = math.lcm(*(one.denominator for one in ratios.values())) if own else 1
    short = parts * Fraction(f"{size / parts:.7g}")
    if not own:
        ratios = {name: one * prepared.grid.step_size / short for name, one in ratios.items()}
    whole = math.lcm(*(one.numerator for one in ratios.values() if own or one.denominator == 1))
    stop = prepared.grid.start + -(-steps // whole) * whole * short
    changed = [f"run.step_size={_exact(short)} s", f"run.stop_time={_exact(stop)} s"]
    if own:
        models = prepared.config.model.instances
        changed += [
            f"instances.{name}.step_size={_exact(one * short)} s"
            for name, one in ratios.items()
            if models[name].step_size is not None
        ]
    return float(short), tuple(changed)


def _exact(value: Fraction) -> Decimal:
    return Context(prec=60).divide(Decimal(value.numerator), Decimal(value.denominator))


def with_step(prepared: Prepared, size: float, *, own: bool = False) -> Prepared:
    """The system with a communication step near a size [s], for a run of a few steps.

    Args:
        own: see `at_step`.
    """
    if own or all(one.ratio == 1 for one in prepared.system.instances):
        return replace(prepared, grid=Grid(prepared.grid.start, Fraction(f"{size:.7g}"), _FEW))
    return prepare(prepared.config, at_step(prepared, size)[1])


def moving_modes(modes: Modes) -> list[Mode]:
    """Those but the roots 0 of the continuous system, as integrators have."""
    size = max((abs(one.root) for one in modes.modes), default=0.0)
    return [one for one in modes.modes if abs(one.root) > 1e-9 * size]


def resting_roots(modes: Modes) -> int:
    """How many roots 0 the continuous system has."""
    return len(modes.modes) - len(moving_modes(modes))


def step_report(prepared: Prepared, linear: Linearised, modes: Modes) -> dict[str, Any]:
    """The system as the config's master and step make it.

    Args:
        prepared: the checked system.
        linear: what `linearise` gave.
        modes: its modes.
    Returns: a dict with `master`, `step` [s], `own_steps` (whether instances have steps of their own),
        `verdict`, `modes` (each with `root`, `multiplier`, `frequency`, `damping`, `participation`, and as
        `machine` the root of the continuous system that it stands for, or None) and `largest_step`; or with
        `refused`, why it is not known.
    """
    resting = resting_roots(modes)
    try:
        sampled = sampled_system(prepared, linear, resting)
    except ConfigError as error:
        return {"refused": "; ".join(str(one.what) for one in error.problems)}
    found = sampled.modes()
    moving = moving_modes(modes)
    partner = dict(zip(pairs(found, moving), moving, strict=False))
    unstable = sampled.unstable
    verdict = "stable"
    if unstable:
        verdict = f"unstable: {unstable} of its eigenvalues outside the unit circle"
    elif any(abs(one.root.real) <= _UNDAMPED * abs(one.root) for one in found):
        verdict = "on the border: eigenvalues on the unit circle"
    elif resting:
        verdict = f"stable but for the machine's {resting} root{'s' if resting > 1 else ''} at 0"
    return {
        "master": prepared.config.model.run.master_name,
        "step": sampled.step_size,
        "period": sampled.period,
        "size": sampled.size,
        "verdict": verdict,
        "modes": [_entry(one, sampled, partner.get(index)) for index, one in enumerate(found)],
        "own_steps": any(one.ratio != 1 for one in prepared.system.instances),
        "largest_step": largest_step(prepared, linear, resting, bool(modes.unstable), bool(unstable)),
    }


def _entry(one: Mode, sampled: SampledSystem, machine: Mode | None) -> dict[str, Any]:
    z = np.exp(one.root * sampled.period)
    return {
        "root": [one.root.real, one.root.imag],
        "multiplier": [float(z.real), float(z.imag)],
        "frequency": one.frequency,
        "damping": one.damping,
        "residual": one.residual,
        "participation": dict(one.participation[:3]),
        "machine": None if machine is None else [machine.root.real, machine.root.imag],
    }


def pairs(found: Sequence[Mode], machine: Sequence[Mode]) -> list[int | None]:
    """For each root of the machine the place of the sampled one that stands for it, the nearest."""
    left = dict(enumerate(found))
    found_pairs: list[int | None] = []
    for one in machine:
        near = min(left, key=lambda place: abs(left[place].root - one.root), default=None)
        if near is not None and abs(left[near].root - one.root) > abs(one.root):
            near = None
        if near is not None:
            del left[near]
        found_pairs.append(near)
    return found_pairs


def largest_step(
    prepared: Prepared, linear: Linearised, resting: int, machine_unstable: bool, unstable: bool
) -> dict[str, Any] | None:
    """The communication step at which stability ends.

    Steps are looked at in ratios of 1.19, upwards from the config's while it is stable, else downwards; then
    the border is found to 0.02 %. Instances' own steps change in the same ratio.

    Args:
        prepared, linear, resting: as for `sampled_system`.
        machine_unstable, unstable: of the continuous system, and with the config's step.
    Returns: a dict with `value` [s], `frequency` of what grows beyond it [Hz], and `refused`, why the config
        takes no longer step where that ends the search (else None); None where the machine is unstable itself
        or all steps up to the length of the run are stable.
    """
    if machine_unstable:
        return None

    def look(size: float) -> SampledSystem:
        return sampled_system(with_step(prepared, size, own=True), linear, resting)

    begin = float(prepared.grid.step_size)
    longest = float(prepared.grid.stop - prepared.grid.start)
    low, high, refused = begin, begin, None
    try:
        if unstable:
            while look(low).unstable:
                high, low = low, low / _RATIO
                if low < 1e-4 * begin:
                    return None
        else:
            while not look(high).unstable:
                low, high = high, high * _RATIO
                if high > longest:
                    return None
    except ConfigError as error:
        refused = error.problems[0].what
        if unstable:
            return {"value": None, "frequency": None, "refused": refused}
        return {"value": low, "frequency": None, "refused": refused}
    while high - low > _BORDER * low:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if look(middle).unstable else (middle, high)
    grows = look(high).modes(1)[0]
    return {"value": low, "frequency": abs(grows.root.imag) / (2.0 * np.pi), "refused": None}


def step_text(report: dict[str, Any], machine_stable: bool) -> str:
    """The report in lines for terminals."""
    if "refused" in report:
        return f"as co-simulated: not known, {report['refused']}"
    lines = [
        f"as co-simulated by {report['master']} with a step of {_time(report['step'])}: {report['verdict']}"
    ]
    if machine_stable and report["verdict"].startswith("unstable"):
        lines[0] += "; the machine is stable, the simulation makes it unstable"
    for one in report["modes"]:
        size = abs(complex(*one["multiplier"]))
        if one["machine"] is None and size < 0.5:
            continue
        origin = (
            "no listed root of the machine" if one["machine"] is None else f"machine {_root(one['machine'])}"
        )
        oscillates = f", {one['frequency']:.4g} Hz, damping {one['damping']:.4g}" if one["root"][1] else ""
        lines.append(f"  {_root(one['root'])} 1/s: |z| {size:.6g}{oscillates}; {origin}")
    border = report["largest_step"]
    if border is None:
        pass
    elif border["value"] is None:
        lines.append(f"  largest stable step: not known, {border['refused']}")
    elif border["refused"]:
        lines.append(
            f"  stable up to a step of {_time(border['value'])} at least; beyond: {border['refused']}"
        )
    else:
        with_own = ", own steps of instances in the same ratio" if report["own_steps"] else ""
        text = f"{_time(border['value'])}{with_own}; beyond it {border['frequency']:.4g} Hz grows"
        lines.append(f"  largest stable step: {text}")
    return "\n".join(lines)


def _time(value: float) -> str:
    return f"{value:.4g} s" if value >= 1.0 else f"{1e3 * value:.4g} ms"


def _root(root: Sequence[float]) -> str:
    return f"{root[0]:.6g}" + (f" +-{abs(root[1]):.6g}j" if root[1] else "")
