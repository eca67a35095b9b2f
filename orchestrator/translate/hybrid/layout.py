"""Where the variables of a hybrid model stand in the arrays of runtime/hybrid/hybrid.h, and in the FMU."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..rewriting.class_bodies import MARK
from . import expression as ex
from .expression import Expr
from .model import Action, Scalar
from .structure import System

_HISTORY_ROOM = 6 + 8 * 4096  # as in hybrid.h


@dataclass(frozen=True)
class Port:
    """A variable of the FMU.

    Attributes:
        name: of it.
        kind: constant of ModelKind without KIND_.
        index: position in z, u, p or w.
        scalar: its declaration; None for time.
        value: of a computed one.
        order: of the derivative that it is.
        start: where the importer may set it; None where it is computed.
        indicator: whether it is an event indicator.
    """

    name: str
    kind: str
    index: int
    scalar: Scalar | None
    value: Expr | None = None
    order: int = 0
    start: float | None = None
    indicator: bool = False


@dataclass
class Layout:
    """Where everything stands in z, p and u, and the FMU's variables."""

    system: System
    slots: dict[Expr, int]
    inputs: dict[Expr, int]
    parameters: dict[Expr, int]
    ports: list[Port]
    n_z: int
    mode_slot: int
    condition_slot: int
    clock_slot: int
    warned_slot: int
    done_slot: int
    size_slot: int
    use_slot: int
    history_slot: int
    settable: list[tuple[int, int, int]]

    @property
    def computed(self) -> list[Port]:
        """Ports whose values the function of outputs computes, in their order."""
        return [one for one in self.ports if one.kind == "ALGEBRAIC"]


def layout_of(system: System, indicators: bool = False) -> Layout:
    """Give every variable its place.

    Args:
        indicators: whether event indicators are variables, as FMI 3.0 has them.
    """
    model = system.model
    variables = [one for one in model.variables if one.type != "string"]
    inputs = {one.value: n for n, one in enumerate(v for v in variables if v.role == "input")}
    parameters = {one.value: n for n, one in enumerate(v for v in variables if v.role == "parameter")}
    slots: dict[Expr, int] = {}
    for one in variables:
        if one.value not in inputs and one.value not in parameters and one.value not in system.aliases:
            slots[one.value] = len(slots)
    for one in system.unknowns:
        slots.setdefault(one, len(slots))
    started = [one for one in variables if one.role in ("state", "algebraic", "discrete", "free")]
    for one in started:
        if one.value in slots or one.fixed:
            slots[ex.symbol("start", one.value.args[1])] = len(slots)
    used = ex.symbols(*_expressions(system))
    for one in sorted(started, key=lambda one: one.role != "discrete"):
        before = ex.symbol("pre", one.value.args[1])
        if one.value in slots and (one.role == "discrete" or before in used):
            slots[before] = len(slots)
    n_z = len(slots)
    settable = []
    for one in started:
        if one.value in slots and one.role == "state" and one.start.op == "num":
            settable.append((slots[one.value], slots[ex.symbol("start", one.value.args[1])], n_z))
            n_z += 1
    modes = n_z
    conditions = modes + len(model.modes)
    clocks = conditions + len(model.conditions)
    warned = clocks + len(model.clocks)
    done = warned + len(reported_actions(system))
    ports = [Port("time", "TIME", 0, None)]
    may_set = {place for place, _, _ in settable}
    count = 0
    shown = [
        one for one in variables if one.role == "state" or not one.name.rpartition(".")[2].startswith(MARK)
    ]
    for one in shown:
        if one.role == "input":
            ports.append(Port(one.name, "INPUT", inputs[one.value], one, start=_number(one.start)))
        elif one.role == "parameter":
            ports.append(Port(one.name, "PARAMETER", parameters[one.value], one, start=_number(one.start)))
        elif one.role == "state":
            start = _number(one.start) if slots[one.value] in may_set else None
            ports.append(Port(one.name, "STATE", slots[one.value], one, start=start))
        else:
            ports.append(Port(one.name, "ALGEBRAIC", count, one, system.aliases.get(one.value, one.value)))
            count += 1
    for one in shown:
        if one.role == "state":
            slope = ex.symbol("der", one.value.args[1], 1)
            ports.append(Port(f"der({one.name})", "ALGEBRAIC", count, one, slope, order=1))
            count += 1
    for number, margin in enumerate(margins_of(model.modes) if indicators else (), 1):
        indicator = Scalar(f"'event indicator {number}'", "algebraic", "real", ex.ZERO, False)
        ports.append(Port(indicator.name, "ALGEBRAIC", count, indicator, margin, indicator=True))
        count += 1
    return Layout(
        system, slots, inputs, parameters, ports, done + 5 + _HISTORY_ROOM * len(model.delays), modes,
        conditions, clocks, warned, done, done + 1, done + 2, done + 5, settable,
    )  # fmt: skip


def _number(one: Expr) -> float:
    return float(one.args[0]) if one.op == "num" else 0.0


def _expressions(system: System) -> Iterator[Expr]:
    """All expressions in which a value before an event may stand."""
    model = system.model
    yield from (one for block in (*system.blocks, *system.initial_blocks) for one in block.residuals)
    yield from (branch.value for one in model.discretes for branch in one.branches)
    yield from (one.value for one in model.actions if one.value is not None)
    yield from (o for one in model.conditions for o in one.operands if isinstance(o, Expr))
    yield from model.modes
    yield from (part for one in model.delays for part in (one.operand, one.lag))


def reported_actions(system: System) -> list[Action]:
    """The actions that are reported to the importer: all but those that set states."""
    return [one for one in system.model.actions if one.kind != "reinit"]


def margins_of(modes: Sequence[Expr]) -> list[Expr]:
    """Expressions whose zeros are where a mode changes; of a rounding function both ends of its step."""
    found: list[Expr] = []
    for number, one in enumerate(modes):
        held = ex.symbol("mode", number)
        before, after = ex.sub(held, ex.ONE), ex.add(held, ex.ONE)
        match one.op:
            case "lt" | "le" | "gt" | "ge" | "eq" | "ne":
                found.append(ex.sub(*one.args))
            case "fn:sign":
                found.append(one.args[0])
            case "fn:floor":
                found += [ex.sub(one.args[0], held), ex.sub(after, one.args[0])]
            case "fn:ceil":
                found += [ex.sub(one.args[0], before), ex.sub(held, one.args[0])]
            case "fn:trunc":
                low = ex.conditional(ex.logical("gt", held, ex.ZERO), held, before)
                high = ex.conditional(ex.logical("lt", held, ex.ZERO), held, after)
                found += [ex.sub(one.args[0], low), ex.sub(high, one.args[0])]
    return found
