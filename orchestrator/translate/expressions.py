"""Read expressions of the compiler's intermediate representation; every node is known or refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import reduce
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from .flat import Delay, Derivative, If, Literal, Node, NoEvent, Operation, Reference, render, walk
from .interpreter import evaluate
from .node_arrays import (
    Nodes,
    as_nodes,
    cross,
    element_name,
    elementwise,
    mapped,
    matrix,
    negate,
    plus,
    product,
    scalar_node,
    times,
)
from .sources import DELAY, Location

Json = dict[str, Any]

_BINARY = {"Add": "+", "Sub": "-", "Div": "/", "Exp": "^"} | {
    "Lt": "<", "Le": "<=", "Gt": ">", "Ge": ">=", "Eq": "==", "Neq": "<>", "And": "and", "Or": "or",
    "AddElem": "+", "SubElem": "-", "MulElem": "*", "DivElem": "/", "ExpElem": "^",
}  # fmt: skip
_FUNCTIONS = {
    "Abs": 1, "Sign": 1, "Sqrt": 1, "Floor": 1, "Ceil": 1, "Integer": 1, "Mod": 2, "Rem": 2, "Div": 2,
    "Exp": 1, "Sin": 1, "Cos": 1, "Tan": 1, "Asin": 1, "Acos": 1, "Atan": 1, "Atan2": 2,
    "Sinh": 1, "Cosh": 1, "Tanh": 1,
    "Log": 1, "Log10": 1,
}  # fmt: skip


class ExpressionReader:
    """Turns JSON expressions into arrays of scalar nodes.

    Args:
        shapes: name of every variable -> its dimensions.
        place: span of the representation -> line of the source.
        integers: name of every Integer parameter and constant -> expression of its value.

    Attributes:
        delays: source and byte offset of every delay that was read.
        structural: parameters whose value went into a subscript or size.
    """

    def __init__(
        self,
        shapes: Mapping[str, tuple[int, ...]],
        place: Callable[[Json], Location],
        integers: Mapping[str, Json],
    ) -> None:
        self._shapes = shapes
        self._place = place
        self._integers_declared = integers
        self._indices: dict[str, int] = {}
        self.delays: set[tuple[int, int]] = set()
        self.structural: set[str] = set()

    @contextmanager
    def loop(self, indices: Mapping[str, int]) -> Iterator[None]:
        """Within it, the names of a for-loop's indices stand for these values."""
        outer, self._indices = self._indices, {**self._indices, **indices}
        try:
            yield
        finally:
            self._indices = outer

    def scalar(self, json: Json, where: Location) -> Node:
        """Read an expression that has to be scalar. Raises: BuildError."""
        nodes = self.read(json, where)
        if nodes.shape != ():
            raise BuildError(f"{where}: a scalar is expected, got an array {list(nodes.shape)}")
        return nodes[()]

    def read(self, json: Json, where: Location) -> Nodes:
        """Read an expression.

        Args:
            json: node of the intermediate representation.
            where: line to name in an error if the node has none of its own.
        Returns: array of nodes with the expression's shape.
        Raises: BuildError for a node, operator or function that is not supported.
        """
        kind, body = _only_item(json, where)
        if isinstance(body, dict) and isinstance(body.get("span"), dict):
            where = self._place(body["span"])
        method = getattr(self, f"_read_{kind.lower()}", None)
        if method is None:
            raise BuildError(f"{where}: expressions of kind {kind} are not supported")
        return method(body, where)

    def _read_literal(self, body: Json, where: Location) -> Nodes:
        _known(body, {"value", "span"}, "literal", where)
        kind, value = _only_item(body["value"], where)
        if kind == "Boolean":
            return scalar_node(Literal(bool(value)))
        if kind in ("Real", "Integer"):
            return scalar_node(Literal(float(value)))
        raise BuildError(f"{where}: literals of type {kind} are not supported here")

    def _read_varref(self, body: Json, where: Location) -> Nodes:
        _known(body, {"name", "subscripts", "span"}, "reference", where)
        name = body["name"]["name"]
        if name in self._indices and not body["subscripts"]:
            return scalar_node(Literal(float(self._indices[name])))
        if name == "time":
            return scalar_node(Reference("time"))
        if name not in self._shapes:
            raise BuildError(
                f"{where}: {name} is no variable of Real, Integer or Boolean type; enumerations and "
                "strings are "
                "not supported, use an Integer parameter"
            )
        return self._element(name, Reference, body["subscripts"], where)

    def _element(
        self, name: str, make: Callable[[str], Node], subscripts: list[Json], where: Location
    ) -> Nodes:
        shape = self._shapes[name]
        whole = np.empty(shape, dtype=object)
        for index in np.ndindex(shape):
            whole[index] = make(element_name(name, index))
        return whole if not subscripts else self._index(whole, subscripts, where)

    def _index(self, whole: Nodes, subscripts: list[Json], where: Location) -> Nodes:
        selectors: list[Any] = []
        if len(subscripts) > whole.ndim:
            raise BuildError(f"{where}: {len(subscripts)} subscripts for an array {list(whole.shape)}")
        for axis, subscript in enumerate(subscripts):
            kind, body = _only_item(subscript, where)
            if kind == "Colon":
                selectors.append(slice(None))
                continue
            if kind == "Index":
                index = np.array(body["value"], dtype=int)
            elif kind == "Expr":
                index = self._integers(body["expr"], where)
            else:
                raise BuildError(f"{where}: subscripts of kind {kind} are not supported")
            if (index < 1).any() or (index > whole.shape[axis]).any():
                raise BuildError(f"{where}: subscript {index.tolist()} is outside 1 to {whole.shape[axis]}")
            selectors.append(index - 1)
        result = whole
        # From the last axis on, so that a scalar subscript does not shift the axes still to come.
        for axis in reversed(range(len(selectors))):
            selector = selectors[axis]
            if not isinstance(selector, slice):
                result = np.take(result, selector, axis=axis)
        return as_nodes(result)

    def _integers(self, json: Json, where: Location) -> np.ndarray:
        nodes = self.read(json, where)
        try:
            values = [float(evaluate(node, self._known_integers(node))) for node in nodes.flat]
        except (KeyError, ArithmeticError, ValueError):
            values = [0.5]
        if any(value != int(value) for value in values):
            raise BuildError(
                f"{where}: a subscript or size has to be an Integer of constants and parameters, got "
                f"{', '.join(map(render, nodes.flat))}"
            )
        return np.array(values, dtype=int).reshape(nodes.shape)

    def _known_integers(self, node: Node) -> dict[str, float]:
        """Values of the Integer parameters in an expression; they become structural."""
        known: dict[str, float] = {}
        for part in walk(node):
            if isinstance(part, Reference) and part.name in self._integers_declared:
                inner = self.scalar(self._integers_declared[part.name], Location(part.name, 0))
                known[part.name] = float(evaluate(inner, self._known_integers(inner)))
                self.structural.add(part.name)
        return known

    def _read_binary(self, body: Json, where: Location) -> Nodes:
        _known(body, {"op", "lhs", "rhs", "span"}, "operator", where)
        left, right = self.read(body["lhs"], where), self.read(body["rhs"], where)
        name = body["op"]
        if name == "Mul":
            return product(left, right, where)
        if name not in _BINARY:
            raise BuildError(f"{where}: the operator {name} is not supported")
        if name == "Exp" and (left.ndim or right.ndim):
            raise BuildError(f"{where}: a power of a matrix is not supported; use .^ for elements")
        return elementwise(_BINARY[name], where, left, right)

    def _read_unary(self, body: Json, where: Location) -> Nodes:
        _known(body, {"op", "rhs", "span"}, "operator", where)
        operand = self.read(body["rhs"], where)
        match body["op"]:
            case "Plus" | "DotPlus":
                return operand
            case "Minus" | "DotMinus":
                return mapped(negate, operand)
            case "Not":
                return elementwise("not", where, operand)
        raise BuildError(f"{where}: the operator {body['op']} is not supported")

    def _read_if(self, body: Json, where: Location) -> Nodes:
        _known(body, {"branches", "else_branch", "span"}, "if-expression", where)
        result = self.read(body["else_branch"], where)
        for condition, value in reversed(body["branches"]):
            test = self.scalar(condition, where)
            values = self.read(value, where)
            if values.shape != result.shape:
                raise BuildError(
                    f"{where}: the branches have shapes {list(values.shape)} and {list(result.shape)}"
                )
            result = mapped(lambda one, other, test=test: If(test, one, other), values, result)
        return result

    def _read_array(self, body: Json, where: Location) -> Nodes:
        _known(body, {"elements", "kind", "span"}, "array", where)
        elements = [self.read(element, where) for element in body["elements"]]
        try:
            match body["kind"]:
                case "Array":
                    return as_nodes(np.stack(elements))
                case "Horizontal":
                    return as_nodes(np.concatenate([matrix(element) for element in elements], axis=1))
                case "Vertical":
                    return as_nodes(np.concatenate([matrix(element) for element in elements], axis=0))
        except ValueError as error:
            shapes = ", ".join(str(list(element.shape)) for element in elements)
            raise BuildError(f"{where}: array elements of shapes {shapes} do not fit together") from error
        raise BuildError(f"{where}: arrays of kind {body['kind']} are not supported")

    def _read_range(self, body: Json, where: Location) -> Nodes:
        _known(body, {"start", "step", "end", "span"}, "range", where)
        step = 1 if body["step"] is None else int(self._integers(body["step"], where))
        start, end = int(self._integers(body["start"], where)), int(self._integers(body["end"], where))
        if step == 0:
            raise BuildError(f"{where}: the step of a range is zero")
        return as_nodes(
            np.array([Literal(float(i)) for i in range(start, end + (1 if step > 0 else -1), step)], object)
        )

    def _read_functioncall(self, body: Json, where: Location) -> Nodes:
        _known(body, {"name", "args", "is_constructor", "span"}, "function call", where)
        name = body["name"]["name"]
        if name == DELAY and len(body["args"]) == 3:
            return self._delay(body, body["args"], where)
        raise BuildError(
            f"{where}: the function {name} is not supported; only built-in functions are, write its "
            "formula instead"
        )

    def _delay(self, body: Json, arguments: list[Json], where: Location) -> Nodes:
        span = body["span"]
        self.delays.add((span["source"], span["start"]))
        operand, time, *limits = (self.read(argument, where) for argument in arguments)
        limit = limits[0] if limits else None
        if limit is not None and limit.shape == () and limit[()] == Literal(-1.0):
            limit = None  # the default of the function that stands for delay()
        if time.shape != () or (limit is not None and limit.shape != ()):
            raise BuildError(f"{where}: the delay time has to be a scalar")
        return mapped(lambda one: Delay(one, time[()], None if limit is None else limit[()], where), operand)

    def _read_builtincall(self, body: Json, where: Location) -> Nodes:
        _known(body, {"function", "args", "span"}, "function call", where)
        name, arguments = body["function"], body["args"]
        if name == "Der":
            return self._derivative(arguments, where)
        if name == "Delay":
            return self._delay(body, arguments, where)
        if name == "Size":
            return self._size(arguments, where)
        values = [self.read(argument, where) for argument in arguments]
        if name in _FUNCTIONS and len(values) == _FUNCTIONS[name]:
            return elementwise(name.lower(), where, *values)
        match name, values:
            case "NoEvent", [value]:
                return mapped(NoEvent, value)
            # An expression that is smooth needs no event, but an event does no harm.
            case "Smooth", [_, value]:
                return value
            case (("Min" | "Max"), [value]) if value.size:
                return scalar_node(
                    reduce(lambda one, other: Operation(name.lower(), (one, other)), value.flat)
                )
            case (("Min" | "Max"), [_, _]):
                return elementwise(name.lower(), where, *values)
            case "Sum", [value]:
                return scalar_node(reduce(plus, value.flat, Literal(0.0)))
            case "Product", [value]:
                return scalar_node(reduce(times, value.flat, Literal(1.0)))
            case "Transpose", [value] if value.ndim == 2:
                return value.T
            case "Cross", [left, right] if left.shape == right.shape == (3,):
                return cross(left, right)
            case "Fill", [value, *_] if value.shape == ():
                return self._filled(value[()], arguments[1:], where)
            case "Zeros", _:
                return self._filled(Literal(0.0), arguments, where)
            case "Ones", _:
                return self._filled(Literal(1.0), arguments, where)
        raise BuildError(
            f"{where}: {name[:1].lower()}{name[1:]}() with {len(values)} arguments is not supported"
        )

    def _derivative(self, arguments: list[Json], where: Location) -> Nodes:
        kind, body = _only_item(arguments[0], where)
        if len(arguments) != 1 or kind != "VarRef" or body["name"]["name"] not in self._shapes:
            raise BuildError(
                f"{where}: der() of an expression is not supported; give it a variable of its own"
            )
        return self._element(body["name"]["name"], Derivative, body["subscripts"], where)

    def _size(self, arguments: list[Json], where: Location) -> Nodes:
        shape = self.read(arguments[0], where).shape
        if len(arguments) == 1:
            return as_nodes(np.array([Literal(float(length)) for length in shape], object))
        axis = int(self._integers(arguments[1], where))
        if not 1 <= axis <= len(shape):
            raise BuildError(f"{where}: size() of dimension {axis} of an array {list(shape)}")
        return scalar_node(Literal(float(shape[axis - 1])))

    def _filled(self, node: Node, sizes: list[Json], where: Location) -> Nodes:
        shape = tuple(int(self._integers(size, where)) for size in sizes)
        result = np.empty(shape, dtype=object)
        for index in np.ndindex(shape):
            result[index] = node
        return result


def _only_item(json: Any, where: Location) -> tuple[str, Any]:
    if not isinstance(json, dict) or len(json) != 1:
        raise BuildError(f"{where}: the compiler's representation has an unknown form here: {str(json)[:80]}")
    return next(iter(json.items()))


def _known(body: Json, keys: set[str], what: str, where: Location) -> None:
    unknown = sorted(set(body) - keys)
    if unknown:
        raise BuildError(
            f"{where}: the compiler describes this {what} by {', '.join(unknown)}, which is not supported"
        )
