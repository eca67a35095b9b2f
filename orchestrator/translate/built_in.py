"""The built-in functions of Modelica: the type of their results, and how C and Python compute them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class BuiltIn:
    """A built-in function whose result is no array of another size than its arguments.

    Attributes:
        result: its type; "" for that of its arguments.
        value: what it gives of numbers; None where it is no function of numbers alone.
        in_c: the function of C; "" where none does the same.
        jumps: whether its value jumps where its arguments do not.
        inputs: how many numbers it takes.
    """

    result: str
    value: Callable[..., float] | None = None
    in_c: str = ""
    jumps: bool = False
    inputs: int = 1


def _quotient(one: float, other: float) -> float:
    return float(math.trunc(one / other))


def _floor(one: float) -> float:
    return float(math.floor(one))


_SAME_IN_C = "sqrt exp log log10 sin cos tan asin acos atan sinh cosh tanh".split()
BUILT_IN = {
    "abs": BuiltIn("Real", abs, "fabs"),
    **{name: BuiltIn("Real", getattr(math, name), name) for name in _SAME_IN_C},
    "atan2": BuiltIn("Real", math.atan2, "atan2", inputs=2),
    "sign": BuiltIn("Real", lambda one: float((one > 0) - (one < 0)), "sign", jumps=True),
    "floor": BuiltIn("Real", _floor, "floor", jumps=True),
    "ceil": BuiltIn("Real", lambda one: float(math.ceil(one)), "ceil", jumps=True),
    "integer": BuiltIn("Integer", _floor, "floor", jumps=True),
    "mod": BuiltIn("Real", lambda one, other: one - math.floor(one / other) * other, jumps=True, inputs=2),
    "rem": BuiltIn("Real", lambda one, other: one - _quotient(one, other) * other, jumps=True, inputs=2),
    "div": BuiltIn("Real", _quotient, jumps=True, inputs=2),
    "min": BuiltIn("Real", min, inputs=2),
    "max": BuiltIn("Real", max, inputs=2),
    **dict.fromkeys(("der", "delay", "semiLinear"), BuiltIn("Real")),
    **dict.fromkeys(("size", "ndims"), BuiltIn("Integer")),
    **dict.fromkeys(("initial", "terminal", "sample", "edge", "change"), BuiltIn("Boolean")),
    **dict.fromkeys("noEvent smooth pre homotopy inStream actualStream".split(), BuiltIn("")),
}
ARRAY_FUNCTIONS = frozenset(
    "fill zeros ones linspace sum product transpose identity diagonal cat scalar vector matrix symmetric "
    "cross skew outerProduct".split()
)
"""Functions that make arrays, or of whole arrays."""
FUNCTIONS = {name: one.in_c for name, one in BUILT_IN.items() if one.in_c and not one.jumps}
"""Continuous functions of numbers, and what C calls them; they apply to each element of an array."""
STEPS = {name: one.in_c for name, one in BUILT_IN.items() if one.in_c and one.jumps}
"""Functions of one number whose value jumps: outside noEvent it is held between events."""
