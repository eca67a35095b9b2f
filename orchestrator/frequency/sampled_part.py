"""One instance of a linear system over one of its steps, as a master gives it its inputs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
import scipy.linalg

from ..base.arrays import Array
from .from_system import Linearised
from .inner_delays import with_lines
from .statespace import LateInput, Law, StateSpace


class Part:
    """x' = A x + B u, y = C x + D u over one step; u a polynomial, some of its effect later by a delay."""

    def __init__(self, space: StateSpace, late: Mapping[str, LateInput], step: float, order: int) -> None:
        self.space, self.step, self.order = space, step, order
        n = len(space.a)
        self.transition, *self.fed = _over(space.a, space.b, step)
        self.late = []
        self.size = n
        for index, name in enumerate(space.inputs):
            if name not in late:
                continue
            one = late[name]
            whole = math.floor(one.delay / step + 1e-9)
            rest = max(one.delay - whole * step, 0.0)
            rest = rest if rest > 1e-9 * step else 0.0
            column = np.zeros((n, 1))
            column[: len(one.gains), 0] = one.gains
            after = scipy.linalg.expm(space.a * (step - rest))
            first = [after @ one for one in _integrals(space.a, column, rest)]
            second = _integrals(space.a, column, step - rest)
            kept = whole + (1 if rest else 0)
            rows = slice(self.size, self.size + kept * (order + 1))
            self.size = rows.stop
            self.late.append((index, whole, rest, first, second, rows, one.through[:, None]))

    def advance(self, z: Array, course: Sequence[Array]) -> tuple[Array, Array]:
        """State and outputs at the step's end; `course`: inputs and their derivatives at its begin."""
        n, columns = len(self.space.a), z.shape[1]
        x = self.transition @ z[:n]
        for gain, value in zip(self.fed, course, strict=False):
            x = x + gain @ value
        kept, passed = z.copy(), np.zeros((len(self.space.outputs), columns))
        for index, whole, rest, first, second, rows, through in self.late:
            now = np.zeros((1, self.order + 1, columns))
            for place, value in enumerate(course):
                now[0, place] = value[index]
            line = np.concatenate([now, z[rows].reshape(-1, self.order + 1, columns)])
            for gain, value in zip(second, line[whole], strict=False):
                x = x + gain @ value[None]
            if rest:
                for gain, value in zip(first, _ahead(line[whole + 1], self.step - rest), strict=False):
                    x = x + gain @ value[None]
            if through.any():
                # A delay of whole steps ends where the input may jump: the value after the jump comes out.
                early = whole and not rest
                end = line[whole - 1] if early else line[whole]
                passed = passed + through @ _ahead(end, 0.0 if early else self.step - rest)[0][None]
            kept[rows] = line[: len(line) - 1].reshape(-1, columns)
        kept[:n] = x
        return kept, self.space.c @ x + self.space.d @ _ahead(course, self.step)[0] + passed


class SampledPart:
    """A law that samples: x+ = A x + B u, y = C x + D u at its instants, held between them.

    Its rows: x, the outputs, and where a sample is taken once more the x before it.
    """

    def __init__(self, law: Law, space: StateSpace, every: int) -> None:
        self.law, self.space, self.every, self.late = law, space, every, ()
        self.again = law.begins and law.ends
        self.size = len(space.states) * (2 if self.again else 1) + len(space.outputs)

    def advance(self, z: Array, course: Sequence[Array], phase: int) -> tuple[Array, Array]:
        """State and outputs at the end of the step `phase`, where it samples if one is due."""
        n, p = len(self.space.states), len(self.space.outputs)
        x, outputs, before = z[:n], z[n : n + p], z[n + p :]
        if self.law.begins and phase % self.every == 0:
            x, outputs = self._sample(before if self.again else x, course[0])
        if self.law.ends and (phase + 1) % self.every == 0:
            before = x if self.again else before
            x, outputs = self._sample(x, course[0])
        return np.concatenate([x, outputs, before]), outputs

    def _sample(self, x: Array, u: Array) -> tuple[Array, Array]:
        return self.space.a @ x + self.space.b @ u, self.space.c @ x + self.space.d @ u


def sampled_part(
    linear: Linearised, name: str, step: float, order: int = 0, samples: int = 1
) -> Part | SampledPart:
    """An instance from one of its steps to the next.

    Args:
        step: its own [s]; order: of the polynomials that its inputs follow.
        samples: steps in a sample period, of one whose law samples.
    """
    law, space = linear.laws.get(name), linear.parts[name]
    if law is not None and law.sampled is not None:
        return SampledPart(law, law.sampled, samples)
    late = {port: linear.late[f"{name}.{port}"] for port in space.inputs if f"{name}.{port}" in linear.late}
    return Part(with_lines(space, linear.inner.get(name, ())), late, step, order)


def _ahead(course: Sequence[Array] | Array, time: float) -> list[Array]:
    """A polynomial's value and derivatives after a time."""
    return [
        np.sum([later * time**k / math.factorial(k) for k, later in enumerate(course[place:])], axis=0)
        for place in range(len(course))
    ]


def _integrals(a: Array, b: Array, time: float) -> list[Array]:
    """Integrals of exp(A (time - t)) B t^k/k! from 0 to `time`, for k = 0, 1, 2; each of B's shape."""
    return _over(a, b, time)[1:]


def _over(a: Array, b: Array, time: float) -> list[Array]:
    """exp(A time), and the integrals of exp(A (time - t)) B t^k/k! from 0 to `time`, for k = 0, 1, 2."""
    return list(_over_known(a.tobytes(), b.tobytes(), b.shape, time))


@lru_cache(maxsize=4096)
def _over_known(a: bytes, b: bytes, shape: tuple[int, int], time: float) -> tuple[Array, ...]:
    # Charts and searches of a step ask for the same instances again and again.
    n, m = shape
    if not n:
        return np.zeros((0, 0)), *(np.zeros(shape) for _ in range(3))
    whole = np.zeros((n + 3 * m, n + 3 * m))
    whole[:n, :n], whole[:n, n : n + m] = np.frombuffer(a).reshape(n, n), np.frombuffer(b).reshape(shape)
    for k in range(2):
        whole[n + k * m : n + (k + 1) * m, n + (k + 1) * m : n + (k + 2) * m] = np.eye(m)
    made = scipy.linalg.expm(whole * time)
    return made[:n, :n], *(made[:n, n + k * m : n + (k + 1) * m] for k in range(3))
