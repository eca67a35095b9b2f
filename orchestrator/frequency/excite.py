"""The frequency response of a configured system, measured by co-simulating it under its own master.

An input is driven by a multisine, or has one added to what feeds it. The multisine works as an effect on the
connection, so that it adds no instance and no step of delay.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arrays import Array
from ..base.errors import Problem, listed, nearest
from ..effects import Effect
from ..fmi import Causality, Point
from ..simulation.grid import Grid
from ..simulation.loop import Report, simulate
from ..simulation.run import Prepared, prepare
from ..system.connection import Connection, Leg, Link, Port, Wire
from ..system.signal_vector import Layout, Signals
from ..system.system import System
from .tones import Measured, Tones


class _Multisine(Effect):
    """y = keep x + sum of sin(omega_i (t - start) + phase_i), times a factor."""

    jittable: ClassVar[bool] = True

    keep: float
    start: float
    factor: float
    omega: tuple[float, ...]
    phases: tuple[float, ...]

    def numbers(self) -> list[float]:
        return [self.keep, self.start, self.factor, *self.omega, *self.phases]

    @staticmethod
    def kernel(time: float, x: Any, options: Any, memory: Any, commit: bool) -> float:
        count = (len(options) - 3) // 2
        total = 0.0
        for index in range(count):
            total += math.sin(options[3 + index] * (time - options[1]) + options[3 + count + index])
        return options[0] * x[0] + options[2] * total


def sweep_system(
    config: str | Path | Mapping[str, Any] | Prepared,
    source: str,
    targets: str | Sequence[str],
    frequencies: ArrayLike,
    *,
    amplitude: float,
    overrides: Iterable[str] = (),
    cut: bool = True,
    periods: int = 2,
    settle: int = 1,
    limit: bool = False,
) -> dict[str, Measured]:
    """Measure responses of a configured system around the course that it takes from its start values.

    The response is that of the co-simulation: its master, and its communication step, are part of it. A
    straight drift, such as that of a free body, is taken out of the outputs.

    Args:
        config, overrides: as `orchestrator.simulation.run.prepare`.
        source: an input, as "robot.command"; targets: outputs, as "contact.force".
        frequencies: wanted [Hz]; each is moved to the nearest whole multiple of the lowest, whose period is
            to be a whole number of communication steps.
        amplitude: largest deviation of the input, in its unit.
        cut: whether the multisine replaces what feeds the input, which opens loops there; else it is added.
        periods: of the lowest frequency that are measured, at least 2.
        settle: periods before them, in which transients die away.
        limit: whether to measure with a half and a quarter of the step, too, and to extrapolate to small
            steps; the effect of the step is then in the result.
    Returns: responses by target.
    Raises: ConfigError for names and numbers that do not fit; StepError if a run fails.
    """
    prepared = config if isinstance(config, Prepared) else prepare(config, overrides)
    names = [targets] if isinstance(targets, str) else list(targets)
    step = prepared.grid.step_size
    problems = _unknown(prepared.system, source, names, prepared.config.name)
    if periods < 2 or settle < 0:
        got = f"periods = {periods!r}, settle = {settle!r}"
        problems.append(Problem(prepared.config.name, got, "at least 2 periods are needed, settle >= 0"))
    tones = Tones.of(prepared.config.name, frequencies, float(step), amplitude, periods, problems)
    ports = [Port.of(name) for name in names]
    found = []
    for part in (1, 2, 4) if limit else (1,):
        drive = _Drive(Port.of(source), ports, tones, amplitude, cut)
        found.append(_once(prepared, drive, periods, settle, part))
    if not limit:
        return dict(zip(names, found[0], strict=True))
    return {name: _limit(*(one[index] for one in found)) for index, name in enumerate(names)}


def _limit(whole: Measured, half: Measured, quarter: Measured) -> Measured:
    """Richardson's extrapolation of magnitude in logarithm and of phase: exact for what steps add as delay.

    It is free of errors of first and second order in the step.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = np.log(half.response / whole.response), np.log(quarter.response / half.response)
        # Of 2 b - a and 2 c - b the combination 4/3 and -1/3, each as a step from c.
        response = quarter.response * np.exp(second + (second * 2.0 - first) / 3.0)
        # What is zero, or unmeasurably small, stays so.
        response = np.where(np.isfinite(response), response, quarter.response)
        effect = whole.response / response - 1.0
    coherence = np.minimum(np.minimum(whole.coherence, half.coherence), quarter.coherence)
    return Measured(whole.omega, response, coherence, effect)


class _Drive(NamedTuple):
    """What is driven, how, and what is looked at."""

    source: Port
    targets: Sequence[Port]
    tones: Tones
    amplitude: float
    cut: bool


def _once(prepared: Prepared, drive: _Drive, periods: int, settle: int, part: int) -> list[Measured]:
    """The responses with a part of the communication step."""
    tones = drive.tones
    step: Fraction = prepared.grid.step_size / part
    steps = tones.steps * part
    time = np.arange(steps) * float(step)
    peak = np.max(np.abs(np.sin(np.outer(time, tones.omega) + tones.phases).sum(axis=1)))
    factor = drive.amplitude / float(peak)
    begin = prepared.grid.start
    system = _excited(prepared.system, drive, factor, float(begin))
    layout = Layout.of(system)
    places = [layout.index[port] for port in drive.targets]
    rows = np.zeros((len(places), (settle + periods) * steps))

    class Observer:
        def __call__(self, point: Point, signals: Signals) -> None:
            if point.index < rows.shape[1]:
                rows[:, point.index] = signals.values[places]

        def observe_block(self, first: int, times: Array, values: Array) -> None:
            last = min(first + len(values), rows.shape[1])
            rows[:, first:last] = values[: last - first, places].T

    grid = Grid(begin, step, (settle + periods) * steps)
    report = Report()
    simulate(system, prepared.master, grid, [Observer()], report, loop=prepared.config.model.run.loop)
    if report.ended is not None:
        raise report.ended
    measured = []
    for row in rows:
        answer = row.reshape(settle + periods, steps)[settle:]
        # What differs from period to period by the same amount is a ramp.
        slope = np.mean(np.diff(answer, axis=0)) / steps
        answer = answer - slope * np.arange(periods * steps).reshape(periods, steps)
        measured.append(tones.measured(answer, factor))
    return measured


def _excited(system: System, drive: _Drive, factor: float, start: float) -> System:
    """The system with a multisine at an input, and the targets recorded."""
    source, cut, tones = drive.source, drive.cut, drive.tones
    old = next((one for one in system.connections if one.target == source), None)
    effect = _Multisine(
        keep=0.0 if cut else 1.0,
        start=start,
        factor=factor if cut or old is None else factor / old.gain,
        omega=tuple(tones.omega.tolist()),
        phases=tuple(tones.phases.tolist()),
    )
    recorded = tuple(dict.fromkeys(drive.targets))
    if cut or old is None:
        # Some output has to stand at the wire's begin. One of the same instance is never known ahead, so that
        # every master without extrapolation feeds the value of the step's begin.
        output = _some_output(system, source.instance)
        level = _start_value(system, source)
        wire = Wire((Leg(output, 0.0),), (Link(effect, "multisine", (), False),))
        others = [one for one in system.connections if one.target != source]
        new = Connection(output, source, 1.0, level, wire)
        return replace(system, connections=(*others, new), recorded=recorded)
    return replace(with_effect(system, source, effect), recorded=recorded)


def with_effect(system: System, target: Port, effect: Effect) -> System:
    """The system with one effect more at the end of the connection that feeds an input."""
    (old,) = [one for one in system.connections if one.target == target]
    legs = (Leg(old.source),) if old.wire is None else old.wire.legs
    links = () if old.wire is None else old.wire.links
    wire = Wire(legs, (*links, Link(effect, type(effect).__name__.strip("_").lower())))
    new = Connection(old.source, target, old.gain, old.offset, wire)
    return replace(system, connections=tuple(new if one is old else one for one in system.connections))


def _start_value(system: System, source: Port) -> float:
    """The operating point of a driven input: its start value, in the FMU's unit."""
    instance = next(one for one in system.instances if one.name == source.instance)
    value = instance.start.get(source.variable, instance.variable(source.variable).start)
    return 0.0 if value is None else float(value)


def _some_output(system: System, name: str) -> Port:
    instances = sorted(system.instances, key=lambda one: one.name != name)
    return next(
        Port(one.name, variable.name)
        for one in instances
        for variable in one.fmu.description.outputs
        if variable.kind.numeric
    )


def _unknown(system: System, source: str, targets: Sequence[str], place: str) -> list[Problem]:
    """Names that are no numeric ports of the system."""
    problems = []
    for name, causality in ((source, Causality.INPUT), *((one, Causality.OUTPUT) for one in targets)):
        there = [
            f"{one.name}.{variable.name}"
            for one in system.instances
            for variable in one.fmu.description.variables.values()
            if variable.causality is causality and variable.kind.numeric
        ]
        if name not in there:
            kind = causality.value
            allowed = f"{kind}s: {listed(there)}"
            problems.append(Problem(place, f"no numeric {kind} {name}", allowed, nearest(name, there)))
    return problems
