"""A flattened model: scalar variables, equations and assertions, in plain data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from .built_in import BUILT_IN
from .sources import Location

TIME = "time"


@dataclass(frozen=True, slots=True)
class Literal:
    """A number or truth value."""

    value: float | bool


@dataclass(frozen=True, slots=True)
class Reference:
    """The value of a variable, or of time."""

    name: str


@dataclass(frozen=True, slots=True)
class Derivative:
    """The time derivative of a variable."""

    name: str


@dataclass(frozen=True, slots=True)
class Operation:
    """An operator or function by its name in `OPERATIONS`, with its arguments."""

    name: str
    arguments: tuple[Node, ...]


@dataclass(frozen=True, slots=True)
class If:
    """`if condition then value else otherwise`."""

    condition: Node
    value: Node
    otherwise: Node


@dataclass(frozen=True, slots=True)
class NoEvent:
    """An expression whose relations raise no events."""

    argument: Node


@dataclass(frozen=True, slots=True)
class Delay:
    """The operand as it was `time` seconds ago; `limit` is the largest delay allowed, or None."""

    operand: Node
    time: Node
    limit: Node | None
    location: Location = field(compare=False)


Node = Literal | Reference | Derivative | Operation | If | NoEvent | Delay

RELATIONS = frozenset({"<", "<=", ">", ">="})
EQUALITIES = frozenset({"==", "<>"})
LOGIC = frozenset({"and", "or", "not"})
ARITHMETIC = frozenset({"+", "-", "*", "/", "^", "negate"})
# These jump or have a kink where Modelica raises an event (MLS 3.7.2).
KINKED = frozenset({"abs", "sign"})
STEPPED = frozenset(name for name, one in BUILT_IN.items() if one.jumps) - KINKED
_OF_NUMBERS = frozenset(name for name, one in BUILT_IN.items() if one.value)
OPERATIONS = RELATIONS | EQUALITIES | LOGIC | ARITHMETIC | _OF_NUMBERS


class Type(StrEnum):
    """Modelica type of a scalar variable."""

    REAL = "Real"
    INTEGER = "Integer"
    BOOLEAN = "Boolean"


class Role(StrEnum):
    """What a variable is to the model."""

    CONSTANT = "constant"
    PARAMETER = "parameter"
    INPUT = "input"
    OUTPUT = "output"
    LOCAL = "local"


@dataclass(frozen=True)
class Variable:
    """A scalar variable.

    Attributes:
        name: with dots and, for an array's element, indices.
        role: input and output only at the top level.
        type: Real, Integer or Boolean.
        location: line of the declaration.
        binding: of a constant or parameter, its value; None for other variables, whose declaration
            equations are among the model's equations.
        start: None if not declared.
        fixed: whether `start` is the initial value rather than a guess.
        minimum, maximum, nominal: None if not declared; numbers in the variable's unit.
        unit, display_unit, quantity, description: "" if not declared.
        final: cannot be changed from outside.
        protected: declared in a protected section.
    """

    name: str
    role: Role
    type: Type
    location: Location
    binding: Node | None = None
    start: Node | None = None
    fixed: bool = False
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    unit: str = ""
    display_unit: str = ""
    quantity: str = ""
    description: str = ""
    final: bool = False
    protected: bool = False


@dataclass(frozen=True)
class Equation:
    """left = right, as written at `location`."""

    left: Node
    right: Node
    location: Location


@dataclass(frozen=True)
class Assertion:
    """`condition` has to hold; `error`: whether it is an error, not a warning."""

    condition: Node
    message: str
    error: bool
    location: Location


@dataclass(frozen=True)
class FlatModel:
    """A model without structure.

    Attributes:
        name: qualified name of the class.
        description: its description string.
        variables: in the order of declaration.
        equations: as many as there are unknowns, if the model is sound.
        assertions: every assert, and one for each limit of a delay.
        experiment: numbers of the experiment annotation by name.
        structural: parameters that decide which equations there are; they are final.
    """

    name: str
    description: str
    variables: tuple[Variable, ...]
    equations: tuple[Equation, ...]
    assertions: tuple[Assertion, ...] = ()
    experiment: dict[str, float] = field(default_factory=dict)
    structural: tuple[str, ...] = ()


def children(node: Node) -> tuple[Node, ...]:
    """The operands of an expression, in order."""
    match node:
        case Operation(_, arguments):
            return arguments
        case If(condition, value, otherwise):
            return (condition, value, otherwise)
        case NoEvent(argument):
            return (argument,)
        case Delay(operand, time, limit):
            return (operand, time) if limit is None else (operand, time, limit)
        case _:
            return ()


def walk(node: Node) -> Iterator[Node]:
    """Every part of an expression, itself first."""
    yield node
    for child in children(node):
        yield from walk(child)


_INFIX = {
    "and": 1,
    "or": 0,
    "<": 3,
    "<=": 3,
    ">": 3,
    ">=": 3,
    "==": 3,
    "<>": 3,
    "+": 4,
    "-": 4,
    "*": 5,
    "/": 5,
    "^": 7,
}


def render(node: Node, level: int = -1) -> str:
    """Write an expression as Modelica text, for documentation and messages."""
    match node:
        case Literal(value):
            if isinstance(value, bool):
                return str(value).lower()
            return f"{value:.15g}"
        case Reference(name):
            return name
        case Derivative(name):
            return f"der({name})"
        case Operation("negate", (argument,)):
            text, own = f"-{render(argument, 5)}", 4
        case Operation("not", (argument,)):
            text, own = f"not {render(argument, 2)}", 2
        case Operation(name, (left, right)) if name in _INFIX:
            own = _INFIX[name]
            right_level = own + (name in ("-", "/", "^") or name in RELATIONS | EQUALITIES)
            text = f"{render(left, own + (name == '^'))} {name} {render(right, right_level)}"
            if name in "*/^":
                text = text.replace(f" {name} ", name, 1) if name == "^" else text
        case If(condition, value, otherwise):
            text, own = f"if {render(condition)} then {render(value)} else {render(otherwise)}", -1
            return f"({text})" if level >= 0 else text
        case NoEvent(argument):
            return f"noEvent({render(argument)})"
        case Delay():
            return f"delay({', '.join(render(child) for child in children(node))})"
        case Operation(name, arguments):
            return f"{name}({', '.join(map(render, arguments))})"
    return f"({text})" if own < level else text
