"""The frequency response of any FMU, measured: a multisine through its steps, with coherence.

All frequencies are in the record at once, each a whole number of times, with Schroeder's phases (IEEE Trans.
Inf.
Theory 16, 1970) that keep the peak low; the first period lets transients die away and is dropped. What the
response differs from period to period, and what it gives at frequencies that are not in the input, lowers the
coherence: a nonlinear or a ringing FMU shows there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import bundled
from ..errors import ConfigError, Problem, StepError, listed, nearest
from ..fmi import Fmu, Point, StepStatus, Value, load_fmu
from .transfer import Array

__all__ = ["Measured", "direct_gains", "sweep"]


@dataclass(frozen=True)
class Measured:
    """A measured frequency response.

    Attributes:
        omega: frequencies, shape (n,) [rad/s].
        response: output over input, shape (n,), in the FMU's units.
        coherence: share of the output around each frequency that the input explains, 0 to 1, shape (n,).
    """

    omega: Array
    response: NDArray[np.complex128]
    coherence: Array

    def frequency_response(self) -> Any:
        """As python-control's FrequencyResponseData."""
        import control

        return control.frd(self.response, self.omega)


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

    An FMU that interpolates inputs gets value and two derivatives of the multisine; any other holds, as the
    masters'
    extrapolation has it, the value of the step's end where the input acts on the output at once, else of its
    middle.
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
    loaded = _load(fmu)
    harmonics, steps, lowest = _record(loaded, source, target, frequencies, step_size, amplitude, periods)
    description = loaded.description
    omega = 2.0 * np.pi * lowest * harmonics
    phases = -np.pi * np.arange(len(harmonics)) * (np.arange(len(harmonics)) - 1) / len(harmonics)
    time = np.arange(steps) * step_size
    direct = source in description.variables and _acts_at_once(loaded, source, target)
    interpolating = description.capabilities.interpolate_inputs
    late = 0.0 if interpolating else step_size if direct else 0.5 * step_size
    curves = [_multisine(time + late, omega, phases, order) for order in range(3)]
    factor = amplitude / np.max(np.abs(curves[0]))
    value, slope, bend = (curve * factor for curve in curves)
    answer = _run(
        loaded, source, target, value + offset, (slope, bend), step_size, dict(start or {}), inputs, periods
    )
    spectrum = np.fft.rfft(answer.reshape(periods, steps), axis=1) / steps
    # The input at the instants at which outputs are read, the steps' ends: exact, not the held one.
    given = 0.5 * factor * np.exp(1j * (phases + omega * step_size)) / 1j
    mean = spectrum.mean(axis=0)
    return Measured(omega, mean[harmonics] / given, _coherence(spectrum, harmonics))


def direct_gains(
    fmu: Fmu | Path | str, inputs: list[str], outputs: list[str], start: Mapping[str, Value] | None = None
) -> Array:
    """Partial derivatives of outputs by inputs at the start: the gain at infinite frequency, shape (outputs,
    inputs).

    Raises: ConfigError if the FMU offers no directional derivatives.
    """
    loaded = _load(fmu)
    name = loaded.description.name
    if not loaded.description.capabilities.directional_derivatives:
        what = "it offers no directional derivatives"
        raise ConfigError([Problem(name, what, "", "Measure the response with sweep.")])
    instance = loaded.instantiate("linearised")
    try:
        instance.enter_initialisation(0.0, dict(start or {}))
        instance.exit_initialisation()
        return instance.output_derivatives(outputs, inputs)
    finally:
        instance.free()


def _load(fmu: Fmu | Path | str) -> Fmu:
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


def _record(
    fmu: Fmu,
    source: str,
    target: str,
    frequencies: ArrayLike,
    step_size: float,
    amplitude: float,
    periods: int,
) -> tuple[NDArray[np.int64], int, float]:
    """Harmonics of the lowest frequency, steps in its period, and itself [Hz]; refuses what does not fit."""
    wanted = np.unique(np.atleast_1d(np.asarray(frequencies, np.float64)))
    place, problems = fmu.description.name, []
    for name, causality in ((source, "input"), (target, "output")):
        there = [key for key, one in fmu.description.variables.items() if one.causality.value == causality]
        if name not in there:
            problems.append(
                Problem(
                    place, f"no {causality} {name}", f"{causality}s: {listed(there)}", nearest(name, there)
                )
            )
    if not wanted.size or not (np.isfinite(wanted).all() and wanted[0] > 0.0):
        problems.append(Problem(place, "a frequency is not positive", "allowed: finite and positive [Hz]"))
    if not (step_size > 0.0 and amplitude > 0.0 and periods >= 1):
        got = f"step_size = {step_size!r} s, amplitude = {amplitude!r}, periods = {periods!r}"
        problems.append(Problem(place, got, "all are to be positive"))
    if problems:
        raise ConfigError(problems)
    steps = 1.0 / (wanted[0] * step_size)
    if abs(steps - round(steps)) > 1e-6 * steps:
        what = f"the period of {wanted[0]:g} Hz is {steps:.6g} steps of {step_size:g} s"
        raise ConfigError([Problem(place, what, "a whole number is needed")])
    if wanted[-1] * step_size > 0.1:
        what = f"{wanted[-1]:g} Hz has {1 / (wanted[-1] * step_size):.3g} steps in a period"
        raise ConfigError([Problem(place, what, "at least 10 are needed", "Take a smaller step size.")])
    return np.unique(np.rint(wanted / wanted[0]).astype(np.int64)), round(steps), float(wanted[0])


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
    interpolating = fmu.description.capabilities.interpolate_inputs
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


def _coherence(spectrum: NDArray[np.complex128], harmonics: NDArray[np.int64]) -> Array:
    """1 - unexplained/all power: what changes between periods, what lies beside the input's frequencies."""
    mean = spectrum.mean(axis=0)
    change = np.mean(np.abs(spectrum[:, harmonics] - mean[harmonics]) ** 2, axis=0)
    power = np.abs(mean) ** 2
    others = power.copy()
    others[[0, *harmonics]] = 0.0
    # Each harmonic answers for what lies halfway to its neighbours.
    edges = np.concatenate([[1], (harmonics[:-1] + harmonics[1:] + 1) // 2, [len(power)]])
    beside = np.array([others[low:high].sum() for low, high in pairwise(edges)])
    return power[harmonics] / np.maximum(power[harmonics] + change + beside, 1e-300)
