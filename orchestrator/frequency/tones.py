"""Design a multisine input, and compute frequency response and coherence from the output.

All frequencies are in the record at once, each a whole number of times, with Schroeder's phases (IEEE Trans.
Inf. Theory 16, 1970) that keep the peak low; the first period lets transients die away and is dropped. What
the response differs from period to period, and what it gives at frequencies that are not in the input, lowers
the coherence: a nonlinear or a ringing system shows there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arrays import Array, Complex
from ..base.errors import ConfigError, Problem


@dataclass(frozen=True)
class Measured:
    """A measured frequency response.

    Attributes:
        omega: frequencies, shape (n,) [rad/s].
        response: output over input, shape (n,), in the FMUs' units.
        coherence: share of the output around each frequency that the input explains, 0 to 1, shape (n,).
        step_effect: what the communication step makes of the response, relative, shape (n,); `response` is
            then the limit of small steps. None where it was not measured.
    """

    omega: Array
    response: Complex
    coherence: Array
    step_effect: Complex | None = None


@dataclass(frozen=True)
class Tones:
    """The frequencies of a record.

    Attributes:
        harmonics: of the lowest frequency, shape (n,).
        omega: shape (n,) [rad/s].
        phases: shape (n,) [rad].
        steps: in a period of the lowest frequency.
    """

    harmonics: NDArray[np.int64]
    omega: Array
    phases: Array
    steps: int

    @staticmethod
    def of(
        place: str,
        frequencies: ArrayLike,
        step_size: float,
        amplitude: float,
        periods: int,
        problems: Sequence[Problem] = (),
    ) -> Tones:
        """Choose frequencies and phases of a record.

        Args:
            place: stands in messages.
            frequencies: wanted [Hz]; each is moved to the nearest whole multiple of the lowest.
            step_size: [s]; the period of the lowest frequency is to be a whole number of steps.
            amplitude: only checked.
            periods: only checked.
            problems: found before.
        Raises: ConfigError with all problems.
        """
        wanted, problems = np.unique(np.atleast_1d(np.asarray(frequencies, np.float64))), list(problems)
        if not wanted.size or not (np.isfinite(wanted).all() and wanted[0] > 0.0):
            what = "a frequency is not positive"
            problems.append(Problem(place, what, "allowed: finite and positive [Hz]"))
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
        harmonics = np.unique(np.rint(wanted / wanted[0]).astype(np.int64))
        count = np.arange(len(harmonics))
        phases = -np.pi * count * (count - 1) / len(harmonics)
        return Tones(harmonics, 2.0 * np.pi * float(wanted[0]) * harmonics, phases, round(steps))

    def measured(self, answer: Array, factor: float, ahead: float = 0.0) -> Measured:
        """The response in a record of the output.

        Args:
            answer: shape (periods, steps), the instants k * step_size + ahead.
            factor: amplitude of each tone sin(omega t + phase) of the input.
            ahead: [s].
        """
        spectrum = np.fft.rfft(answer, axis=1) / answer.shape[1]
        given = 0.5 * factor * np.exp(1j * (self.phases + self.omega * ahead)) / 1j
        mean = spectrum.mean(axis=0)
        return Measured(self.omega, mean[self.harmonics] / given, _coherence(spectrum, self.harmonics))


def _coherence(spectrum: Complex, harmonics: NDArray[np.int64]) -> Array:
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
