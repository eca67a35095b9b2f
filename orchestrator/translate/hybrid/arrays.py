"""Arrays of scalar expressions: operators, functions and reductions of Modelica."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from . import expression as ex
from .expression import Expr

_ZERO = ex.ZERO
_LARGEST = sys.float_info.max  # the least of no numbers, as the language has it


def each(make: Callable[..., Expr], *values: Any) -> Any:
    """A function of scalars for each element."""
    arrays = [np.asarray(one, dtype=object) for one in values]
    if not any(one.ndim for one in arrays):
        return make(*(one.item() for one in arrays))
    spread = np.broadcast_arrays(*arrays)
    made = np.empty(spread[0].shape, dtype=object)
    for index in np.ndindex(*made.shape):
        made[index] = make(*(one[index] for one in spread))
    return made


def stacked(values: list[Any]) -> np.ndarray:
    """An array of arrays of equal shape."""
    arrays = [np.asarray(one, dtype=object) for one in values]
    made = np.empty((len(arrays), *(arrays[0].shape if arrays else ())), dtype=object)
    for place, one in enumerate(arrays):
        made[place] = one if one.ndim else one.item()
    return made


def _total(values: Iterable[Expr]) -> Expr:
    found = _ZERO
    for one in values:
        found = ex.add(found, one)
    return found


def product(a: np.ndarray, b: np.ndarray) -> Any:
    """Product of vectors and matrices."""
    if a.ndim == b.ndim == 1:
        return _total(ex.mul(x, y) for x, y in zip(a, b, strict=True))
    left, right = np.atleast_2d(a), b if b.ndim == 2 else b[:, None]
    made = np.empty((left.shape[0], right.shape[1]), dtype=object)
    for row, column in np.ndindex(*made.shape):
        made[row, column] = product(left[row], right[:, column])
    return made if a.ndim == b.ndim == 2 else made.ravel()


def _reduced(make: Callable[[Expr, Expr], Expr], empty: Expr, values: list[Any]) -> Any:
    if len(values) > 1:
        return each(make, *values)
    flat = list(np.ravel(np.asarray(values[0], dtype=object)))
    if not flat:
        return empty
    found = flat[0]
    for one in flat[1:]:
        found = make(found, one)
    return found


def _cross(values: list[Any]) -> np.ndarray:
    a, b = values
    pairs = ((1, 2), (2, 0), (0, 1))
    return stacked([ex.sub(ex.mul(a[i], b[j]), ex.mul(a[j], b[i])) for i, j in pairs])


def _skew(v: np.ndarray) -> np.ndarray:
    x, y, z = v
    return np.array([[_ZERO, ex.neg(z), y], [z, _ZERO, ex.neg(x)], [ex.neg(y), x, _ZERO]], dtype=object)


def _whole(one: Any) -> int:
    """A size that is known when the model is built."""
    value = np.asarray(one, dtype=object).item()
    if value.op != "num":
        raise BuildError("a size that is not known when the model is built is not supported")
    return int(value.args[0])


def _linspace(first: Expr, last: Expr, count: Expr) -> np.ndarray:
    n = _whole(count)
    step = ex.div(ex.sub(last, first), ex.number(n - 1))
    return stacked([ex.add(first, ex.mul(ex.number(k), step)) for k in range(n)])


OPERATORS: dict[str, Callable[[Expr, Expr], Expr]] = {
    "add": ex.add, "subtract": ex.sub, "multiply": ex.mul, "divide": ex.div, "power": ex.power,
    "and": partial(ex.logical, "and"), "or": partial(ex.logical, "or"),
}  # fmt: skip
REDUCTIONS: dict[str, Callable[[list[Any]], Any]] = {
    "min": partial(_reduced, partial(ex.function, "fmin"), ex.number(_LARGEST)),
    "max": partial(_reduced, partial(ex.function, "fmax"), ex.number(-_LARGEST)),
    "sum": partial(_reduced, ex.add, _ZERO),
    "product": partial(_reduced, ex.mul, ex.ONE),
    "transpose": lambda values: np.asarray(values[0], dtype=object).T,
    "cross": _cross,
    "skew": lambda values: _skew(*values),
    "outer_product": lambda values: stacked([[ex.mul(a, b) for b in values[1]] for a in values[0]]),
    "scalar": lambda values: np.ravel(values[0])[0],
    "vector": lambda values: np.ravel(values[0]),
    "matrix": lambda values: np.asarray(values[0], dtype=object).reshape(np.shape(values[0])[0], -1),
    "zeros": lambda values: np.full([_whole(one) for one in values], _ZERO, dtype=object),
    "ones": lambda values: np.full([_whole(one) for one in values], ex.ONE, dtype=object),
    "fill": lambda values: np.full([_whole(one) for one in values[1:]], values[0], dtype=object),
    "identity": lambda values: np.array(
        [[ex.ONE if i == j else _ZERO for j in range(_whole(values[0]))] for i in range(_whole(values[0]))],
        dtype=object,
    ),
    "diagonal": lambda values: np.array(
        [[one if i == j else _ZERO for j in range(len(values[0]))] for i, one in enumerate(values[0])],
        dtype=object,
    ),
    "linspace": lambda values: _linspace(*values),
    "size": lambda values: ex.number(np.shape(values[0])[_whole(values[1]) - 1]),
}  # fmt: skip
