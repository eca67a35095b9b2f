"""The frequency response of any FMU, measured: a multisine through its steps, with coherence."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..base.arrays import Array
from ..base.errors import ConfigError, Problem, StepError, listed, nearest
from ..fmi import Fmu, Point, StepStatus, Value, bundled, load_fmu
from .tones import Measured, Tones


def sweep(
    fmu: Fmu | Path | str,
    source: str,
    target: str,
    frequencies: ArrayLike,
    *,
    step_size: float,
    amplitude: float,
    offset: float = 0.0,
    start: Mapping[str, Value] | None = None,
    inputs: Mapping[str, float] | None = None,
    periods: int = 2,
) -> Measured:
    """Measure the response of an FMU's output to one of its inputs around an operating point.

    An FMU that follows the course of the input over a step gets value and two derivatives of the multisine;
    any other holds, as the masters' extrapolation has it, the value of the step's end where the input acts on
    the output at once, else of its middle.
    At frequency f the hold then leaves a relative error of (2 pi f step_size)^2/24, without phase.

    Args:
        fmu: a bundled name, a path or what `load_fmu` gave.
        source, target: names of a real input and output.
        frequencies: wanted [Hz]; each is moved to the nearest whole multiple of the lowest.
        step_size: [s]; the period of the lowest frequency is to be a whole number of steps.
        amplitude: largest deviation of the input, in its unit.
        offset: the input's operating point, in its unit.
        start: start values, FMU's units.
        inputs: other inputs' values, held, FMU's units.
        periods: of the lowest frequency that are measured, after one that is not.
    Raises: ConfigError for names and numbers that do not fit; StepError if the FMU fails.
    """
    loaded = load(fmu)
    description = loaded.description
    problems = _unknown_ports(loaded, source, target)
    tones = Tones.of(description.name, frequencies, step_size, amplitude, periods, problems)
    omega, phases, steps = tones.omega, tones.phases, tones.steps
    time = np.arange(steps, dtype=np.float64) * step_size
    direct = source in description.variables and _acts_at_once(loaded, source, target)
    interpolating = source in description.followed
    late = 0.0 if interpolating else step_size if direct else 0.5 * step_size
    curves = [_multisine(time + late, omega, phases, order) for order in range(3)]
    factor = amplitude / np.max(np.abs(curves[0]))
    value, slope, bend = (curve * factor for curve in curves)
    answer = _run(
        loaded, source, target, value + offset, (slope, bend), step_size, dict(start or {}), inputs, periods
    )
    # The input at the instants at which outputs are read, the steps' ends: exact, not the held one.
    return tones.measured(answer.reshape(periods, steps), factor, step_size)


def load(fmu: Fmu | Path | str) -> Fmu:
    """An FMU from a path or the name of a bundled one. Raises: FmuError."""
    if not isinstance(fmu, str | Path):
        return fmu
    path = Path(fmu)
    found = path if path.is_file() else bundled.find_fmu(str(fmu))
    if found is None:
        names = bundled.fmu_names()
        raise ConfigError(
            [Problem(str(fmu), "no such FMU", f"bundled: {listed(names)}", nearest(str(fmu), names))]
        )
    return load_fmu(found)


def _unknown_ports(fmu: Fmu, source: str, target: str) -> list[Problem]:
    place, problems = fmu.description.name, []
    for name, causality in ((source, "input"), (target, "output")):
        there = [key for key, one in fmu.description.variables.items() if one.causality.value == causality]
        if name not in there:
            allowed = f"{causality}s: {listed(there)}"
            problems.append(Problem(place, f"no {causality} {name}", allowed, nearest(name, there)))
    return problems


def _acts_at_once(fmu: Fmu, source: str, target: str) -> bool:
    through = fmu.description.feedthrough.get(target)
    return through is None or source in through


def _multisine(time: Array, omega: Array, phases: Array, order: int) -> Array:
    """A derivative of the sum of sin(omega t + phase), each of amplitude one, shape (steps,)."""
    total = np.zeros(len(time))
    for w, phase in zip(omega, phases, strict=True):
        total += w**order * np.sin(w * time + phase + 0.5 * np.pi * order)
    return total


def _run(
    fmu: Fmu,
    source: str,
    target: str,
    value: Array,
    derivatives: tuple[Array, ...],
    step_size: float,
    start: dict[str, Value],
    inputs: Mapping[str, float] | None,
    periods: int,
) -> Array:
    """The output at the steps' ends, without the first period, shape (periods * steps,)."""
    others = dict(inputs or {})
    names = (source, *others)
    u, y = np.array([value[0], *others.values()], np.float64), np.zeros(1)
    steps = len(value)
    answer = np.zeros(periods * steps)
    rates = np.zeros(len(names))
    interpolating = source in fmu.description.followed
    instance = fmu.instantiate("swept")
    try:
        instance.bind(names, u, (target,), y)
        instance.enter_initialisation(0.0, start, None)
        instance.write_inputs()
        instance.exit_initialisation()
        for index in range((periods + 1) * steps):
            place = index % steps
            u[0] = value[place]
            instance.write_inputs()
            if interpolating:
                for order, curve in enumerate(derivatives, 1):
                    rates[0] = curve[place]
                    instance.write_input_derivatives(order, rates)
            status = instance.do_step(Point(index, index * step_size, step_size))
            if status > StepStatus.WARNING:
                raise StepError(
                    f"refused a step of {step_size!r} s",
                    instance="swept",
                    time=index * step_size,
                    status=status.name.lower(),
                    log=instance.log_lines(),
                )
            instance.read_outputs()
            if index >= steps:
                answer[index - steps] = y[0]
        instance.terminate()
    finally:
        instance.free()
    return answer
