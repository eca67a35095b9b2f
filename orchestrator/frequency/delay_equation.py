"""Linear systems of delayed connections: x' = A x + B u, y = C x + D u, u = sum of K_k y(t - tau_k).

Roots: each delay is discretised by Chebyshev collocation of its transport line, which makes an ordinary
system whose eigenvalues begin Newton's method on the exact equation (Breda, Maset, Vermiglio, SIAM J. Sci.
Comput. 27, 2005). What counts is the residual on the exact equation, and that the argument principle finds as
many roots to the right of a line as are listed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ..base.errors import ConfigError, OrchestratorError, Problem, listed
from .statespace import differentiation

__all__ = ["SMALL", "DelayEquation", "Link", "Mode", "Modes", "in_parts"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_ORDERS = (12, 20, 32, 48)
_RESIDUAL = 1e-9
# Neighbouring values on the contour turn by less than this [rad], or more are taken between them.
_TURN = 0.7
_MOST_POINTS = 400_000
_TOGETHER = 64
# Roots that are looked for beyond those asked for.
_MORE = 12
# Points around a cluster of roots; powers of their distances over the circle's radius that count as 0.
_AROUND, _ONE_PLACE = 128, 1e-9
# On a circle exp(-s delay) changes by no more than this power of e to either side.
_LATE = 20.0
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


class _Cluster(NamedTuple):
    """Roots that cannot be distinguished from one multiple root.

    Attributes:
        root: their mean; times: their number.
        radius: of a circle without others, shared by its conjugate; spread: they lie no further from the mean
            by rounding.
    """

    root: complex
    times: int
    radius: float
    spread: float


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
        return float(-self.root.real / abs(self.root)) if self.root else 1.0

    def __repr__(self) -> str:
        states = ", ".join(f"{name} {100 * share:.0f} %" for name, share in self.participation[:3])
        return f"{self.root:.6g} 1/s: {self.frequency:.4g} Hz, damping {self.damping:.4g}; {states}"


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
        return np.linalg.inv(self._loop_at_once)

    @cached_property
    def _undelayed(self) -> Complex:
        """Roots if nothing were late, shape (n,); empty if an algebraic loop then has no solution."""
        gains = np.sum(self._k, axis=0)
        loop = np.eye(len(self.inputs)) - gains @ self.d
        if not self.inputs or np.linalg.cond(loop) > 1e12:
            return np.zeros(0, np.complex128)
        return np.linalg.eigvals(self.a + self.b @ np.linalg.solve(loop, gains @ self.c))

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

    def modes(self, count: int = 6) -> Modes:
        """The rightmost modes, at least `count` roots where there are so many.

        Raises: ConfigError as `check`; OrchestratorError if the roots cannot be certified.
        """
        self.check()
        if not self.states:
            return Modes((), -np.inf)
        for order in _ORDERS:
            guesses = self.guesses(order)
            ordered = guesses[np.argsort(-guesses.real)]
            clusters = self._clusters(ordered, count + _MORE)
            # Equal parts have equal roots, too, which Newton's method finds each on its own.
            for together in [clusters, []] if clusters else [clusters]:
                found = self._certified(ordered, count, together)
                if found is not None:
                    return found
        raise OrchestratorError(
            f"the rightmost roots could not be certified with {_ORDERS[-1]} points a delay\n"
            "  Two may lie on top of one another, as of parts that are there twice."
        )

    def guesses(self, order: int) -> Complex:
        """Approximate roots: eigenvalues of `collocated`."""
        return np.linalg.eigvals(scipy.linalg.matrix_balance(self.collocated(order))[0])

    def collocated(self, order: int) -> Array:
        """x' = M x of the system with every delay as a line of so many points."""
        n, m, p = len(self.states), len(self.inputs), len(self.outputs)
        delayed = [
            (delay, source)
            for delay, gains in zip(self._delays, self._k, strict=True)
            for source in range(p)
            if delay > 0.0 and gains[:, source].any()
        ]
        size = n + order * len(delayed)
        a, b, c = np.zeros((size, size)), np.zeros((size, m)), np.zeros((p, size))
        a[:n, :n], b[:n], c[:, :n] = self.a, self.b, self.c
        # u = K0 (C x + D u) + F v, with v the ends of the lines.
        ends = np.zeros((m, size))
        derivative = differentiation(order)
        into = np.zeros((size, p))
        for index, (delay, source) in enumerate(delayed):
            low = n + index * order
            own = derivative / delay
            a[low : low + order, low : low + order] = own[1:, 1:]
            into[low : low + order, source] = own[1:, 0]
            which = int(np.searchsorted(self._delays, delay))
            ends[:, low + order - 1] += self._k[which][:, source]
        u_of_x = np.linalg.solve(self._loop_at_once, self._at_once @ c + ends)
        return a + into @ (c + self.d @ u_of_x) + b @ u_of_x

    def _certified(self, ordered: Complex, count: int, clusters: Sequence[_Cluster]) -> Modes | None:
        apart = np.array([all(abs(s - one.root) > one.radius for one in clusters) for s in ordered], bool)
        upper = ordered[apart & (ordered.imag >= -1e-9 * abs(ordered))][: count + _MORE]
        roots: list[complex] = []
        for guess in upper:
            found = self.root_near(complex(guess))
            if found is not None and not any(abs(found - one) <= 1e-7 * max(abs(one), 1e-9) for one in roots):
                roots.append(found)
        known = {one.root: one.times for one in clusters}
        roots = [*known, *(s for s in roots if all(abs(s - one.root) > one.radius for one in clusters))]
        roots.sort(key=lambda one: (-one.real, one.imag))
        totals = np.cumsum([known.get(one, 1) * (2 if one.imag > 0.0 else 1) for one in roots])
        for wanted in range(len(roots), 0, -1):
            if wanted < len(roots):
                line = 0.5 * (roots[wanted - 1].real + roots[wanted].real)
                close = roots[wanted - 1].real - roots[wanted].real
            elif float(self._delays[-1]) == 0.0 or totals[-1] < count:  # there may be no others
                line, close = roots[-1].real - 0.1 * abs(roots[-1]) - 1e-6, np.inf
            else:
                continue
            if close <= 1e-9 * abs(roots[wanted - 1]):
                continue
            if any(abs(line - one.root.real) < one.spread for one in clusters):
                continue
            if totals[wanted - 1] < min(count, int(totals[-1])) and wanted < len(roots) - 1:
                return None
            try:
                counted = self.count_right_of(line)
                times = [known.get(one, 1) for one in roots[:wanted]]
                if counted > totals[wanted - 1]:
                    times = self._multiplicities(roots[:wanted], known)
                if counted == sum(k * (2 if s.imag > 0.0 else 1) for k, s in zip(times, roots, strict=False)):
                    listed = [self._mode(s, k) for k, s in zip(times, roots, strict=False) for _ in range(k)]
                    return Modes(tuple(listed), float(line))
            except OrchestratorError:
                continue
        return None

    def _clusters(self, ordered: Complex, count: int) -> list[_Cluster]:
        """Multiple roots: guesses that lie together and apart from all others. P(s) shows one place for them.

        A root of k times moves by the k-th root of a rounding error, so that neither guesses nor Newton's
        method find it. log det P(s) around it does: without k log(s - c), its powers that are negative are
        -p_m/m (s - c)^-m with p_m the sum of (root - c)^m (Delves and Lyness, Math. Comp. 21, 1967).
        """
        found: list[_Cluster] = []
        for seed in ordered[:count]:
            if seed.imag < 0.0 or any(abs(seed - one.root) <= one.radius for one in found):
                continue
            distances = np.sort(abs(ordered - seed))
            for times in range(2, len(distances)):
                near, far = distances[times - 1 : times + 1]
                if near * 9.0 > far:
                    continue
                together = ordered[abs(ordered - seed) <= near]
                centre = complex(np.mean(together))
                radius = (far - near) / 3.0
                if abs(centre.imag) < radius:
                    centre = complex(centre.real, 0.0)
                for _ in range(2):  # the second time around their mean
                    sums = self._power_sums(centre, radius)
                    if len(sums) != times + 1:
                        break
                    centre += radius * complex(sums[1]) / times
                if len(sums) != times + 1 or np.max(abs(sums[1:])) > _ONE_PLACE:
                    continue
                if abs(centre) <= _ONE_PLACE * radius:
                    centre = 0j
                elif abs(centre.imag) < _ONE_PLACE * radius:
                    centre = complex(centre.real, 0.0)
                spread = max(3.0 * _ONE_PLACE ** (1.0 / times) * radius, 2.0 * near)
                found.append(_Cluster(centre, times, radius, min(spread, radius)))
                break
        return found

    def _power_sums(self, centre: complex, radius: float) -> Complex:
        """Sums over the roots in a circle of ((root - centre)/radius)^m, m from 0 to their number; empty if a
        root lies on it, or if delays vary too much on it.
        """
        turn = np.arange(_AROUND) / _AROUND
        if float(self._delays[-1]) * (radius - centre.real) > _LATE:
            return np.zeros(0, np.complex128)
        s = centre + radius * np.exp(2j * np.pi * turn)
        found = [np.linalg.slogdet(self._matrix(one)) for one in in_parts(s)]
        sign, log = (np.concatenate([one[part] for one in found]) for part in (0, 1))
        if not sign.all():
            return np.zeros(0, np.complex128)
        phase = np.unwrap(np.angle(np.append(sign, sign[0])))
        times = round(float(phase[-1] - phase[0]) / (2.0 * np.pi))
        if not 0 < times < _AROUND // 4:
            return np.zeros(0, np.complex128)
        terms = np.fft.fft(log + 1j * (phase[:-1] - 2.0 * np.pi * times * turn)) / _AROUND
        return np.array([times, *(-m * terms[-m] for m in range(1, times + 1))])

    def _multiplicities(self, roots: Sequence[complex], known: Mapping[complex, int]) -> list[int]:
        """How many roots lie on top of one another at each, by the argument principle around it."""
        found = []
        for s in roots:
            if s in known:
                found.append(known[s])
                continue
            others = [other for one in roots for other in (one, one.conjugate()) if other != s]
            size = max(abs(s), 1e-3 * max(map(abs, roots)), 1e-6)
            radius = min([1e-3 * size, *(0.3 * abs(other - s) for other in others)])
            sign = self._signs(s + radius * np.exp(2j * np.pi * np.linspace(0.0, 1.0, 129)))
            turns = np.sum(np.angle(sign[1:] / sign[:-1])) if sign.all() else 0.0
            found.append(max(1, round(float(turns) / (2.0 * np.pi))))
        return found

    def root_near(self, s: complex) -> complex | None:
        """The root of P(s) v = 0 near a guess; None if the iteration does not settle there."""
        start, vector = s, None
        for _ in range(40):
            with np.errstate(over="ignore", invalid="ignore"):
                matrix = self._matrix(np.array([s]))[0]
            if not np.isfinite(matrix).all():  # exp(-s delay) is too large: it stands too far to the left
                return None
            if vector is None:
                vector = np.linalg.svd(matrix)[2][-1].conj()
                norm = vector.conj()
            slope = self._slope(s) @ vector
            whole = np.block([[matrix, slope[:, None]], [norm[None], np.zeros((1, 1))]])
            try:
                step = np.linalg.solve(whole, np.concatenate([-(matrix @ vector), [1.0 - norm @ vector]]))
            except np.linalg.LinAlgError:
                break
            vector = vector + step[:-1]
            s = s + complex(step[-1])
            if not np.isfinite(s) or abs(s - start) > 0.5 * abs(start) + 10.0:
                return None
            if abs(step[-1]) <= 1e-13 * abs(s) + 1e-15:
                break
        if abs(s.imag) <= 1e-10 * abs(s):
            s = complex(s.real, 0.0)
        return complex(s.real, abs(s.imag)) if self._residual(s) <= _RESIDUAL else None

    def vector(self, root: complex) -> Complex:
        """States and inputs of the mode of a root, shape (n + m,), of length 1."""
        return np.linalg.svd(self._matrix(np.array([root]))[0])[2][-1].conj()

    def _residual(self, s: complex) -> float:
        matrix = self._matrix(np.array([s]))[0]
        # Units of states and inputs differ by many orders: rows and columns are scaled first.
        matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=1, keepdims=True), 1e-300)
        matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=0, keepdims=True), 1e-300)
        values = np.linalg.svd(matrix, compute_uv=False)
        return float(values[-1] / values[0])

    def _mode(self, root: complex, times: int = 1) -> Mode:
        n = len(self.states)
        left, values, right = np.linalg.svd(self._matrix(np.array([root]))[0])
        # Of parts that are there twice, each has a vector of its own.
        null = max(1, int(np.sum(values[-times:] <= 1e-9 * values[0])))
        share = np.sum(abs(left[:n, -null:] * right[-null:, :n].T), axis=1)
        share = share / share.sum() if share.sum() else np.full(n, 1.0 / n)
        order = np.argsort(-share)
        named = tuple((self.states[index], float(share[index])) for index in order if share[index] > 1e-3)
        return Mode(root, self._residual(root), named)


def in_parts(s: Complex) -> list[Complex]:
    """So few values at a time that their matrices fit in the processor's cache."""
    return np.array_split(s, max(len(s) // _TOGETHER, 1))


def _contracts(matrix: Array) -> bool:
    """Whether powers of a matrix die out."""
    return not matrix.size or max(abs(np.linalg.eigvals(matrix))) < 1.0 - 1e-9
