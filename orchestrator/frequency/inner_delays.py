"""Delays between the states of an FMU, which directional derivatives do not show.

Where an output or a derivative passes through a delay, directional derivatives treat the delayed value as a
constant. An initialisation from other start values moves it: a delay begins with what it is given then. The
difference gives the total gain of all delays. Runs that differ in a start value or an input give the times.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ..base.arrays import Array
from ..base.errors import OrchestratorError, listed
from ..fmi import FmuInstance, Point
from .alone import Alone, step_all, usual_size
from .statespace import StateSpace, differentiation, linearised, state_names

# Change of a start value or an input, relative to its value or nominal one.
_CHANGE = 1e-4
# A difference of an output or a derivative below this share of its own counts as none.
_SEEN = 1e-4
# What a jump or a bend has to be, relative to the linear change, and to the value.
_BENT, _ROUNDED = 1e-3, 1e-8
# Steps of the runs, and steps in a communication step; samples that a delay is fitted to.
_STEPS = (64, 512, 5_000)
_FINE = (1, 8, 64)
_WINDOWS = (24, 12, 6)
# What a fit may leave, relative to what it explains: with the gains that are left, and with others.
_LEFT, _OTHER = 1e-4, 1e-3
# The same with the gains that are left where the FMU does not rest.
_MOVING = 5e-3
_MOST = 4
_NONE = "no delay"
# Points of a line that stands for a delay in the sampled system.
_POINTS = 40


@dataclass(frozen=True)
class InnerDelay:
    """A delay within an FMU between its own states.

    Attributes:
        delay: [s].
        seen: share of each state and input in what is delayed, shape (n + m,).
        gains: what the delayed value adds to each state's derivative, shape (n,).
        through: what it adds to each output, shape (p,).
    """

    delay: float
    seen: Array
    gains: Array
    through: Array


def initial_gains(at: Alone, part: StateSpace, idle: bool = False) -> Array:
    """What initialisation adds to directional derivatives: gains of delays, which begin with their operand.

    Args:
        part: by directional derivatives.
        idle: with inputs that act on nothing at once, too.
    Returns: shape (n + p, n + m); 0 where a state has no start value that can be set.
    """
    return _Runs(at, part, idle).gains()


def inner_delays(at: Alone, part: StateSpace) -> tuple[tuple[InnerDelay, ...], str]:
    """The delays between states of an FMU, and of inputs that act on something at once, too.

    Delays before outputs that no connection reads act on nothing.

    Args: part: by directional derivatives.
    Returns: the delays, and what could not be found; empty if nothing is left out.
    """
    runs = _Runs(at, part)
    try:
        gains = runs.gains()
    except OrchestratorError:  # it refuses to be initialised on its own
        return (), ""
    gains[len(part.states) :][[name not in at.read for name in part.outputs]] = 0.0
    if not gains.any():
        return (), ""
    try:
        found = runs.found(gains)
    except OrchestratorError as error:
        found = f"{runs.in_words(gains)}, and it does not run on its own: {str(error).splitlines()[0]}"
    return ((), found) if isinstance(found, str) else (found, "")


def uneven(at: Alone, part: StateSpace) -> list[str]:
    """Derivatives and outputs that jump or bend where the FMU stands, as at an event."""
    try:
        return _Runs(at, part).uneven()
    except OrchestratorError:  # it refuses to be initialised on its own
        return []


class _Runs:
    """Runs of one FMU on its own from changed start values."""

    def __init__(self, at: Alone, part: StateSpace, idle: bool = False) -> None:
        self.at, self.part = at, part
        self.rates = [rate for rate, _ in state_names(at.one.fmu)]
        self.rows = [*self.rates, *part.outputs]
        self.columns = [*part.states, *part.inputs]
        self.values = {name: float(at.values[name]) for name in self.columns}
        acts = np.any(np.vstack([part.b, part.d]), axis=0)
        self.chosen = [
            column
            for column, name in enumerate(self.columns)
            if (column < len(part.states) and at.one.variable(name).settable)
            or (column >= len(part.states) and (idle or acts[column - len(part.states)]))
        ]
        self.heights = np.array(
            [_CHANGE * usual_size(value, at.one.variable(name)) for name, value in self.values.items()]
        )
        self.jacobian = np.block([[part.a, part.b], [part.c, part.d]])

    def begun(self, changes: Array) -> FmuInstance:
        """An instance that is initialised with changed states and inputs, shape (n + m,)."""
        start = {name: self.values[name] + changes[column] for column, name in enumerate(self.columns)}
        start = {name: value for name, value in start.items() if self.at.one.variable(name).settable}
        inputs = np.array([self.values[name] for name in self.part.inputs])
        return self.at.started(self.at.begin, start, inputs)

    def initial(self, changes: Array) -> Array:
        instance = self.begun(changes)
        try:
            return self.read(instance, self.rows)
        finally:
            instance.free()

    @staticmethod
    def read(instance: FmuInstance, names: list[str]) -> Array:
        known = instance.get_values(list(dict.fromkeys(names)))
        return np.array([float(known[name]) for name in names])

    def gains(self) -> Array:
        """See `initial_gains`."""
        found = np.zeros_like(self.jacobian)
        if not self.chosen or not self.rows:
            return found
        # All at once first: most FMUs have no delay.
        if not self._remaining(self._drawn()).any():
            return found
        for column in self.chosen:
            changes = np.zeros(len(self.columns))
            changes[column] = self.heights[column]
            whole, half = (self._remaining(share * changes) / share for share in (1.0, 0.5))
            # What is of third order, as of steep friction, is a quarter for half the change.
            found[:, column] = np.where(abs(half) < 0.6 * abs(whole), 0.0, whole) / self.heights[column]
        return found

    def _drawn(self) -> Array:
        """Changes of all states and inputs at once, shape (n + m,)."""
        draw = np.random.default_rng(1)
        share = np.zeros(len(self.columns))
        share[self.chosen] = draw.uniform(0.5, 1.0, len(self.chosen)) * draw.choice([-1.0, 1.0])
        return share * self.heights

    def _remaining(self, changes: Array) -> Array:
        """What rows change by, beside the directional derivatives; 0 where that is rounding."""
        up, down = self.initial(changes), self.initial(-changes)
        expected = self.jacobian @ changes
        made = 0.5 * (up - down) - expected
        size = np.maximum(abs(self.jacobian) @ abs(changes), abs(made))
        small = abs(made) < _SEEN * size + 1e-12 * np.maximum(abs(up), abs(down))
        return np.where(small, 0.0, made)

    def found(self, gains: Array) -> tuple[InnerDelay, ...] | str:
        """The delays behind total gains, or what is not found."""
        rows = np.flatnonzero(gains.any(axis=1))
        seen = np.any(gains, axis=0)
        delays: dict[int, list[tuple[float, Array]]] = {}
        self._search(gains, np.flatnonzero(seen), delays, _LEFT)
        others = [column for column in self.chosen if column < len(self.part.states) and not seen[column]]
        if len(delays) < len(rows) and others:
            # Where the FMU does not rest, gains change along the runs. What is delayed begins at no
            # difference here, so that this is of second order when it comes out.
            self._search(gains, np.array(others), delays, _MOVING)
        if len(delays) == len(rows):
            return self._joined(delays)
        return f"{self.in_words(gains, delays)}, not by a delay that was found; that is left out"

    def _search(
        self,
        gains: Array,
        columns: NDArray[np.intp],
        delays: dict[int, list[tuple[float, Array]]],
        enough: float,
    ) -> None:
        """Find the delays of rows from runs that differ in some states or inputs; adds to `delays`."""
        fine, place = _FINE[0], 0
        while place < len(_STEPS):
            times, moved, left = self.courses(columns, _STEPS[place], fine)
            early = False
            for row in np.flatnonzero(gains.any(axis=1)):
                if row in delays:
                    continue
                # A jump of an input bends the course of states: without need it is left out.
                fed = gains[row, len(self.part.states) :].any()
                runs = np.flatnonzero(fed | (columns < len(self.part.states)))
                known = _Row(
                    times, moved[0][:, runs], moved[1][:, runs], left[:, runs, row], self.heights
                ).delays(gains[row], enough)
                early |= known in ("early", _NONE)
                if not isinstance(known, str):
                    delays[int(row)] = known
            if all(row in delays for row in np.flatnonzero(gains.any(axis=1))):
                return
            if early and fine < _FINE[-1]:
                fine = _FINE[_FINE.index(fine) + 1]
            else:
                place += 1

    def in_words(self, gains: Array, but: Collection[int] = ()) -> str:
        """What total gains say of rows, but some."""
        names = listed([self.rows[row] for row in np.flatnonzero(gains.any(axis=1)) if row not in but])
        before = listed([self.columns[column] for column in np.flatnonzero(gains.any(axis=0))])
        return f"{names} depends on what {before} was before"

    def uneven(self) -> list[str]:
        """See `uneven`."""
        if not self.chosen or not self.rows:
            return []
        changes, middle = self._drawn(), self.initial(np.zeros(len(self.columns)))

        def parts(changes: Array) -> tuple[Array, Array]:
            up, down = self.initial(changes), self.initial(-changes)
            return 0.5 * (up - down) - self.jacobian @ changes, up + down - 2.0 * middle

        odd, even = parts(changes)
        least = _BENT * abs(self.jacobian) @ abs(changes) + _ROUNDED * abs(middle)
        if np.all(np.maximum(abs(odd), abs(even)) <= least):
            return []
        half_odd, half_even = parts(0.5 * changes)
        # Of half the change a jump leaves all, a bend half, and a smooth law a quarter of what is even.
        jumps = (abs(odd) > least) & (abs(half_odd) > 0.75 * abs(odd))
        bends = (abs(even) > least) & (abs(half_even) > 0.375 * abs(even))
        return [name for name, one in zip(self.rows, jumps | bends, strict=True) if one]

    def courses(self, columns: NDArray[np.intp], steps: int, fine: int) -> tuple[Array, Any, Array]:
        """Runs that differ in one state or input each.

        Returns: times, shape (k,); by how much states and inputs differ and the rates of that, shape (k,
            runs, n + m); what outputs and derivatives differ by beside the directional derivatives, shape
            (k, runs, n + p).
        """
        part, n = self.part, len(self.part.states)
        begin, step = self.at.begin, self.at.step / fine
        still = np.array([self.values[name] for name in part.inputs])
        instances: list[FmuInstance] = []
        inputs = [still.copy() for _ in range(len(columns) + 1)]
        values: list[Array] = []
        left: list[Array] = []
        slopes: list[Array] = []
        try:
            for number in range(len(columns) + 1):
                changes = np.zeros(len(self.columns))
                if number and columns[number - 1] < n:
                    changes[columns[number - 1]] = self.heights[columns[number - 1]]
                instances.append(self.begun(changes))
                instances[-1].bind(list(part.inputs), inputs[number], [], np.zeros(0))
            names = [*part.states, *self.rows]
            for index in range(steps + 1):
                found = np.array([self.read(instance, names) for instance in instances])
                found = found[1:] - found[0]
                fed = np.array([one - still for one in inputs[1:]]).reshape(len(columns), -1)
                here = linearised(self.at.one.fmu, instances[0], part.inputs, part.outputs)
                jacobian = np.block([[here.a, here.b], [here.c, here.d]])
                whole = np.hstack([found[:, :n], fed])
                values.append(whole)
                left.append(found[:, n:] - whole @ jacobian.T)
                if index == 0:
                    for number, column in enumerate(columns, 1):
                        if column >= n:
                            inputs[number][column - n] += self.heights[column]
                            found[number - 1, n : 2 * n] += jacobian[:n, column] * self.heights[column]
                slopes.append(np.hstack([found[:, n : 2 * n], np.zeros_like(fed)]))
                if not step_all(instances, Point(index, begin + index * step, step)):
                    break
        finally:
            for instance in instances:
                instance.free()
        times = step * np.arange(len(values), dtype=np.float64)
        return times, (np.array(values), np.array(slopes)), np.array(left)

    def _joined(self, delays: Mapping[int, list[tuple[float, Array]]]) -> tuple[InnerDelay, ...]:
        """Rows with the same delay together, each as few paths as their gains need."""
        groups: list[tuple[float, Array]] = []
        n = len(self.part.states)
        for row, each in delays.items():
            for delay, gain in each:
                same = [whole for known, whole in groups if abs(known - delay) <= 1e-5 * delay]
                if not same:
                    same = [np.zeros_like(self.jacobian)]
                    groups.append((delay, same[0]))
                same[0][row] += gain
        found = []
        for delay, whole in groups:
            scale = np.max(abs(whole * self.heights), axis=1, initial=0.0)
            while True:
                share = abs(whole * self.heights) / np.where(scale > 0.0, scale, 1.0)[:, None]
                row, column = map(int, np.unravel_index(int(np.argmax(share)), share.shape))
                if share[row, column] < 1e-3:
                    break
                seen, into = whole[row].copy(), whole[:, column] / whole[row, column]
                found.append(InnerDelay(delay, seen, into[:n].copy(), into[n:].copy()))
                whole = whole - np.outer(into, seen)
        return tuple(found)


class _Row:
    """What one output or derivative remembers, in runs that differ in one state or input each."""

    def __init__(self, times: Array, values: Array, slopes: Array, left: Array, heights: Array) -> None:
        self.times, self.values, self.heights = times, values, heights
        self.left = left - left[:1]
        from scipy.interpolate import CubicHermiteSpline  # slow to import

        self.course = CubicHermiteSpline(times, values, slopes, axis=0) if len(times) > 1 else None

    def delays(self, gains: Array, enough: float = _LEFT) -> list[tuple[float, Array]] | str:
        """Delays [s] and gains, shape (n + m,), that leave no more than `enough`; "early" if the step is too
        long, "late" if the runs are too short, else why there are none.
        """
        found: list[tuple[float, Array]] = []
        rest, left = gains.copy(), self.left.copy()
        size = np.max(abs(gains) * self.heights)
        while np.max(abs(rest) * self.heights) > 1e-3 * size:
            moved = np.flatnonzero(np.max(abs(left), axis=1) > 1e-6 * size)
            if not moved.size or self.course is None:
                return "late"
            onset = int(moved[0])
            if onset < 8:
                return "early"
            one = self._fitted(left, onset, rest, enough)
            if isinstance(one, str):
                return one
            found.append(one)
            rest, left = rest - one[1], left - self._before(self.times, one[0]) @ one[1]
            if len(found) > _MOST:
                return _NONE
        return found

    def _before(self, times: Array, delay: float) -> Array:
        """By how much states and inputs moved between the start and a delay ago, shape (k, runs, n + m)."""
        ago = times - delay
        assert self.course is not None
        made = self.course(np.maximum(ago, 0.0)) - self.values[0]
        # Inputs jump at the start; a line between samples would be a ramp.
        jumps = self.values[-1] - self.values[0]
        constant = (self.values[1:] == self.values[1]).all(axis=0) & (jumps != 0.0)
        made[:, constant] = np.broadcast_to(jumps, made.shape)[:, constant]
        made[ago <= 0.0] = 0.0
        return made

    def _fitted(self, left: Array, onset: int, rest: Array, enough: float) -> tuple[float, Array] | str:
        step = self.times[1]
        for window in _WINDOWS:
            if onset + window > len(self.times):
                return "late"
            rows = np.arange(onset, onset + window)
            wanted = left[rows].ravel()
            norm = float(np.linalg.norm(wanted))

            def design(delay: float, rows: Any = rows) -> Array:
                return self._before(self.times[rows], delay).reshape(-1, len(self.heights))

            def known(delay: float, design: Any = design, wanted: Any = wanted) -> float:
                return float(np.linalg.norm(design(delay) @ rest - wanted))

            def free(delay: float, design: Any = design, wanted: Any = wanted) -> tuple[float, Array]:
                made = np.where(rest != 0.0, design(delay) / self.heights, 0.0)
                gain, *_ = np.linalg.lstsq(made, wanted, rcond=1e-7)
                return float(np.linalg.norm(made @ gain - wanted)), gain / self.heights

            bounds = (self.times[onset] - 4.0 * step, self.times[onset])
            delay, miss, sharp = _least(known, bounds)
            if miss < enough * norm:
                return (delay, rest) if sharp else "an input acts at once and after a delay"
            delay, miss, sharp = _least(lambda one, free=free: free(one)[0], bounds)
            if miss < _OTHER * norm and sharp:
                return delay, free(delay)[1]
        return _NONE


def _least(misfit: Any, bounds: tuple[float, float]) -> tuple[float, float, bool]:
    """The delay with the least misfit, the misfit, and whether its neighbours are worse."""
    from scipy.optimize import minimize_scalar  # slow to import

    places = np.linspace(*bounds, 41)
    values = np.array([misfit(one) for one in places])
    index = int(np.argmin(values))
    low, high = places[max(index - 1, 0)], places[min(index + 1, 40)]
    options = {"xatol": 1e-12 * bounds[1]}
    found = minimize_scalar(misfit, bounds=(low, high), method="bounded", options=options)
    best, value = (found.x, found.fun) if found.fun < values[index] else (places[index], values[index])
    beside = misfit(best - 0.1 * (places[1] - places[0])) - value
    return float(best), float(value), bool(beside > 1e-12 * np.max(values))


def with_lines(space: StateSpace, inner: tuple[InnerDelay, ...]) -> StateSpace:
    """The same with each delay as a line of Chebyshev points; their values are states without a name."""
    for one in inner:
        n, size = len(space.states), len(space.a)
        seen = np.concatenate([one.seen[:n], np.zeros(size - n), one.seen[n:]])
        line = differentiation(_POINTS) / one.delay
        a = scipy.linalg.block_diag(space.a, line[1:, 1:])
        b = np.vstack([space.b, np.outer(line[1:, 0], seen[size:])])
        a[size:, :size] += np.outer(line[1:, 0], seen[:size])
        a[:n, -1] += one.gains
        c = np.hstack([space.c, np.zeros((len(space.c), _POINTS))])
        c[:, -1] += one.through
        space = replace(space, a=a, b=b, c=c)
    return space
