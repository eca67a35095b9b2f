"""The values of expressions in algorithm sections, in symbols."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from ..built_in import FUNCTIONS, STEPS
from ..rewriting.hidden_sections import Section
from ..sources import Location
from . import expression as ex
from .arrays import OPERATORS, REDUCTIONS, each, product, stacked
from .expression import Expr
from .functions import call
from .statements import Node, Parser

_RELATIONS = {"<": "lt", "<=": "le", ">": "gt", ">=": "ge", "==": "eq", "<>": "ne"}
_SIGNS = {"+": "add", "-": "subtract", "*": "multiply", "/": "divide", "^": "power", "and": "and", "or": "or"}
EVENTS = ("initial", "terminal", "sample")  # conditions that have no value between events
Env = dict[int, np.ndarray]
"""Numbers of variables -> their elements at a place of a section."""


class UnknownLength(Exception):
    """A loop whose length is not known before the run."""


class SectionValues:
    """Expressions of one section of one component."""

    def __init__(self, model: Any, owner: str, section: Section) -> None:
        self._model = model  # the reader of the DAE form
        self._owner = owner
        self._section = section
        self._here = Location(section.file, section.line)
        self._loops: dict[str, Any] = {}
        self._done: set[int] = set()  # variables whose last assignment is behind
        self._known: dict[int, np.ndarray] | None = None  # which elements of variables are assigned

    def _refusal(self, what: str) -> BuildError:
        where = f"{self._section.file}:{self._section.line}"
        return BuildError(f"{where}: the algorithm of {self._section.scope}: {what} is not supported")

    # Names

    def _path_to(self, name: str) -> str:
        return f"{self._owner}.{name}" if self._owner else name

    def _all_of(self, target: Node) -> list[int]:
        """Numbers of the variables that a target may be."""
        number = self._model.number_of(self._path_to(target[1]))
        if number is not None:
            return [number]
        pattern = r"(\[\d+(,\d+)*\])?\.".join(re.escape(one) for one, _ in target[3])
        return list(self._model.numbers_like(self._path_to("") + pattern if self._owner else pattern))

    def _variable(self, node: Node, env: Env) -> tuple[int | None, Sequence[Node | None]]:
        """A variable's number and the subscripts that it is used with."""
        number = self._model.number_of(self._path_to(node[1]))
        if number is not None or len(node) < 4:
            return number, node[2]
        texts = []
        for one, subscripts in node[3][:-1]:
            values = [self._fixed(self._scalar(s, env)) for s in subscripts if s is not None]
            texts.append(f"{one}[{','.join(map(str, values))}]" if values else one)
        last, subscripts = node[3][-1]
        return self._model.number_of(self._path_to(".".join([*texts, last]))), subscripts

    def _fixed(self, value: Expr) -> int:
        return int(value.args[0] if value.op == "num" else self._model.number(value, "a subscript"))

    def _current(self, number: int, env: Env) -> np.ndarray:
        """A variable's elements here: what is assigned later starts from its value before, or its start."""
        if number in env:
            return env[number]
        places: np.ndarray = self._model.places_of(number)
        later = (self._known or {}).get(number)
        if later is None or number in self._done:
            return places
        before = np.empty(places.shape, dtype=object)
        for index in np.ndindex(*places.shape):
            before[index] = self._model.before(places[index]) if later[index] else places[index]
        return before

    def _places(self, shape: tuple[int, ...], subscripts: Sequence[Node | None], env: Env) -> list[Any]:
        found: list[Any] = []
        for axis, size in enumerate(shape):
            node = subscripts[axis] if axis < len(subscripts) else None
            if node is None:
                found.append(slice(None))
                continue
            value = np.asarray(self._value(node, env, size), dtype=object)
            if any(one.op != "num" for one in value.ravel()):
                if value.ndim:
                    raise self._refusal("a vector of subscripts that changes while the model runs")
                found.append(value.item())
                continue
            numbers = [int(one.args[0]) - 1 for one in value.ravel()]
            if any(not 0 <= one < size for one in numbers):
                raise self._refusal(f"a subscript outside 1 to {size}")
            found.append(numbers if value.ndim else numbers[0])
        if sum(isinstance(one, list) for one in found) > 1:
            wide = [[one] if isinstance(one, int) else one for one in found]
            ranges = [list(range(shape[k])) if isinstance(one, slice) else one for k, one in enumerate(wide)]
            return list(np.ix_(*ranges))
        return found

    # Expressions

    def _scalar(self, node: Node, env: Env) -> Expr:
        value = np.asarray(self._value(node, env), dtype=object)
        if value.size != 1:
            raise self._refusal(f"an array of {value.size} elements in place of one number")
        return value.item()

    def _value(self, node: Node, env: Env, end: int | None = None) -> Any:
        at: Callable[[Node], Any] = lambda one: self._value(one, env, end)  # noqa: E731
        match node[0]:
            case "number":
                return ex.number(node[1])
            case "text":
                return ex.symbol("text", node[1][1:-1])
            case "end":
                return ex.number(float(end or 0))
            case "name":
                return self._named(node, env)
            case "negative":
                return each(ex.neg, at(node[1]))
            case "not":
                return each(partial(ex.logical, "not"), at(node[1]))
            case "binary":
                left = at(node[2])
                if node[1] in ("and", "or") and isinstance(left, Expr):
                    with self._model.guarded(left if node[1] == "and" else ex.logical("not", left)):
                        return self._binary(node[1], left, at(node[3]))
                return self._binary(node[1], left, at(node[3]))
            case "choice":
                condition = self._scalar(node[1], env)
                if condition.op == "num":
                    return at(node[2] if condition.args[0] else node[3])
                with self._model.guarded(condition):
                    yes = at(node[2])
                with self._model.guarded(ex.logical("not", condition)):
                    no = at(node[3])
                return each(partial(ex.conditional, condition), yes, no)
            case "array":
                return stacked([at(one) for one in node[1]])
            case "matrix":
                rows = [
                    np.concatenate([np.atleast_2d(np.asarray(at(one), dtype=object)) for one in row], 1)
                    for row in node[1]
                ]
                return np.concatenate(rows, 0)
            case "range":
                first, step, last = (self._bound(one, env) for one in node[1:])
                count = max(0, int(np.floor((last - first) / step * (1 + 1e-12) + 1e-9)) + 1)
                return np.array([ex.number(first + step * k) for k in range(count)], dtype=object)
            case "comprehension":
                (name, over), *rest = node[2]
                found, outer = [], self._loops.get(name)
                for one in np.ravel(self._value(over, env)):
                    self._loops[name] = one
                    found.append(self._value(("comprehension", node[1], rest) if rest else node[1], env))
                self._loops.pop(name, None)
                if outer is not None:
                    self._loops[name] = outer
                return stacked(found)
            case "call":
                return self._called(node, env, end)
        raise self._refusal(f"an expression of the kind {node[0]}")

    def _bound(self, node: Node, env: Env) -> float:
        value = self._scalar(node, env)
        if value.op == "num":
            return float(value.args[0])
        if all(one.args[0] == "p" for one in value.free):
            return float(self._model.number(value, "the length of a loop"))
        raise UnknownLength

    def _named(self, node: Node, env: Env) -> Any:
        name = node[1]
        if name in self._loops:
            return self._loops[name]
        if name == "time":
            return ex.symbol("t")
        if name in ("true", "false"):
            return ex.number(name == "true")
        number, subscripts = self._variable(node, env)
        if number is not None:
            return self._element(self._current(number, env), subscripts, env)
        if (value := self._model.constant(name, self._section)) is not None:
            return ex.number(value)
        raise self._refusal(f"the name {name}")

    def _element(self, base: np.ndarray, subscripts: Sequence[Node | None], env: Env) -> Any:
        if not subscripts:
            return base[()] if not base.shape else base
        places = self._places(base.shape, subscripts, env)
        result: Any = base
        for axis in range(len(places) - 1, -1, -1):
            if isinstance(places[axis], Expr):
                result = self._model.selected(result, axis, places[axis], self._here)
                places[axis] = None
        kept = tuple(one for one in places if one is not None)
        return np.asarray(result, dtype=object)[kept] if kept else result

    def _binary(self, word: str, a: Any, b: Any) -> Any:
        if word in _RELATIONS:
            return each(partial(self._model.relation, _RELATIONS[word]), a, b)
        if word == "*" and np.ndim(a) and np.ndim(b):
            return product(np.asarray(a, dtype=object), np.asarray(b, dtype=object))
        return each(OPERATORS[_SIGNS[word.lstrip(".")]], a, b)

    def _called(self, node: Node, env: Env, end: int | None) -> Any:
        name, arguments = node[1], node[2]
        at: Callable[[Node], Any] = lambda one: self._value(one, env, end)  # noqa: E731
        if name in ("pre", "edge", "change"):
            number, subscripts = self._variable(arguments[0], env)
            if number is None:
                raise self._refusal(f"{name}() of {arguments[0][1]}")
            before = self._element(self._model.pre_of(number), subscripts, env)
            if name == "pre":
                return before
            now = at(arguments[0])
            if name == "change":
                return each(partial(ex.logical, "ne"), now, before)
            return each(lambda a, b: ex.logical("and", a, ex.logical("not", b)), now, before)
        if name in ("noEvent", "smooth"):
            events = self._model.hold(False) if name == "noEvent" else None
            try:
                return at(arguments[-1])
            finally:
                if events is not None:
                    self._model.hold(events)
        if name == "initial":
            return ex.symbol("initial")
        if name in EVENTS:
            raise self._refusal(f"{name}() outside the condition of a when-statement")
        if name == "size":
            shape = np.shape(at(arguments[0]))
            if len(arguments) == 1:
                return np.array([ex.number(one) for one in shape], dtype=object)
            return ex.number(shape[self._fixed(self._scalar(arguments[1], env)) - 1])
        if name in ("sum", "product", "min", "max") and len(arguments) == 1:
            values = np.ravel(at(arguments[0]))
            return REDUCTIONS[name]([values]) if len(values) else ex.number(name == "product")
        if name in FUNCTIONS:
            return each(partial(ex.function, FUNCTIONS[name]), *map(at, arguments))
        if name in STEPS:
            return each(partial(self._model.stepped, STEPS[name]), at(arguments[0]))
        if name in ("mod", "div", "rem"):
            return self._model.quotient(name, *map(at, arguments))
        if name in ("Integer", "String", "delay"):
            if name == "Integer":
                return at(arguments[0])
            raise self._refusal(f"{name}()")
        if name == "cat":
            axis = self._fixed(self._scalar(arguments[0], env)) - 1
            return np.concatenate([np.asarray(at(one), dtype=object) for one in arguments[1:]], axis)
        if name in REDUCTIONS:
            return REDUCTIONS[name]([at(one) for one in arguments])
        found = self._function(node, env)[0]
        return found if np.ndim(found) else np.asarray(found, dtype=object).item()

    def _function(self, node: Node, env: Env) -> list[Any]:
        """The results of a function of the model or a library."""
        source = self._model.function_near(node[1], self._section.scope)
        if source is None:
            if node[1].rpartition(".")[2] in FUNCTIONS:  # as Modelica.Math.sin
                short = FUNCTIONS[node[1].rpartition(".")[2]]
                return [each(partial(ex.function, short), *(self._value(one, env) for one in node[2]))]
            raise self._refusal(f"the function {node[1]}()")
        variables, _ = Parser(source).function()
        inputs = [one for one in variables if one.role == "input"]
        arguments = [self._value(one, env) for one in node[2]]
        for one in inputs[len(arguments) :]:
            if one.name not in node[3]:
                break
            arguments.append(self._value(node[3][one.name], env))
        if len(arguments) < len(node[2]) + len(node[3]):
            raise self._refusal(f"a call of {node[1]}() with arguments left out")
        results = call(source, self._model.function_texts, arguments)
        self._model.need_value(results[0], node[1], self._here)
        return results
