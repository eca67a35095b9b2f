"""A chunk of communication steps in machine code."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba.extending import register_jitable

from ...base.compiled_functions import njit
from .effects import _PATH_ROW, evaluate
from .extrapolation import bend, bend_on, bends, feed, predict, settle, settle_all
from .foreign_calls import (
    call_fmi2_step,
    call_fmi2_values,
    call_fmi3_step,
    call_fmi3_values,
    call_timer,
    load,
    store,
)
from .plain_steps import end as _end
from .plain_steps import ends_after, not_finite, run_plain
from .plain_steps import word as _word
from .table_columns import Ahead, Call, Code, Outcome, Phase, Step
from .table_columns import Path as Chain

# numba takes plain whole numbers for constants.
_C_FUNCTION, _C_COMPONENT, _REFERENCES, _COUNT, _VALUES, _CODE, _PLACE, _VALUE_COUNT = map(int, Call)
_VERSION, _FUNCTION, _COMPONENT, _NO_ROLLBACK, _EVENT, _TERMINATE, _EARLY, _REACHED = map(int, list(Step)[:8])
_FIRST_SET, _END_SET, _FIRST_GET, _END_GET, _FIRST_INPUT, _END_INPUT, _CONVERTS = map(int, list(Step)[10:17])
_EVERY, _PARTS = map(int, list(Step)[17:])
_DIRECT, _F64, _F32, _I8, _U8, _I16, _U16, _I32, _U32, _I64, _U64, _BOOL = map(int, Code)
_DONE, _SET, _ADVANCE, _GET, _FINITE, _CONVERT, _BEND = map(int, Phase)
_AT_END, _PATH_PLACE, _ENDER = int(Ahead.END), int(Chain.PLACE), int(Outcome.ENDER)
_CALL_ROW, _STEP_ROW = 8 * len(Call), 8 * len(Step)  # bytes

# Of a step: how near its end an early return counts as its end, as in fmi3.py.
_CLOSE = 1e-9

_BIGGEST = 2.0**63


# Helpers take addresses instead of arrays: numba counts the references of every array that is passed on, with
# atomic operations that cost as much as a small FMU's step.


@register_jitable
def _call_values(row, version):
    """Call a get or set function."""
    if version == 3:
        return call_fmi3_values(
            _word(row, _C_FUNCTION),
            _word(row, _C_COMPONENT),
            _word(row, _REFERENCES),
            _word(row, _COUNT),
            _word(row, _VALUES),
            _word(row, _VALUE_COUNT),
        )
    return call_fmi2_values(
        _word(row, _C_FUNCTION),
        _word(row, _C_COMPONENT),
        _word(row, _REFERENCES),
        _word(row, _COUNT),
        _word(row, _VALUES),
    )


@register_jitable
def _stopped(row, end):
    """Whether the last step asks to end the simulation, or returned before its end."""
    if load(_word(row, _TERMINATE), np.uint8(0)) != 0:
        return True
    return load(_word(row, _EARLY), np.uint8(0)) != 0 and load(_word(row, _REACHED), 0.0) < end


@register_jitable
def _step(row, time, step_size):
    """Call a step function."""
    if _word(row, _VERSION) == 3:
        return call_fmi3_step(
            _word(row, _FUNCTION),
            _word(row, _COMPONENT),
            time,
            step_size,
            np.int32(_word(row, _NO_ROLLBACK)),
            _word(row, _EVENT),
            _word(row, _TERMINATE),
            _word(row, _EARLY),
            _word(row, _REACHED),
        )
    return call_fmi2_step(
        _word(row, _FUNCTION),
        _word(row, _COMPONENT),
        time,
        step_size,
        np.int32(_word(row, _NO_ROLLBACK)),
    )


@register_jitable
def _unsigned(value):
    """A whole number from -2**63 to below 2**64, as 64 bits."""
    if value < _BIGGEST:
        return np.uint64(np.int64(value))
    return np.uint64(np.int64(value - _BIGGEST)) + np.uint64(1 << 63)


@register_jitable
def _fits(code, whole):
    """Whether a type holds a whole number; none holds NaN or infinities."""
    if code == _BOOL:
        return math.isfinite(whole)
    signed = code == _I8 or code == _I16 or code == _I32 or code == _I64
    if code == _I8 or code == _U8:
        count = 256.0
    elif code == _I16 or code == _U16:
        count = 65536.0
    elif code == _I32 or code == _U32:
        count = 4294967296.0
    else:
        # The double next to the largest number of 64 bits stands for it; see `_whole_64`.
        return (-_BIGGEST <= whole <= _BIGGEST) if signed else (0.0 <= whole <= 2.0 * _BIGGEST)
    if signed:
        return -0.5 * count <= whole < 0.5 * count
    return 0.0 <= whole < count


@register_jitable
def _whole_64(code, value):
    """A whole number as 64 bits. Signals are doubles: that next to the largest number is one beyond it."""
    if code == _I64 and value >= _BIGGEST:
        return np.uint64((1 << 63) - 1)
    if value >= 2.0 * _BIGGEST:
        return np.uint64((1 << 64) - 1)
    return _unsigned(value)


@register_jitable
def _send(row, places, memory):
    """Memory -> buffer; whether all values could be converted."""
    code = _word(row, _CODE)
    address = _word(row, _VALUES)
    places += 8 * _word(row, _PLACE)
    for index in range(_word(row, _VALUE_COUNT)):
        value = load(memory + 8 * _word(places, index), np.float64(0))
        if code == _F64:
            store(address + 8 * index, value)
            continue
        if code == _F32:
            store(address + 4 * index, np.float32(value))
            continue
        if not _fits(code, np.rint(value)):
            return False
        if code == _BOOL:
            store(address + index, np.uint8(np.rint(value) != 0.0))
            continue
        whole = _whole_64(code, np.rint(value))
        if code == _I64 or code == _U64:
            store(address + 8 * index, whole)
        elif code == _I32 or code == _U32:
            store(address + 4 * index, np.uint32(whole))
        elif code == _I16 or code == _U16:
            store(address + 2 * index, np.uint16(whole))
        else:
            store(address + index, np.uint8(whole))
    return True


@register_jitable
def _fetch(row, places, memory):
    """Buffer -> memory."""
    code = _word(row, _CODE)
    address = _word(row, _VALUES)
    places += 8 * _word(row, _PLACE)
    for index in range(_word(row, _VALUE_COUNT)):
        if code == _F64:
            value = load(address + 8 * index, np.float64(0))
        elif code == _F32:
            value = np.float64(load(address + 4 * index, np.float32(0)))
        elif code == _I64:
            value = np.float64(load(address + 8 * index, np.int64(0)))
        elif code == _U64:
            value = np.float64(load(address + 8 * index, np.uint64(0)))
        elif code == _I32:
            value = np.float64(load(address + 4 * index, np.int32(0)))
        elif code == _U32:
            value = np.float64(load(address + 4 * index, np.uint32(0)))
        elif code == _I16:
            value = np.float64(load(address + 2 * index, np.int16(0)))
        elif code == _U16:
            value = np.float64(load(address + 2 * index, np.uint16(0)))
        elif code == _I8:
            value = np.float64(load(address + index, np.int8(0)))
        elif code == _U8:
            value = np.float64(load(address + index, np.uint8(0)))
        else:
            value = 1.0 if load(address + index, np.uint8(0)) != 0 else 0.0
        store(memory + 8 * _word(places, index), value)


@register_jitable
def _transfer(row, source, gain, offset, values, inputs):
    """Feed an instance's inputs; where no connection converts, bits are not touched."""
    if _word(row, _CONVERTS) != 0:
        for index in range(_word(row, _FIRST_INPUT), _word(row, _END_INPUT)):
            value = load(values + 8 * _word(source, index), np.float64(0))
            value = value * load(gain + 8 * index, np.float64(0)) + load(offset + 8 * index, np.float64(0))
            store(inputs + 8 * index, value)
    else:
        for index in range(_word(row, _FIRST_INPUT), _word(row, _END_INPUT)):
            store(inputs + 8 * index, load(values + 8 * _word(source, index), np.float64(0)))


@register_jitable
def _follow(first, end, after, paths, links, legs, leg_gain, leg_offset, reads, values, time):
    """Evaluate, on trial, the connections that depend on an instance: those of a stretch of `after`."""
    for index in range(first, end):
        evaluate(
            paths + _PATH_ROW * _word(after, index), links, legs, leg_gain, leg_offset, reads, values,
            time, False,
        )  # fmt: skip


@register_jitable
def _now(timer):
    """Nanoseconds of the clock; 0 without one."""
    if _word(timer, 0) == 0:
        return 0
    call_timer(_word(timer, 0), _word(timer, 1), timer + 16)
    return _word(timer, 2) * 1_000_000_000 + _word(timer, 3)


def _compile(name: str, wired: bool, bent: bool) -> Callable[..., int]:
    """The function below; it is kept under its name, all sources and the values that it closes over.

    Args:
        wired: whether connections have effects; what serves them is left out of the code otherwise.
        bent: whether inputs follow curves; the same.
    """

    def run_steps(
        order, late, steps, calls, plan, places, source, gain, offset, values, inputs, first, times,
        step_size, begun, columns, elapsed, timed_every, timer, paths, links, legs, leg_gain, leg_offset,
        reads, after, bounds, ahead, square, outcome,
    ):  # fmt: skip
        """Take the steps that begin at `times`, or those until one fails.

        Args:
            order: positions of instances in the order of stepping, shape (i,).
            late: whether an instance's inputs are fed right before it steps (Gauss-Seidel), not at the begin.
            steps, calls: tables, shapes (i, len(Step)) and (c, len(Call)).
            plan: for `run_plain`, shape (i, len(Plain)); (0, len(Plain)) where the system is not plain.
            places: of values that go by way of a buffer, in `inputs` or `values`.
            source, gain, offset: of each input: input = gain * values[source] + offset, shape (u,).
            values: the signals, shape (y,), bound to the FMUs' outputs; updated.
            inputs: bound to the FMUs' inputs, shape (u,).
            first: index of the first point; times: communication points, shape (n,) [s]; step_size: [s].
            begun: when the steps of instances began that take several communication steps, shape (i,) [s];
                updated.
            columns: where the signals at each point go, shape (y, n or more), or (y, 0) to record nothing.
            elapsed: time in each instance's steps, shape (i,) [ns]; updated.
            timed_every: time the first of so many steps.
            timer: address of clock_gettime, its clock, and two words for it to write, shape (4,).
            paths, links, legs, leg_gain, leg_offset, reads, after, bounds: of connections with effects, see
                `wiring.Wiring`.
            ahead: of inputs that follow curves, see `ahead.Curves`; square: of `step_size`.
            outcome: how it ended, by `Outcome`.
        Returns: the number of steps that were finished. An instance may end the simulation
            after the last one.
        """
        _end(outcome.ctypes.data, 0, _DONE, 0, 0)
        outcome[_ENDER] = ender = np.int64(-1)
        steps_at, calls_at, places_at = steps.ctypes.data, calls.ctypes.data, places.ctypes.data
        source_at, gain_at, offset_at = source.ctypes.data, gain.ctypes.data, offset.ctypes.data
        values_at, inputs_at, timer_at = values.ctypes.data, inputs.ctypes.data, timer.ctypes.data
        outcome_at = outcome.ctypes.data
        paths_at, links_at, reads_at = paths.ctypes.data, links.ctypes.data, reads.ctypes.data
        legs_at, leg_gain_at = legs.ctypes.data, leg_gain.ctypes.data
        leg_offset_at, after_at = leg_offset.ctypes.data, after.ctypes.data
        ahead_at, curved = ahead.ctypes.data, np.int64(0)
        bits = values.view(np.int64)
        record = columns.shape[1] > 0
        countdown = 1
        plain = not wired and not bent and plan.shape[0] > 0 and timed_every > 1
        point = 0
        while point < times.shape[0]:
            time = times[point]
            begin = np.int64(0)
            countdown -= 1
            timed = countdown == 0
            if timed:
                countdown = timed_every
            elif plain:
                last = min(point + countdown, times.shape[0])
                reached = run_plain(
                    point, last, plan, steps_at, late, source, inputs_at, values, bits, times, step_size,
                    columns, record, outcome_at,
                )  # fmt: skip
                if reached != last or _word(outcome_at, _ENDER) >= 0:
                    return reached
                point, countdown = last, 1
                continue
            if record:
                for index in range(values.shape[0]):
                    columns[index, point] = values[index]
            if bent:
                curved = predict(ahead_at, first + point, values_at)
            if not late:
                for who in order:
                    step = steps_at + _STEP_ROW * who
                    if bent and curved > 0:
                        feed(step, ahead_at, source_at, gain_at, offset_at, inputs_at)
                    elif (first + point) % _word(step, _EVERY) == 0:
                        _transfer(step, source_at, gain_at, offset_at, values_at, inputs_at)
            for who in order:
                step = steps_at + _STEP_ROW * who
                every, parts = _word(step, _EVERY), _word(step, _PARTS)
                own_time, own_size = time, step_size
                if every != 1:
                    if (first + point) % every == 0:
                        begun[who] = time
                    if (first + point + 1) % every != 0:
                        # It keeps its outputs until its step ends.
                        if wired and late:
                            _follow(
                                bounds[who], bounds[who + 1], after_at, paths_at, links_at, legs_at,
                                leg_gain_at, leg_offset_at, reads_at, values_at, time + step_size,
                            )  # fmt: skip
                        continue
                    own_time, own_size = begun[who], every * step_size
                elif parts != 1:
                    own_size = step_size / parts
                if late:
                    if bent and curved > 0:
                        feed(step, ahead_at, source_at, gain_at, offset_at, inputs_at)
                    else:
                        _transfer(step, source_at, gain_at, offset_at, values_at, inputs_at)
                if timed:
                    begin = _now(timer_at)
                version = _word(step, _VERSION)
                follows = bent and curved > 0 and bends(ahead_at, who)
                for part in range(parts):
                    passed = 0.0
                    if parts != 1:
                        passed = step_size * (part / parts)
                        own_time = time + passed
                    if bent and follows and part > 0:
                        bend_on(
                            step, ahead_at, curved, who, source_at, gain_at, offset_at, inputs_at, step_size,
                            square, passed,
                        )  # fmt: skip
                    if part == 0 or (bent and follows):
                        for index in range(_word(step, _FIRST_SET), _word(step, _END_SET)):
                            call = calls_at + _CALL_ROW * index
                            if _word(call, _CODE) != _DIRECT and not _send(call, places_at, inputs_at):
                                _end(outcome_at, who, _CONVERT, index, 0, part)
                                return point
                            status = _call_values(call, version)
                            if status > 1:
                                _end(outcome_at, who, _SET, index, status, part)
                                return point
                    if bent and follows:
                        status = bend(
                            step, ahead_at, curved, who, source_at, gain_at, step_size, square, passed
                        )
                        if status > 1:
                            _end(outcome_at, who, _BEND, 0, status, part)
                            return point
                    status = _step(step, own_time, own_size)
                    if status > 1 or (version == 3 and _stopped(step, own_time + (1.0 - _CLOSE) * own_size)):
                        if not ends_after(step, status, time, step_size):
                            _end(outcome_at, who, _ADVANCE, 0, status, part)
                            return point
                        ender = who
                        break
                for index in range(_word(step, _FIRST_GET), _word(step, _END_GET)):
                    call = calls_at + _CALL_ROW * index
                    status = _call_values(call, version)
                    if status > 1:
                        _end(outcome_at, who, _GET, index, status)
                        return point
                    if _word(call, _CODE) != _DIRECT:
                        _fetch(call, places_at, values_at)
                if wired and late:
                    _follow(
                        bounds[who], bounds[who + 1], after_at, paths_at, links_at, legs_at, leg_gain_at,
                        leg_offset_at, reads_at, values_at, time + step_size,
                    )  # fmt: skip
                if bent and late and curved > 0:
                    settle_all(ahead_at, curved, who, values_at)
                    end = _word(ahead_at, _AT_END)
                    for index in range(bounds[who], bounds[who + 1]):
                        # Of what is yet to come it is made as that is supposed to be.
                        path = paths_at + _PATH_ROW * _word(after_at, index)
                        evaluate(
                            path, links_at, legs_at, leg_gain_at, leg_offset_at, reads_at, end,
                            time + step_size, False,
                        )  # fmt: skip
                        place = _word(path, _PATH_PLACE)
                        settle(ahead_at, curved, place, load(end + 8 * place, np.float64(0)))
                if timed:
                    elapsed[who] += _now(timer_at) - begin
            if wired:
                for index in range(paths.shape[0]):
                    evaluate(
                        paths_at + _PATH_ROW * index, links_at, legs_at, leg_gain_at, leg_offset_at,
                        reads_at, values_at, time + step_size, True,
                    )  # fmt: skip
            if not_finite(bits):
                _end(outcome_at, 0, _FINITE, 0, 0)
                return point
            point += 1
            if ender >= 0:
                outcome[_ENDER] = ender
                return point
        return times.shape[0]

    run_steps.__qualname__ = name
    return njit(nogil=True, error_model="numpy")(run_steps)


run_steps = _compile("run_steps", False, False)
run_wired_steps = _compile("run_wired_steps", True, False)
run_bent_steps = _compile("run_bent_steps", True, True)
