"""Linear systems of delayed connections: x' = A x + B u, y = C x + D u, u = sum of K_k y(t - tau_k).

Roots: each delay is discretised by Chebyshev collocation of its transport line, which makes an ordinary
system whose eigenvalues begin Newton's method on the exact equation (Breda, Maset, Vermiglio, SIAM J. Sci.
Comput. 27, 2005). What counts is the residual on the exact equation, and that the argument principle finds as
many roots to the right of a line as are listed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from ..base import graph
from ..base.errors import ConfigError, OrchestratorError, Problem, listed, nearest
from ..translate.linear_model import as_state_space
from .margins import FAR, Crossover, DelayMargin, Margins, borne_delay, gain_crossovers
from .refine import minima, zeros
from .statespace import differentiation

if TYPE_CHECKING:
    import control

__all__ = ["FILTER", "DelaySystem", "Link", "Mode", "Modes"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Stands in the names of blocks and links that low-pass filters of connections become.
FILTER = " filter"

_ORDERS = (12, 20, 32, 48)
_RESIDUAL = 1e-9
# Neighbouring values on the contour turn by less than this [rad], or more are taken between them.
_TURN = 0.7
_MOST_POINTS = 400_000
# Of systems with more states the instances are reduced to what links see; in blocks of so many rows.
_SMALL = 40
_BLOCK = 32
# |L| below this limits no gain.
_NO_GAIN = 1e-9
# Deepest dips on the grid that are followed down: a sharp one may be deeper than the deepest there.
_DIPS = 4


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


@dataclass(frozen=True)
class Modes:
    """The rightmost modes.

    Attributes:
        modes: from the right to the left.
        line: a real part [rad/s] to the right of which there are these roots and no others, by counting.
    """

    modes: tuple[Mode, ...]
    line: float

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
class DelaySystem:
    """A closed linear system with delays.

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

    @staticmethod
    def loop(system: Any, delay: float = 0.0, name: str = "loop") -> DelaySystem:
        """Negative feedback around a system of python-control or scipy behind a delay: 1 + L(s) exp(-delay
        s).

        Args:
            system: continuous, with as many outputs as inputs; each output feeds the input of its number.
            delay: [s].
            name: of the connection; of several "name[1]" and so on.
        Raises: ConfigError if the system is discrete or has other ports, or the delay is negative.
        """
        space = as_state_space(system, name)
        problems = []
        if space.isdtime(strict=True) or space.ninputs != space.noutputs:
            what = f"it has {space.ninputs} inputs, {space.noutputs} outputs and dt = {space.dt}"
            problems.append(Problem(name, what, "continuous time, as many outputs as inputs"))
        if not (np.isfinite(delay) and delay >= 0.0):
            problems.append(Problem(name, f"delay is {delay!r} s", "allowed: finite and not negative"))
        if problems:
            raise ConfigError(problems)
        count = space.ninputs
        names = [name] if count == 1 else [f"{name}[{index + 1}]" for index in range(count)]
        return DelaySystem(
            *(np.asarray(one, np.float64) for one in (space.A, space.B, space.C, space.D)),
            tuple(f"{name}.x{index + 1}" for index in range(space.nstates)),
            tuple(f"{name}.u{index + 1}" for index in range(count)),
            tuple(f"{name}.y{index + 1}" for index in range(count)),
            tuple(Link(one, index, index, -1.0, float(delay)) for index, one in enumerate(names)),
        )

    def later(self, connection: str, delay: float) -> DelaySystem:
        """The same system with a connection that is later by a delay [s]."""
        links = tuple(
            one._replace(delay=one.delay + delay) if one.connection == connection else one
            for one in self.links
        )
        return replace(self, links=links)

    def scaled(self, connection: str, factor: float) -> DelaySystem:
        """The same system with the gain of a connection times a factor."""
        links = tuple(
            one._replace(gain=one.gain * factor) if one.connection == connection else one
            for one in self.links
        )
        return replace(self, links=links)

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
        n, m = len(self.states), len(self.inputs)
        k = np.einsum("sk,kmp->smp", np.exp(-s[:, None] * self._delays), self._k if gains is None else gains)
        made = np.zeros((len(s), n + m, n + m), np.complex128)
        made[:, :n, :n] = s[:, None, None] * np.eye(n) - self.a
        made[:, :n, n:] = -self.b
        made[:, n:, :n] = -k @ self.c
        made[:, n:, n:] = np.eye(m) - k @ self.d
        return made

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
        if len(self.states) <= _SMALL:
            parts = np.array_split(s, max(len(s) // 2000, 1))
            return np.concatenate([np.linalg.slogdet(self._matrix(one))[0] for one in parts])
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
            found = self._certified(self.guesses(order), count)
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

    def _certified(self, guesses: Complex, count: int) -> Modes | None:
        ordered = guesses[np.argsort(-guesses.real)]
        upper = ordered[ordered.imag >= -1e-9 * abs(ordered)][: count + 12]
        roots: list[complex] = []
        for guess in upper:
            found = self.root_near(complex(guess))
            if found is not None and not any(abs(found - one) <= 1e-7 * max(abs(one), 1e-9) for one in roots):
                roots.append(found)
        roots.sort(key=lambda one: (-one.real, one.imag))
        totals = np.cumsum([2 if one.imag > 0.0 else 1 for one in roots])
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
            if totals[wanted - 1] < min(count, int(totals[-1])) and wanted < len(roots) - 1:
                return None
            try:
                counted = self.count_right_of(line)
                times = [1] * wanted
                if counted > totals[wanted - 1]:
                    times = self._multiplicities(roots[:wanted])
                if counted == sum(k * (2 if s.imag > 0.0 else 1) for k, s in zip(times, roots, strict=False)):
                    listed = [self._mode(s, k) for k, s in zip(times, roots, strict=False) for _ in range(k)]
                    return Modes(tuple(listed), float(line))
            except OrchestratorError:
                continue
        return None

    def _multiplicities(self, roots: Sequence[complex]) -> list[int]:
        """How many roots lie on top of one another at each, by the argument principle around it."""
        found = []
        for s in roots:
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

    def loops(self) -> tuple[str, ...]:
        """Connections within feedback loops, in their order."""
        owners = {_owner(one) for one in (*self.inputs, *self.outputs)}
        place = {name: index for index, name in enumerate(sorted(owners))}
        after: list[set[int]] = [set() for _ in place]
        ends = [
            (one.connection, place[_owner(self.outputs[one.source])], place[_owner(self.inputs[one.target])])
            for one in self.links
        ]
        for _, source, target in ends:
            after[source].add(target)
        group: dict[int, int] = {}
        for number, members in enumerate(graph.strong_components([sorted(one) for one in after])):
            group |= dict.fromkeys(members, number)
        # What leads into a connection's filter is a part of that connection.
        named = (
            name for name, source, target in ends if group[source] == group[target] and FILTER not in name
        )
        return tuple(dict.fromkeys(named))

    def open_loop(self, connection: str, omega: ArrayLike) -> Complex:
        """L(j omega) with one connection cut, of negative feedback: the closed loop is 1 + L.

        Args:
            connection: as a link names it.
            omega: shape (k,) [rad/s].
        """
        return self.response(connection, 1j * np.atleast_1d(np.asarray(omega, np.float64)))

    def open_loops(self, connections: Sequence[str], omega: ArrayLike) -> Complex:
        """L(j omega) with several connections cut at once, shape (k, connections, connections).

        Args:
            connections: as links name them; a row is what comes back at one, a column what is put in at one.
            omega: shape (k,) [rad/s].
        """
        return self._opened(connections, 1j * np.atleast_1d(np.asarray(omega, np.float64)))

    def response(self, connection: str, s: ArrayLike) -> Complex:
        """L(s) of `open_loop` at any s, of the shape of s [rad/s]."""
        s = np.asarray(s, np.complex128)
        return self._opened([connection], s.ravel())[:, 0, 0].reshape(s.shape)

    def driven(self, given: Mapping[str, ArrayLike], target: str, s: ArrayLike) -> Complex:
        """What arrives at an input where some outputs are given, whatever their instances do.

        Args:
            given: Laplace transforms of outputs at s, by name; 0 cuts what leads on from an output.
            target: the input.
            s: shape (k,) [rad/s].
        """
        s = np.atleast_1d(np.asarray(s, np.complex128))
        n, cut = len(self.states), {self.outputs.index(name): value for name, value in given.items()}
        rest = self._gains([one for one in self.links if one.source not in cut])
        wanted = np.zeros((len(s), n + len(self.inputs), 1), np.complex128)
        for one in self.links:
            if one.source in cut:
                wanted[:, n + one.target, 0] += one.gain * np.exp(-s * one.delay) * cut[one.source]
        return np.linalg.solve(self._matrix(s, rest), wanted)[:, n + self.inputs.index(target), 0]

    def _opened(self, connections: Sequence[str], s: Complex) -> Complex:
        own = [[one for one in self.links if one.connection == name] for name in connections]
        if not all(own):
            known = list(dict.fromkeys(one.connection for one in self.links))
            problems = [
                Problem("connection", f"no {name!r}", f"there are {listed(known)}", nearest(name, known))
                for name, links in zip(connections, own, strict=True)
                if not links
            ]
            raise ConfigError(problems)
        rest = self._gains([one for one in self.links if one.connection not in connections])
        n, m = len(self.states), len(self.inputs)
        # Further places that a connection feeds, as the delayed path into an FMU, carry the same signal.
        drive = np.zeros((m, len(own)))
        for column, links in enumerate(own):
            drive[[one.target for one in links], column] = 1.0
        if n > _SMALL and not self._near_poles(s).any():
            targets, sources = self._reduced[4:]
            response = self._instances(s)
            k = np.einsum("sk,kmp->smp", np.exp(-s[:, None] * self._delays), rest[:, targets][:, :, sources])
            wanted = np.broadcast_to(drive[targets], (len(s), len(targets), len(own)))
            y = response @ np.linalg.solve(np.eye(len(targets)) - k @ response, wanted)
            rows = {source: row for row, source in enumerate(sources)}
        else:
            wanted = np.broadcast_to(np.vstack([np.zeros((n, len(own))), drive]), (len(s), n + m, len(own)))
            solved = np.linalg.solve(self._matrix(s, rest), wanted)
            y = self.c @ solved[:, :n] + self.d @ solved[:, n:]
            rows = {source: source for source in range(len(self.outputs))}
        back = np.zeros((len(s), len(own), len(own)), np.complex128)
        for row, links in enumerate(own):
            first = min(one.target for one in links)
            for one in links:
                if one.target == first:
                    back[:, row] += (one.gain * np.exp(-s * one.delay))[:, None] * y[:, rows[one.source]]
        return -back

    def to_control(self, connection: str, order: int = 6) -> control.StateSpace:
        """L(s) of `open_loop` as a state space of python-control, delays by Pade's approximation.

        It is near the exact one where |s| times the longest delay is below `order`; `to_response` is exact.

        Args:
            connection: as a link names it.
            order: of the approximation of each delay.
        """
        import control

        n, m = len(self.states), len(self.inputs)
        parts = []
        at_once = np.zeros((m, len(self.outputs)))
        for one in self.links:
            if one.delay > 0.0:
                late = control.tf2ss(*control.pade(one.delay, order))
                blocks = [np.atleast_2d(np.asarray(x, float)) for x in (late.A, late.B, late.C, late.D)]
            else:
                blocks = [np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))]
            parts.append(blocks)
        lines = scipy.linalg.block_diag(np.zeros((0, 0)), *(one[0] for one in parts))
        size = n + len(lines)
        into = np.zeros((size, len(self.outputs)))
        ends, back, back_at_once = np.zeros((m, size)), np.zeros((1, size)), np.zeros((1, len(self.outputs)))
        drive = np.zeros((m, 1))
        own = [one for one in self.links if one.connection == connection]
        first = min(one.target for one in own)
        low = n
        for one, (a, b, c, d) in zip(self.links, parts, strict=True):
            high = low + len(a)
            into[low:high, one.source] += b[:, 0]
            if one.connection != connection:
                ends[one.target, low:high] += one.gain * c[0]
                at_once[one.target, one.source] += one.gain * d[0, 0]
                low = high
                continue
            drive[one.target] = 1.0
            if one.target == first:
                back[0, low:high] += one.gain * c[0]
                back_at_once[0, one.source] += one.gain * d[0, 0]
            low = high
        c = np.hstack([self.c, np.zeros((len(self.outputs), size - n))])
        solved = np.linalg.inv(np.eye(m) - at_once @ self.d)
        u_of_x, u_of_v = solved @ (at_once @ c + ends), solved @ drive
        y_of_x, y_of_v = c + self.d @ u_of_x, self.d @ u_of_v
        a = scipy.linalg.block_diag(self.a, lines) + into @ y_of_x
        b = into @ y_of_v
        a[:n] += self.b @ u_of_x
        b[:n] += self.b @ u_of_v
        return control.ss(a, b, -(back + back_at_once @ y_of_x), -back_at_once @ y_of_v)

    def to_response(self, connection: str, omega: ArrayLike) -> control.FrequencyResponseData:
        """`open_loop`, exact, for the plots and margins of python-control.

        Args:
            omega: shape (k,) [rad/s].
        """
        import control

        omega = np.atleast_1d(np.asarray(omega, np.float64))
        return control.frd(self.open_loop(connection, omega), omega)

    def step_response(self, connection: str, time: ArrayLike) -> Array:
        """How the closed loop follows a step at a connection: L/(1 + L), by exact steps with lines between.

        Args:
            connection: as a link names it: what it carries is asked to change by 1.
            time: shape (k,), evenly spaced from 0 [s]; delays lie on lines between these instants.
        Returns: shape (k,).
        """
        time = np.asarray(time, np.float64)
        step, n, m = float(time[1] - time[0]), len(self.states), len(self.inputs)
        whole = np.zeros((n + 2 * m, n + 2 * m))
        whole[:n, :n], whole[:n, n : n + m] = self.a, self.b
        whole[n : n + m, n + m :] = np.eye(m) / step
        made = scipy.linalg.expm(whole * step)
        forward, ramp = made[:n, :n], made[:n, n + m :]
        hold = made[:n, n : n + m] - ramp
        late = [(delay / step, gains) for delay, gains in zip(self._delays, self._k, strict=True)]
        drive = np.zeros(m)
        own = [one for one in self.links if one.connection == connection]
        drive[[one.target for one in own]] = 1.0
        # What acts within the step: K0 and the share of delays shorter than it.
        now = sum((max(0.0, 1.0 - lag) * gains for lag, gains in late), np.zeros((m, len(self.outputs))))
        solved = np.linalg.inv(np.eye(m) - now @ (self.c @ ramp + self.d))
        x, outputs, found = np.zeros(n), np.zeros((len(time), len(self.outputs))), np.zeros(len(time))
        u = np.linalg.solve(np.eye(m) - self._at_once @ self.d, drive)
        outputs[0] = self.d @ u
        first = min(one.target for one in own)
        for index in range(len(time)):
            if index:
                fed = drive.copy()
                for lag, gains in late:
                    low = int(lag)
                    share = lag - low
                    for place, weight in ((index - low, 1.0 - share), (index - low - 1, share)):
                        if 0 <= place < index and weight:
                            fed = fed + weight * gains @ outputs[place]
                moved = forward @ x + hold @ u
                u = solved @ (fed + now @ (self.c @ moved))
                x = moved + ramp @ u
                outputs[index] = self.c @ x + self.d @ u
            for one in own:
                if one.target == first:
                    low = int(one.delay / step)
                    share = one.delay / step - low
                    for place, weight in ((index - low, 1.0 - share), (index - low - 1, share)):
                        if place >= 0:
                            found[index] -= weight * one.gain * outputs[place, one.source]
        return found

    def margins(self, connection: str, modes: Modes | None = None) -> Margins:
        """Margins of the loop through one connection, all crossovers considered."""
        modes = modes or self.modes()
        omega = self.frequencies(modes)

        def response(s: Complex) -> Complex:
            return self.response(connection, s)

        crossovers = []
        for w, falling in gain_crossovers(response, omega):
            angle = float(np.angle(-response(np.array([1j * w]))[0]))
            crossovers.append(Crossover(w, np.degrees(angle), float(np.mod(angle, 2.0 * np.pi)) / w, falling))
        value = response(1j * omega)
        real = _real_crossings(response, omega, value)
        # Where L does not integrate, the locus begins on the real axis: its first crossing is at no
        # frequency.
        still, lower = response(1j * omega[0] * np.array([1e-3, 1e-6]))
        if still.real < -_NO_GAIN and abs(lower - still) < 1e-6 * abs(still):
            real.insert(0, (0.0, float(-1.0 / still.real)))
        distance = abs(1.0 + value)
        peak = abs(value) / np.maximum(distance, 1e-300)
        near, least = _lowest(lambda w: abs(1.0 + response(1j * w)), omega, distance)
        with np.errstate(divide="ignore", invalid="ignore"):  # of a root on the axis
            top, most = _lowest(lambda w: -abs(1.0 - 1.0 / (1.0 + response(1j * w))), omega, -peak)
        far = float(np.max(abs(response(1j * omega[-1] * FAR))))
        return Margins(modes.unstable, tuple(crossovers), tuple(real), least, near, -most, top, far)

    def delay_margin(self, connections: Sequence[str] = (), modes: Modes | None = None) -> DelayMargin:
        """By how much connections may be later, all by the same delay, before the system is unstable.

        Args:
            connections: as links name them; all within feedback loops if none is named.
            modes: what `modes` gave.
        """
        names = tuple(connections) or self.loops()
        modes = modes or self.modes()
        if modes.unstable or not names:
            return DelayMargin(names, np.nan if modes.unstable else np.inf, np.nan)
        found = borne_delay(lambda s: self._opened(names, s), self.frequencies(modes))
        return DelayMargin(names, *found)

    def frequencies(self, modes: Modes | None) -> Array:
        """Frequencies that show all of a loop, shape (k,) [rad/s]."""
        own = np.linalg.eigvals(self.a)
        poles = [*own, *(one.root for one in modes.modes)] if modes else []
        sizes = [abs(one) for one in (*(poles or own), *self._undelayed) if abs(one) > 1e-9]
        low, high = (min(sizes), max(sizes)) if sizes else (1.0, 1.0)
        longest = float(self._delays[-1])
        high = max(high, 20.0 / longest if longest else high)
        grid = [np.geomspace(1e-3 * low, 1e2 * high, 1500)]
        for one in poles:
            if abs(one.imag) > 0.0:
                # Close together around resonances, from their width out to the grid's distance.
                width = max(abs(one.real) / abs(one.imag), 1e-12)
                away = np.geomspace(
                    0.03 * width, max(0.1, width), 12 * int(np.ceil(np.log10(3.0 / width) + 2.0))
                )
                grid += [abs(one.imag) * (1.0 - away[away < 1.0]), abs(one.imag) * (1.0 + away)]
        every = np.concatenate(grid)
        return np.unique(every[every > 0.0])


def _lowest(function: Callable[[Any], Any], omega: Array, values: Array) -> tuple[float, float]:
    """Where a function is least and its value, near the lowest dips of its values on a grid."""
    place = int(np.argmin(values))
    inner = np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:])) + 1
    chosen = inner[np.argsort(values[inner])][:_DIPS]
    at, least = minima(function, omega[chosen - 1], omega[chosen + 1])
    pairs = zip([omega[place], *at], [values[place], *least], strict=True)
    return min(((float(w), float(value)) for w, value in pairs), key=lambda one: one[1])


def _contracts(matrix: Array) -> bool:
    """Whether powers of a matrix die out."""
    return not matrix.size or max(abs(np.linalg.eigvals(matrix))) < 1.0 - 1e-9


def _owner(port: str) -> str:
    """The block that a port belongs to: its instance, or a connection's filter."""
    return port if FILTER in port else port.partition(".")[0]


def _real_crossings(response: Any, omega: Array, value: Complex) -> list[tuple[float, float]]:
    """(omega, factor by which the gain may change there) where L is real and negative."""
    # What is as small as rounding has no sign, and no gain that anyone would reach makes it 1.
    clear = (abs(value.imag) > 1e-9 * abs(value)) & (abs(value) > _NO_GAIN)
    sign = np.where(clear, np.sign(value.imag), 0.0)
    index = np.flatnonzero((sign[:-1] * sign[1:] < 0.0) & (value.real[:-1] < 0.0) & (value.real[1:] < 0.0))
    at = zeros(lambda w: response(1j * w).imag, omega[index], omega[index + 1])
    factors = -1.0 / response(1j * at).real
    return [(float(w), float(factor)) for w, factor in zip(at, factors, strict=True) if factor > 0.0]
