"""Steps of plain systems: FMI 2.0, doubles that are moved where they lie, nothing converted, nothing timed.

Most systems are such, and a loop that holds no more than they need takes two thirds of the general one's
time.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from .foreign_calls import call_fmi2_status, call_fmi2_step, call_fmi2_values, load, store
from .table_columns import Outcome, Phase, Plain, Step

# numba takes plain whole numbers for constants.
_WHO, _PHASE, _BLOCK, _STATUS, _PART, _ENDER = map(int, Outcome)
_SET, _ADVANCE, _GET, _FINITE = map(int, (Phase.SET, Phase.ADVANCE, Phase.GET, Phase.FINITE))
_COMPONENT, _SETTER, _INPUTS, _INPUT_COUNT, _U, _STEP, _NO_ROLLBACK = map(int, list(Plain)[:7])
_GETTER, _OUTPUTS, _OUTPUT_COUNT, _Y, _FIRST_INPUT, _END_INPUT = map(int, list(Plain)[7:13])
_POSITION, _SET_ROW, _GET_ROW = map(int, list(Plain)[13:])
_VERSION, _OWNER, _TERMINATE, _REACHED, _ASK_TERMINATE, _ASK_REACHED = map(
    int,
    (Step.VERSION, Step.COMPONENT, Step.TERMINATE, Step.REACHED, Step.ASK_TERMINATE, Step.ASK_REACHED),
)
_ROW, _STEP_ROW = 8 * len(Plain), 8 * len(Step)  # bytes

# Codes of FMI 2.
_DISCARD, _LAST_SUCCESSFUL_TIME, _TERMINATED = 2, 2, 3
# How near a step's end an end of the simulation counts as being there, as in running_instances.py: parts of
# the step, and roundings.
_CLOSE, _ROUNDINGS = 1e-9, 8.0

# The bits of a double that are all ones in infinities and NaNs only.
_EXPONENT = 0x7FF0000000000000


@register_jitable
def word(row, column):
    """An entry of a row of a table, by the row's address."""
    return load(row + 8 * column, np.int64(0))


@register_jitable
def end(outcome, who, phase, row, status, part=0):
    """Report how a chunk ended."""
    store(outcome + 8 * _WHO, np.int64(who))
    store(outcome + 8 * _PHASE, np.int64(phase))
    store(outcome + 8 * _BLOCK, np.int64(row))
    store(outcome + 8 * _STATUS, np.int64(status))
    store(outcome + 8 * _PART, np.int64(part))


@register_jitable
def ends_after(step, status, time, step_size):
    """Whether an instance finished a communication step and asks to end the simulation.

    Args:
        step: address of the instance's row of table_columns.Step.
        status: what its step function returned.
        time, step_size: of the communication step [s].
    """
    if word(step, _VERSION) == 3:
        if status > 1 or load(word(step, _TERMINATE), np.uint8(0)) == 0:
            return False
    else:
        asked, reached = word(step, _ASK_TERMINATE), word(step, _ASK_REACHED)
        if status != _DISCARD or asked == 0 or reached == 0:
            return False
        owner, answer = word(step, _OWNER), word(step, _TERMINATE)
        store(answer, np.int32(0))
        if (
            call_fmi2_status(asked, owner, np.int32(_TERMINATED), answer) > 1
            or load(answer, np.int32(0)) == 0
        ):
            return False
        if call_fmi2_status(reached, owner, np.int32(_LAST_SUCCESSFUL_TIME), word(step, _REACHED)) > 1:
            return False
    until = time + step_size
    close = max(_CLOSE * step_size, _ROUNDINGS * np.spacing(abs(until)))
    return load(word(step, _REACHED), np.float64(0)) >= until - close


@register_jitable
def not_finite(bits):
    """Whether one of these doubles, given by their bits, is no finite number."""
    # Vectorised, in numbers that do not overflow: compiled code may take that as given.
    found = np.int64(0)
    for index in range(bits.shape[0]):
        found |= ((bits[index] & _EXPONENT) ^ _EXPONENT) - 1
    return found < 0


@register_jitable
def run_plain(
    first, last, plan, steps_at, late, source, inputs_at, values, bits, times, step_size, columns, record,
    outcome,
):  # fmt: skip
    """Take the steps first <= point < last, or those until one fails; see `kernel.run_steps`.

    Args:
        plan: one row of codes.Plain for each instance in the order of stepping.
        steps_at, inputs_at, outcome: addresses.
        bits: of `values`.
    Returns: the first point whose step was not taken, or not finished.
    """
    plan_at, values_at, count, inputs = plan.ctypes.data, values.ctypes.data, plan.shape[0], source.shape[0]
    source_at = source.ctypes.data
    ender = np.int64(-1)
    for point in range(first, last):
        time = times[point]
        if record:
            for index in range(values.shape[0]):
                columns[index, point] = values[index]
        if not late:
            for index in range(inputs):
                store(inputs_at + 8 * index, load(values_at + 8 * word(source_at, index), np.float64(0)))
        row = plan_at
        for _ in range(count):
            if late:
                for index in range(word(row, _FIRST_INPUT), word(row, _END_INPUT)):
                    store(inputs_at + 8 * index, load(values_at + 8 * word(source_at, index), np.float64(0)))
            component = word(row, _COMPONENT)
            size = word(row, _INPUT_COUNT)
            if size != 0:
                status = call_fmi2_values(
                    word(row, _SETTER), component, word(row, _INPUTS), size, word(row, _U)
                )
                if status > 1:
                    end(outcome, word(row, _POSITION), _SET, word(row, _SET_ROW), status)
                    return point
            status = call_fmi2_step(
                word(row, _STEP), component, time, step_size, np.int32(word(row, _NO_ROLLBACK))
            )
            if status > 1:
                position = word(row, _POSITION)
                if not ends_after(steps_at + _STEP_ROW * position, status, time, step_size):
                    end(outcome, position, _ADVANCE, 0, status)
                    return point
                ender = position
            size = word(row, _OUTPUT_COUNT)
            if size != 0:
                status = call_fmi2_values(
                    word(row, _GETTER), component, word(row, _OUTPUTS), size, word(row, _Y)
                )
                if status > 1:
                    end(outcome, word(row, _POSITION), _GET, word(row, _GET_ROW), status)
                    return point
            row += _ROW
        if not_finite(bits):
            end(outcome, 0, _FINITE, 0, 0)
            return point
        if ender >= 0:
            store(outcome + 8 * _ENDER, ender)
            return point + 1
    return last
