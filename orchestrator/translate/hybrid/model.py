"""A model in scalars, between the compiler's form and the order of its solution."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from orchestrator.base.errors import BuildError

from ..faults import PlacedError
from ..sources import Location
from . import expression as ex
from .expression import Expr

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
        """The name of the variable, derivative, delayed value or clock that a symbol stands for."""
        if one.args[0] == "delayed":
            return self.delays[one.args[1]].shown
        if one.args[0] == "rise":
            return f"rise of condition {one.args[1] + 1}"
        if one.args[0] == "tick":
            return "sample({:g}, {:g})".format(*self.clocks[one.args[1]])
        name = self.variables[one.args[1]].name
        return "der(" * one.args[2] + name + ")" * one.args[2] if one.args[0] == "der" else name
