"""Calls of laws by address from machine code."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

# time, signals, numbers, hidden states, written: the law's value and the derivatives of its hidden states.
_POINTER = types.CPointer(types.float64)
SIGNATURE = types.void(types.float64, _POINTER, _POINTER, _POINTER, _POINTER)


@intrinsic
def call_law(typing, function, time, signals, theta, hidden, out):
    """Call a compiled law; see SIGNATURE."""
    word, double = ir.IntType(64), ir.DoubleType()
    c_type = ir.FunctionType(ir.VoidType(), [double, word, word, word, word])

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address = builder.inttoptr(arguments[0], c_type.as_pointer())
        builder.call(address, list(arguments[1:]))
        return context.get_dummy_value()

    kinds = (types.int64, types.float64, types.int64, types.int64, types.int64, types.int64)
    return types.none(*kinds), generate
