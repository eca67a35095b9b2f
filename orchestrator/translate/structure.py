"""Which unknown depends on which known, for ModelStructure of the model description."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca

from .flat import Literal, Node, Reference
from .generate import TableEntry
from .program import Program


@dataclass(frozen=True)
class Unknown:
    """An unknown with what it depends on.

    Attributes:
        reference: its value reference.
        dependencies: value references of its knowns, ascending.
        kinds: FMI dependenciesKind of each; empty if all are dependent.
    """

    reference: int
    dependencies: tuple[int, ...]
    kinds: tuple[str, ...] = ()


@dataclass(frozen=True)
class Structure:
    """ModelStructure: outputs and derivatives at a communication point, and what initialisation computes."""

    outputs: tuple[Unknown, ...]
    derivatives: tuple[Unknown, ...]
    initial_unknowns: tuple[Unknown, ...]


def model_structure(program: Program, table: Iterable[TableEntry]) -> Structure:
    """Find the dependencies of a model's outputs and derivatives.

    At a communication point the knowns are inputs, states and time. A value that is decided by a relation
    depends on the relation's operands. A delay makes no direct dependency if its time cannot be zero.
    At initialisation the knowns are inputs, independent parameters, states with a start value of their
    own and time, and every delay operator has the value of its operand.
    """
    return _Structure(program, tuple(table)).structure()


class _Structure:
    def __init__(self, program: Program, table: tuple[TableEntry, ...]) -> None:
        self._program = program
        self._table = table
        self._numbers = {entry.name: number for number, entry in enumerate(table)}
        model = program.model
        symbols = model.symbols
        # CasADi keeps names for display only: its hash identifies a symbol.
        self._names = {
            symbol.element_hash(): name
            for group in (symbols.states, symbols.inputs, symbols.parameters)
            for name, symbol in group.items()
        }
        self._names[symbols.time.element_hash()] = "time"
        self._symbols = {name: group[name] for group in (symbols.states, symbols.inputs) for name in group}
        self._symbols["time"] = symbols.time
        self._delays = {delay.symbol.element_hash(): delay for delay in model.delays}
        self._relations = {relation.symbol.element_hash(): relation for relation in model.relations}

    def structure(self) -> Structure:
        model = self._program.model
        expressions: dict[str, ca.SX] = {**model.algebraics, **self._program.model.symbols.states}
        outputs, derivatives, initial = [], [], []
        for number, entry in enumerate(self._table):
            variable = entry.variable
            if entry.kind == "DERIVATIVE":
                expression = model.derivatives[self._program.states[entry.index]]
                derivatives.append(self._at_point(number, expression))
                initial.append(self._at_start(number, expression))
            elif entry.kind == "PARAMETER" and not entry.settable and not entry.constant:
                initial.append(self._at_start(number, model.symbols.parameters[entry.name]))
            elif entry.kind == "STATE" and entry.start is None:
                initial.append(self._at_start(number, expressions[entry.name]))
            if variable is not None and variable.role == "output" and entry.kind in ("STATE", "ALGEBRAIC"):
                outputs.append(self._at_point(number, expressions[entry.name]))
                if entry.kind == "ALGEBRAIC":
                    initial.append(self._at_start(number, expressions[entry.name]))
        return Structure(
            tuple(outputs), tuple(derivatives), tuple(sorted(initial, key=lambda item: item.reference))
        )

    def _at_point(self, number: int, expression: ca.SX) -> Unknown:
        direct = {self._names[h] for h in self._hashes(expression) if h in self._names}
        all_names = self._reach(expression, initial=False)
        found = {}
        for name in sorted(all_names, key=self._numbers.__getitem__):
            if name not in self._symbols:
                continue  # parameters are no knowns at a communication point
            only_direct = name in direct and name not in self._reach_indirectly(expression)
            found[self._numbers[name]] = self._kind(expression, name) if only_direct else "dependent"
        return Unknown(number, tuple(found), tuple(found.values()))

    def _kind(self, expression: ca.SX, name: str) -> str:
        slope = ca.densify(ca.jacobian(expression, self._symbols[name]))
        free = {self._names.get(h, "") for h in self._hashes(slope)}
        if slope.is_zero():
            return "dependent"  # reached through a condition, not through a value
        if not free:
            return "constant"
        return "fixed" if free <= set(self._program.parameters) else "dependent"

    def _at_start(self, number: int, expression: ca.SX) -> Unknown:
        names = self._reach(expression, initial=True)
        return Unknown(number, tuple(sorted(self._numbers[name] for name in names)))

    def _reach_indirectly(self, expression: ca.SX) -> set[str]:
        found: set[str] = set()
        for element in self._hashes(expression):
            if element in self._delays or element in self._relations:
                found |= self._reach_of(element, False, set())
        return found

    def _reach(self, expression: ca.SX, initial: bool) -> set[str]:
        found: set[str] = set()
        for element in self._hashes(expression):
            found |= self._reach_of(element, initial, set())
        return found

    def _reach_of(self, element: int, initial: bool, seen: set[int]) -> set[str]:
        """Names of the knowns behind a symbol."""
        if element in seen:
            return set()
        seen.add(element)
        symbols = self._program.model.symbols
        if element in self._delays:
            delay = self._delays[element]
            ways = [delay.time]
            if initial or not _positive(delay.node.time, self._program):
                ways.append(delay.operand)
        elif element in self._relations:
            ways = [self._relations[element].expression]
        else:
            name = self._names[element]
            if name in symbols.dependent:
                ways = [symbols.dependent[name]]
            elif initial and name in self._program.started:
                ways = [symbols.starts[name]]
            elif initial and name in symbols.parameters and not self._table[self._numbers[name]].settable:
                return set()  # has a value that nobody can change
            else:
                return {name}
        found: set[str] = set()
        for way in ways:
            for inner in self._hashes(way):
                found |= self._reach_of(inner, initial, seen)
        return found

    @staticmethod
    def _hashes(expression: ca.SX) -> list[int]:
        return [symbol.element_hash() for symbol in ca.symvar(expression)]


def _positive(time: Node, program: Program) -> bool:
    """Whether a delay time is never zero."""
    if isinstance(time, Literal):
        return time.value > 0
    if isinstance(time, Reference):
        constants: Mapping[str, float] = program.model.symbols.constants
        if time.name in constants:
            return constants[time.name] > 0
        for variable in program.model.symbols.flat.variables:
            if variable.name == time.name and time.name in program.parameters:
                return variable.minimum is not None and variable.minimum > 0
    return False
