"""Calls in the compiler's form: functions, evaluated into the expressions, tables, delays, functions in C."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from ..rewriting.class_bodies import MARK
from ..rewriting.external_functions import CALL
from ..sources import DELAY
from . import expression as ex
from .arrays import each
from .expression import Expr
from .external import external_call
from .form import Form, Json, refused
from .functions import call
from .model import Delay
from .tables import Table, read_table

_DEEPEST_CALL = 200
_MOST_DELAYS = 64  # as in hybrid.h  # as in hybrid.h


class Calls(Form):
    """Reads calls."""

    def _delayed(self, operand: Expr, lag: Expr) -> Expr:
        if not operand.free:
            return operand
        if any(one.args[0] != "p" for one in lag.free):
            raise refused(self._name, "delay() with a delay time that changes")
        made = Delay(operand, lag, f"delay({self._shown(operand)}, {self._shown(lag)})")
        if made not in self._delays:
            if len(self._delays) >= _MOST_DELAYS:
                raise refused(self._name, f"delay() more than {_MOST_DELAYS} times")
            self._delays.append(made)
        return ex.symbol("delayed", self._delays.index(made))

    def _called(self, number: int, content: Json, operands: list[int], bound: Mapping[Any, Any]) -> Any:
        if content["owner"] != number:
            operands = self._nodes[content["owner"]][2]
        function = self._s["functions"][content["function"]]
        if function["external"]:
            if function["name"] == DELAY:
                return self._delayed(*(self._single(one, bound) for one in operands[:2]))
            return self._external(number, content["output"], function, operands, bound)
        if content.get("derivative"):
            raise refused(self._name, f"a derivative of the function {function['name']}()")
        self._depth += 1
        if self._depth > _DEEPEST_CALL:
            raise refused(self._name, f"the function {function['name']}(), which calls itself without end,")
        before, self._events = self._events, False
        try:
            inside: dict[Any, Any] = {
                ("parameter", place): self._at(one, bound) for place, one in enumerate(operands)
            }
            self._statements(function["statements"], inside)
            found = inside["value", content["output"]]
            # Where an assertion fails, the function has no value, and the run ends.
            if (holds := inside.get("holds", ex.ONE)) is ex.ONE:
                return found
            self.need(holds, f"an assertion of {function['name']}() fails", number)
            kept = partial(each, lambda one: ex.conditional(holds, one, ex.number(np.nan)))
            return tuple(map(kept, found)) if isinstance(found, tuple) else kept(found)
        except KeyError as error:
            raise refused(
                self._name, f"the function {function['name']}() (a value before it is set)"
            ) from error
        finally:
            self._events = before
            self._depth -= 1

    def _external(
        self, number: int, output: int, function: Json, operands: list[int], bound: Mapping[Any, Any]
    ) -> Any:
        symbol = function["external"]["symbol"]
        if symbol == CALL and (source := self._functions(function["name"])) is not None:
            before, self._events = self._events, False
            try:
                found = call(source, self._functions, [self._at(one, bound) for one in operands])[output]
            finally:
                self._events = before
            self.need_value(found, function["name"], number)
            return found if found.shape else found.item()
        if not symbol.startswith("ModelicaStandardTables_Combi"):
            return self._native(function, operands, bound)
        values = [self._at(one, bound) for one in operands]
        kind, _, what = symbol.removeprefix("ModelicaStandardTables_Combi").partition("_")
        table = self._table(values[0], kind == "Table2D")
        first = table.rows[:, 0]
        match what:
            case "getValue" if kind == "Table1D":
                return table.value(values[1], values[2])
            case "getValue" if kind == "Table2D":
                return table.surface(values[1], values[2])
            case "getValue":
                return table.at_time(values[1], values[2], values[3])
            case "nextTimeEvent":
                return table.next_event(values[1])
            case "minimumAbscissa" | "minimumTime" if kind != "Table2D":
                return ex.number(first[0])
            case "maximumAbscissa" | "maximumTime" if kind != "Table2D":
                return ex.number(first[-1])
        raise refused(self._name, f"the function {function['name']}() of a table")

    def _native(self, function: Json, operands: list[int], bound: Mapping[Any, Any]) -> Any:
        """A C function with its source beside the model."""
        source = self._functions(function["name"])
        if source is None or source.text.startswith("impure"):
            raise refused(self._name, f"the impure external function {function['name']}()")
        arrays = [np.asarray(self._at(one, bound), dtype=object) for one in operands]
        inside = {("parameter", place): one for place, one in enumerate(arrays)}
        kinds = [self._s["value_types"][one["value_type"]]["scalar"] for one in function["parameters"]]
        handles = {
            one.name.rpartition(f"{MARK}")[0] + one.name.rpartition(MARK)[2].rpartition("_")[0]
            for one in self._scalars
            if MARK in one.name
        }
        if any(
            one.op == "sym" and one.args[0] == "p" and self._scalars[one.args[1]].name in handles
            for array in arrays
            for one in array.ravel()
        ):
            raise refused(self._name, f"the external object of the function {function['name']}()")

        def argument(number: int) -> int | float:
            _, content, _ = self._nodes[number]
            if isinstance(content, dict) and "function_parameter" in content:
                return int(content["function_parameter"]["ordinal"])
            return float(self._single(number, inside).args[0])

        return external_call(function, arrays, kinds, argument, self._path_of)

    def _table(self, handle: Expr, surface: bool) -> Table:
        """The table that a variable stands for; see `adapted`."""
        if handle in self._tables:
            return self._tables[handle]
        if handle.op != "sym":
            raise refused(self._name, "a table that depends on a condition")
        head, dot, last = self._scalars[handle.args[1]].name.rpartition(".")
        found = {}
        for number, variable in enumerate(self._s["variables"]):
            name = variable["name"]
            if name.startswith(f"{head}{dot}"):
                found[name.removeprefix(f"{head}{dot}")] = number

        def numbers(name: str) -> np.ndarray | None:
            place = found.get(f"{MARK}{last}_{name}")
            if place is None or (binding := self._s["variables"][place]["attributes"].get("binding")) is None:
                return None
            value = np.asarray(self._at(binding, {}), dtype=object)
            return np.vectorize(lambda one: self._number(one, f"{head}{dot}{last}"), otypes=[float])(value)

        def one(name: str, otherwise: float) -> float:
            value = numbers(name)
            return otherwise if value is None else float(value)

        def said(name: str) -> int | None:
            place = found.get(name)
            return None if place is None else self._s["variables"][place]["attributes"].get("binding")

        rows = numbers("table")
        on_file = said("tableOnFile")
        if on_file is not None and self._number(self._single(on_file), f"{head}.tableOnFile"):
            path, name = (self._text(said(key) or 0) for key in ("fileName", "tableName"))
            rows = read_table(self._path_of(path), name)
        if rows is None or rows.ndim != 2 or not rows.size:
            raise BuildError(f"{self._name}: the table of {head}{dot}{last} has no value")
        columns = numbers("columns")
        self._tables[handle] = made = Table(
            rows, [2] if columns is None else [int(n) for n in np.ravel(columns)], int(one("smoothness", 1)),
            int(one("extrapolation", 2)), int(one("timeEvents", 3)), one("startTime", -np.inf),
            one("shiftTime", 0.0), surface,
        )  # fmt: skip
        return made

    def _statements(self, statements: Iterable[Json], inside: dict[Any, Any]) -> None:
        for statement in statements:
            ((kind, content),) = statement.items()
            if kind == "assignment":
                inside["value", content["target"]] = self._at(content["rhs"], inside)
            elif kind == "assignment_group":
                made = [(one["target"], self._at(one["rhs"], inside)) for one in content["assignments"]]
                inside.update({("value", target): value for target, value in made})
            elif kind == "for":
                # An inner loop's domain has the outer one as its parent, whose values hold here.
                binders = [one for one in self._domain(content["domain"]) if one[0] not in inside]
                for values in itertools.product(*(values for _, values in binders)):
                    inside.update(zip((key for key, _ in binders), values, strict=True))
                    self._statements(content["statements"], inside)
                for key, _ in binders:
                    inside.pop(key, None)
            elif kind == "assertion" and content.get("level") == "error":
                holds = self._single(content["condition"], inside)
                inside["holds"] = ex.logical("and", inside.get("holds", ex.ONE), holds)
            else:
                raise refused(self._name, f"a statement of the kind {kind} in a function")
