"""Steps of one FMU in machine code, so that the caller is not measured."""

from __future__ import annotations

import numpy as np
from numba import njit

from ...fmi import Array
from ...fmi.binary_instance import NativeCalls
from ...simulation.native.foreign_calls import (
    call_fmi2_step,
    call_fmi2_values,
    call_fmi3_step,
    call_fmi3_values,
)

SET, STEP, GET = 1, 2, 4
_FUNCTION, _REFERENCES, _COUNT, _VALUES, _VALUE_COUNT = range(5)


def tables(calls: NativeCalls) -> tuple[Array, Array, Array]:
    """What `run` calls: the step, shape (7,), and blocks to set and to get, shape (blocks, 5); addresses."""
    from ctypes import addressof

    step = np.array([calls.step, calls.component, calls.no_rollback, *calls.returned], np.int64)
    blocks = [
        np.array(
            [
                [
                    one.address,
                    addressof(one.references),
                    len(one.references),
                    addressof(one.values),
                    len(one.values),
                ]
                for one in group
            ],
            np.int64,
        ).reshape(len(group), 5)
        for group in (calls.inputs, calls.outputs)
    ]
    return step, *blocks


@njit
def _values(version, component, row):
    if version == 3:
        return call_fmi3_values(
            row[_FUNCTION], component, row[_REFERENCES], row[_COUNT], row[_VALUES], row[_VALUE_COUNT]
        )
    return call_fmi2_values(row[_FUNCTION], component, row[_REFERENCES], row[_COUNT], row[_VALUES])


@njit
def run(what, version, step, setting, getting, rows, u, first, count, size):
    """Take steps, or parts of them; how many went well.

    Args:
        what: sum of SET, STEP and GET.
        step, setting, getting: see `tables`.
        rows: inputs that follow each other, shape (n, inputs), over and over.
        u: where the FMU's inputs are taken from, shape (inputs,).
        first: number of the first step; count: of steps; size: of one [s].
    """
    component = step[1]
    for index in range(first, first + count):
        if what & SET:
            u[:] = rows[index % len(rows)]
            for block in range(len(setting)):
                if _values(version, component, setting[block]) > 1:
                    return index - first
        if what & STEP:
            time = index * size
            if version == 3:
                status = call_fmi3_step(
                    step[0], component, time, size, step[2], step[3], step[4], step[5], step[6]
                )
            else:
                status = call_fmi2_step(step[0], component, time, size, np.int32(step[2]))
            if status > 1:
                return index - first
        if what & GET:
            for block in range(len(getting)):
                if _values(version, component, getting[block]) > 1:
                    return index - first
    return count
