"""Evaluate flat expressions number by number, by the names of variables: the yardstick of the self-check."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from .built_in import BUILT_IN
from .flat import Delay, Derivative, If, Literal, Node, NoEvent, Operation, Reference

Value = float | bool


def _power(base: float, exponent: float) -> float:
    result = base**exponent
    if isinstance(result, complex):
        raise ValueError("power of a negative number")
    return result


_OPERATIONS: dict[str, Callable[..., Value]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "^": _power,
    "negate": lambda a: -a,
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
    "==": lambda a, b: a == b,
    "<>": lambda a, b: a != b,
    "and": lambda a, b: bool(a) and bool(b),
    "or": lambda a, b: bool(a) or bool(b),
    "not": lambda a: not a,
    **{name: one.value for name, one in BUILT_IN.items() if one.value},
}


def derivative_key(name: str) -> str:
    """Key of a variable's derivative among the values: der(name)."""
    return f"der({name})"


def evaluate(
    node: Node,
    values: Mapping[str, Value],
    delays: Mapping[Delay, float] | None = None,
    magnitude: list[float] | None = None,
) -> Value:
    """Return the value of an expression.

    Only the branch taken of an if-expression is evaluated.

    Args:
        node: the expression.
        values: value of every variable, of `time` and, under `der(name)`, of every derivative.
        delays: value of every delay operator.
        magnitude: if given, its first element is raised to the largest number met on the way: the scale
            of the rounding errors.
    Raises: KeyError for a missing value; ArithmeticError or ValueError where the expression has none.
    """
    match node:
        case Literal(value):
            result: Value = value
        case Reference(name):
            result = values[name]
        case Derivative(name):
            result = values[derivative_key(name)]
        case NoEvent(argument):
            result = evaluate(argument, values, delays, magnitude)
        case If(condition, value, otherwise):
            taken = value if evaluate(condition, values, delays, magnitude) else otherwise
            result = evaluate(taken, values, delays, magnitude)
        case Delay():
            if delays is None:
                raise KeyError("delay")
            result = delays[node]
        case Operation(name, arguments):
            result = _OPERATIONS[name](
                *(evaluate(argument, values, delays, magnitude) for argument in arguments)
            )
    if not math.isfinite(result):
        raise OverflowError(f"not finite: {node}")
    if magnitude is not None:
        magnitude[0] = max(magnitude[0], abs(float(result)))
    return result
