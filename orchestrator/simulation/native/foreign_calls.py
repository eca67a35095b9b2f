"""Calls and memory accesses by address, from numba's nopython code.

An address is an ordinary argument, so that compiled code can be kept on disk and serve every FMU; ctypes
function objects would be compiled into it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_DOUBLE, _INT, _WORD = ir.DoubleType(), ir.IntType(32), ir.IntType(64)
# How an argument travels: what numba holds, what C takes. Pointers and size_t are words of 64 bits; an FMI 3
# Boolean is passed as int, and the callee reads its lowest byte.
_KINDS = {"d": (types.float64, _DOUBLE), "i": (types.int32, _INT), "w": (types.int64, _WORD)}


def _caller(kinds: str, result: str = "i") -> Callable[..., Any]:
    """A code generator that calls the address in the first argument with the others."""
    signature = _KINDS[result][0](types.int64, *(_KINDS[kind][0] for kind in kinds))
    function_type = ir.FunctionType(_KINDS[result][1], [_KINDS[kind][1] for kind in kinds])

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function = builder.inttoptr(arguments[0], function_type.as_pointer())
        return builder.call(function, list(arguments[1:]))

    return lambda: (signature, generate)


_VALUES2, _VALUES3, _DERIVATIVES2 = _caller("wwww"), _caller("wwwww"), _caller("wwwww")
_STEP2, _STEP3 = _caller("wddi"), _caller("wddiwwww")
_STATUS2 = _caller("wiw")
_TIMER = _caller("iw")
_EFFECT = _caller("dwwwwwww", "d")


@intrinsic
def call_fmi2_values(typing, function, component, references, count, values):
    """fmi2Status (*)(fmi2Component, const fmi2ValueReference[], size_t, values[])"""
    return _VALUES2()


@intrinsic
def call_fmi2_derivatives(typing, function, component, references, count, orders, values):
    """fmi2Status (*)(fmi2Component, const fmi2ValueReference[], size_t, fmi2Integer[], fmi2Real[])"""
    return _DERIVATIVES2()


@intrinsic
def call_fmi3_values(typing, function, component, references, count, values, value_count):
    """fmi3Status (*)(fmi3Instance, const fmi3ValueReference[], size_t, values[], size_t)"""
    return _VALUES3()


@intrinsic
def call_fmi2_step(typing, function, component, time, step_size, no_rollback):
    """fmi2Status (*)(fmi2Component, fmi2Real, fmi2Real, fmi2Boolean)"""
    return _STEP2()


@intrinsic
def call_fmi2_status(typing, function, component, kind, value):
    """fmi2Status (*)(fmi2Component, const fmi2StatusKind, value *)"""
    return _STATUS2()


@intrinsic
def call_fmi3_step(
    typing, function, component, time, step_size, no_rollback, event, terminate, early, reached
):
    """fmi3Status (*)(fmi3Instance, fmi3Float64, fmi3Float64, fmi3Boolean, 3 * fmi3Boolean*, fmi3Float64*)"""
    return _STEP3()


@intrinsic
def call_timer(typing, function, clock, result):
    """Int (*)(clockid_t, struct timespec *)"""
    return _TIMER()


@intrinsic
def call_effect(typing, function, time, x, x_count, options, option_count, memory, memory_count, commit):
    """Double (*)(double, double[], int64, const double[], int64, double[], int64, int64)"""
    return _EFFECT()


@intrinsic
def as_doubles(typing, address):
    """An address as a pointer to doubles."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.CPointer(types.float64)(types.int64), generate


@intrinsic
def load(typing, address, like):
    """The value of the type of `like` at an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = context.get_value_type(signature.return_type)
        return builder.load(builder.inttoptr(arguments[0], kind.as_pointer()))

    return like(types.int64, like), generate


@intrinsic
def store(typing, address, value):
    """Put a value, in the width of its type, at an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = context.get_value_type(signature.args[1])
        builder.store(arguments[1], builder.inttoptr(arguments[0], kind.as_pointer()))
        return context.get_dummy_value()

    return types.none(types.int64, value), generate
