"""A Python component as functions: its own code, run with traced numbers, read off as CasADi functions.

The component is the file that its Python FMU is built from (see python_fmu.py). What it registers decides
what a variable is: inputs and parameters by their causality; a variable whose setter stores what its getter
returns is a state; one whose getter computes is computed. All memory has to lie in the states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca

from orchestrator.base.errors import BuildError

from .explore import Explorer, Leaf
from .traced import Tape, Traced, TraceError
from .traced_library import tracing_numpy
from .traced_module import instrument, loaded_copy, source_line

OK, WARNING, DISCARD, ERROR = "RT_OK", "RT_WARNING", "RT_DISCARD", "RT_ERROR"


@dataclass(frozen=True)
class StepVariable:
    """A registered variable; its position among them is the value reference.

    Attributes:
        name: as registered.
        kind: INPUT, PARAMETER, STATE or ALGEBRAIC (computed).
        type: float, int or bool.
        index: position among those of its kind.
        start: start value; None where it is computed.
    """

    name: str
    kind: str
    type: str
    index: int
    start: float | None


@dataclass(frozen=True)
class Outcome:
    """One way for a call to end; number 0 is "all well".

    Attributes:
        status: constant of RtStatus.
        text: message, with marks of the tape where something is known at run time only.
    """

    status: str
    text: str


@dataclass(frozen=True)
class ComponentProgram:
    """Functions of (t, h, x, u, p): time [s], step size [s], states, inputs, parameters.

    Attributes:
        name: of the component's class.
        variables: in the order of value references.
        tape: what the marks in messages stand for.
        outcomes: by number.
        setup, initialise, advance: new states and the number of the outcome, of setup_experiment,
            exit_initialization_mode and do_step; h is 0 in the first two, t the start time.
        algebraics: the computed variables.
        tangent: (t, h, x, u, p, variations of x, of u) -> variation of the computed variables.
        arguments: the numbers that messages speak of.
        spoken: where in `arguments` a traced number stands, by its number.
        set_up: names of the states that setup_experiment sets.
        paths: how many paths do_step has.
    """

    name: str
    variables: tuple[StepVariable, ...]
    tape: Tape
    outcomes: tuple[Outcome, ...]
    setup: ca.Function
    initialise: ca.Function
    advance: ca.Function
    algebraics: ca.Function
    tangent: ca.Function
    arguments: ca.Function
    spoken: dict[int, int]
    set_up: tuple[str, ...]
    paths: int

    def of_kind(self, kind: str) -> list[StepVariable]:
        """Variables of a kind, in the order of their indices."""
        return [variable for variable in self.variables if variable.kind == kind]


def trace_component(script: Path, class_name: str) -> ComponentProgram:
    """Trace a component.

    Args:
        script: the Python file.
        class_name: of its subclass of pythonfmu's Fmi2Slave.
    Raises: BuildError, with the line, for code that has no native form.
    """
    with loaded_copy(script) as module, tracing_numpy():
        try:
            return _Component(module, class_name, script).program()
        except (TraceError, TypeError, AttributeError, ArithmeticError, LookupError) as error:
            raise BuildError(f"{script.name}{source_line(error, script)}: native form: {error}") from error


class _Component:
    """One component while it is traced."""

    def __init__(self, module: ModuleType, class_name: str, script: Path) -> None:
        self.name, self.script = class_name, script
        self.tape = Tape()
        cls = getattr(module, class_name)
        self.slave = cls(instance_name=self.tape.mark("name"))
        self.explorer = Explorer(self.tape, module.__name__, [self.slave])
        self.registered = list(self.slave.vars.values())
        self.slave.log = self._log
        instrument(module, self.explorer)
        self.variables, self.symbols = self._classify()
        self.time, self.step_size = (self.tape.symbol(name, "float") for name in ("time", "step_size"))
        self.outcomes = [Outcome(OK, "")]

    def _log(self, message: str, status: Any = None, *more: Any, **options: Any) -> None:
        self.explorer.log(getattr(status, "name", "ok"), message)

    def _classify(self) -> tuple[tuple[StepVariable, ...], list[Traced | None]]:
        """Kind of every variable, and the symbol of each that is not computed."""
        counts = dict.fromkeys(("INPUT", "PARAMETER", "STATE", "ALGEBRAIC"), 0)
        variables: list[StepVariable] = []
        symbols: list[Traced | None] = []
        for variable in self.registered:
            type_name = {"Real": "float", "Integer": "int", "Boolean": "bool"}.get(type(variable).__name__)
            causality = getattr(variable.causality, "name", None) or "local"
            if type_name is None or causality == "independent":
                raise BuildError(
                    f"{self.script.name}: native form: {variable.name} is "
                    f"{'a ' + type(variable).__name__ if type_name is None else 'the independent variable'}; "
                    "allowed: Real, Integer and Boolean inputs, parameters, outputs and local variables"
                )
            symbol = self.tape.symbol(variable.name, type_name)
            kind = {"input": "INPUT", "parameter": "PARAMETER"}.get(causality)
            if kind is None:
                kind = "STATE" if self._stores(variable, symbol) else "ALGEBRAIC"
            computed = kind == "ALGEBRAIC"
            start = None if computed else float(variable.getter())
            variables.append(StepVariable(variable.name, kind, type_name, counts[kind], start))
            symbols.append(None if computed else symbol)
            counts[kind] += 1
        return tuple(variables), symbols

    @staticmethod
    def _stores(variable: Any, symbol: Traced) -> bool:
        """Whether the getter gives what the setter was given."""
        if variable.setter is None:
            return False
        before = variable.getter()
        variable.setter(symbol)
        stored = variable.getter() is symbol
        variable.setter(before)
        return stored

    def program(self) -> ComponentProgram:
        for variable, symbol in zip(self.registered, self.symbols, strict=True):
            if symbol is not None:
                variable.setter(symbol)
        setup, _ = self._transition(lambda: self.slave.setup_experiment(self.time, None, None))
        initialise, _ = self._transition(self._initialise)
        advance, paths = self._transition(lambda: self.slave.do_step(self.time, self.step_size), step=True)
        computed = self._computed()
        arguments, spoken = self._spoken()
        x, u, p = (self._column(kind) for kind in ("STATE", "INPUT", "PARAMETER"))
        given = [self.time.sx, self.step_size.sx, x, u, p]
        seeds = [ca.SX.sym("vary_x", x.shape[0]), ca.SX.sym("vary_u", u.shape[0])]
        w = _vector(computed)
        # Of the derivatives no order of rounding is asked for.
        ca.GlobalOptions.setSimplificationOnTheFly(True)
        varied = ca.jtimes(w, ca.vertcat(x, u), ca.vertcat(*seeds))
        states = self._of("STATE")
        return ComponentProgram(
            name=self.name,
            variables=self.variables,
            tape=self.tape,
            outcomes=tuple(self.outcomes),
            setup=_function("setup", given, [_vector(setup[0]), _vector([setup[1]])]),
            initialise=_function("initialise", given, [_vector(initialise[0]), _vector([initialise[1]])]),
            advance=_function("advance", given, [_vector(advance[0]), _vector([advance[1]])]),
            algebraics=_function("algebraics", given, [w]),
            tangent=_function("tangent", [*given, *seeds], [varied]),
            arguments=_function("spoken_of", given, [_vector(arguments)]),
            spoken=spoken,
            set_up=tuple(
                variable.name
                for (variable, symbol), value in zip(states, setup[0], strict=True)
                if value is not symbol
            ),
            paths=paths,
        )

    def _initialise(self) -> None:
        self.slave.enter_initialization_mode()
        self.slave.exit_initialization_mode()

    def _of(self, kind: str) -> list[tuple[StepVariable, Traced | None]]:
        pairs = zip(self.variables, self.symbols, strict=True)
        return [(variable, symbol) for variable, symbol in pairs if variable.kind == kind]

    def _column(self, kind: str) -> ca.SX:
        return _vector([symbol for _, symbol in self._of(kind)])

    def _transition(self, call: Callable[[], Any], step: bool = False) -> tuple[tuple[list[Any], Any], int]:
        """New states and the number of the outcome of a call, and the number of its paths."""
        getters = [
            item.getter
            for item, variable in zip(self.registered, self.variables, strict=True)
            if variable.kind == "STATE"
        ]

        def run() -> tuple[bool, tuple[Any, ...]]:
            done = call()
            accepted = bool(done) if step else True
            return accepted, tuple(getter() for getter in getters)

        leaves = self.explorer.explore(run)
        groups = self.explorer.groups(leaves, _ending)
        numbers = {}
        for group in groups:
            outcome = _outcome(group[0])
            if outcome not in self.outcomes:
                self.outcomes.append(outcome)
            numbers.update({id(leaf): self.outcomes.index(outcome) for leaf in group})
        number = self.explorer.merge(leaves, leaves, lambda leaf: numbers[id(leaf)])
        kept = [leaf for leaf in leaves if leaf.error is None and leaf.value[0]]
        if not kept:
            raise TraceError(f"every path ends with: {self.outcomes[-1].text}")
        states = [
            self.explorer.merge(leaves, kept, lambda leaf, index=index: leaf.value[1][index])
            for index in range(len(getters))
        ]
        return (states, number), len(leaves)

    def _computed(self) -> list[Any]:
        found = []
        for item, variable in zip(self.registered, self.variables, strict=True):
            if variable.kind == "ALGEBRAIC":
                leaves = self.explorer.explore(item.getter)
                if any(leaf.error is not None or leaf.logs for leaf in leaves):
                    raise TraceError(f"{variable.name}: what it is computed by may not raise or log")
                found.append(self.explorer.merge(leaves, leaves, lambda leaf: leaf.value))
        return found

    def _spoken(self) -> tuple[list[Any], dict[int, int]]:
        """What messages need to know, and where it stands."""
        values: list[Any] = []
        places: dict[int, int] = {}

        def collect(text: str) -> None:
            for part in self.tape.parts(text):
                if isinstance(part, str) or part[0] == "name":
                    continue
                if part[1].number not in places:
                    places[part[1].number] = len(values)
                    values.append(part[1])
                if part[0] == "choice":
                    collect(part[2])
                    collect(part[3])

        for outcome in self.outcomes:
            collect(outcome.text)
        return values, places


def _ending(leaf: Leaf) -> tuple:
    accepted = leaf.error is None and leaf.value[0]
    return accepted, None if leaf.error is None else str(leaf.error), leaf.logs


def _outcome(leaf: Leaf) -> Outcome:
    text = "; ".join(message for _, message in leaf.logs)
    if leaf.error is not None:
        return Outcome(ERROR, str(leaf.error))
    if not leaf.value[0]:
        return Outcome(DISCARD, text or "the model refuses the step without a reason")
    return Outcome(WARNING, text) if text else Outcome(OK, "")


def _vector(values: Sequence[Any]) -> ca.SX:
    return ca.vertcat(*map(Tape.expression, values)) if values else ca.SX.zeros(0, 1)


def _function(name: str, arguments: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    # Every result is dense: the generated C would leave structural zeros unwritten.
    return ca.Function(name, arguments, [ca.densify(result) for result in results])
