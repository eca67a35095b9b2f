"""Expressions of the compiler's form, as arrays of scalar expressions."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from ..built_in import FUNCTIONS, STEPS
from ..faults import placed
from . import expression as ex
from .arrays import OPERATORS, REDUCTIONS, each, product, stacked
from .calls import Calls
from .expression import Expr
from .form import Json, refused, values_of
from .model import Condition

_RELATIONS = {
    "less": "lt", "less_equal": "le", "greater": "gt", "greater_equal": "ge", "equal": "eq",
    "not_equal": "ne",
}  # fmt: skip
# Kinds of references to variables.
_REFERENCES = (
    "state", "algebraic", "output", "discrete_real", "discrete_value", "input", "parameter", "constant",
)  # fmt: skip
_ZERO = ex.number(0)


class Values(Calls):
    """Evaluates the compiler's expressions to arrays of scalar `Expr`."""

    def _domain(self, number: int) -> list[tuple[tuple[int, int], range]]:
        """Binders of a domain and its parents, outermost first, with their values."""
        entry = self._s["domains"][number]
        outer = [] if entry["parent"] is None else self._domain(entry["parent"])
        return outer + [
            ((number, place), range(one["lower"], one["upper"] + (1 if one["step"] > 0 else -1), one["step"]))
            for place, one in enumerate(entry["domain"]["binders"])
        ]

    def _single(self, number: int, bound: Mapping[Any, Any] | None = None) -> Expr:
        value = np.asarray(self._at(number, bound or {}), dtype=object)
        if value.size != 1:
            raise refused(self._name, f"an array of {value.size} elements in place of one number")
        return value.item()

    def _flat(self, number: int, size: int) -> list[Expr]:
        value = np.asarray(self._at(number, {}), dtype=object).ravel()
        return list(value) if len(value) == size else [value.item()] * size

    def _at(self, number: int, bound: Mapping[Any, Any]) -> Any:
        """As `_value`; an error gets the place of the innermost expression."""
        try:
            return self._value(number, bound)
        except BuildError as error:
            raise placed(error, self._spans(self._provenance[number])) from None

    def _value(self, number: int, bound: Mapping[Any, Any]) -> Any:
        """An expression's value: a 0-dimensional or larger array of Expr, or an Expr.

        Args:
            bound: values of binders by (domain, place), and of a function's variables by ("value", number).
        """
        kind, content, operands = self._nodes[number]
        at = partial(self._at, bound=bound)
        match kind:
            case "literal":
                ((sort, value),) = content.items()
                if sort == "string":
                    return ex.symbol("text", str(value))
                return ex.number(float(value))
            case "coordinate":
                return self._coordinate(content, bound)
            case "function_value":
                return bound["value", content["value"]]
            case "unary":
                if content["operator"] == "not":
                    return each(lambda a: ex.logical("not", a), at(content["operand"]))
                if content["operator"] == "negate":
                    return each(ex.neg, at(content["operand"]))
                return at(content["operand"])
            case "binary":
                left = at(content["lhs"])
                if content["operator"] in ("and", "or") and isinstance(left, Expr):
                    other = left if content["operator"] == "and" else ex.logical("not", left)
                    with self.guarded(other):
                        return self._binary(content["operator"], left, at(content["rhs"]))
                return self._binary(content["operator"], left, at(content["rhs"]))
            case "runtime_quotient_owner":
                return self._quotient(content, at(content["lhs"]), at(content["rhs"]))
            case "array":
                return stacked([at(one) for one in operands])
            case "index":
                base = content["base"]
                array = self._at(base, self._unbound(base, bound))
                return self._indexed(array, number, bound)
            case "array_update":
                return self._updated(number, content, bound)
            case "record":
                return tuple(at(one) for one in operands)
            case "field":
                record = at(content["base"])
                if not isinstance(record, tuple):
                    raise refused(self._name, "a member of an array of records")
                return record[content["field"]]
            case "range":
                return self._range(content, bound)
            case "comprehension":
                return self._comprehension(content, bound)
            case "conditional":
                return self._conditional(operands, bound)
            case "builtin":
                return self._builtin(content["builtin"], operands, bound)
            case "call":
                return self._called(number, content, operands, bound)
        raise refused(self._name, f"an expression of the kind {kind}")

    def _unbound(self, number: int, bound: Mapping[Any, Any]) -> Mapping[Any, Any]:
        """Values of binders outside an array that is made in full, even where its own index is bound."""
        kind, content, _ = self._nodes[number]
        if kind != "comprehension":
            return bound
        return {key: value for key, value in bound.items() if key[0] != content["domain"]}

    def _coordinate(self, content: Any, bound: Mapping[Any, Any]) -> Any:
        if content == "time":
            return ex.symbol("t")
        ((kind, where),) = content.items()
        if kind == "binder":
            return ex.number(bound[where["domain"], where["ordinal"]])
        if kind == "function_parameter":
            return bound["parameter", where["ordinal"]]
        if kind == "derivative":
            return (
                self._derivatives[where][()]
                if not self._derivatives[where].shape
                else self._derivatives[where]
            )
        if kind == "condition":
            return self._truth(where)
        if kind == "delay":
            one = self._s["delays"][where]
            ((_, about),) = one["kind"].items()
            lag = about["delay_time"]
            return self._delayed(
                self._single(one["source"], bound),
                self._single(lag["expression"] if isinstance(lag, dict) else lag, bound),
            )
        if kind == "terminal":
            return self._at_the_end().operands[0]
        table = self._pre if kind.startswith("pre_") else self._elements
        if kind.removeprefix("pre_") in _REFERENCES:
            return table[where][()] if not table[where].shape else table[where]
        raise refused(self._name, f"a reference of the kind {kind}")

    def _truth(self, number: int) -> Expr:
        """Whether a condition holds, as an expression."""
        node = self._s["conditions"][number]["node"]
        if node == "terminal":
            return _ZERO
        if node in ("always", "initial"):
            return ex.ONE if node == "always" else ex.symbol("initial")
        ((kind, content),) = node.items()
        match kind:
            case "relation":
                return self._single(self._s["relations"][content]["relation"]["expression"])
            case "discrete":
                return self._single(content)
            case "not":
                return ex.logical("not", self._truth(content))
            case "and" | "or":
                return ex.logical(kind, self._truth(content["lhs"]), self._truth(content["rhs"]))
            case "clock":
                return ex.symbol("tick", content)
        raise refused(self._name, f"the condition {kind} in an equation")

    def _at_the_end(self) -> Condition:
        self._remarks.append(
            "what it does when terminal() is left out: an FMU does not know its end beforehand"
        )
        return Condition("value", (_ZERO,))

    def _binary(self, operator: str, a: Any, b: Any) -> Any:
        if operator == "multiply":
            left, right = np.asarray(a, dtype=object), np.asarray(b, dtype=object)
            return product(left, right) if left.ndim and right.ndim else each(ex.mul, a, b)
        if operator in _RELATIONS:
            return each(partial(self._relation, _RELATIONS[operator]), a, b)
        for name, make in OPERATORS.items():
            if operator in (name, f"elementwise_{name}", f"element_{name}"):
                if name == "power" and np.ndim(a) == 2:
                    raise refused(self._name, "a power of a matrix")
                return each(make, a, b)
        raise refused(self._name, f"the operator {operator}")

    def _relation(self, op: str, a: Expr, b: Expr) -> Expr:
        a, b = self._string_value(a), self._string_value(b)
        if op in ("eq", "ne") and a.op == b.op == "sym" and a.args[0] == b.args[0] == "text":
            return ex.number((a is b) == (op == "eq"))
        made = ex.logical(op, a, b)
        # Of discrete values and parameters alone a relation changes at events only, by itself.
        return self._with_mode(made) if made.op == op and self._events and self._is_continuous(made) else made

    def _string_value(self, one: Expr) -> Expr:
        """The text that a String parameter or constant, or a sum of them, stands for; others as they are."""
        if one.op == "add":
            a, b = (self._string_value(part) for part in one.args)
            if a.op == b.op == "sym" and a.args[0] == b.args[0] == "text":
                return ex.symbol("text", a.args[1] + b.args[1])
        if one not in self._strings or self._scalars[one.args[1]].role != "parameter":
            return one
        place = next(n for n, places in enumerate(self._elements) if one in places.ravel())
        binding = self._s["variables"][place]["attributes"].get("binding")
        return one if binding is None else self._string_value(self._single(binding))

    def _is_continuous(self, made: Expr) -> bool:
        continuous = ("state", "algebraic", "input", "output")
        if not self._roles:
            self._roles = {
                place: variable["role"]
                for variable, places in zip(self._s["variables"], self._elements, strict=True)
                for place in places.ravel()
            }
        return any(
            one.args[0] in ("t", "der", "delayed") or self._roles.get(one) in continuous for one in made.free
        )

    def _with_mode(self, made: Expr) -> Expr:
        if made not in self._mode_of:
            self._mode_of[made] = len(self._modes)
            self._modes.append(made)
        return ex.symbol("mode", self._mode_of[made])

    def _stepped(self, name: str, a: Expr) -> Expr:
        made = ex.function(name, a)
        return (
            self._with_mode(made) if made.op != "num" and self._events and self._is_continuous(made) else made
        )

    def _quotient(self, content: Json, a: Any, b: Any) -> Any:
        def one(x: Expr, y: Expr) -> Expr:
            ratio = ex.div(x, y)
            whole = self._stepped("floor" if content["builtin"] == "mod" else "trunc", ratio)
            return whole if content["builtin"] == "div" else ex.sub(x, ex.mul(whole, y))

        return each(one, a, b)

    def _indexed(self, base: Any, number: int, bound: Mapping[Any, Any]) -> Any:
        places: list[Any] = []
        for one in self._subscripts[number]:
            kind = one["kind"]
            if not isinstance(kind, dict):
                places.append(slice(None))
                continue
            ((sort, subscript),) = kind.items()
            chosen = np.asarray(self._at(subscript, bound), dtype=object)
            size = np.shape(base)[len(places)]
            if self._structural(chosen) and any(one.free for one in np.ravel(base)):
                known = [ex.number(self._number(one, "a subscript")) for one in chosen.ravel()]
                chosen = np.array(known, dtype=object).reshape(chosen.shape)
            if any(value.op != "num" for value in chosen.ravel()):
                if chosen.ndim:
                    raise refused(self._name, "a vector of subscripts that changes while the model runs")
                self.keep_within(chosen.item(), size, number)
                places.append(chosen.item())
                continue
            numbers = np.vectorize(lambda value: int(value.args[0]) - 1, otypes=[int])(chosen)
            if outside := [int(one) + 1 for one in numbers.ravel() if not 0 <= one < size]:
                if self._guards:  # a condition that is known later only keeps it from being read
                    self.keep_within(ex.number(outside[0]), size, number)
                    return ex.number(np.nan)
                raise BuildError(f"{self._name}: subscript {outside[0]} is outside 1:{size}; keep within it")
            places.append(int(numbers) if sort == "index" and not numbers.shape else numbers.ravel())
        base = np.asarray(base, dtype=object)
        result = base
        for axis in range(len(places) - 1, -1, -1):
            place = places[axis]
            result = (
                self._selected(result, axis, place)
                if isinstance(place, Expr)
                else result[(slice(None),) * axis + (place,)]
            )
        return result

    def _structural(self, subscripts: np.ndarray) -> bool:
        """Whether subscripts follow from parameters that the declaration evaluates or makes final."""
        scalars = [
            self._scalars[symbol.args[1]] if symbol.args[0] == "p" else None
            for one in subscripts.ravel()
            for symbol in one.free
        ]
        return bool(scalars) and all(one is not None and one.role == "dependent" for one in scalars)

    def _updated(self, number: int, content: Json, bound: Mapping[Any, Any]) -> Any:
        """An array in which the elements of some subscripts have a new value."""
        base = np.array(self._at(content["base"], bound), dtype=object)
        places: list[Any] = []
        for one in self._subscripts[number]:
            kind = one["kind"]
            if not isinstance(kind, dict):
                places.append(slice(None))
                continue
            chosen = np.asarray(self._at(next(iter(kind.values())), bound), dtype=object)
            if any(value.op != "num" for value in chosen.ravel()):
                raise refused(self._name, "an assignment to an element whose subscript changes")
            size = base.shape[len(places)]
            if not chosen.ndim and not 1 <= chosen.item().args[0] <= size:
                raise BuildError(
                    f"{self._name}: subscript {chosen.item().args[0]:g} is outside 1:{size}; keep within it"
                )
            places.append(int(chosen.item().args[0]) - 1 if not chosen.ndim else None)
        if None in places:
            raise refused(self._name, "an assignment to a vector of subscripts")
        base[tuple(places)] = self._at(content["value"], bound)
        return base

    @staticmethod
    def _selected(base: np.ndarray, axis: int, chosen: Expr) -> Any:
        """The part of an array at a subscript that is known while the model runs; NaN outside the array."""
        parts = list(np.moveaxis(base, axis, 0))
        inside = values_of(chosen) and all(1 <= one <= len(parts) for one in values_of(chosen))
        found = parts.pop() if inside else each(lambda _: ex.number(np.nan), parts[-1])
        for place in range(len(parts) - 1, -1, -1):
            here = ex.logical("eq", chosen, ex.number(place + 1))
            found = each(partial(ex.conditional, here), parts[place], found)
        return found

    def _range(self, content: Json, bound: Mapping[Any, Any]) -> Any:
        first, last = (self._single(content[f"{key}_expression"], bound) for key in ("start", "stop"))
        step = content.get("explicit_step_expression")
        by = ex.ONE if step is None else self._single(step, bound)
        if any(one.op != "num" for one in (first, last, by)) or not by.args[0]:
            raise refused(self._name, "a range that is not known when the model is built")
        start, stop, width = first.args[0], last.args[0], by.args[0]
        count = max(0, int(np.floor((stop - start) / width * (1 + 1e-12) + 1e-9)) + 1)
        return np.array([ex.number(start + width * k) for k in range(count)], dtype=object)

    def _comprehension(self, content: Json, bound: Mapping[Any, Any]) -> Any:
        binders = [one for one in self._domain(content["domain"]) if one[0] not in bound]
        made = [
            self._at(
                content["body"], {**bound, **dict(zip((key for key, _ in binders), values, strict=True))}
            )
            for values in itertools.product(*(values for _, values in binders))
        ]
        shape = tuple(len(values) for _, values in binders)
        found = stacked(made)
        return found.reshape(shape + found.shape[1:])

    def _conditional(self, operands: list[int], bound: Mapping[Any, Any]) -> Any:
        pairs, otherwise = operands[:-1], operands[-1]
        cases = []
        passed: list[Expr] = []
        for place in range(0, len(pairs), 2):
            condition = self._single(pairs[place], bound)
            if condition.op == "num":
                if condition.args[0]:
                    otherwise = pairs[place + 1]
                    break
                continue
            with self.guarded(*passed, condition):
                cases.append((condition, self._at(pairs[place + 1], bound)))
            passed.append(ex.logical("not", condition))
        with self.guarded(*passed):
            found = self._at(otherwise, bound)
        for condition, value in reversed(cases):
            if isinstance(found, tuple):
                found = tuple(
                    each(partial(ex.conditional, condition), a, b) for a, b in zip(value, found, strict=True)
                )
                continue
            found = each(partial(ex.conditional, condition), value, found)
        return found

    def _builtin(self, name: str, operands: list[int], bound: Mapping[Any, Any]) -> Any:
        if name in ("no_event", "smooth"):
            before, self._events = self._events, self._events and name != "no_event"
            try:
                return self._at(operands[-1], bound)
            finally:
                self._events = before
        values = [self._at(one, bound) for one in operands]
        if name in FUNCTIONS:
            return each(partial(ex.function, FUNCTIONS[name]), *values)
        if name in STEPS:
            return each(partial(self._stepped, STEPS[name]), values[0])
        if name in REDUCTIONS:
            return REDUCTIONS[name](values)
        if name in ("mod", "div", "rem"):
            return self._quotient({"builtin": name}, *values)
        if name == "homotopy":
            share = ex.symbol("homotopy")
            rest = ex.sub(ex.ONE, share)
            return each(lambda a, b: a if a is b else ex.add(ex.mul(share, a), ex.mul(rest, b)), *values[:2])
        if name in ("promoted_cat1", "promoted_cat2"):
            # A vector counts as a column (Modelica Language Specification 3.6, section 10.4.2).
            promoted = [np.asarray(one, dtype=object) for one in values]
            promoted = [one if one.ndim > 1 else one.reshape(-1, 1) for one in promoted]
            return np.concatenate(promoted, axis=int(name[-1]) - 1)
        raise refused(self._name, f"the function {name}()")
