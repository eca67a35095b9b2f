"""Eigenvalues of the linear system that a master steps, and how many of them are unstable.

Eigenvalues z of the matrix from one communication point to the next give the roots log(z)/period. Delays of
many steps are kept as powers of z, so that the matrix stays small.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..base.arrays import Array, Complex
from ..base.errors import OrchestratorError
from .modes import Mode

_SHOWN = 6
# Eigenvalues below this size have decayed after a few steps.
_GONE = 1e-6
# Up to this size all eigenvalues of the full matrix are found at once.
_DENSE = 300
_RADIUS = 1.0 + 1e-8
_TURN = 0.7
# Radii that Newton's method begins at, and the least of a root that it looks for.
_STARTS = (1.0, 0.97, 0.85)
_LEAST = 0.3
_RESIDUAL = 1e-12
# How many eigenvalues nearest to 1 are looked for in turn, from a place beside it.
_NEAREST = (20, 80)
_BESIDE = 1.0 + 1e-4 + 1e-4j
_MOST_ANGLES = 200_000


class Late(NamedTuple):
    """What a signal adds to the complete state so many periods later.

    Attributes:
        lag: periods.
        head: row of the signal.
        column: what it adds, shape (n,).
    """

    lag: int
    head: int
    column: Array


@dataclass(frozen=True)
class SampledSystem:
    """What a master makes of a linear system: z(k+1) = M z(k) + sum of column z_head(k - lag).

    Attributes:
        step_size: the communication step [s].
        period: after which holds and instances with longer steps repeat: the step or a multiple of it [s].
        core: M, shape (n, n).
        late: what delays add; together with M they are one matrix of `size` rows.
        states: name of the continuous state in each row; empty for held signals and what effects remember.
        resting: eigenvalues 1 that the continuous system has as roots 0, such as of integrators.
    """

    step_size: float
    period: float
    core: Array
    late: tuple[Late, ...]
    states: tuple[str, ...]
    resting: int

    @cached_property
    def _longest(self) -> dict[int, int]:
        longest: dict[int, int] = {}
        for one in self.late:
            longest[one.head] = max(longest.get(one.head, 0), one.lag)
        return longest

    @property
    def size(self) -> int:
        """Numbers that the complete state consists of."""
        return len(self.core) + sum(self._longest.values())

    def _entries(self) -> tuple[Any, Any, Array]:
        """Rows, columns and values of the complete state's matrix; its first rows are those of `core`."""
        n = len(self.core)
        rows, columns = np.nonzero(self.core)
        parts = [(rows, columns, self.core[rows, columns])]
        low = n
        for head, length in self._longest.items():
            line = np.arange(low, low + length)
            parts.append((line, np.concatenate([[head], line[:-1]]), np.ones(length)))
            for one in self.late:
                if one.head == head:
                    fed = np.flatnonzero(one.column)
                    parts.append((fed, np.full(len(fed), low + one.lag - 1), one.column[fed]))
            low += length
        rows, columns, values = (np.concatenate(each) for each in zip(*parts, strict=True))
        return rows, columns, values

    @property
    def matrix(self) -> Array:
        """The complete state's, shape (size, size)."""
        rows, columns, values = self._entries()
        whole = np.zeros((self.size, self.size))
        np.add.at(whole, (rows, columns), values)
        return whole

    @cached_property
    def _eigenvalues(self) -> Complex:
        """All of them, of a small system."""
        return np.linalg.eigvals(self.matrix).astype(np.complex128)

    @cached_property
    def unstable(self) -> int:
        """How many eigenvalues lie outside the unit circle, those `resting` left out.

        Of large systems they are counted by the argument principle, outside a circle of radius 1 + 1e-8.
        Raises: OrchestratorError if one lies on this circle.
        """
        if self.size <= _DENSE:
            return int(np.sum(np.abs(self._moving(self._eigenvalues)) > 1.0 + 1e-10))
        return self._outside(_RADIUS)

    def _outside(self, radius: float) -> int:
        """How many eigenvalues lie outside a circle, by the argument principle.

        Raises: OrchestratorError if one lies on it.
        """
        angle = np.concatenate([[0.0], np.geomspace(1e-9, np.pi, 500)])
        sign: Complex = self._signs(np.asarray(radius * np.exp(1j * angle)))
        while True:
            turn = np.angle(sign[1:] / sign[:-1])
            rough = np.flatnonzero(abs(turn) > _TURN)
            if not rough.size:
                return -round(float(np.sum(turn)) / np.pi)
            if min(np.diff(angle)[rough]) < 1e-13 or len(angle) > _MOST_ANGLES:
                raise OrchestratorError(
                    f"an eigenvalue of the sampled system lies on the circle |z| = {radius:g}"
                )
            middle = 0.5 * (angle[rough] + angle[rough + 1])
            angle = np.insert(angle, rough + 1, middle)
            sign = np.insert(sign, rough + 1, self._signs(radius * np.exp(1j * middle)))

    def _at(self, z: Complex) -> Complex:
        """M with what is late at eigenvalues z, shape (len(z), n, n)."""
        made = np.broadcast_to(self.core, (len(z), *self.core.shape)).astype(np.complex128)
        for one in self.late:
            made[:, :, one.head] += (z**-one.lag)[:, None] * one.column
        return made

    def _signs(self, z: Complex) -> Complex:
        """det(1 - M/z) over its size."""
        eye = np.eye(len(self.core))
        parts = np.array_split(z, max(len(z) * len(eye) ** 2 // 1_000_000, 1))
        return np.concatenate(
            [np.linalg.slogdet(eye - self._at(one) / one[:, None, None])[0] for one in parts]
        )

    def _moving(self, z: Complex) -> Complex:
        """The eigenvalues without those that rest, the largest first."""
        near = np.argsort(abs(z - 1.0))[: self.resting]
        near = near[abs(z[near] - 1.0) < 1e-5]
        left = np.delete(z, near)
        return left[np.argsort(-abs(left), kind="stable")]

    def modes(self, count: int = _SHOWN) -> tuple[Mode, ...]:
        """The `count` modes with the largest |z|, and those of `resting` left out.

        Of large systems they are found by Newton's method from all around the unit circle.

        Returns: roots log(z)/period [1/s]; the residual is that of the eigenvector, relative to the matrix.
        """
        z = self._eigenvalues if self.size <= _DENSE else self._searched()
        wanted = self._moving(z[z.imag >= 0.0])
        return tuple(self._mode(complex(one)) for one in wanted[abs(wanted) > _GONE][:count])

    def _mode(self, z: complex) -> Mode:
        matrix = self._at(np.array([z]))[0]
        left, values, right = np.linalg.svd(z * np.eye(len(matrix)) - matrix)
        share = abs(left[:, -1] * right[-1])
        share = np.where([bool(name) for name in self.states], share, 0.0)
        share = share / share.sum() if share.sum() else share
        order = [index for index in np.argsort(-share) if share[index] > 1e-3]
        named = tuple((self.states[index], float(share[index])) for index in order)
        return Mode(complex(np.log(z) / self.period), float(values[-1] / max(values[0], abs(z))), named)

    def _searched(self) -> Complex:
        """The largest eigenvalues, until counting finds no others among them, and some that lie near them."""
        from scipy.sparse import csc_array  # slow to import
        from scipy.sparse.linalg import eigs

        angles = np.concatenate([[0.0], np.geomspace(1e-6, np.pi, 60 if len(self.core) <= 100 else 20)])
        found: list[complex] = []
        for start in np.outer(_STARTS, np.exp(1j * angles)).ravel():
            guesses = np.linalg.eigvals(self._at(np.array([start]))[0])
            self._refine(guesses[np.argsort(abs(guesses - start))[:2]], found)
        for count in _NEAREST:
            if self._complete(found) or count >= self.size - 1:
                break
            # Slow modes lie close together at 1.
            rows, columns, values = self._entries()
            whole = csc_array((values, (rows, columns)), shape=(self.size, self.size))
            self._refine(eigs(whole, count, sigma=_BESIDE)[0], found)
        return np.array(found, np.complex128)

    def _complete(self, found: Sequence[complex]) -> bool:
        """Whether there are no others outside a circle within which all but those that are shown lie."""
        sizes = np.sort(abs(np.array(found)))[::-1]
        gaps = np.flatnonzero(sizes[_SHOWN:-1] > sizes[_SHOWN + 1 :] * (1.0 + 1e-7)) + _SHOWN
        if not gaps.size:
            return False
        radius = float(np.sqrt(sizes[gaps[0]] * sizes[gaps[0] + 1]))
        known = sum(1 if one.imag == 0.0 else 2 for one in found if abs(one) > radius)
        try:
            return self._outside(radius) == known
        except OrchestratorError:
            return False

    def _refine(self, guesses: Complex, found: list[complex]) -> None:
        """Add the eigenvalues near guesses that are not known."""
        for guess in guesses:
            z = self._newton(complex(guess))
            if z is not None and not any(abs(z - one) <= 1e-8 * abs(one - 1.0) + 1e-13 for one in found):
                found.append(z)

    def _newton(self, z: complex) -> complex | None:
        eye, vector = np.eye(len(self.core)), None
        # Further in, what is late outgrows all else.
        least = max(_LEAST, math.exp(-25.0 / max(self._longest.values(), default=1)))
        for _ in range(40):
            if not least < abs(z) < 10.0:
                return None
            matrix = z * eye - self._at(np.array([z]))[0]
            slope = eye.astype(np.complex128)
            for one in self.late:
                slope[:, one.head] += one.lag * z ** (-one.lag - 1) * one.column
            if vector is None:
                vector = np.linalg.svd(matrix)[2][-1].conj()
                norm = vector.conj()
            whole = np.block([[matrix, (slope @ vector)[:, None]], [norm[None], np.zeros((1, 1))]])
            try:
                step = np.linalg.solve(whole, np.concatenate([-(matrix @ vector), [1.0 - norm @ vector]]))
            except np.linalg.LinAlgError:
                return None
            vector, z = vector + step[:-1], z + complex(step[-1])
            if abs(step[-1]) <= 1e-14:
                z = complex(z.real, abs(z.imag) if abs(z.imag) > 1e-13 else 0.0)
                return z if least < abs(z) and self._mode(z).residual < _RESIDUAL else None
        return None
