"""The compiler's DAE form as tables, and what its expressions need to have a value."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from ..rewriting.hidden_sections import Sections
from ..sources import Location, Spans
from . import expression as ex
from .expression import Expr
from .functions import Source
from .model import Action, Condition, Delay, Scalar
from .tables import Table

Json = Mapping[str, Any]
_HIDDEN_NODES = 6
_ZERO = ex.number(0)
# What to write instead of a construct, by words of its refusal.
_INSTEAD = {
    "delay()": "give it a delay time of parameters",
    "external function": "write it as a Modelica function, or make an FMU of its own",
    "text": "choose by an Integer or an enumeration",
    "previous()": "use sample() and pre()",
    "clock": "use sample() and pre()",
    "reinit of an array": "reinit its elements one by one",
    "calls itself": "write it as a for-loop",
    "range": "give its bounds as numbers or constants",
    "depend on each other at an event": "write a when-equation for each variable",
}


def refused(name: str, what: str) -> BuildError:
    """That a construct of a model is not supported, and what to write instead where that is known."""
    instead = next((text for words, text in _INSTEAD.items() if words in what), "")
    message = f"{what} is not supported beside events, algebraic loops or functions"
    return BuildError(f"{message}; {instead}" if instead else message)


def values_of(one: Expr) -> tuple[float, ...]:
    """All values that a choice between numbers may have; none if it is something else."""
    if one.op == "num":
        return (one.args[0],)
    if one.op != "if":
        return ()
    parts = [values_of(part) for part in one.args[1:]]
    return tuple(itertools.chain(*parts)) if all(parts) else ()


class Form:
    """What is known of a model while its form is read."""

    def __init__(
        self,
        storage: Json,
        name: str,
        spans: Spans,
        folders: Sequence[Path],
        functions: Source,
        sections: Sections,
    ) -> None:
        self._s = storage
        # Symbols of each variable's elements, of their derivatives and of their values before an event.
        self._elements: list[np.ndarray] = []
        self._derivatives: list[np.ndarray] = []
        self._pre: list[np.ndarray] = []
        self._sections = sections
        self._remarks: list[str] = []
        self._delays: list[Delay] = []
        self._conditions: list[Condition] = []
        self._actions: list[Action] = []
        self._clocks: list[tuple[float, float]] = []
        self._functions = functions
        self._spans = spans
        self.here: Json = {}  # of what is read
        self._folders = folders
        self._scalars: list[Scalar] = []
        self._tables: dict[Expr, Table] = {}
        self._built_in: list[str] = []
        self._strings: set[Expr] = set()
        self._name = name
        self._modes: list[Expr] = []
        self._mode_of: dict[Expr, int] = {}
        self._events = True
        self._nodes: dict[int, tuple[str, Any, list[int]]] = {}
        self._provenance: dict[int, Json] = {}
        self._subscripts: dict[int, list[Json]] = {}
        self._number_nodes()
        self._depth = 0
        # Of the expression that is read: conditions under which it counts, and what it needs to have a value.
        self._guards: list[Expr] = []
        self._needs: list[tuple[Expr, str]] = []
        self._roles: dict[Expr, str] = {}
        self._valueless: list[str] = []

    def _number_nodes(self) -> None:
        table = self._s["expressions"]
        operands, subscripts = iter(table["operands"]), iter(table["subscripts"])
        number = 0
        for node, provenance in zip(table["nodes"], table["provenance"], strict=True):
            ((kind, content),) = node.items()
            self._provenance[number] = provenance
            taken = []
            if isinstance(content, dict):
                taken = list(itertools.islice(operands, content.get("operand_count", 0)))
                if "subscript_count" in content:
                    self._subscripts[number] = list(itertools.islice(subscripts, content["subscript_count"]))
            self._nodes[number] = (kind, content, taken)
            hides = kind == "runtime_quotient_owner" and "function" not in content["kind"]
            number += 1 + (_HIDDEN_NODES if hides else 0)

    def _at(self, number: int, bound: Mapping[Any, Any]) -> Any:
        raise NotImplementedError  # see `Values`

    def _single(self, number: int, bound: Mapping[Any, Any] | None = None) -> Expr:
        raise NotImplementedError

    def _domain(self, number: int) -> list[tuple[tuple[int, int], range]]:
        raise NotImplementedError

    @contextmanager
    def guarded(self, *conditions: Expr) -> Iterator[None]:
        """Expressions that are read within count where all these hold."""
        before = self._guards
        self._guards = [*before, *conditions]
        try:
            yield
        finally:
            self._guards = before

    def need(self, holds: Expr, message: str, place: Location | int) -> None:
        """What has to hold where the expression that is read counts, else the run ends with the message.

        Args:
            place: of it, or the number of the node.
        """
        for guard in self._guards:
            holds = ex.logical("or", ex.logical("not", guard), holds)
        if holds is not ex.ONE:
            found = self._spans(self._provenance[place]) if isinstance(place, int) else place
            # An FMU's bytes must not depend on the folder that it is built in.
            head = f"{Path(found.file).name}:{found.line}: " if found else ""
            self._needs.append((holds, head + message))

    def keep_within(self, chosen: Expr, size: int, place: Location | int) -> None:
        """A subscript has to be between 1 and a size."""
        if all(1 <= one <= size for one in values_of(chosen) or (0,)):
            return
        low, high = ex.logical("ge", chosen, ex.ONE), ex.logical("le", chosen, ex.number(size))
        outside = f"a subscript is outside 1:{size}" if chosen.op != "num" else (
            f"subscript {chosen.args[0]:g} is outside 1:{size}")  # fmt: skip
        self.need(ex.logical("and", low, high), outside, place)

    def need_value(self, found: Any, name: str, place: Location | int) -> None:
        """The results of a function in C have to be numbers."""
        for one in np.ravel(found)[:1]:
            holds = ex.logical("not", ex.make("fn:isnan", one))
            self.need(holds, f"{name}() has no value: an assertion fails, or a subscript is outside", place)

    def _bind(self, trigger: int | None = None, guard: int | None = None) -> None:
        """Make actions of what the expressions read so far need; it counts at a trigger, or always."""
        for holds, message in dict.fromkeys(self._needs):
            self._actions.append(Action("bound", trigger, guard, value=holds, message=message))
        self._needs = []

    def _number(self, value: Expr, what: str) -> float:
        """What an expression of parameters comes to; they are built in from now on."""
        by = {}
        for one in value.free:
            scalar = self._scalars[one.args[1]] if one.args[0] == "p" else None
            if scalar is None or scalar.role not in ("parameter", "dependent") or not scalar.fixed:
                raise BuildError(f"{self._name}: {what} depends on what is not known when the model is built")
            if scalar.role == "parameter":
                scalar.role, scalar.binding = "dependent", scalar.start
                self._built_in.append(scalar.name)
            by[one] = ex.number(self._number(scalar.binding or _ZERO, what))
        found = ex.substituted(value, by)
        if found.op != "num":
            raise BuildError(f"{self._name}: {what} has no value that is known when the model is built")
        return float(found.args[0])

    def _path_of(self, text: str) -> Path:
        if text.startswith("modelica://"):
            library, _, rest = text.removeprefix("modelica://").partition("/")
            places = [folder / library.replace(".", "/") / rest for folder in self._folders]
            return next((one for one in places if one.is_file()), places[0])
        return next((one for one in (folder / text for folder in self._folders) if one.is_file()), Path(text))

    def _shown(self, one: Expr) -> str:
        """A number or a variable's name, for messages."""
        if one.op == "num":
            return f"{one.args[0]:g}"
        return self._scalars[one.args[1]].name if one.op == "sym" and len(one.args) > 1 else "..."

    def _text(self, number: int) -> str:
        kind, content, _ = self._nodes[number]
        if kind == "literal" and isinstance(content, dict) and "string" in content:
            return str(content["string"])
        if kind == "binary" and content["operator"] == "add":
            return self._text(content["lhs"]) + self._text(content["rhs"])
        if kind == "coordinate" and isinstance(content, dict) and "parameter" in content:
            binding = self._s["variables"][content["parameter"]]["attributes"].get("binding")
            if binding is not None and self._elements[content["parameter"]].item() in self._strings:
                return self._text(binding)
        if kind == "call" and self._s["functions"][content["function"]]["name"].endswith("loadResource"):
            return self._text(self._nodes[content["owner"]][2][0])
        return "(a value)"

    @staticmethod
    def _ratio(value: Json) -> float:
        return float(value["num"]) / float(value["den"])
