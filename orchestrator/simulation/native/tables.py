"""What the native loop calls and moves, as tables of numbers."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Sequence
from ctypes import addressof
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...fmi import Array
from ...fmi.binary_instance import NativeCalls
from ...fmi.block import Block
from ...master.running_instances import Instances
from .choice import Schedule
from .effects import Wiring
from .extrapolation import Curves
from .table_columns import Call, Code, Plain, Step

_CODES = {
    ctypes.c_double: Code.F64,
    ctypes.c_float: Code.F32,
    ctypes.c_int8: Code.I8,
    ctypes.c_uint8: Code.U8,
    ctypes.c_int16: Code.I16,
    ctypes.c_uint16: Code.U16,
    ctypes.c_int32: Code.I32,
    ctypes.c_uint32: Code.U32,
    ctypes.c_int64: Code.I64,
    ctypes.c_uint64: Code.U64,
    ctypes.c_bool: Code.BOOL,
}

Whole = NDArray[np.int64]


@dataclass(frozen=True)
class Tables:
    """Arguments of `kernel.run_steps` that stay the same for a run; see there.

    Attributes:
        blocks: the blocks behind the rows of `calls`.
    """

    order: Whole
    late: bool
    steps: Whole
    calls: Whole
    plan: Whole
    places: Whole
    source: Whole
    gain: Array
    offset: Array
    values: Array
    inputs: Array
    timer: Whole
    wiring: Wiring
    curves: Curves
    blocks: tuple[Block, ...]

    @staticmethod
    def of(
        instances: Instances,
        native: Sequence[NativeCalls],
        planned: Schedule,
        step_size: float,
    ) -> Tables:
        """The tables of instances that are bound.

        Args:
            native: what each instance calls.
            planned: how the master steps.
            step_size: the communication step [s].
        """
        order, late, extrapolation = planned
        values, inputs = instances.native_memory
        layout = instances.layout
        steps, calls, places = [], [], []
        blocks: list[Block] = []
        first = 0
        for position, one in enumerate(native):
            end = first + len(layout.inputs[position].names)
            row: list[Any] = [
                one.version,
                one.step,
                one.component,
                one.no_rollback,
                *one.returned,
                *one.asked,
            ]
            for group, begin in ((one.inputs, first), (one.outputs, layout.spans[position].start)):
                row.append(len(blocks))
                for block in group:
                    calls.append(_call(block, one.component, len(places)))
                    places += [begin + place for place in block.positions]
                    blocks.append(block)
                row.append(len(blocks))
            ratio = instances.system.instances[position].ratio
            converts = layout.inputs[position].gain is not None
            steps.append([*row, first, end, converts, ratio.numerator, ratio.denominator])
            first = end
        plan = _plan(native, steps, calls, order, late)
        gains = [
            (
                np.ones(len(one.names)) if one.gain is None else one.gain,
                np.zeros(len(one.names)) if one.offset is None else one.offset,
            )
            for one in layout.inputs
        ]
        return Tables(
            order=_whole(order),
            late=late,
            steps=_whole(steps).reshape(-1, len(Step)),
            calls=_whole(calls).reshape(-1, len(Call)),
            plan=_whole(plan).reshape(-1, len(Plain)),
            places=_whole(places),
            source=_whole(np.concatenate([_whole([]), *(one.source for one in layout.inputs)])),
            gain=np.concatenate([np.zeros(0), *(gain for gain, _ in gains)]),
            offset=np.concatenate([np.zeros(0), *(offset for _, offset in gains)]),
            values=values,
            inputs=inputs,
            timer=_timer(),
            wiring=Wiring.of(instances, step_size),
            curves=Curves.of(instances, native, extrapolation, steps),
            blocks=tuple(blocks),
        )


def _call(block: Block, component: int, place: int) -> list[int]:
    return [
        block.address,
        component,
        addressof(block.references),
        len(block.references),
        addressof(block.values),
        Code.DIRECT if block.direct else _CODES[block.ctype],
        place,
        len(block.values),
    ]


def _plan(
    native: Sequence[NativeCalls],
    steps: Sequence[Sequence[int]],
    calls: Sequence[Sequence[int]],
    order: Sequence[int],
    late: bool,
) -> list[list[int]]:
    """The plan of a plain system; empty for others."""
    plan = []
    for who in order:
        step = steps[who]
        sets = range(step[Step.FIRST_SET], step[Step.END_SET])
        gets = range(step[Step.FIRST_GET], step[Step.END_GET])
        direct = all(calls[row][Call.CODE] == Code.DIRECT for row in (*sets, *gets))
        if native[who].version != 2 or not direct or len(sets) > 1 or len(gets) > 1 or step[Step.CONVERTS]:
            return []
        if step[Step.EVERY] != 1 or step[Step.PARTS] != 1:
            return []
        given = (Call.FUNCTION, Call.REFERENCES, Call.COUNT, Call.VALUES)
        setter, getter = (
            [calls[rows[0]][one] for one in given] if rows else [0] * 4 for rows in (sets, gets)
        )
        fed = (step[Step.FIRST_INPUT], step[Step.END_INPUT]) if late else (0, 0)
        stepping = (step[Step.FUNCTION], step[Step.NO_ROLLBACK])
        plan.append([step[Step.COMPONENT], *setter, *stepping, *getter, *fed, who, sets.start, gets.start])
    return plan


def _whole(values: Any) -> Whole:
    return np.array(values, np.int64)


def _timer() -> Whole:
    """Address of clock_gettime, the monotonic clock, and room for what it gives; no address on Windows."""
    import time

    if sys.platform == "win32":
        return np.zeros(4, np.int64)
    function = ctypes.CDLL(None).clock_gettime
    return _whole([ctypes.cast(function, ctypes.c_void_p).value, time.CLOCK_MONOTONIC, 0, 0])
