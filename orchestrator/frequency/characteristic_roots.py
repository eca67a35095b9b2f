"""The rightmost roots of linear systems with delays, certified.

Each delay is discretised by Chebyshev collocation of its transport line, which makes an ordinary system whose
eigenvalues begin Newton's method on the exact equation (Breda, Maset, Vermiglio, SIAM J. Sci. Comput. 27,
2005). What counts is the residual on the exact equation, and that the argument principle finds as many roots
to the right of a line as are listed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg

from ..base.arrays import Array, Complex
from ..base.errors import OrchestratorError
from .delay_equation import DelayEquation, in_parts
from .modes import Mode, Modes
from .statespace import differentiation

_ORDERS = (12, 20, 32, 48)
_RESIDUAL = 1e-9
# Roots that are looked for beyond those asked for.
_MORE = 12
# Points around a cluster of roots; powers of their distances over the circle's radius that count as 0.
_AROUND, _ONE_PLACE = 128, 1e-9
# On a circle exp(-s delay) changes by no more than this power of e to either side.
_LATE = 20.0


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


class CharacteristicRoots(DelayEquation):
    """The roots of a delay equation, from the right."""

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

    def moved(self, root: complex) -> dict[str, float]:
        """By how much what is added to an input moves the mode of a root, relative to others; by input."""
        left = np.linalg.svd(self._matrix(np.array([root]))[0])[0][:, -1]
        return dict(zip(self.inputs, abs(left[len(self.states) :]).tolist(), strict=True))

    def _residual(self, s: complex) -> float:
        matrix = self._matrix(np.array([s]))[0]
        # Units of states and inputs differ by many orders: rows and columns are scaled first, by the size of
        # their terms: s - a of a state that nothing else moves vanishes at its root.
        terms, diagonal = abs(matrix), np.arange(len(self.states))
        terms[diagonal, diagonal] = abs(s) + abs(np.diag(self.a))
        rows = np.maximum(np.linalg.norm(terms, axis=1, keepdims=True), 1e-300)
        columns = np.maximum(np.linalg.norm(terms / rows, axis=0, keepdims=True), 1e-300)
        values = np.linalg.svd(matrix / rows / columns, compute_uv=False)
        return float(values[-1] / max(values[0], 1.0))

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
