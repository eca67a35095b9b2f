"""From the compiler's DAE form to scalar equations, discrete updates and events.

Arrays become scalars, functions are evaluated into the expressions that call them.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from ..faults import placed
from ..rewriting.class_bodies import MARK
from ..rewriting.hidden_sections import Section
from ..sources import Location, Spans
from . import expression as ex
from .expression import Expr
from .form import Json, refused
from .functions import CONSTANTS, Source, function_near, named_constant
from .model import Action, Branch, Condition, DaeModel, Discrete, Scalar
from .sections import SectionEvaluation, hidden_section, set_by_events
from .statements import FunctionSource
from .values import Values

_ROLES = {
    "discrete_real": "discrete", "discrete_value": "discrete", "constant": "parameter", "output": "algebraic",
}  # fmt: skip
_ZERO = ex.number(0)


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
            raise placed(refused(name, what), _first_place(storage[key], spans))
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


class _Reader(Values):
    # Variables

    def model(self) -> DaeModel:
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
            done = SectionEvaluation(self, owner, section)
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
                raise placed(refused(self._name, f"the text {text!r} in an equation"), place)
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
            raise refused(self._name, f"the variable {name} of kind {role}")
        kind = self._s["value_types"][variable["value_type"]]["scalar"]
        if kind not in ("real", "integer", "boolean", "enumeration", "string"):
            raise refused(self._name, f"the variable {name} of type {kind}")
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
        # Initial equations may have another solution, such as 0, outside the range of a parameter.
        for key, relation, sign in (("min", "ge", -1.0), ("max", "le", 1.0)):
            if attributes.get(key) is not None and any(one.role == "free" for one in ours):
                limits = self._flat(attributes[key], len(ours))
                for one, symbol, limit in zip(ours, places.ravel(), limits, strict=True):
                    if limit.op == "num":
                        value = limit.args[0]
                        limit = ex.number(value + sign * 1e-9 * max(1.0, abs(value)))
                    what = f"initialisation finds {one.name} beyond its {key}; give it another start value"
                    self._needs.append((ex.logical(relation, symbol, limit), what))

    # Equations and events

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
                raise refused(self._name, f"an equation of the kind {kind}")
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
        raise refused(self._name, f"a discrete equation that is active at {activation}")

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
        raise refused(self._name, f"the discrete equation 0 = {residual!r}")

    def _condition(self, node: Any) -> Condition:
        if isinstance(node, str):
            if node in ("always", "initial"):
                return Condition(node)
            if node == "terminal":
                return self._at_the_end()
            raise refused(self._name, f"a condition {node}()")
        ((kind, content),) = node.items()
        match kind:
            case "relation":
                relation = self._s["relations"][content]
                return Condition("value", (self._single(relation["relation"]["expression"]),))
            case "discrete":
                return Condition("value", (self._single(content),))
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
        raise refused(self._name, f"a condition of the kind {kind}")

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

    def _action(self, action: Json) -> Action:
        self.here = action.get("provenance", {})
        ((kind, content),) = action["kind"].items()
        where = action["trigger"], action["guard"]
        match kind:
            case "reinitialize":
                place = self._elements[content["state"]]
                if place.shape:
                    raise refused(self._name, "reinit of an array")
                return Action("reinit", *where, target=place.item(), value=self._single(content["value"]))
            case "assert":
                return Action("assert", *where, message=self._text(content["message"]))
            case "warning":
                held = self._single(content["condition"]) if content.get("condition") is not None else None
                return Action("warning", *where, value=held, message=self._text(content["message"]))
            case "terminate":
                return Action("terminate", *where, message=self._text(content["message"]))
        raise refused(self._name, f"the action {kind}")

    def _clock(self, kind: Json) -> tuple[float, float]:
        lattice = kind.get("periodic", {}).get("lattice") if isinstance(kind, dict) else None
        if not lattice:
            raise refused(self._name, "a clock that is not periodic")
        return self._ratio(lattice["phase"]), self._ratio(lattice["period"])

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
        return function_near(self._functions, name, scope)

    def constant(self, name: str, section: Section) -> float | None:
        """The value of a constant of the library, or of a member of an enumeration, which a name means."""
        if (value := named_constant(name)) is not None:
            return value
        owner, _, member = name.rpartition(".")
        if not owner:
            return CONSTANTS.get(name) if name == "pi" else None
        known: list[list[str]] = getattr(self._functions, "members", lambda *_: [])(owner, section.file)
        ordinals = {names.index(member) + 1 for names in known if member in names}
        return float(ordinals.pop()) if len(ordinals) == 1 else None


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
