"""Turn a flat model into CasADi expressions: a symbol per name, a mode per relation, a delay per operator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

import casadi as ca

from orchestrator.base.errors import BuildError

from .flat import (
    EQUALITIES,
    KINKED,
    RELATIONS,
    STEPPED,
    TIME,
    Delay,
    Derivative,
    FlatModel,
    If,
    Literal,
    Node,
    NoEvent,
    Operation,
    Reference,
    Role,
    Type,
    Variable,
    render,
    walk,
)
from .interpreter import evaluate
from .sources import Location


@dataclass
class Relation:
    """`expression` > 0 (strict) or >= 0 decides the mode `symbol`."""

    symbol: ca.SX
    expression: ca.SX
    strict: bool
    location: Location


@dataclass
class DelayOperator:
    """`symbol` is what `operand` was `time` seconds ago; `maximum` bounds `time` by parameters, if known."""

    node: Delay
    symbol: ca.SX
    operand: ca.SX
    time: ca.SX
    maximum: ca.SX | None


@dataclass
class SymbolicModel:
    """A flat model with its symbols.

    Attributes:
        flat: the flat model.
        time: symbol of time.
        constants: value of every constant.
        states, inputs, parameters, algebraics: name -> symbol, in order of declaration.
        derivatives: name of a state -> symbol of its derivative.
        residuals: left - right of every equation, in order.
        relations, delays: see Relation, DelayOperator.
        assertions: condition (0 or 1) of every assertion, in order.
        dependent: name of a dependent parameter -> its value from the independent ones.
        starts: name of a state -> its start value from the parameters.
    """

    flat: FlatModel
    time: ca.SX = field(default_factory=lambda: ca.SX.sym("time"))
    constants: dict[str, float] = field(default_factory=dict)
    states: dict[str, ca.SX] = field(default_factory=dict)
    inputs: dict[str, ca.SX] = field(default_factory=dict)
    parameters: dict[str, ca.SX] = field(default_factory=dict)
    algebraics: dict[str, ca.SX] = field(default_factory=dict)
    derivatives: dict[str, ca.SX] = field(default_factory=dict)
    residuals: list[ca.SX] = field(default_factory=list)
    relations: list[Relation] = field(default_factory=list)
    delays: list[DelayOperator] = field(default_factory=list)
    assertions: list[ca.SX] = field(default_factory=list)
    dependent: dict[str, ca.SX] = field(default_factory=dict)
    starts: dict[str, ca.SX] = field(default_factory=dict)

    def unknowns(self) -> dict[str, ca.SX]:
        """Algebraic variables and derivatives: what the equations are solved for, by printed name."""
        return {**self.algebraics, **{f"der({name})": symbol for name, symbol in self.derivatives.items()}}


def symbolic_model(flat: FlatModel) -> SymbolicModel:
    """Build the CasADi expressions of a flat model.

    Raises: BuildError for what has no meaning in them, naming the line.
    """
    return _Builder(flat).model


class _Builder:
    def __init__(self, flat: FlatModel) -> None:
        self.model = SymbolicModel(flat)
        self._variables = {variable.name: variable for variable in flat.variables}
        if len(self._variables) != len(flat.variables):
            raise BuildError(f"{flat.name}: two variables have one name")
        self._modes: dict[tuple[Node, bool], ca.SX] = {}
        self._delays: dict[tuple[Delay, bool], ca.SX] = {}
        self._declare(flat)
        self._parameters()
        for equation in flat.equations:
            left = self._convert(equation.left, True, equation.location)
            right = self._convert(equation.right, True, equation.location)
            self.model.residuals.append(left - right)
        for assertion in flat.assertions:
            # Looked at where the importer looks, after each step: no event is needed for it.
            self.model.assertions.append(self._convert(assertion.condition, False, assertion.location))
        for name in self.model.states:
            variable = self._variables[name]
            start = variable.start if variable.start is not None else Literal(0.0)
            self._only_parameters(start, f"the start value of {name}", variable.location)
            self.model.starts[name] = self._convert(start, False, variable.location)

    def _declare(self, flat: FlatModel) -> None:
        model = self.model
        differentiated: dict[str, Location] = {}
        for equation in flat.equations:
            for side in (equation.left, equation.right):
                for node in walk(side):
                    if isinstance(node, Derivative):
                        differentiated.setdefault(node.name, equation.location)
        for variable in flat.variables:
            name = variable.name
            if name in differentiated:
                if variable.role not in (Role.OUTPUT, Role.LOCAL) or variable.type is not Type.REAL:
                    raise BuildError(
                        f"{differentiated[name]}: der({name}) is the derivative of a {variable.type} "
                        f"{variable.role}; "
                        "only a Real variable of the model's own can be a state"
                    )
                model.states[name] = ca.SX.sym(name)
                model.derivatives[name] = ca.SX.sym(f"der({name})")
            elif variable.role is Role.CONSTANT:
                model.constants[name] = math.nan
            else:
                group = {Role.PARAMETER: model.parameters, Role.INPUT: model.inputs}.get(
                    variable.role, model.algebraics
                )
                group[name] = ca.SX.sym(name)
                if variable.fixed and group is model.algebraics:
                    raise BuildError(
                        f"{variable.location}: {name} has fixed=true but is no state; drop it, or write the "
                        "equation so that der() of it appears"
                    )

    def _parameters(self) -> None:
        """Evaluate constants; order dependent parameters so that each needs only earlier ones."""
        kinds = (Role.CONSTANT, Role.PARAMETER)
        bound = {name: variable for name, variable in self._variables.items() if variable.role in kinds}
        needs = {
            name: sorted(
                {node.name for node in walk(variable.binding or Literal(0.0)) if isinstance(node, Reference)}
            )
            for name, variable in bound.items()
        }
        for name, variable in bound.items():
            what = f"the {variable.role} {name}"
            self._only_parameters(variable.binding or Literal(0.0), what, variable.location)
        try:
            order = list(TopologicalSorter(needs).static_order())
        except CycleError as error:
            cycle = error.args[1]
            raise BuildError(
                f"{bound[cycle[0]].location}: parameters depend on each other: {' <- '.join(cycle)}; give "
                "one a number"
            ) from None
        for name in order:
            variable = bound[name]
            binding = variable.binding or Literal(0.0)
            if all(self._variables[other].role is Role.CONSTANT for other in needs[name]):
                value = self._number(variable, binding)
                if variable.role is Role.CONSTANT:
                    self.model.constants[name] = value
            elif variable.role is Role.CONSTANT:
                raise BuildError(
                    f"{variable.location}: the constant {name} depends on a parameter; make it a parameter"
                )
            else:
                self.model.dependent[name] = self._convert(binding, False, variable.location)

    def _number(self, variable: Variable, binding: Node) -> float:
        try:
            return float(evaluate(binding, self.model.constants))
        except (ArithmeticError, ValueError) as error:
            raise BuildError(
                f"{variable.location}: {variable.name} = {render(binding)} has no finite value"
            ) from error

    def _only_parameters(self, node: Node, what: str, where: Location) -> None:
        if not self._parametric(node):
            raise BuildError(f"{where}: {what} is {render(node)}; it can depend on parameters only")

    def _symbol(self, name: str) -> ca.SX:
        model = self.model
        if name == TIME:
            return model.time
        if name in model.constants:
            return ca.SX(model.constants[name])
        for group in (model.states, model.inputs, model.parameters, model.algebraics):
            if name in group:
                return group[name]
        raise BuildError(f"{model.flat.name}: no variable {name}")

    def _convert(self, node: Node, events: bool, where: Location) -> ca.SX:
        match node:
            case Literal(value):
                return ca.SX(float(value))
            case Reference(name):
                return self._symbol(name)
            case Derivative(name):
                return self.model.derivatives[name]
            case NoEvent(argument):
                return self._convert(argument, False, where)
            case If(condition, value, otherwise):
                return ca.if_else(
                    self._convert(condition, events, where),
                    self._convert(value, events, where),
                    self._convert(otherwise, events, where),
                )
            case Delay():
                return self._delay(node, events)
            case Operation(name, arguments):
                varies = events and any(map(self._varies, arguments))
                if varies and name in STEPPED:
                    raise BuildError(
                        f"{where}: {name}() of a variable raises events, which is not supported; write "
                        f"noEvent({render(node)})"
                    )
                if varies and name in RELATIONS:
                    return self._relation(name, *arguments, where)
                if varies and name in KINKED:
                    return self._kinked(name, arguments[0], where)
                if name in EQUALITIES and not all(map(self._discrete, arguments)):
                    raise BuildError(
                        f"{where}: {render(node)} compares Reals for equality, which Modelica does not "
                        "allow; use <= or >="
                    )
                return _apply(name, [self._convert(argument, events, where) for argument in arguments])
        raise BuildError(f"{where}: {render(node)} is not supported")

    def _kinked(self, name: str, argument: Node, where: Location) -> ca.SX:
        value = self._convert(argument, True, where)
        if name == "abs":
            return ca.if_else(self._relation(">=", argument, Literal(0.0), where), value, -value)
        above = self._relation(">", argument, Literal(0.0), where)
        return above - self._relation("<", argument, Literal(0.0), where)

    def _relation(self, name: str, left: Node, right: Node, where: Location) -> ca.SX:
        if name in ("<", "<="):
            left, right = right, left
        strict = name in ("<", ">")
        key = (Operation("-", (left, right)), strict)
        if key not in self._modes:
            # Entered before its expression, which may hold relations of its own.
            number = len(self.model.relations)
            symbol = ca.SX.sym(f"mode_{number}")
            self._modes[key] = symbol
            relation = Relation(symbol, ca.SX(0), strict, where)
            self.model.relations.append(relation)
            relation.expression = self._convert(left, True, where) - self._convert(right, True, where)
        return self._modes[key]

    def _delay(self, node: Delay, events: bool) -> ca.SX:
        key = (node, events)
        if key not in self._delays:
            operand = self._convert(node.operand, events, node.location)
            time = self._convert(node.time, events, node.location)
            symbol = ca.SX.sym(f"delay_{len(self.model.delays)}")
            self._delays[key] = symbol
            self.model.delays.append(DelayOperator(node, symbol, operand, time, self._maximum(node)))
        return self._delays[key]

    def _maximum(self, node: Delay) -> ca.SX | None:
        if self._parametric(node.time):
            return self._convert(node.time, False, node.location)
        if node.limit is None:
            return None
        self._only_parameters(node.limit, "the limit of a delay", node.location)
        return self._convert(node.limit, False, node.location)

    def _parametric(self, node: Node) -> bool:
        """Whether an expression depends on parameters and constants alone."""
        return not any(
            isinstance(part, Delay | Derivative)
            or (isinstance(part, Reference) and not self._is_parameter(part.name))
            for part in walk(node)
        )

    def _is_parameter(self, name: str) -> bool:
        return name != TIME and self._variables[name].role in (Role.CONSTANT, Role.PARAMETER)

    def _varies(self, node: Node) -> bool:
        """Whether an expression can change between events."""
        for part in walk(node):
            if isinstance(part, Derivative | Delay):
                return True
            if isinstance(part, Reference) and not self._constant_between_events(part.name):
                return True
        return False

    def _constant_between_events(self, name: str) -> bool:
        if name == TIME:
            return False
        return self._is_parameter(name) or self._variables[name].type is not Type.REAL

    def _discrete(self, node: Node) -> bool:
        """Whether an expression is made of Integers, Booleans and parameters."""
        return not self._varies(node)


def _apply(name: str, values: list[ca.SX]) -> ca.SX:
    functions: Mapping[str, object] = {
        "+": lambda a, b: a + b,
        "-": lambda a, b: a - b,
        "*": lambda a, b: a * b,
        "/": lambda a, b: a / b,
        "^": lambda a, b: a**b,
        "negate": lambda a: -a,
        "<": ca.lt,
        "<=": ca.le,
        ">": ca.gt,
        ">=": ca.ge,
        "==": ca.eq,
        "<>": ca.ne,
        "and": ca.logic_and,
        "or": ca.logic_or,
        "not": ca.logic_not,
        "abs": ca.fabs,
        "sign": ca.sign,
        "floor": ca.floor,
        "integer": ca.floor,
        "ceil": ca.ceil,
        "mod": lambda a, b: a - ca.floor(a / b) * b,
        "div": lambda a, b: _truncate(a / b),
        "rem": lambda a, b: a - _truncate(a / b) * b,
        "min": ca.fmin,
        "max": ca.fmax,
        "log": ca.log,
        "log10": ca.log10,
        "atan2": ca.atan2,
    }
    function = functions.get(name) or getattr(ca, name)
    return function(*values)  # type: ignore[operator]


def _truncate(value: ca.SX) -> ca.SX:
    return ca.if_else(value < 0, ca.ceil(value), ca.floor(value))
