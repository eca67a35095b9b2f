"""A loop that is cut at one connection, as people use it from Python."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..base.arrays import Array, Complex
from .delay_system import DelaySystem
from .disk import disk_margin
from .margins import Margins

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class OpenLoop:
    """L(s) of a connection, of negative feedback: the closed loop has its poles where 1 + L(s) = 0.

    Attributes:
        system: the closed system.
        connection: as its links name it.
    """

    system: DelaySystem
    connection: str

    @cached_property
    def frequencies(self) -> Array:
        """Frequencies around the crossovers and the slowest modes, shape (k,) [rad/s]."""
        modes = self.system.modes()
        sizes = [abs(mode.root) for mode in modes.modes if abs(mode.root) > 1e-9][:2]
        sizes += [each.omega for each in self.margins().crossovers]
        return np.geomspace(0.05 * min(sizes or [1.0]), 20.0 * max(sizes or [1.0]), 1500)

    def __call__(self, omega: ArrayLike) -> Complex:
        """L(j omega), exact; shape of omega [rad/s]."""
        return self.system.response(self.connection, 1j * np.asarray(omega, np.float64))

    def margins(self) -> Margins:
        """Gain, phase, delay and modulus margin with all crossovers."""
        return self.system.margins(self.connection)

    def disk_margin(self) -> float:
        """By how much gain and phase may change at once; NaN where the closed loop is unstable."""
        return disk_margin(self.system, [self.connection]).margin

    def to_control(self, order: int = 6) -> control.StateSpace:
        """For python-control, delays by Pade's approximation; see `DelaySystem.to_control`."""
        return self.system.to_control(self.connection, order)

    def to_response(self, omega: ArrayLike | None = None) -> control.FrequencyResponseData:
        """For python-control, exact, at `omega` [rad/s] or around the crossovers."""
        return self.system.to_response(self.connection, self.frequencies if omega is None else omega)

    def bode(self) -> Figure:
        """Bode diagram."""
        from . import figures

        return figures.bode(self.connection, self.frequencies, self(self.frequencies))

    def nyquist(self) -> Figure:
        """Nyquist diagram."""
        from . import figures

        return figures.nyquist(self.connection, self.frequencies, self(self.frequencies))

    def nichols(self) -> Figure:
        """Nichols diagram."""
        from . import figures

        return figures.nichols(self.connection, self.frequencies, self(self.frequencies))

    def step(self, time: ArrayLike) -> Array:
        """How the closed loop follows a step; see `DelaySystem.step_response`."""
        return self.system.step_response(self.connection, time)

    def __repr__(self) -> str:
        return f"loop at {self.connection}: {self.margins()!r}"
