"""Arrays of scalar expressions: elementwise operations, products, names of elements."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from .flat import Literal, Node, Operation
from .sources import Location

Nodes = np.ndarray
"""Array of Node objects; shape () for a scalar."""


def element_name(name: str, index: tuple[int, ...]) -> str:
    """Name of an array's element, counted from 1: w[2,1]; the name itself for a scalar."""
    return f"{name}[{','.join(str(i + 1) for i in index)}]" if index else name


def scalar_node(node: Node) -> Nodes:
    """Array of shape () of one node."""
    result = np.empty((), dtype=object)
    result[()] = node
    return result


def as_nodes(values: Any) -> Nodes:
    """Array of what NumPy returned, which for a single element is the element itself."""
    if isinstance(values, np.ndarray):
        return values
    return scalar_node(values)


def matrix(value: Nodes) -> Nodes:
    """Array of two dimensions: a vector becomes a column. Raises: ValueError for more dimensions."""
    if value.ndim > 2:
        raise ValueError
    return value if value.ndim == 2 else value.reshape((-1, 1))


def mapped(function: Callable[..., Node], *values: Nodes) -> Nodes:
    """Array of the function's values, element by element; all arrays have one shape."""
    result = np.empty(values[0].shape, dtype=object)
    for index in np.ndindex(values[0].shape):
        result[index] = function(*(value[index] for value in values))
    return result


def elementwise(name: str, where: Location, *values: Nodes) -> Nodes:
    """Apply an operation element by element; scalars go with every element.

    Raises: BuildError at `where` if arrays have unlike shapes.
    """
    shapes = {value.shape for value in values if value.shape != ()}
    if len(shapes) > 1:
        raise BuildError(
            f"{where}: arrays of unlike shapes {', '.join(str(list(s)) for s in sorted(shapes))} meet in "
            f"{name}"
        )
    shape = shapes.pop() if shapes else ()
    result = np.empty(shape, dtype=object)
    for index in np.ndindex(shape):
        result[index] = Operation(name, tuple(value[index] if value.shape else value[()] for value in values))
    return result


def plus(one: Node, other: Node) -> Node:
    """Sum of two nodes, without a leading zero."""
    return other if one == Literal(0.0) else Operation("+", (one, other))


def times(one: Node, other: Node) -> Node:
    """Product of two nodes, without a leading one."""
    return other if one == Literal(1.0) else Operation("*", (one, other))


def negate(node: Node) -> Node:
    """Minus a node; of a number, the negative number."""
    if isinstance(node, Literal) and not isinstance(node.value, bool):
        return Literal(-node.value)
    return Operation("negate", (node,))


def product(left: Nodes, right: Nodes, where: Location) -> Nodes:
    """Modelica's `*`: scalars scale, vectors and matrices multiply (MLS 10.6.4).

    Raises: BuildError at `where` if the shapes do not fit.
    """
    if not left.shape or not right.shape:
        return elementwise("*", where, left, right)
    if left.ndim > 2 or right.ndim > 2 or left.shape[-1] != right.shape[0]:
        raise BuildError(f"{where}: arrays {list(left.shape)} and {list(right.shape)} cannot be multiplied")
    rows = left.reshape((-1, left.shape[-1]))
    columns = right.reshape((right.shape[0], -1))
    result = np.empty((rows.shape[0], columns.shape[1]), dtype=object)
    for row, column in np.ndindex(result.shape):
        terms = [Operation("*", pair) for pair in zip(rows[row], columns[:, column], strict=True)]
        result[row, column] = reduce(plus, terms, Literal(0.0))
    return result.reshape(left.shape[:-1] + right.shape[1:])


def cross(left: Nodes, right: Nodes) -> Nodes:
    """The cross product of two vectors, each of three elements (MLS 10.3.5)."""
    result = np.empty(3, dtype=object)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        pairs = ((left[j], right[k]), (left[k], right[j]))
        result[i] = Operation("-", tuple(Operation("*", pair) for pair in pairs))
    return result
