"""Evaluate a system of FMUs, with laws inserted, at one point: derivatives and outputs in machine code."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.compiled_functions import njit
from ...simulation.native.foreign_calls import call_fmi2_values, call_fmi3_values, load, store
from .calls import call_law

Array = NDArray[np.float64]
# Columns of a component's row.
SET, GET, SELF, SET_REFS, SETS, SET_VALUES, GET_REFS, GETS, GET_VALUES = range(9)
X, NX, U, NU, P, NP, Y, NY, VERSION = range(9, 18)
COLUMNS = 18
# Columns of what acts: where, and which law.
_KIND, _COMPONENT, _INDEX, _HAS_W, _LAW, _SIGNAL, _COUNT, _NUMBER, _HIDDEN, _STATES = range(10)
_INTERVAL, _DELAY = 10, 11
_OTHER, _MOVED, _SEEN, _SIZE, _BEGIN, _END, _COLUMNS = range(12, 19)
# Step of differences between what components answer, over the size of a variable, 1 at least.
_STEP = 1e-6
# Evaluations of a component that show two capacities.
_CAPACITIES = 4


class Kinds(IntEnum):
    """Where an unknown input acts."""

    NONE = 0
    INPUT = 1
    RATE = 2
    OUTPUT = 3
    EXCHANGE = 4


@dataclass(frozen=True)
class Place:
    """Where physics can be missing.

    Attributes:
        name: of the input, the output or the state's derivative.
        component: index of the instance.
        index: among all inputs, states or outputs, by `kind`.
        other: of an exchange, which leaves the state `index`, the state that it enters.
        via: of an exchange, what shows the capacities of both states; see `capacities`.
        size: of an exchange, what divides the first state's share; see `capacities`.
        ratio: of an exchange, the second state's share over the first one's; NaN if it changes with states.
    """

    name: str
    kind: Kinds
    component: int
    index: int
    other: int = -1
    via: tuple[int, int] = (0, 0)
    size: float = 1.0
    ratio: float = field(default=math.nan, compare=False)  # NaN differs from itself


@dataclass(frozen=True)
class Inserted:
    """A law at a place: its machine code's address, the signals it reads, its numbers and states.

    Attributes:
        settled: states that start at the first signal.
        delay: see `Law.delay`. Open simulations then look the signal up in the past, filters take the law's
            states.
    """

    place: Place
    address: int
    signals: tuple[int, ...]
    numbers: int
    states: int = 0
    settled: tuple[int, ...] = ()
    delay: str = ""


@njit()
def past_of(acts, steps):
    """Memory of laws: signals that they delay over so many steps, the present (see `_delayed`), one call.

    Without steps no signal is kept: filters and derivatives take the states of such laws.
    """
    kept = steps + 1 if steps > 0 and np.any(acts[:, _DELAY]) else 0
    return np.zeros((len(acts), kept, 3)), np.zeros(4), np.zeros((2, 8))


@njit(allocates=False)
def _summed(past, step, now, signal, at):
    """Integral of a signal up to a point of time [steps]; see `_delayed`."""
    if at <= 0.0:
        return at * (past[0, 0] if step > 0 or now[3] > 0.0 else signal)
    before = int(at)
    if before < step:
        part = at - before
        begin, end = past[before, 0], past[before + 1, 1]
        return past[before, 2] + part * (begin + 0.5 * part * (end - begin))
    begin = past[step, 0] if now[3] > 0.0 else signal
    return past[step, 2] + (at - step) * 0.5 * (begin + signal)


@njit(allocates=False)
def _delayed(past, now, time, signal):
    """A signal some time ago, the mean over one step; writes `past`.

    A jump within a step then counts by its part of the step, so that fits see it move.

    Args:
        past: values at the begin and at the end of each step, and the integral up to its begin, shape
            (steps + 1, 3). Where the signal jumps at a step's begin, both differ.
        now: step, its part that is over, its length [s], and 1 where it begins, 2 where it ends.
        signal: its present value.
    """
    step = int(now[0])
    if now[3] == 1.0:
        past[step, 0] = signal
    elif now[3] == 2.0:
        past[step + 1, 1] = signal
        past[step + 1, 2] = past[step, 2] + 0.5 * (past[step, 0] + signal)
    at = now[0] + now[1] - abs(time) / now[2]
    half = min(0.5, now[0] + now[1] - at)
    if half < 1e-9:
        return signal
    late = _summed(past, step, now, signal, at + half)
    return (late - _summed(past, step, now, signal, at - half)) / (2.0 * half)


@njit(allocates=False)
def _since(t, period, share, before):
    """Time since the latest of the instants (n + share) period, at t or, if asked, before it.

    Before the first one it is that since 0. Of the share, what is beyond 1 does not count.
    """
    period, share = abs(period) + 1e-300, share - math.floor(share)
    number = math.floor(t / period - share + 1e-6)
    if before:
        number = math.ceil(t / period - share - 1e-6) - 1.0
    return max(t - period * (number + share), 0.0) if number >= 0.0 else t


@njit(allocates=False)
def _acting(act, x, u, y, t, w, signals, theta, hidden, extra, past, now, call):
    """What one row of `acts` adds at its place; writes the derivatives of its law's states."""
    total = w if act[_HAS_W] else 0.0
    if act[_LAW] != 0:
        s, out = call
        nx, nu = len(x), len(u)
        for k in range(act[_COUNT]):
            j = signals[act[_SIGNAL] + k]
            s[k] = x[j] if j < nx else (u[j - nx] if j < nx + nu else y[j - nx - nu])
        s[2] = 1e-9 * act[_INTERVAL]
        numbers = theta.ctypes.data + 8 * act[_NUMBER]
        states = hidden.ctypes.data + 8 * act[_HIDDEN]
        call_law(act[_LAW], t, s.ctypes.data, numbers, states, out.ctypes.data)
        if act[_DELAY] and len(past) > 0:
            late = theta[act[_NUMBER]]
            if act[_DELAY] == 2:
                late = _since(t, late, theta[act[_NUMBER] + 1], now[3] == 2.0)
            out[0] = _delayed(past, now, late, s[0]) - s[0]
        total += out[0]
        for k in range(act[_STATES]):
            extra[act[_HIDDEN] + k] = out[1 + k]
    return total


@njit(allocates=False)
def _passes(acts, signals, nx, nu):
    """How often components are evaluated: twice with laws whose inputs or outputs read other inputs.

    The order of evaluation knows only what the components themselves pass on at once.
    """
    for a in range(len(acts)):
        for k in range(acts[a, _SIGNAL], acts[a, _SIGNAL] + acts[a, _COUNT]):
            own = acts[a, _KIND] == 1 and signals[k] == nx + acts[a, _INDEX]
            if acts[a, _LAW] != 0 and acts[a, _KIND] != 2 and signals[k] >= nx and not own:
                if signals[k] < nx + nu or acts[a, _KIND] == 1:
                    return 2
    return 1


@njit(allocates=False)
def answered(row):
    """Have a component answer to what is set: its derivatives and outputs."""
    if row[VERSION] == 2:
        if row[SETS] > 0:
            call_fmi2_values(row[SET], row[SELF], row[SET_REFS], row[SETS], row[SET_VALUES])
        call_fmi2_values(row[GET], row[SELF], row[GET_REFS], row[GETS], row[GET_VALUES])
    else:
        if row[SETS] > 0:
            call_fmi3_values(row[SET], row[SELF], row[SET_REFS], row[SETS], row[SET_VALUES], row[SETS])
        call_fmi3_values(row[GET], row[SELF], row[GET_REFS], row[GETS], row[GET_VALUES], row[GETS])


@njit(allocates=False)
def answer_at(row, seen):
    """What a component answers, a derivative or an output, by its position."""
    return load(row[GET_VALUES] + 8 * seen, 0.0)


@njit(allocates=False)
def put_at(row, moved, value, relative):
    """Set one variable of a component by its position, and have it answered; returns what it was before.

    Args:
        relative: whether `value` is a change, in the variable's size, 1 at least.
    """
    at = row[SET_VALUES] + 8 * moved
    before = load(at, 0.0)
    store(at, before + value * max(1.0, abs(before)) if relative else value)
    answered(row)
    return before


@njit(allocates=False)
def slope(row, moved, seen):
    """Derivative of one answer of a component by what is set, both by their positions."""
    first = answer_at(row, seen)
    value = put_at(row, moved, _STEP, True)
    change = answer_at(row, seen) - first
    put_at(row, moved, value, False)
    return change / (_STEP * max(1.0, abs(value)))


@njit(allocates=False)
def capacities(row, first, second, moved, seen):
    """Shares of two states in what passes between them: one over their capacities, but for a factor.

    What one variable does to a state and what the state does to that variable's counterpart differ by the
    capacities of both, as pressures move a piston that displaces oil, or as two bodies exchange heat.

    Args:
        first, second: positions of the states. moved, seen: of the variable, and of its counterpart.
    """
    to_first, to_second = row[GET_VALUES] + 8 * first, row[GET_VALUES] + 8 * second
    to_seen = row[GET_VALUES] + 8 * seen
    before, begin, end = load(to_seen, 0.0), load(to_first, 0.0), load(to_second, 0.0)
    value = put_at(row, first, _STEP, True)
    by_first = (load(to_seen, 0.0) - before) / max(1.0, abs(value))
    store(row[SET_VALUES] + 8 * first, value)
    value = put_at(row, second, _STEP, True)
    by_second = (load(to_seen, 0.0) - before) / max(1.0, abs(value))
    store(row[SET_VALUES] + 8 * second, value)
    value = put_at(row, moved, _STEP, True)
    begin, end = load(to_first, 0.0) - begin, load(to_second, 0.0) - end
    step = max(1.0, abs(value))
    put_at(row, moved, value, False)
    if by_first == 0.0 or by_second == 0.0:
        return 0.0, 0.0
    return abs(begin / step / by_first), abs(end / step / by_second)


@njit(allocates=False)
def evaluate(rows, wiring, x, ext, p, t, acts, w, signals, theta, hidden, u, y, rate, extra, past, now, call):
    """Derivatives and outputs at one point.

    Args:
        rows: components, shape (n, 18). wiring: see `StateModel`. x, ext, p: states, fed signals, parameters.
        acts: what acts where, shape (n, 19), see `acts_of`. w: the unknown input.
        signals: which of [x, u, y] the laws read. theta, hidden: their numbers and their states.
        u, y, rate: written, inputs, outputs and derivatives. extra: written, derivatives of `hidden`.
        past, now, call: memory of laws; see `past_of`.
    """
    first, source, gain, constant, u_ext, y_ext, schedule = wiring
    for turn in range(_passes(acts, signals, len(x), len(u)) * len(schedule)):
        c = schedule[turn % len(schedule)]
        row = rows[c]
        for i in range(row[U], row[U] + row[NU]):
            if u_ext[i] >= 0:
                u[i] = ext[u_ext[i]]
            else:
                value = constant[i]
                for k in range(first[i], first[i + 1]):
                    value += gain[k] * (y[source[k]] if y_ext[source[k]] < 0 else ext[y_ext[source[k]]])
                u[i] = value
        for a in range(len(acts)):
            if acts[a, _COMPONENT] == c and acts[a, _KIND] == 1:
                u[acts[a, _INDEX]] += _acting(
                    acts[a], x, u, y, t, w, signals, theta, hidden, extra, past[a], now, call
                )  # fmt: skip
        at = row[SET_VALUES]
        for i in range(row[NX]):
            store(at, x[row[X] + i])
            at += 8
        for i in range(row[NU]):
            store(at, u[row[U] + i])
            at += 8
        for i in range(row[NP]):
            store(at, p[row[P] + i])
            at += 8
        answered(row)
        at = row[GET_VALUES]
        for i in range(row[NX]):
            rate[row[X] + i] = load(at, 0.0)
            at += 8
        for i in range(row[NY]):
            y[row[Y] + i] = load(at, 0.0)
            at += 8
        for a in range(len(acts)):
            if acts[a, _COMPONENT] == c and acts[a, _KIND] > 1:
                added = _acting(
                    acts[a], x, u, y, t, w, signals, theta, hidden, extra, past[a], now, call
                )  # fmt: skip
                if acts[a, _KIND] == 4:
                    i, j = acts[a, _INDEX], acts[a, _OTHER]
                    at = acts.ctypes.data + 8 * a * _COLUMNS
                    if now[3] < 2.0:  # capacities hardly change within a step
                        begin, end = capacities(row, i - row[X], j - row[X], acts[a, _MOVED], acts[a, _SEEN])
                        store(at + 8 * _BEGIN, begin)
                        store(at + 8 * _END, end)
                    added /= load(at + 8 * _SIZE, 0.0)
                    rate[i] -= added * load(at + 8 * _BEGIN, 0.0)
                    rate[j] += added * load(at + 8 * _END, 0.0)
                elif acts[a, _KIND] == 2:
                    rate[acts[a, _INDEX]] += added
                else:
                    y[acts[a, _INDEX]] += added


def calls_of(components: int, laws: Sequence[Inserted], w: Place | None = None) -> int:
    """Evaluations of components at one point; see `capacities` for those of an exchange."""
    places = [*(one.place for one in laws), *([] if w is None else [w])]
    return components + _CAPACITIES * sum(one.kind is Kinds.EXCHANGE for one in places)


def acts_of(laws: Sequence[Inserted], w: Place | None, interval: float) -> tuple[Any, Any]:
    """Rows of what acts, and the signals that laws read: inserted laws, then the unknown input.

    Args:
        interval: of the logs [s], for laws that need it.
    """
    rows, signals, number, hidden = [], list[int](), 0, 0

    def place(one: Place) -> list[int]:
        return [one.other, *one.via, int(np.float64(one.size).view(np.int64)), 0, 0]

    for one in laws:
        where = one.place
        rows.append([
            int(where.kind), where.component, where.index, 0, one.address, len(signals), len(one.signals),
            number, hidden, one.states, round(1e9 * interval), ("", "fixed", "held").index(one.delay),
            *place(where),
        ])  # fmt: skip
        signals += one.signals
        number, hidden = number + one.numbers, hidden + one.states
    if w is not None:
        rows.append([int(w.kind), w.component, w.index, 1, 0, 0, 0, 0, 0, 0, 0, 0, *place(w)])
    return np.array(rows, np.int64).reshape(len(rows), _COLUMNS), np.array(signals, np.int64)
