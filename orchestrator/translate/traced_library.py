"""What Python code calls, for plain and traced numbers: `math`, some builtins, a matrix inverse."""

from __future__ import annotations

import builtins
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import casadi as ca
import numpy as np

from .traced import LARGEST, OPERATIONS, Tape, Traced, TraceError


class TracedMath:
    """The module `math` for plain and traced numbers."""

    def __getattr__(self, name: str) -> Any:
        original = getattr(math, name)
        if not callable(original):
            return original

        def function(*arguments: Any) -> Any:
            traced = next((x for x in arguments if isinstance(x, Traced)), None)
            if traced is None:
                return original(*arguments)
            if name in ("floor", "ceil", "trunc"):
                return getattr(traced, f"__{name}__")()
            if name == "fabs":
                return abs(traced).as_float()
            if name == "isfinite":
                return abs(traced) <= LARGEST
            if name == "isnan":
                return traced != traced
            if name == "isinf":
                return abs(traced) > LARGEST
            if name in OPERATIONS:
                return traced.tape.make(name, "float", *arguments)
            raise TraceError(f"math.{name} has no native form")

        return function


def _extreme(name: str, better: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    original = getattr(builtins, name)

    def function(*arguments: Any, **options: Any) -> Any:
        values = arguments if len(arguments) > 1 else tuple(arguments[0])
        traced = next((x for x in values if isinstance(x, Traced)), None)
        if traced is None or options:
            return original(*arguments, **options)
        found = values[0]
        for value in values[1:]:
            found = _where(traced.tape, better(value, found), value, found)
        return found

    return function


def _where(tape: Tape, condition: Any, a: Any, b: Any) -> Any:
    return tape.select(condition, a, b) if isinstance(condition, Traced) else a if condition else b


def _int(value: Any = 0, *more: Any) -> Any:
    return value.__trunc__() if isinstance(value, Traced) else int(value, *more)


def _float(value: Any = 0.0) -> Any:
    return value.as_float() if isinstance(value, Traced) else float(value)


SHADOWS: dict[str, Any] = {
    "max": _extreme("max", lambda value, found: value > found),
    "min": _extreme("min", lambda value, found: value < found),
    "int": _int,
    "float": _float,
}
"""What a traced module finds in place of these builtins: they return no float or decide nothing."""


@contextmanager
def tracing_numpy() -> Iterator[None]:
    """Let numpy.linalg.inv invert a 1 by 1 matrix of traced numbers, as scalar measurements need it."""
    original = np.linalg.inv

    def inverse(matrix: Any) -> Any:
        if not (isinstance(matrix, np.ndarray) and matrix.dtype.hasobject):
            return original(matrix)
        if matrix.shape != (1, 1):
            raise TraceError(
                f"the inverse of a matrix of shape {matrix.shape} has no native form; allowed: (1, 1)"
            )
        return np.array([[1.0 / matrix[0, 0]]], dtype=object)

    np.linalg.inv = inverse
    simplifying = ca.GlobalOptions.getSimplificationOnTheFly()
    # CasADi would turn a + b - b into a, which rounds otherwise.
    ca.GlobalOptions.setSimplificationOnTheFly(False)
    try:
        yield
    finally:
        np.linalg.inv = original
        ca.GlobalOptions.setSimplificationOnTheFly(simplifying)
