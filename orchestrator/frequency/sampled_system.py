"""The linear system that a master steps: from one communication point to the next by one matrix.

Every FMU is taken to solve its linear equations exactly over a step, for the course of its inputs that the
master gives it: held, extrapolated or interpolated. Delays of connections lie on the line between two
instants, as in a run; delays within FMUs are exact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Array
from ..base.errors import ConfigError, Problem
from ..effects.sample_and_hold import SampleAndHold
from ..master.extrapolation import weights
from ..master.gauss_seidel import GaussSeidel
from ..master.iterative import Iterative
from ..master.jacobi import Jacobi
from ..simulation.run import Prepared
from ..system.signal_vector import Layout
from .connections import Feed
from .from_system import Linearised
from .sampled_modes import Late, SampledSystem
from .sampled_part import Part, SampledPart, sampled_part
from .statespace import Law

_MOST_ROWS = 50_000
_MOST_STEPS = 1000


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

    def _input(self, index: int) -> tuple[NDArray[Any], ...]:
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
        if chosen:
            follows &= self.layout.smooth[source]
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
        z: Array = np.zeros((self.size, len(columns)))
        given: dict[int, list[Array]] = {}
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
