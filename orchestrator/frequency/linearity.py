"""Whether the instances of a system answer a mode's own motion as their linear equations do.

The inputs of an instance move as they do in the mode, without growth or decay, and so little that any smooth
law is linear. What the instance's outputs then do beside its equations is a switch, a play, a dead band, a
memory or an event at the operating point: roots and margins know nothing of it. An instance that moves on
from its operating point differs, too, but answers in proportion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.arrays import Array
from ..base.errors import OrchestratorError
from ..simulation.run import Prepared
from ..system.system import Instance
from .alone import Alone, usual_size
from .from_system import Linearised
from .modes import Mode, Modes
from .sampled_part import SampledPart, sampled_part
from .statespace import LateInput

# Largest motion of an input, relative to its value or nominal one; how many cycles; steps at most.
_HEIGHT, _CYCLES, _MOST = 1e-3, 2.0, 6000
# Steps that show the motion; shorter communication steps are taken together.
_ENOUGH = 400
# Steps before the motion, for what initialises itself at the first ones.
_SETTLE = 16
# Of an output's motion: what may differ. A smooth law differs by a share of the height.
_APART = 0.02
# An instance that is unstable on its own moves by no more than this power of e.
_GROWN = 3.0


@dataclass(frozen=True)
class Unlike:
    """An output that does not move as its instance's linear equations have it.

    Attributes:
        instance, output: which.
        difference: largest one, relative to the output's largest motion.
        frequency: of the motion [Hz].
        drifts: whether it answers each motion in proportion all the same: it is linear, but the point that it
            is linear around moves on.
    """

    instance: str
    output: str
    difference: float
    frequency: float
    drifts: bool


def unlike_parts(prepared: Prepared, linear: Linearised, modes: Modes) -> list[Unlike]:
    """For each instance the output that differs most from its linear equations in the dominant mode's motion.

    Instances whose law a measure of the config knows, those that the mode does not move, and those that do
    not run on their own are left out.

    Args:
        prepared: the checked system, with the start values that it is linear around.
        modes: of the linear system.
    """
    mode = modes.dominant
    if mode is None:
        return []
    moved = _moved(linear, mode)
    size = float(prepared.grid.step_size)
    found = []
    for one in prepared.system.instances:
        if one.name in linear.of_measures or one.fmu.path is None:
            continue
        stretch = _stretch(one, linear, mode, size)
        samples = _every(linear, one.name, size)
        part = sampled_part(linear, one.name, size * stretch, samples=samples)
        inputs = [name for name in part.space.inputs if f"{one.name}.{name}" in moved]
        worst = _worst(one, inputs, moved, mode, prepared, linear, part, stretch) if inputs else None
        found += [worst] if worst is not None else []
    return found


def _stretch(one: Instance, linear: Linearised, mode: Mode, step: float) -> int:
    """Communication steps in a step of the motion: as many as keep the motion smooth."""
    law = linear.laws.get(one.name)
    if (law is not None and law.period) or not one.fmu.description.capabilities.variable_step_size:
        return 1
    return max(1, int(_CYCLES * 2.0 * np.pi / (_omega(mode) * step) / _ENOUGH))


def _omega(mode: Mode) -> float:
    return abs(mode.root.imag) or abs(mode.root)


def _every(linear: Linearised, name: str, step: float) -> int:
    law = linear.laws.get(name)
    return max(1, round(law.period / step)) if law is not None else 1


def _moved(linear: Linearised, mode: Mode) -> dict[str, complex]:
    """The inputs' parts in a mode, by name."""
    whole = linear.system.vector(mode.root)
    values = dict(zip(linear.system.inputs, whole[len(linear.system.states) :], strict=True))
    paths: dict[str, tuple[LateInput, ...]] = {name: (one,) for name, one in linear.late.items()}
    for name, law in linear.laws.items():
        paths |= {f"{name}.{port}": late for port, late in law.late.items()}
    for name, late in paths.items():
        if len(late) == 1:  # what is fed is the place behind the delay
            values[name] = values.pop(f"{name} delayed", 0.0) * np.exp(mode.root * late[0].delay)
    size = max(map(abs, values.values()), default=0.0)
    return {name: complex(value) for name, value in values.items() if abs(value) > 1e-9 * size}


def _worst(
    one: Instance,
    inputs: list[str],
    moved: dict[str, complex],
    mode: Mode,
    prepared: Prepared,
    linear: Linearised,
    part: Any,
    stretch: int,
) -> Unlike | None:
    step = float(prepared.grid.step_size) * stretch
    omega = _omega(mode)
    count = int(np.ceil(_CYCLES * 2.0 * np.pi / (omega * step)))
    if not 8 * _CYCLES <= count <= _MOST:
        return None
    growth = max(np.linalg.eigvals(linear.parts[one.name].a).real, default=0.0)
    count = min(count, int(_GROWN / (growth * step)) if growth > 0.0 else count)
    if count < 8:
        return None
    seen = [name for name in part.space.outputs if _read(linear, f"{one.name}.{name}")]
    values = {name: linear.point[f"{one.name}.{name}"] for name in part.space.inputs}
    at = Alone(one, prepared, tuple(part.space.inputs), tuple(seen), values)
    share = np.array([moved[f"{one.name}.{name}"] for name in inputs])
    usual = [usual_size(float(values[name]), one.variable(name)) for name in inputs]
    share = share * _HEIGHT / np.max(abs(share) / usual)
    times = step * (np.arange(count) + 1.0)
    course = np.real(share * np.exp(1j * omega * times)[:, None])
    still = np.zeros((_SETTLE, len(inputs)))

    def answers(factor: float) -> Array:
        motion = [*still, *(factor * course)]
        known = list(at.differences(inputs, seen, motion, 1.0 / stretch))
        known = known[_SETTLE + 1 :]
        return np.array(known).reshape(len(known), len(seen)) / factor

    try:
        found = answers(1.0)
        if len(found) < count or not seen:
            return None
        expected = _expected(part, inputs, course, seen)
        size = np.maximum(abs(found).max(axis=0), abs(expected).max(axis=0))
        apart = abs(found - expected).max(axis=0) / np.where(size > 0.0, size, 1.0)
        if not np.any(apart > _APART):
            return None
        other = answers(-0.5)
        if len(other) == count:
            # Of half the motion backwards what is of second order is half as large, with the other sign: that
            # is a smooth law, as of the real part of a quaternion. What is small there is rounded.
            beside = found - expected
            large = abs(beside) > 0.5 * abs(beside).max(axis=0)
            missing = np.where(large, other - expected + 0.5 * beside, 0.0)
            apart[abs(missing).max(axis=0) < _APART * apart * size] = 0.0
        place = int(np.argmax(apart))
        if not apart[place] > _APART:
            return None
    except OrchestratorError:
        return None
    drifts = len(other) == count and bool(np.max(abs(other - found)[:, place]) < _APART * size[place])
    return Unlike(one.name, seen[place], float(apart[place]), omega / (2.0 * np.pi), drifts)


def _read(linear: Linearised, output: str) -> bool:
    return any(linear.system.outputs[link.source] == output for link in linear.system.links)


def _expected(part: Any, inputs: list[str], course: Array, seen: list[str]) -> Array:
    """Outputs by the linear equations, at the ends of steps, shape (steps, outputs)."""
    columns = [part.space.inputs.index(name) for name in inputs]
    rows = [part.space.outputs.index(name) for name in seen]
    z, u = np.zeros((part.size, 1)), np.zeros((len(part.space.inputs), 1))
    found = np.zeros((len(course), len(seen)))
    for index, values in enumerate(course):
        u[columns, 0] = values
        # Samples fall where those of the run do.
        more = (index + _SETTLE,) if isinstance(part, SampledPart) else ()
        z, outputs = part.advance(z, [u], *more)
        found[index] = outputs[rows, 0]
    return found


def linearity_text(found: Sequence[Unlike]) -> list[str]:
    """What the linear system leaves out, in lines for terminals."""
    lines = []
    for one in found:
        motion = f"its output {one.output}, moved as in the mode of {one.frequency:.4g} Hz, differs by"
        share = f"{100 * one.difference:.2g} % from its linear equations".replace("1e+02", "100")
        if one.drifts:
            lines.append(
                f"{one.instance} does not rest at its operating point: {motion} {share} within "
                f"{_CYCLES:g} cycles. --trim finds a point at rest."
            )
        else:
            lines.append(
                f"{one.instance} is not linear at its operating point: {motion} {share}. Roots and margins "
                "leave that out; a run shows what it does."
            )
    return lines
