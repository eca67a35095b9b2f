"""Linear systems of delayed connections: x' = A x + B u, y = C x + D u, u = sum of K_k y(t - tau_k).

How many roots lie to the right of a line follows from the argument principle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ..base.arrays import Array, Complex
from ..base.errors import ConfigError, OrchestratorError, Problem, listed

# Neighbouring values on the contour turn by less than this [rad], or more are taken between them.
_TURN = 0.7
_MOST_POINTS = 400_000
_TOGETHER = 64
# Of systems with more states the instances are reduced to what links see; in blocks of so many rows.
SMALL = 40
_BLOCK = 32


class Link(NamedTuple):
    """One term of a connection: input += gain * output(t - delay).

    Attributes:
        connection: the connection that it belongs to, as messages name it.
        source, target: indices of the output and the input.
        delay: [s].
    """

    connection: str
    source: int
    target: int
    gain: float
    delay: float = 0.0


@dataclass(frozen=True)
class DelayEquation:
    """P(s) v = 0 of a closed linear system with delays, and its roots.

    Attributes:
        a, b, c, d: of all instances, block by block; shapes (n, n), (n, m), (p, n), (p, m).
        states, inputs, outputs: names.
        links: what feeds the inputs.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    links: tuple[Link, ...]

    @cached_property
    def _delays(self) -> Array:
        return np.unique([one.delay for one in self.links] or [0.0])

    def _gains(self, links: Sequence[Link]) -> Array:
        """One matrix for each of `_delays`, shape (k, m, p)."""
        made = np.zeros((len(self._delays), len(self.inputs), len(self.outputs)))
        for one in links:
            made[np.searchsorted(self._delays, one.delay), one.target, one.source] += one.gain
        return made

    @cached_property
    def _k(self) -> Array:
        return self._gains(self.links)

    def _matrix(self, s: Complex, gains: Array | None = None) -> Complex:
        """P(s) = [[s - A, -B], [-K(s) C, 1 - K(s) D]], shape (len(s), n + m, n + m)."""
        n, gains = len(self.states), self._k if gains is None else gains
        made = np.zeros((len(s), n + len(self.inputs), n + len(self.inputs)), np.complex128)
        made[:, :n, :n], made[:, :n, n:] = -self.a, -self.b
        made[:, n:, n:] = np.eye(len(self.inputs))
        made[:, range(n), range(n)] += s[:, None]
        whole = np.concatenate([self.c, self.d], axis=1)
        for delay, matrix in zip(self._delays, gains, strict=True):
            rows = np.flatnonzero(matrix.any(axis=1))
            back = matrix[rows] @ whole
            made[:, n + rows] -= back if delay == 0.0 else np.exp(-s * delay)[:, None, None] * back
        return made

    def _driven(self, s: Complex, drive: Array, gains: Array | None = None) -> tuple[Complex, Complex]:
        """Inputs and outputs where something is added to the inputs.

        Only states and what is late are solved for: most links of large systems are not late.

        Args: drive: shape (m, k); gains: of links, as `_gains` has them; None: of all.
        Returns: shapes (len(s), m, k) and (len(s), p, k).
        Raises: numpy.linalg.LinAlgError at a root.
        """
        gains, n = self._k if gains is None else gains, len(self.states)
        late = [
            (place, source)
            for place, delay in enumerate(self._delays)
            if delay > 0.0
            for source in np.flatnonzero(gains[place].any(axis=0))
        ]
        sources = [source for _, source in late]
        into = np.array([gains[place, :, source] for place, source in late]).reshape(len(late), len(drive)).T
        now = gains[0] if self._delays[0] == 0.0 else np.zeros(gains[0].shape)
        solved = np.linalg.inv(np.eye(len(self.inputs)) - now @ self.d)
        # u = U (x, v) + u0 and y = Y (x, v) + y0 with v what is late.
        u, u0 = solved @ np.hstack([now @ self.c, into]), solved @ drive
        y, y0 = np.hstack([self.c, np.zeros((len(self.c), len(late)))]) + self.d @ u, self.d @ u0
        turn = np.exp(-s[:, None] * self._delays[[place for place, _ in late]])
        matrix = np.zeros((len(s), n + len(late), n + len(late)), np.complex128)
        matrix[:, range(n + len(late)), range(n + len(late))] = 1.0
        matrix[:, range(n), range(n)] = s[:, None]
        matrix[:, :n] -= np.hstack([self.a, np.zeros((n, len(late)))]) + self.b @ u
        matrix[:, n:] -= turn[:, :, None] * y[sources]
        right = np.zeros((len(s), n + len(late), drive.shape[1]), np.complex128)
        right[:, :n], right[:, n:] = self.b @ u0, turn[:, :, None] * y0[sources]
        found = np.linalg.solve(matrix, right)
        return u @ found + u0, y @ found + y0

    def _slope(self, s: complex) -> Complex:
        """dP/ds."""
        n = len(self.states)
        k = np.einsum("k,kmp->mp", -self._delays * np.exp(-s * self._delays), self._k)
        made = np.zeros((n + len(self.inputs),) * 2, np.complex128)
        made[:n, :n] = np.eye(n)
        made[n:, :n], made[n:, n:] = -k @ self.c, -k @ self.d
        return made

    def check(self) -> None:
        """Raises: ConfigError if an algebraic loop has no solution, or a loop with a delay has no state."""
        if self.inputs and np.linalg.cond(self._loop_at_once) > 1e12:
            share = abs(np.linalg.svd(self._loop_at_once)[2][-1])
            names = [name for name, one in zip(self.inputs, share, strict=True) if one > 1e-6]
            what = f"the algebraic loop through {listed(names)} has no solution, or no single one"
            raise ConfigError([Problem("system", what, "", "Put a state or a delay into the loop.")])
        if not _contracts(self._shift()):
            what = "a loop holds a delay and direct feedthrough of gain 1 or more, and no state"
            remedy = "Put a filter into the loop: a real system has one."
            raise ConfigError([Problem("system", what, "loops with delay need a state", remedy)])

    def _shift(self, line: float = 0.0) -> Array:
        """Bound of what delayed feedthrough makes of inputs: |S| sum |K_k| |D| right of a line."""
        delayed = self._delays > 0.0
        weight = np.exp(-line * self._delays[delayed])
        sums = np.einsum("k,kmp->mp", weight, abs(self._k[delayed]))
        return abs(self._solved) @ sums @ abs(self.d)

    @cached_property
    def _at_once(self) -> Array:
        """K of the links without delay, shape (m, p)."""
        return self._k[0] if self._delays[0] == 0.0 else np.zeros(self._k[0].shape)

    @property
    def _loop_at_once(self) -> Array:
        """1 - K D of the links without delay, shape (m, m)."""
        return np.eye(len(self.inputs)) - self._at_once @ self.d

    @cached_property
    def _solved(self) -> Array:
        return np.asarray(np.linalg.inv(self._loop_at_once), np.float64)

    @cached_property
    def _undelayed(self) -> Complex:
        """Roots if nothing were late, shape (n,); empty if an algebraic loop then has no solution."""
        gains = np.sum(self._k, axis=0)
        loop = np.eye(len(self.inputs)) - gains @ self.d
        if not self.inputs or np.linalg.cond(loop) > 1e12:
            return np.zeros(0, np.complex128)
        closed = self.a + self.b @ np.linalg.solve(loop, gains @ self.c)
        return np.asarray(np.linalg.eigvals(closed), np.complex128)

    def _reach(self, line: float) -> float:
        """A radius that holds all roots right of a line: |s| |x| <= N |x|, element by element."""
        shift = self._shift(line)
        weight = np.exp(-line * self._delays)
        fed = abs(self._solved) @ np.einsum("k,kmp->mp", weight, abs(self._k)) @ abs(self.c)
        if not _contracts(shift):
            return np.inf
        bound = abs(self.a) + abs(self.b) @ np.linalg.solve(np.eye(len(shift)) - shift, fed)
        return 1.001 * max(abs(np.linalg.eigvals(bound)), default=0.0) + abs(line) + 1e-300

    def count_right_of(self, line: float = 0.0) -> int:
        """Number of roots with Re s > line, by the argument principle.

        Raises: OrchestratorError if a root lies on the line, or if no circle is known that holds them all.
        """
        radius = self._reach(line)
        if not np.isfinite(radius):
            raise OrchestratorError(f"roots right of {line:g} rad/s cannot be counted: no circle holds them")
        half = np.arccos(np.clip(line / radius, -1.0, 1.0))
        top = radius * np.sin(half)
        low = max(1e-9 * radius, 1e-12)
        straight = np.concatenate([[0.0], np.geomspace(low, top, 400)])[::-1]
        path = np.concatenate(
            [radius * np.exp(1j * half * np.linspace(0.0, 1.0, 65)[:-1]), line + 1j * straight]
        )
        path[0] = radius
        sign = self._signs(path)
        while True:
            if not sign.all():
                raise OrchestratorError(f"a root lies on the line Re s = {line:g} to within rounding")
            turn = np.angle(sign[1:] / sign[:-1])
            rough = np.flatnonzero(abs(turn) > _TURN)
            if not rough.size:
                break
            if len(path) > _MOST_POINTS or min(abs(path[rough + 1] - path[rough])) < 1e-13 * radius:
                raise OrchestratorError(f"a root lies on the line Re s = {line:g} to within rounding")
            middle = 0.5 * (path[rough] + path[rough + 1])
            path = np.insert(path, rough + 1, middle)
            sign = np.insert(sign, rough + 1, self._signs(middle))
        return round(float(np.sum(turn)) / np.pi)

    def _signs(self, s: Complex) -> Complex:
        """det P(s) / |det P(s)|."""
        if len(self.states) <= SMALL:
            return np.concatenate([np.linalg.slogdet(self._matrix(one))[0] for one in in_parts(s)])
        made = np.empty(len(s), np.complex128)
        near = self._near_poles(s)
        for index in np.flatnonzero(near):
            made[index] = np.linalg.slogdet(self._matrix(s[index : index + 1]))[0][0]
        # det P = det(s - A) det(1 - K G), with G of the instances alone.
        far = s[~near]
        t, _, _, _, targets, sources = self._reduced
        k = np.einsum("sk,kmp->smp", np.exp(-far[:, None] * self._delays), self._k[:, targets][:, :, sources])
        loop = np.eye(len(targets)) - k @ self._instances(far)
        apart = far[:, None] - np.diag(t)
        made[~near] = np.prod(apart / abs(apart), axis=1) * np.linalg.slogdet(loop)[0]
        return made

    @cached_property
    def _reduced(self) -> tuple[Complex, Complex, Complex, Array, list[int], list[int]]:
        """A as an upper triangular matrix; B, C and D of it, for the inputs and outputs that links use."""
        targets = sorted({one.target for one in self.links})
        sources = sorted({one.source for one in self.links})
        t, turn = scipy.linalg.schur(self.a, output="complex")
        b, c = turn.conj().T @ self.b[:, targets], self.c[sources] @ turn
        return t, b, c, self.d[np.ix_(sources, targets)], targets, sources

    def _near_poles(self, s: Complex) -> NDArray[np.bool_]:
        """Where digits are lost in the response of the instances alone."""
        poles = np.diag(self._reduced[0])
        size = np.maximum(np.median(abs(poles)), abs(s))
        return np.min(abs(s[:, None] - poles), axis=1) < 1e-5 * size

    def _instances(self, s: Complex) -> Complex:
        """C (s - A)^-1 B + D of `_reduced`, shape (len(s), sources, targets)."""
        t, b, c, d = self._reduced[:4]
        n, m = b.shape
        if len(s) == 1:
            return (c @ scipy.linalg.solve_triangular(s[0] * np.eye(n) - t, b) + d)[None]
        x = np.zeros((n, len(s), m), np.complex128)
        for high in range(n, 0, -_BLOCK):
            low = max(high - _BLOCK, 0)
            right = b[low:high, None] + np.tensordot(t[low:high, high:], x[high:], 1)
            for row in range(high - 1, low - 1, -1):
                inner = np.tensordot(t[row, row + 1 : high], x[row + 1 : high], 1)
                x[row] = (right[row - low] + inner) / (s - t[row, row])[:, None]
        return np.moveaxis(np.tensordot(c, x, 1), 0, 1) + d


def in_parts(s: Complex) -> list[Complex]:
    """So few values at a time that their matrices fit in the processor's cache."""
    return np.array_split(s, max(len(s) // _TOGETHER, 1))


def _contracts(matrix: Array) -> bool:
    """Whether powers of a matrix die out."""
    return not matrix.size or max(abs(np.linalg.eigvals(matrix))) < 1.0 - 1e-9
