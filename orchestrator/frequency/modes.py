"""Modes of a linear system: characteristic roots, and the states that take part in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mode:
    """A characteristic root, or a conjugate pair of them.

    Attributes:
        root: the one with the imaginary part that is not negative [rad/s].
        residual: smallest singular value of the equation's matrix there, relative to its norm.
        participation: share of each state in the mode, by name, largest first; they sum to 1.
    """

    root: complex
    residual: float
    participation: tuple[tuple[str, float], ...]

    @property
    def frequency(self) -> float:
        """|root| / (2 pi) [Hz]."""
        return abs(self.root) / (2.0 * np.pi)

    @property
    def damping(self) -> float:
        """Damping ratio, -Re/|root|; 1 at zero."""
        # No negative zero.
        return float(-self.root.real / abs(self.root)) + 0.0 if self.root else 1.0

    def __repr__(self) -> str:
        states = ", ".join(f"{name} {100 * share:.0f} %" for name, share in self.participation[:3])
        size = f"{self.frequency:.4g} Hz, damping {self.damping:.4g}" if self.root.imag else "real"
        root = f"{self.root:.6g}" if self.root.imag else f"{self.root.real:.6g}"
        return f"{root} 1/s: {size}; {states}"


@dataclass(frozen=True)
class Modes:
    """The rightmost modes.

    Attributes:
        modes: from the right to the left.
        line: a real part [rad/s] to the right of which there are these roots and no others, by counting.
    """

    modes: tuple[Mode, ...]
    line: float

    def __repr__(self) -> str:
        return "\n".join(map(repr, self.modes))

    @property
    def unstable(self) -> int:
        """How many roots have a positive real part; those at 0, to rounding, do not."""
        size = max((abs(one.root) for one in self.modes), default=0.0)
        growing = [one.root for one in self.modes if one.root.real > 0.0 and abs(one.root) > 1e-12 * size]
        return sum(2 if one.imag > 0.0 else 1 for one in growing)

    @property
    def stable(self) -> bool:
        """Whether all roots lie to the left of the imaginary axis."""
        return all(one.root.real < 0.0 for one in self.modes)

    @property
    def dominant(self) -> Mode | None:
        """The rightmost mode whose root is not 0, as integrators of a reference have; None without one."""
        size = max((abs(one.root) for one in self.modes), default=0.0)
        return next((one for one in self.modes if abs(one.root) > 1e-9 * size), None)
