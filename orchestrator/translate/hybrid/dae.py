"""From the compiler's DAE form to scalar equations, discrete updates and events.

Arrays become scalars, functions are evaluated into the expressions that call them.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from ..faults import PlacedError, placed
from ..sources import DELAY, Location, Spans
from . import expression as ex
from .adapted import CALL, MARK, Section, Sections
from .arrays import FUNCTIONS, OPERATORS, REDUCTIONS, STEPS, each, product, stacked
from .expression import Expr
from .external import external_call
from .functions import CONSTANTS, Source, call, named_constant
from .sections import Run, hidden_section, set_by_events
from .statements import FunctionSource
from .tables import Table, read_table

__all__ = ["Action", "Branch", "Condition", "DaeModel", "Delay", "Discrete", "Scalar", "read_dae"]

Json = Mapping[str, Any]
# Each `mod`, `div`, `rem` outside functions stands for so many further nodes, which the form does not write.
_HIDDEN_NODES = 6
_DEEPEST_CALL = 200
_MOST_DELAYS = 64  # as in hybrid.h
_RELATIONS = {
    "less": "lt", "less_equal": "le", "greater": "gt", "greater_equal": "ge", "equal": "eq",
    "not_equal": "ne",
}  # fmt: skip
_ROLES = {
    "discrete_real": "discrete", "discrete_value": "discrete", "constant": "parameter", "output": "algebraic",
}  # fmt: skip
# Kinds of references to variables.
_REFERENCES = (
    "state", "algebraic", "output", "discrete_real", "discrete_value", "input", "parameter", "constant",
)  # fmt: skip
_ZERO = ex.number(0)


@dataclass
class Scalar:
    """A scalar variable.

    Attributes:
        role: "state", "algebraic", "discrete", "input", "parameter" (its value is given), "dependent" (it
            follows from others) or "free" (a parameter that initialisation determines).
        type: "real", "integer", "boolean" or "enumeration".
        binding: of a dependent parameter.
        start, fixed: as declared; `start` may depend on parameters.
    """

    name: str
    role: str
    type: str
    start: Expr
    fixed: bool
    binding: Expr | None = None
    unit: str = ""
    description: str = ""
    causality: str = "local"
    nominal: float = 1.0
    value: Expr = field(default=_ZERO)


@dataclass(frozen=True)
class Condition:
    """What starts a when-clause: `kind` and its operands.

    Attributes:
        kind: always, initial, value (an expression), clock (a number), and, or, not, rise (either rises).
    """

    kind: str
    operands: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Branch:
    """A value that a discrete variable takes, always or when `trigger` rises while `guard` holds."""

    value: Expr
    trigger: int | None = None
    guard: int | None = None


@dataclass(frozen=True)
class Discrete:
    """A discrete variable with its branches; the first that is active counts."""

    target: Expr
    branches: tuple[Branch, ...]


@dataclass(frozen=True)
class Action:
    """What an event does: reinit of a state, assert, warning or terminate; or "bound", what has to hold.

    Attributes:
        trigger, guard: conditions at whose rise it counts; None: always.
        value: of a state; of all others what has to hold, if that is no condition.
    """

    kind: str
    trigger: int | None
    guard: int | None
    target: Expr | None = None
    value: Expr | None = None
    message: str = ""


@dataclass(frozen=True)
class Delay:
    """delay(operand, lag): symbol ("delayed", k) stands for entry k; `shown` as the model writes it."""

    operand: Expr
    lag: Expr
    shown: str


@dataclass
class DaeModel:
    """A model in scalars.

    Attributes:
        modes: expressions whose value is held between events; symbol ("mode", k) stands for entry k.
        clocks: phase and period of each [s].
        instants: times of events that are known beforehand [s].
        valueless: parameters without a value.
        origins, initial_origins: places of the equations and initial equations.
        declared: places of the variables, by their number.
        built_in: parameters whose value cannot be set any more.
        remarks: what the author of the model has to know.
    """

    name: str
    variables: list[Scalar]
    equations: list[Expr]
    initial_equations: list[Expr]
    initial_values: list[tuple[Expr, Expr]]
    discretes: list[Discrete]
    actions: list[Action]
    conditions: list[Condition]
    modes: list[Expr]
    clocks: list[tuple[float, float]]
    instants: list[float]
    valueless: tuple[str, ...] = ()
    built_in: tuple[str, ...] = ()
    origins: list[Location | None] = field(default_factory=list)
    initial_origins: list[Location | None] = field(default_factory=list)
    declared: list[Location | None] = field(default_factory=list)
    remarks: tuple[str, ...] = ()
    delays: list[Delay] = field(default_factory=list)

    def refusal(self, what: str, place: Location | None = None) -> BuildError:
        """An error about the model, with a place if it is known."""
        return BuildError(f"{self.name}: {what}") if place is None else PlacedError(f"{place}: {what}")

    def place_of(self, one: Expr) -> Location | None:
        """Where the variable of a symbol is declared."""
        number = one.args[1] if len(one.args) > 1 else None
        return self.declared[number] if isinstance(number, int) and number < len(self.declared) else None

    def name_of(self, one: Expr) -> str:
        """The name of the variable, derivative or delayed value that a symbol stands for."""
        if one.args[0] == "delayed":
            return self.delays[one.args[1]].shown
        if one.args[0] == "rise":
            return f"rise of condition {one.args[1] + 1}"
        name = self.variables[one.args[1]].name
        return "der(" * one.args[2] + name + ")" * one.args[2] if one.args[0] == "der" else name


def read_dae(
    document: Json, name: str, folders: Sequence[Path] = (), functions: Source = lambda _: None
) -> DaeModel:
    """Read the DAE form.

    Args:
        functions: text of a function by its qualified name.
        folders: where files of tables may stand: that of the model, those of libraries.
    Raises: BuildError for what has no scalar form, by the construct's name.
    """
    storage = document["storage"]
    spans = document.get("spans") or Spans()
    for key, what in (
        ("previous_values", "previous() of clocked models"),
        ("model_event_transactions", "an algorithm whose steps depend on each other at an event"),
    ):
        if storage.get(key):
            raise placed(_refuse(name, what), _first_place(storage[key], spans))
    reader = _Reader(storage, name, spans, folders, functions, document.get("sections", {}))
    try:
        return reader.model()
    except BuildError as error:
        raise placed(error, spans(reader.here)) from None


def _first_place(value: Any, spans: Spans) -> Location | None:
    """The first place within a part of the form."""
    if isinstance(value, dict):
        if isinstance(value.get("span"), dict):
            return spans(value)
        value = list(value.values())
    found = (_first_place(one, spans) for one in value) if isinstance(value, list) else iter(())
    return next((one for one in found if one is not None), None)


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


def _refuse(name: str, what: str) -> BuildError:
    instead = next((text for words, text in _INSTEAD.items() if words in what), "")
    told = f"{what} is not supported beside events, algebraic loops or functions"
    return BuildError(f"{told}; {instead}" if instead else told)


class _Reader:
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

    # Variables

    def model(self) -> DaeModel:
        self._elements: list[np.ndarray] = []
        self._derivatives: list[np.ndarray] = []
        self._pre: list[np.ndarray] = []
        scalars = self._scalars
        declared: list[Location | None] = []
        self._by_name = {one["name"]: number for number, one in enumerate(self._s["variables"])}
        hidden = [found for one in self._by_name if (found := hidden_section(one, self._sections))]
        for name in (name for one in hidden for name in set_by_events(*one)):
            for variable in self._s["variables"]:
                real = self._s["value_types"][variable["value_type"]]["scalar"] == "real"
                if real and re.sub(r"\[[\d,]*\]", "", variable["name"]) == re.sub(r"\[[\d,]*\]", "", name):
                    variable["role"] = "discrete_real"
        for variable in self._s["variables"]:
            self.here = variable["declaration"]
            shape = tuple(self._s["value_types"][variable["value_type"]]["dimensions"])
            places = np.empty(shape, dtype=object)
            slopes, before = np.empty(shape, dtype=object), np.empty(shape, dtype=object)
            for index in np.ndindex(*shape):
                number = len(scalars)
                role = "p" if variable["role"] in ("parameter", "constant") else "v"
                role = "u" if variable["role"] == "input" else role
                places[index] = ex.symbol(role, number)
                slopes[index], before[index] = ex.symbol("der", number, 1), ex.symbol("pre", number)
                inside = ",".join(str(one + 1) for one in index)
                scalars.append(
                    self._scalar(variable, f"{variable['name']}[{inside}]" if index else variable["name"])
                )
                scalars[-1].value = places[index]
                if scalars[-1].type == "string":
                    self._strings.add(places[index])
            self._elements.append(places)
            self._derivatives.append(slopes)
            self._pre.append(before)
            declared += [self._spans.name(self.here, variable["name"])] * (len(scalars) - len(declared))
        for variable, places in zip(self._s["variables"], self._elements, strict=True):
            self.here = variable["declaration"]
            self._complete(variable, places, scalars)
        equations, origins = self._residuals("continuous_equation_operations")
        self._bind()
        initial, initial_origins = self._residuals("initialization_equation_operations")
        at_start, self._needs = self._needs, []
        discretes = self._discretes()
        for one in self._s["conditions"]:
            self.here = one.get("provenance", {})
            self._conditions.append(self._condition(one["node"]))
        self._needs = []  # each relation is among the conditions, also where another keeps it from counting
        triggers = [branch.trigger for one in discretes for branch in one.branches]
        for number in dict.fromkeys([*triggers, *(one["trigger"] for one in self._s["event_actions"])]):
            if number is not None:
                self._need_condition(number)
        self._bind()
        for event_action in self._s["event_actions"]:
            made = self._action(event_action)
            self._bind(made.trigger, made.guard)
            self._actions.append(made)
        if at_start:
            self._needs, start = at_start, self.add_condition("initial")
            self._bind(start, start)
        self._clocks = [self._clock(one["kind"]) for one in self._s["clocks"]]
        values: list[tuple[Expr, Expr]] = []
        for owner, section in hidden:
            done = Run(self, owner, section)
            start = self.add_condition("initial") if section.initial else None
            self._bind(start, start)
            equations += done.equations
            origins += [Location(section.file, section.line)] * len(done.equations)
            discretes += [Discrete(place, (Branch(value),)) for place, value in done.values]
            for place, value in done.starts:
                if self.role_of(place) == "discrete":
                    values.append((place, value))
                else:
                    initial.append(ex.sub(place, value))
                    initial_origins.append(Location(section.file, section.line))

        for key in ("initial_discrete_values", "initial_parameter_values"):
            for one in self._s[key]:
                target = self._elements[one["target"]].ravel()
                values += list(zip(target, self._flat(one["value"], len(target)), strict=True))
        # An initial equation v = expression of a discrete variable is its initial value.
        held = {one.value for one in scalars if one.role == "discrete"}
        moved = []
        for place, one in enumerate(initial):
            sides = one.args if one.op == "sub" else ()
            for target, value in (sides, sides[::-1]) if sides else ():
                if target in held - {known for known, _ in values} and target not in value.free:
                    values.append((target, value))
                    moved.append(place)
                    break
        for place in reversed(moved):
            del initial[place], initial_origins[place]
        self._bind()
        instants = [self._ratio(one["instant"]) for one in self._s["time_events"] if "instant" in one]
        expand_derivatives(self._name, scalars, equations)
        for one, place in zip([*equations, *initial], [*origins, *initial_origins], strict=False):
            for text in (symbol.args[1] for symbol in one.free if symbol.args[0] == "text"):
                raise placed(_refuse(self._name, f"the text {text!r} in an equation"), place)
        return DaeModel(
            self._name, scalars, equations, initial, values, discretes, self._actions, self._conditions,
            self._modes, self._clocks,
            sorted(set(instants)), tuple(self._valueless), tuple(dict.fromkeys(self._built_in)), origins,
            initial_origins, declared, tuple(dict.fromkeys(self._remarks)), self._delays,
        )  # fmt: skip

    def _scalar(self, variable: Json, name: str) -> Scalar:
        attributes = variable["attributes"]
        role = _ROLES.get(variable["role"], variable["role"])
        if role not in ("state", "algebraic", "discrete", "input", "parameter"):
            raise _refuse(self._name, f"the variable {name} of kind {role}")
        kind = self._s["value_types"][variable["value_type"]]["scalar"]
        if kind not in ("real", "integer", "boolean", "enumeration", "string"):
            raise _refuse(self._name, f"the variable {name} of type {kind}")
        return Scalar(
            name, role, kind, _ZERO, False, unit=attributes.get("unit") or "",
            description=attributes.get("description") or "", causality=attributes.get("causality") or "local",
        )  # fmt: skip

    def _complete(self, variable: Json, places: np.ndarray, scalars: list[Scalar]) -> None:
        attributes = variable["attributes"]
        ours = [scalars[one.args[1]] for one in places.ravel()]
        if not ours or ours[0].type == "string":
            return
        fixed = attributes.get("fixed") or [variable["role"] in ("parameter", "constant")]
        for one, value in zip(ours, itertools.cycle(fixed), strict=False):
            one.fixed = bool(value)
        starts = attributes.get("start")
        if starts is not None:
            for one, start in zip(ours, self._flat(starts, len(ours)), strict=True):
                one.start = start
        if attributes.get("nominal") is not None and not isinstance(attributes["nominal"], bool):
            for one, nominal in zip(ours, self._flat(attributes["nominal"], len(ours)), strict=True):
                one.nominal = abs(nominal.args[0]) or 1.0 if nominal.op == "num" else 1.0
        if variable["role"] not in ("parameter", "constant"):
            return
        binding = attributes.get("binding")
        given = attributes.get("start") is not None and any(one.start is not _ZERO for one in ours)
        if binding is None and variable["role"] == "parameter" and ours[0].fixed and not given:
            self._valueless.append(variable["name"])
        values = [None] * len(ours) if binding is None else self._flat(binding, len(ours))
        for one, value in zip(ours, values, strict=True):
            if not one.fixed and value is not None:  # what an initial algorithm gives it
                one.role, one.binding = "dependent", value
            elif not one.fixed:
                one.role = "free"
            elif value is not None and (value.op != "num" or variable["role"] == "constant"):
                one.role, one.binding = "dependent", value
            elif value is not None:
                one.start = value
            elif one.start.op != "num":
                one.role, one.binding = "dependent", one.start
            made = one.name.rpartition(".")[2].startswith(MARK)
            if (attributes.get("evaluable") or made) and one.role == "parameter":
                one.role, one.binding = "dependent", one.start

    # Equations and events

    def _domain(self, number: int) -> list[tuple[tuple[int, int], range]]:
        """Binders of a domain and its parents, outermost first, with their values."""
        entry = self._s["domains"][number]
        outer = [] if entry["parent"] is None else self._domain(entry["parent"])
        return outer + [
            ((number, place), range(one["lower"], one["upper"] + (1 if one["step"] > 0 else -1), one["step"]))
            for place, one in enumerate(entry["domain"]["binders"])
        ]

    def _residuals(self, key: str) -> tuple[list[Expr], list[Location | None]]:
        found: list[Expr] = []
        origins: list[Location | None] = []
        for operation in self._s[key]:
            ((kind, content),) = operation.items()
            self.here = content.get("provenance", {})
            if kind == "residual":
                found += list(np.ravel(self._at(content["residual"], {})))
            elif kind == "structured":
                found += self._structured(content)
            else:
                raise _refuse(self._name, f"an equation of the kind {kind}")
            origins += [self._spans(self.here)] * (len(found) - len(origins))
        return found, origins

    def _structured(self, content: Json) -> list[Expr]:
        if content["scalar_view"] == "RowMajorProjection":
            return [one for body in content["bodies"] for one in np.ravel(self._at(body, {}))]
        binders = self._domain(content["domain"])
        found: list[Expr] = []
        for values in itertools.product(*(values for _, values in binders)):
            bound = {key: value for (key, _), value in zip(binders, values, strict=True)}
            found += [one for body in content["bodies"] for one in np.ravel(self._at(body, bound))]
        return found

    def _discretes(self) -> list[Discrete]:
        found = []
        for one in self._s["discrete_real_equations"]:
            self.here = one.get("provenance", {})
            activation = one["activation"]
            trigger, guard = self._activation(activation)
            for residual in np.ravel(self._at(one["residual"], {})):
                target, value = self._solved(residual)
                found.append(Discrete(target, (Branch(value, trigger, guard),)))
            self._bind(trigger, guard)
        for one in self._s["discrete_value_owners"]:
            self.here = one.get("provenance", {})
            branches: list[list[Branch]] = []
            targets = [list(self._elements[number].ravel()) for number in one["targets"]]
            for branch in one["branches"]:
                trigger, guard = self._activation(branch["activation"])
                values = [
                    value
                    for places, entry in zip(targets, branch["values"], strict=True)
                    for value in self._flat(entry["value"], len(places))
                ]
                branches.append([Branch(value, trigger, guard) for value in values])
                self._bind(trigger, guard)
            for number, target in enumerate(place for places in targets for place in places):
                found.append(Discrete(target, tuple(one[number] for one in branches)))
        merged: dict[Expr, Discrete] = {}
        for one in found:
            before = merged.get(one.target)
            merged[one.target] = Discrete(one.target, (*before.branches, *one.branches)) if before else one
        return list(merged.values())

    def _activation(self, activation: Any) -> tuple[int | None, int | None]:
        if activation == "always":
            return None, None
        if isinstance(activation, dict) and "when" in activation:
            return activation["when"]["trigger"], activation["when"]["guard"]
        raise _refuse(self._name, f"a discrete equation that is active at {activation}")

    def _solved(self, residual: Expr) -> tuple[Expr, Expr]:
        """Variable and value of a discrete equation."""
        discrete = {"discrete_real", "discrete_value"}
        numbers = {
            place for variable, places in zip(self._s["variables"], self._elements, strict=True)
            if variable["role"] in discrete for place in places.ravel()
        }  # fmt: skip
        sides = residual.args if residual.op == "sub" else (residual, _ZERO)
        for target, value in (sides, sides[::-1]):
            if target in numbers and target not in value.free:
                return target, value
        for target in sorted(residual.free & numbers, key=lambda one: one.args[1]):
            if found := ex.linear(residual, target):
                return target, ex.neg(ex.div(found[1], found[0]))
        raise _refuse(self._name, f"the discrete equation 0 = {residual!r}")

    def _condition(self, node: Any) -> Condition:
        if isinstance(node, str):
            if node in ("always", "initial"):
                return Condition(node)
            if node == "terminal":
                return self._at_the_end()
            raise _refuse(self._name, f"a condition {node}()")
        ((kind, content),) = node.items()
        match kind:
            case "relation":
                relation = self._s["relations"][content]
                return Condition("value", (self._one(relation["relation"]["expression"]),))
            case "discrete":
                return Condition("value", (self._one(content),))
            case "clock":
                return Condition("clock", (content,))
            case "quotient_owner":
                return Condition("value", (_ZERO,))
            case "not":
                return Condition("not", (content,))
            case "and" | "or":
                return Condition(kind, (content["lhs"], content["rhs"]))
            case "any_rise":
                return Condition("rise", (content["lhs"], content["rhs"]))
        raise _refuse(self._name, f"a condition of the kind {kind}")

    def _need_condition(self, number: int) -> None:
        """What a condition that starts a when-clause needs."""
        kind, operands = self._conditions[number].kind, self._conditions[number].operands
        if kind == "value":
            self._condition(self._s["conditions"][number]["node"])
        elif kind in ("not", "and", "or", "rise"):
            self._need_condition(operands[0])
        if kind == "rise":
            self._need_condition(operands[1])
        if kind in ("and", "or") and self._conditions[operands[0]].kind == "value":
            first = self._truth(operands[0])
            with self.guarded(first if kind == "and" else ex.logical("not", first)):
                self._need_condition(operands[1])

    def _at_the_end(self) -> Condition:
        self._remarks.append(
            "what it does when terminal() is left out: an FMU does not know its end beforehand"
        )
        return Condition("value", (_ZERO,))

    # For algorithm sections

    def events_so_far(self) -> tuple[int, ...]:
        """Numbers of modes, conditions, actions, clocks and needs."""
        return tuple(map(len, (self._modes, self._conditions, self._actions, self._clocks, self._needs)))

    def forget_events(self, before: tuple[int, ...]) -> None:
        """Drop what has been added since `events_so_far`."""
        for one in self._modes[before[0] :]:
            del self._mode_of[one]
        held = (self._modes, self._conditions, self._actions, self._clocks, self._needs)
        for kept, count in zip(held, before, strict=True):
            del kept[count:]

    def number_of(self, name: str) -> int | None:
        """Number of a variable; None if there is none of this name."""
        return self._by_name.get(name)

    def numbers_like(self, pattern: str) -> list[int]:
        return [number for name, number in self._by_name.items() if re.fullmatch(pattern, name)]

    def places_of(self, number: int) -> np.ndarray:
        return self._elements[number]

    def pre_of(self, number: int) -> np.ndarray:
        return self._pre[number]

    def role_of(self, place: Expr) -> str:
        return self._scalars[place.args[1]].role

    def before(self, place: Expr) -> Expr:
        """What a variable is before a section assigns it."""
        scalar = self._scalars[place.args[1]]
        return ex.symbol("pre", place.args[1]) if scalar.role == "discrete" else scalar.start

    def hold(self, events: bool) -> bool:
        """Whether relations are events from now on; returns whether they were."""
        before, self._events = self._events, events
        return before

    def relation(self, op: str, a: Expr, b: Expr) -> Expr:
        return self._relation(op, a, b)

    def stepped(self, name: str, a: Expr) -> Expr:
        return self._stepped(name, a)

    def quotient(self, name: str, a: Any, b: Any) -> Any:
        return self._quotient({"builtin": name}, a, b)

    def selected(self, base: np.ndarray, axis: int, chosen: Expr, place: Location) -> Any:
        self.keep_within(chosen, base.shape[axis], place)
        return self._selected(base, axis, chosen)

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
        if all(1 <= one <= size for one in _values_of(chosen) or (0,)):
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

    def number(self, value: Expr, what: str) -> float:
        return self._number(value, what)

    def add_condition(self, kind: str, *operands: Any) -> int:
        """Number of a condition."""
        made = self._at_the_end() if kind == "terminal" else Condition(kind, operands)
        self._conditions.append(made)
        return len(self._conditions) - 1

    def add_clock(self, start: float, period: float) -> int:
        """Number of the condition that a clock ticks."""
        self._clocks.append((start, period))
        return self.add_condition("clock", len(self._clocks) - 1)

    def add_action(
        self, kind: str, trigger: int | None, *, target: Expr | None = None, value: Expr | None = None,
        message: str = "",
    ) -> None:  # fmt: skip
        self._actions.append(Action(kind, trigger, trigger, target, value, message))

    @property
    def function_texts(self) -> Source:
        return self._functions

    def function_near(self, name: str, scope: str) -> FunctionSource | None:
        """A function as a class names it."""
        while True:
            if found := self._functions(f"{scope}.{name}" if scope else name):
                return found
            if not scope:
                return None
            scope = scope.rpartition(".")[0]

    def constant(self, name: str, section: Section) -> float | None:
        """The value of a constant of the library, or of a member of an enumeration, which a name means."""
        if (value := named_constant(name)) is not None:
            return value
        owner, _, member = name.rpartition(".")
        if not owner:
            return CONSTANTS.get(name) if name == "pi" else None
        known = getattr(self._functions, "members", lambda _: [])(owner.rpartition(".")[2])
        ordinals = {names.index(member) + 1 for names in known if member in names}
        return float(ordinals.pop()) if len(ordinals) == 1 else None

    def _action(self, action: Json) -> Action:
        self.here = action.get("provenance", {})
        ((kind, content),) = action["kind"].items()
        where = action["trigger"], action["guard"]
        match kind:
            case "reinitialize":
                place = self._elements[content["state"]]
                if place.shape:
                    raise _refuse(self._name, "reinit of an array")
                return Action("reinit", *where, target=place.item(), value=self._one(content["value"]))
            case "assert":
                return Action("assert", *where, message=self._text(content["message"]))
            case "warning":
                held = self._one(content["condition"]) if content.get("condition") is not None else None
                return Action("warning", *where, value=held, message=self._text(content["message"]))
            case "terminate":
                return Action("terminate", *where, message=self._text(content["message"]))
        raise _refuse(self._name, f"the action {kind}")

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

    def _clock(self, kind: Json) -> tuple[float, float]:
        lattice = kind.get("periodic", {}).get("lattice") if isinstance(kind, dict) else None
        if not lattice:
            raise _refuse(self._name, "a clock that is not periodic")
        return self._ratio(lattice["phase"]), self._ratio(lattice["period"])

    # Expressions

    def _one(self, number: int, bound: Mapping[Any, Any] | None = None) -> Expr:
        value = np.asarray(self._at(number, bound or {}), dtype=object)
        if value.size != 1:
            raise _refuse(self._name, f"an array of {value.size} elements in place of one number")
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
                    raise _refuse(self._name, "a member of an array of records")
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
        raise _refuse(self._name, f"an expression of the kind {kind}")

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
                self._one(one["source"], bound),
                self._one(lag["expression"] if isinstance(lag, dict) else lag, bound),
            )
        if kind == "terminal":
            return self._at_the_end().operands[0]
        table = self._pre if kind.startswith("pre_") else self._elements
        if kind.removeprefix("pre_") in _REFERENCES:
            return table[where][()] if not table[where].shape else table[where]
        raise _refuse(self._name, f"a reference of the kind {kind}")

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
                return self._one(self._s["relations"][content]["relation"]["expression"])
            case "discrete":
                return self._one(content)
            case "not":
                return ex.logical("not", self._truth(content))
            case "and" | "or":
                return ex.logical(kind, self._truth(content["lhs"]), self._truth(content["rhs"]))
        raise _refuse(self._name, f"the condition {kind} in an equation")

    def _binary(self, operator: str, a: Any, b: Any) -> Any:
        if operator == "multiply":
            left, right = np.asarray(a, dtype=object), np.asarray(b, dtype=object)
            return product(left, right) if left.ndim and right.ndim else each(ex.mul, a, b)
        if operator in _RELATIONS:
            return each(partial(self._relation, _RELATIONS[operator]), a, b)
        for name, make in OPERATORS.items():
            if operator in (name, f"elementwise_{name}", f"element_{name}"):
                if name == "power" and np.ndim(a) == 2:
                    raise _refuse(self._name, "a power of a matrix")
                return each(make, a, b)
        raise _refuse(self._name, f"the operator {operator}")

    def _relation(self, op: str, a: Expr, b: Expr) -> Expr:
        a, b = self._told(a), self._told(b)
        if op in ("eq", "ne") and a.op == b.op == "sym" and a.args[0] == b.args[0] == "text":
            return ex.number((a is b) == (op == "eq"))
        made = ex.logical(op, a, b)
        # Of discrete values and parameters alone a relation changes at events only, by itself.
        return self._held(made) if made.op == op and self._events and self._moves(made) else made

    def _told(self, one: Expr) -> Expr:
        """The text that a String parameter or constant stands for; anything else as it is."""
        if one not in self._strings or self._scalars[one.args[1]].role != "parameter":
            return one
        place = next(n for n, places in enumerate(self._elements) if one in places.ravel())
        binding = self._s["variables"][place]["attributes"].get("binding")
        return one if binding is None else self._told(self._one(binding))

    def _moves(self, made: Expr) -> bool:
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

    def _held(self, made: Expr) -> Expr:
        if made not in self._mode_of:
            self._mode_of[made] = len(self._modes)
            self._modes.append(made)
        return ex.symbol("mode", self._mode_of[made])

    def _stepped(self, name: str, a: Expr) -> Expr:
        made = ex.function(name, a)
        return self._held(made) if made.op != "num" and self._events and self._moves(made) else made

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
                    raise _refuse(self._name, "a vector of subscripts that changes while the model runs")
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
                raise _refuse(self._name, "an assignment to an element whose subscript changes")
            size = base.shape[len(places)]
            if not chosen.ndim and not 1 <= chosen.item().args[0] <= size:
                raise BuildError(
                    f"{self._name}: subscript {chosen.item().args[0]:g} is outside 1:{size}; keep within it"
                )
            places.append(int(chosen.item().args[0]) - 1 if not chosen.ndim else None)
        if None in places:
            raise _refuse(self._name, "an assignment to a vector of subscripts")
        base[tuple(places)] = self._at(content["value"], bound)
        return base

    @staticmethod
    def _selected(base: np.ndarray, axis: int, chosen: Expr) -> Any:
        """The part of an array at a subscript that is known while the model runs; NaN outside the array."""
        parts = list(np.moveaxis(base, axis, 0))
        inside = _values_of(chosen) and all(1 <= one <= len(parts) for one in _values_of(chosen))
        found = parts.pop() if inside else each(lambda _: ex.number(np.nan), parts[-1])
        for place in range(len(parts) - 1, -1, -1):
            here = ex.logical("eq", chosen, ex.number(place + 1))
            found = each(partial(ex.conditional, here), parts[place], found)
        return found

    def _range(self, content: Json, bound: Mapping[Any, Any]) -> Any:
        first, last = (self._one(content[f"{key}_expression"], bound) for key in ("start", "stop"))
        step = content.get("explicit_step_expression")
        by = ex.ONE if step is None else self._one(step, bound)
        if any(one.op != "num" for one in (first, last, by)) or not by.args[0]:
            raise _refuse(self._name, "a range that is not known when the model is built")
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
            condition = self._one(pairs[place], bound)
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
        raise _refuse(self._name, f"the function {name}()")

    def _delayed(self, operand: Expr, lag: Expr) -> Expr:
        if not operand.free:
            return operand
        if any(one.args[0] != "p" for one in lag.free):
            raise _refuse(self._name, "delay() with a delay time that changes")
        made = Delay(operand, lag, f"delay({self._shown(operand)}, {self._shown(lag)})")
        if made not in self._delays:
            if len(self._delays) >= _MOST_DELAYS:
                raise _refuse(self._name, f"delay() more than {_MOST_DELAYS} times")
            self._delays.append(made)
        return ex.symbol("delayed", self._delays.index(made))

    def _shown(self, one: Expr) -> str:
        """A number or a variable's name, for messages."""
        if one.op == "num":
            return f"{one.args[0]:g}"
        return self._scalars[one.args[1]].name if one.op == "sym" and len(one.args) > 1 else "..."

    def _called(self, number: int, content: Json, operands: list[int], bound: Mapping[Any, Any]) -> Any:
        if content["owner"] != number:
            operands = self._nodes[content["owner"]][2]
        function = self._s["functions"][content["function"]]
        if function["external"]:
            if function["name"] == DELAY:
                return self._delayed(*(self._one(one, bound) for one in operands[:2]))
            return self._external(number, content["output"], function, operands, bound)
        if content.get("derivative"):
            raise _refuse(self._name, f"a derivative of the function {function['name']}()")
        self._depth += 1
        if self._depth > _DEEPEST_CALL:
            raise _refuse(self._name, f"the function {function['name']}(), which calls itself without end,")
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
            raise _refuse(
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
        raise _refuse(self._name, f"the function {function['name']}() of a table")

    def _native(self, function: Json, operands: list[int], bound: Mapping[Any, Any]) -> Any:
        """A C function with its source beside the model."""
        source = self._functions(function["name"])
        if source is None or source.text.startswith("impure"):
            raise _refuse(self._name, f"the impure external function {function['name']}()")
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
            raise _refuse(self._name, f"the external object of the function {function['name']}()")

        def argument(number: int) -> int | float:
            _, content, _ = self._nodes[number]
            if isinstance(content, dict) and "function_parameter" in content:
                return int(content["function_parameter"]["ordinal"])
            return float(self._one(number, inside).args[0])

        return external_call(function, arrays, kinds, argument, self._path_of)

    def _table(self, handle: Expr, surface: bool) -> Table:
        """The table that a variable stands for; see `adapted`."""
        if handle in self._tables:
            return self._tables[handle]
        if handle.op != "sym":
            raise _refuse(self._name, "a table that depends on a condition")
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
        if on_file is not None and self._number(self._one(on_file), f"{head}.tableOnFile"):
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

    def _statements(self, statements: Iterable[Json], inside: dict[Any, Any]) -> None:
        for statement in statements:
            ((kind, content),) = statement.items()
            if kind == "assignment":
                inside["value", content["target"]] = self._at(content["rhs"], inside)
            elif kind == "assignment_group":
                made = [(one["target"], self._at(one["rhs"], inside)) for one in content["assignments"]]
                inside.update({("value", target): value for target, value in made})
            elif kind == "for":
                binders = self._domain(content["domain"])
                for values in itertools.product(*(values for _, values in binders)):
                    inside.update(zip((key for key, _ in binders), values, strict=True))
                    self._statements(content["statements"], inside)
            elif kind == "assertion" and content.get("level") == "error":
                holds = self._one(content["condition"], inside)
                inside["holds"] = ex.logical("and", inside.get("holds", ex.ONE), holds)
            else:
                raise _refuse(self._name, f"a statement of the kind {kind} in a function")


def _values_of(one: Expr) -> tuple[float, ...]:
    """All values that a choice between numbers may have; none if it is something else."""
    if one.op == "num":
        return (one.args[0],)
    if one.op != "if":
        return ()
    parts = [_values_of(part) for part in one.args[1:]]
    return tuple(itertools.chain(*parts)) if all(parts) else ()


def expand_derivatives(name: str, scalars: list[Scalar], equations: list[Expr]) -> None:
    """Write der(v) of a variable v that stands for an expression as the derivative of that expression.

    Else v would be a state with a start value of its own. Changes both lists.
    """

    def seeds(one: Expr) -> Expr:
        kind = one.args[0]
        if kind == "t":
            return ex.ONE
        if kind == "u":
            raise ex.NoDerivative(
                f"{name}: the input {scalars[one.args[1]].name} would have to be differentiated"
            )
        if kind == "delayed":
            raise ex.NoDerivative(f"{name}: a delay() would have to be differentiated")
        if kind != "v" or scalars[one.args[1]].role not in ("state", "algebraic"):
            return _ZERO
        changing.add(one.args[1])
        return ex.symbol("der", one.args[1], 1)

    by: dict[Expr, Expr] = {}
    for number, one in enumerate(scalars):
        if one.role != "state" or not re.match(rf"{MARK}\d+_of_", one.name.rpartition(".")[2]):
            continue
        value = next(
            (
                b
                for a, b in (e.args for e in equations if e.op == "sub")
                if a is one.value and a not in b.free
            ),
            None,
        )
        if value is None or any(s.args[0] == "der" for s in value.free):
            continue
        changing: set[int] = set()
        by[ex.symbol("der", number, 1)] = ex.derivative(value, seeds)
        one.role = "algebraic"
        for place in changing:
            scalars[place].role = "state"
    for place, equation in enumerate(equations):
        for _ in range(len(by)):  # one may stand in another
            equation = ex.substituted(equation, by)
        equations[place] = equation
