"""The linear system that a master steps: from one communication point to the next by one matrix.

Every FMU is taken to solve its linear equations exactly over a step, for the course of its inputs that the
master gives it: held, extrapolated or interpolated. Delays of connections lie on the line between two
instants, as in a run; delays within FMUs are exact. Eigenvalues z of the matrix give the roots log(z)/period.
Delays of many steps are kept as powers of z, so that the matrix stays small.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ..base.errors import ConfigError, OrchestratorError, Problem
from ..effects.sample_and_hold import SampleAndHold
from ..master.extrapolation import weights
from ..master.gauss_seidel import GaussSeidel
from ..master.iterative import Iterative
from ..master.jacobi import Jacobi
from ..simulation.run import Prepared
from ..system.signal_vector import Layout
from .connections import Feed
from .delay_equation import Mode
from .from_system import Linearised
from .inner_delays import with_lines
from .statespace import LateInput, Law, StateSpace

__all__ = ["Late", "SampledPart", "SampledSystem", "sampled_part", "sampled_system"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_MOST_ROWS = 50_000
_MOST_STEPS = 1000
_SHOWN = 6
# Eigenvalues below this size have decayed after a few steps.
_GONE = 1e-6
# Up to this size all eigenvalues of the whole matrix are found at once.
_DENSE = 300
_RADIUS = 1.0 + 1e-8
_TURN = 0.7
# Radii that Newton's method begins at, and the least of a root that it looks for.
_STARTS = (1.0, 0.97, 0.85)
_LEAST = 0.3
_RESIDUAL = 1e-12
_MOST_ANGLES = 200_000


class Late(NamedTuple):
    """What a signal adds to the whole state so many periods later.

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
        """Numbers that the whole state consists of."""
        return len(self.core) + sum(self._longest.values())

    @cached_property
    def matrix(self) -> Array:
        """The whole state's, shape (size, size); its first rows are those of `core`."""
        n = len(self.core)
        whole = np.zeros((self.size, self.size))
        whole[:n, :n] = self.core
        low = n
        for head, length in self._longest.items():
            whole[low, head] = 1.0
            whole[np.arange(low + 1, low + length), np.arange(low, low + length - 1)] = 1.0
            for one in self.late:
                if one.head == head:
                    whole[:n, low + one.lag - 1] += one.column
            low += length
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
        angle = np.concatenate([[0.0], np.geomspace(1e-9, np.pi, 500)])
        sign = self._signs(_RADIUS * np.exp(1j * angle))
        while True:
            turn = np.angle(sign[1:] / sign[:-1])
            rough = np.flatnonzero(abs(turn) > _TURN)
            if not rough.size:
                return -round(float(np.sum(turn)) / np.pi)
            if min(np.diff(angle)[rough]) < 1e-13 or len(angle) > _MOST_ANGLES:
                raise OrchestratorError("an eigenvalue of the sampled system lies on the unit circle")
            middle = 0.5 * (angle[rough] + angle[rough + 1])
            angle = np.insert(angle, rough + 1, middle)
            sign = np.insert(sign, rough + 1, self._signs(_RADIUS * np.exp(1j * middle)))

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
        return Mode(complex(np.log(z) / self.period), float(values[-1] / values[0]), named)

    def _searched(self) -> Complex:
        """Eigenvalues near the unit circle, and those inside that lie near them."""
        angles = np.concatenate([[0.0], np.geomspace(1e-6, np.pi, 60 if len(self.core) <= 100 else 20)])
        found: list[complex] = []
        for start in np.outer(_STARTS, np.exp(1j * angles)).ravel():
            guesses = np.linalg.eigvals(self._at(np.array([start]))[0])
            for guess in guesses[np.argsort(abs(guesses - start))[:2]]:
                z = self._newton(complex(guess))
                if z is not None and not any(abs(z - one) <= 1e-8 * abs(one - 1.0) + 1e-13 for one in found):
                    found.append(z)
        return np.array(found, np.complex128)

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


def sampled_system(prepared: Prepared, linear: Linearised, resting: int = 0) -> SampledSystem:
    """What the master and the communication step of a config make of its linear system.

    Args:
        prepared: the checked system, with the step and the master.
        linear: what `linearise` gave for it, with whatever step.
        resting: roots 0 of the continuous system.
    Raises: ConfigError for a master whose steps vary, for holds whose instants do not repeat within some
        steps, for a step that has no solution, and for delays of too many steps.
    """
    return _Steps(prepared, linear).assembled(resting)


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


@dataclass(frozen=True)
class _Course:
    """How the signals run over a step: values there, each of shape (signals, columns)."""

    begin: Array
    middle: Array
    end: Array


class _Steps:
    """All parts of a system under its master."""

    def __init__(self, prepared: Prepared, linear: Linearised) -> None:
        system, master = prepared.system, prepared.master
        self.system, self.master, self.layout = system, master, Layout.of(system)
        self.step_size = float(prepared.grid.step_size)
        if not isinstance(master, Jacobi | GaussSeidel | Iterative):
            what = f"the steps of the master {type(master).__name__.lower()} vary"
            raise ConfigError([Problem("run.master", what, "jacobi, gauss-seidel and iterative are covered")])
        self.order = master.interpolation if isinstance(master, Iterative) else master.extrapolation
        self.every = [one.ratio.numerator for one in system.instances]
        self.samples = {name: self._samples(name, law) for name, law in linear.laws.items() if law.sampled}
        self.count = self._count()
        layout, size = self.layout, 0
        self.parts: list[Part | SampledPart] = []
        self.rows: list[slice] = []
        states: list[str] = []
        for one, every in zip(system.instances, self.every, strict=True):
            samples = self.samples.get(one.name, 1)
            part = sampled_part(linear, one.name, every * self.step_size, self.order, samples)
            space = part.space
            self.parts.append(part)
            self.rows.append(slice(size, size + part.size))
            states += [f"{one.name}.{name}" for name in space.states]
            states += [""] * (part.size - len(space.states))
            size += part.size
        self.states = tuple(states)
        self.values = slice(size, size + layout.size)
        size += layout.size
        self.feeds = [
            [Feed([effect for effect, _ in one.links], self.step_size, number + 1) for one in layout.wired]
            for number in range(self.count)
        ]
        self.memories = []
        for feed in self.feeds[0]:
            self.memories.append(slice(size, size + feed.size))
            size += feed.size
        self.number = {one.place: number for number, one in enumerate(layout.wired)}
        kept = self.order if not isinstance(master, Iterative) else 0
        self.history = slice(size, size + kept * layout.size)
        self.size = size + kept * layout.size
        if self.size > _MOST_ROWS:
            what = f"its delays are so many steps that {self.size} signals are remembered"
            remedy = "Take a longer communication step."
            raise ConfigError([Problem("run.step_size", what, f"at most {_MOST_ROWS}", remedy)])
        self.inputs = [self._input(index) for index in range(len(system.instances))]

    def _samples(self, name: str, law: Law) -> int:
        """Communication steps in a sample period of a law."""
        ratio = law.period / self.step_size
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
            what = f"the sample period of {law.period:g} s is {ratio:.6g} communication steps"
            raise ConfigError([Problem(name, what, "a whole number of steps is needed")])
        return round(ratio)

    def _count(self) -> int:
        """Communication steps after which everything repeats."""
        count = math.lcm(*self.every, *self.samples.values())
        for one in self.layout.wired:
            for effect, _ in one.links:
                if not isinstance(effect, SampleAndHold) or not effect.period:
                    continue
                exact = effect.period / self.step_size
                ratio = Fraction(exact).limit_denominator(64)
                if abs(float(ratio) - exact) > 1e-9 * exact or math.lcm(count, ratio.numerator) > _MOST_STEPS:
                    what = f"a sample and hold of {effect.period:g} s is {exact:.6g} communication steps"
                    allowed = f"what repeats within {_MOST_STEPS} steps"
                    raise ConfigError([Problem(str(one.connection), what, allowed)])
                count = math.lcm(count, ratio.numerator)
        return count

    def _input(self, index: int) -> tuple[Array, Array, Array, Array, Array]:
        """Of the real inputs of an instance: columns among those of its part, places of their sources,
        gains, whether it follows their course, whether an output depends on them at once.
        """
        one, fed = self.system.instances[index], self.layout.inputs[index]
        known = self.parts[index].space.inputs
        direct = {name for names in one.feedthrough.values() for name in names}
        chosen = [place for place, name in enumerate(fed.names) if name in known]
        names = [fed.names[place] for place in chosen]
        source = fed.source[chosen]
        gain = np.ones(len(chosen)) if fed.gain is None else fed.gain[chosen]
        follows = np.array([name in one.fmu.description.followed for name in names], bool)
        follows = follows & self.layout.smooth[source] if len(chosen) else follows
        return (
            np.array([known.index(name) for name in names], np.intp),
            source,
            gain,
            follows,
            np.array([name in direct for name in names], bool),
        )

    def course(self, index: int, signals: Array, run: _Course | None) -> list[Array]:
        """What an instance is given over a step: see `Instances.transfer`."""
        columns, source, gain, follows, direct = self.inputs[index]

        def placed(value: Array) -> Array:
            whole = np.zeros((len(self.parts[index].space.inputs), signals.shape[1]))
            whole[columns] = gain[:, None] * value
            return whole

        if run is None:
            return [placed(signals[source])]
        begin, middle, end = (one[source] for one in (run.begin, run.middle, run.end))
        follow = follows[:, None]
        value = np.where(follow, begin, np.where(direct[:, None], end, middle))
        bend = 2.0 * (begin + end - 2.0 * middle)
        slopes = [(end - begin - bend) / self.step_size, 2.0 * bend / self.step_size**2][: self.order]
        return [placed(value), *(placed(np.where(follow, one, 0.0)) for one in slopes)]

    def advance(self, index: int, z: Array, course: list[Array], signals: Array, phase: int) -> None:
        """Step an instance: its state into z, its outputs into the signals."""
        part, span = self.parts[index], self.layout.spans[index]
        begin = z[self.rows[index]]
        if isinstance(part, SampledPart):
            z[self.rows[index]], outputs = part.advance(begin, course, phase)
        else:
            z[self.rows[index]], outputs = part.advance(begin, course)
        signals[span] = 0.0
        for name, value in zip(part.space.outputs, outputs, strict=True):
            if name in self.layout.outputs[index]:
                signals[span.start + self.layout.outputs[index].index(name)] = value

    def made(self, number: int, phase: int, before: Array, signals: Array) -> tuple[Array, Array]:
        """Memory and signal of a connection with effects at a step's end."""
        one = self.layout.wired[number]
        total = one.gain @ signals[one.source]
        return self.feeds[phase][number].advance(before[self.memories[number]], total)

    def follow(self, index: int, phase: int, before: Array, signals: Array) -> None:
        """Evaluate the connections with effects that an instance feeds, on trial."""
        for one in self.layout.wired_after[index]:
            signals[one.place] = self.made(self.number[one.place], phase, before, signals)[1]

    def step(self, before: Array, phase: int, given: dict[int, list[Array]]) -> Array:
        """The whole state after a step, column by column.

        Args:
            before: shape (size, columns).
            phase: number of the step within the period.
            given: what instances with longer steps were given where these began.
        """
        if isinstance(self.master, Iterative):
            return self.solved(before, phase)
        z, signals = before.copy(), before[self.values].copy()
        run = self.extrapolated(before) if self.order else None
        indices = range(len(self.parts))
        if isinstance(self.master, Jacobi):
            for index in indices:
                if phase % self.every[index] == 0:
                    given[index] = self.course(index, signals, run)
            for index in indices:
                if (phase + 1) % self.every[index] == 0:
                    self.advance(index, z, given[index], signals, phase)
        else:
            for index in self.system.order:
                if (phase + 1) % self.every[index] == 0:
                    self.advance(index, z, self.course(index, signals, run), signals, phase)
                self.follow(index, phase, before, signals)
                if run is not None:
                    self.settle(index, phase, before, signals, run)
        return self.committed(before, z, phase, signals)

    def committed(self, before: Array, z: Array, phase: int, signals: Array) -> Array:
        """The state with the signals of the step's end in it, and what effects remember of them."""
        for number, one in enumerate(self.layout.wired):
            z[self.memories[number]], signals[one.place] = self.made(number, phase, before, signals)
        z[self.values] = signals
        if self.history.stop > self.history.start:
            older = np.concatenate([before[self.values], before[self.history]])
            z[self.history] = older[: self.history.stop - self.history.start]
        return z

    def points(self, before: Array) -> list[Array]:
        """Signals at the step's begin and before it, newest first."""
        size = self.layout.size
        kept = before[self.history].reshape(-1, size, before.shape[1])
        return [before[self.values], *kept]

    def extrapolated(self, before: Array) -> _Course:
        """See `orchestrator.master.extrapolation`."""
        points = self.points(before)
        nodes = tuple(-float(one) for one in range(self.order + 1))
        smooth = self.layout.smooth[:, None]
        middle, end = (
            np.where(
                smooth, sum(w * one for w, one in zip(weights(at, nodes), points, strict=True)), points[0]
            )
            for at in (0.5, 1.0)
        )
        return _Course(points[0], middle, end)

    def settle(self, index: int, phase: int, before: Array, signals: Array, run: _Course) -> None:
        """An instance has stepped: the course of its signals ends where they are now."""
        points = self.points(before)
        within = weights(0.5, (1.0, *(-float(one) for one in range(self.order))))

        def known(place: slice, value: Array) -> None:
            bent = within[0] * value
            for weight, one in zip(within[1:], points, strict=False):
                bent = bent + weight * one[place]
            run.end[place] = value
            run.middle[place] = np.where(self.layout.smooth[place][:, None], bent, value)

        span = self.layout.spans[index]
        known(span, signals[span])
        for one in self.layout.wired_after[index]:
            _, value = self.made(self.number[one.place], phase, before, run.end)
            known(slice(one.place, one.place + 1), value[None])

    def solved(self, before: Array, phase: int) -> Array:
        """The state after a step at whose end every input agrees with what feeds it."""
        ports = [int(place) for _, source, *_ in self.inputs for place in source]
        ports += [int(place) for one in self.layout.wired for place in one.source]
        ports = sorted({one for one in ports if one not in self.number})
        unit = np.zeros((self.layout.size, len(ports)))
        unit[ports, np.arange(len(ports))] = 1.0
        answer = self.supposed(np.zeros((self.size, len(ports))), unit, phase)
        base = self.supposed(before, np.zeros((self.layout.size, before.shape[1])), phase)
        places = [self.values.start + one for one in ports]
        loop = np.eye(len(ports)) - answer[places]
        if ports and np.linalg.cond(loop) > 1e12:
            what = "a step of the master iterative has no solution, or no single one"
            raise ConfigError([Problem("run.master", what, "", "Take another communication step.")])
        return base + answer @ np.linalg.solve(loop, base[places])

    def supposed(self, before: Array, ends: Array, phase: int) -> Array:
        """The state after a step whose inputs follow supposed signals of its end."""
        z, signals = before.copy(), ends.copy()
        for number, one in enumerate(self.layout.wired):
            signals[one.place] = self.made(number, phase, before, signals)[1]
        run = None
        if self.order:
            begin = before[self.values]
            smooth = self.layout.smooth[:, None]
            run = _Course(begin, np.where(smooth, 0.5 * (begin + signals), signals), signals)
        made = signals.copy()
        for index in range(len(self.parts)):
            self.advance(index, z, self.course(index, signals, run), made, phase)
        return self.committed(before, z, phase, made)

    def lines(self) -> list[tuple[int, int, int, int, int]]:
        """Rows that only move on: the first, how many at a time, how many such blocks, by how many blocks
        they move in a period, and the first block of those that anything is read of.
        """
        found = []
        for feed, memory in zip(self.feeds[0], self.memories, strict=True):
            for low, length in feed.lines():
                found.append((memory.start + low, 1, length, self.count, length - 3 - self.count))
        for part, rows, every in zip(self.parts, self.rows, self.every, strict=True):
            shift = self.count // every
            for _, whole, _, _, _, own, through in part.late:
                width = self.order + 1
                blocks = (own.stop - own.start) // width
                found.append(
                    (rows.start + own.start, width, blocks, shift, whole - 1 - int(through.any()) - shift)
                )
        return found

    def assembled(self, resting: int) -> SampledSystem:
        """The system over a period."""
        moved = np.zeros(self.size, bool)
        late: list[tuple[int, int, int]] = []
        for low, width, blocks, shift, read in self.lines():
            moved[low + shift * width : low + blocks * width] = True
            for block in range(max(shift, read), blocks):
                late += [
                    (low + block * width + k, block // shift, low + block % shift * width + k)
                    for k in range(width)
                ]
        core = np.flatnonzero(~moved)
        columns = [*core.tolist(), *(row for row, _, _ in late)]
        z, given = np.zeros((self.size, len(columns))), {}
        z[columns, np.arange(len(columns))] = 1.0
        for phase in range(self.count):
            z = self.step(z, phase, given)
        answer = z[core]
        place = {row: index for index, row in enumerate(core.tolist())}
        added = [
            Late(lag, place[head], answer[:, len(core) + index])
            for index, (_, lag, head) in enumerate(late)
            if answer[:, len(core) + index].any()
        ]
        names = [self.states[row] if row < len(self.states) else "" for row in core.tolist()]
        kept = self._used(answer[:, : len(core)], added)
        inner = {int(old): new for new, old in enumerate(kept)}
        added = [
            one._replace(head=inner[one.head], column=one.column[kept]) for one in added if one.head in inner
        ]
        return SampledSystem(
            self.step_size,
            self.count * self.step_size,
            answer[np.ix_(kept, kept)],
            tuple(one for one in added if one.column.any()),
            tuple(names[row] for row in kept),
            resting,
        )

    @staticmethod
    def _used(matrix: Array, late: Sequence[Late]) -> NDArray[np.intp]:
        """Rows but those that nothing depends on."""
        depends = matrix != 0.0
        for one in late:
            depends[:, one.head] |= one.column != 0.0
        kept = np.arange(len(matrix))
        while True:
            inner = depends[np.ix_(kept, kept)].any(axis=0)
            if inner.all():
                return kept
            kept = kept[inner]
