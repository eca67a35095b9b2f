"""A system of FMUs in state form, and how `evaluate` reaches its components.

FMUs stay in initialisation mode. There FMI lets the importer set states, inputs and parameters and read
derivatives and outputs, so that one pair of calls evaluates a component at any point.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...base.errors import ConfigError, Problem, listed
from ...fmi import Causality, CompiledFmu, Kind, Variability
from ...system.connection import Connection, Port
from ...system.system import Instance
from ...translate.opened import Opening
from ..study.study import PortRun, PortStudy
from .effort import Effort
from .evaluation import (
    COLUMNS,
    GET_REFS,
    GET_VALUES,
    GETS,
    NU,
    NX,
    NY,
    SELF,
    SET,
    SET_REFS,
    SET_VALUES,
    SETS,
    VERSION,
    Inserted,
    Kinds,
    Place,
    U,
    X,
    Y,
)
from .exchanges import exchanges
from .inside import inner_places
from .start_values import speeds_by_definition

Array = NDArray[np.float64]


@dataclass
class StateModel:
    """A study's system in state form; a context manager, which frees the FMUs.

    Attributes:
        states, inputs, outputs: ports, in the order of their vectors. parameters: calibrated ones.
        fed, compared: ports whose logs are fed or compared.
        rows: one a component, in the order of direct feedthrough.
        wiring: first leg of each input, source and gain of each leg, constants of inputs, fed index of
            inputs and of outputs, order of evaluation.
        finer: steps of simulations with laws, for each step without them, where these need more.
    Raises: ConfigError if a component gives no access to its states, or a connection has memory.
    """

    # Whether filters and smoothers can follow the logs, which takes access to the states.
    filters: ClassVar[bool] = True

    study: PortStudy
    states: list[Port] = field(default_factory=list)
    inputs: list[Port] = field(default_factory=list)
    outputs: list[Port] = field(default_factory=list)
    parameters: list[Port] = field(default_factory=list)
    effort: Effort = field(default_factory=Effort)
    finer: dict[frozenset[Inserted], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._kept = ExitStack()
        self._memory: list[Any] = []
        try:
            self._make()
        except BaseException:
            self._kept.close()
            raise

    def __enter__(self) -> StateModel:
        return self

    def __exit__(self, *_: object) -> None:
        self._kept.close()

    def _make(self) -> None:
        study, system = self.study, self.study.prepared.system
        # Parameters that differ from run to run are fed like inputs that stay constant.
        parameters = [one for one in study.varied if system.variable(one).causality is Causality.PARAMETER]
        self.fed = (*study.fed, *parameters)
        self.compared = tuple(study.compared)
        problems = [
            Problem(
                str(one), "the connection has effects with memory", "", "Its master simulates the system."
            )
            for one in system.connections
            if one.wire is not None and one.wire.every_link
        ]
        if system.loops:
            problems.append(Problem("connections", "the system has algebraic loops", "none"))
        order = [system.instances[index] for index in system.order]
        nominal = {Port.of(name) for name in study.nominal}
        plans = []
        for one in order:
            plan = self._plan(one, nominal, problems)
            if plan is not None:
                plans.append((one, *plan))
        begun = {*parameters, *(Port(one.name, name) for one, names, *_ in plans for name in names)}
        problems += [
            Problem(str(port), "is no state, so that no run can set it", "a parameter or a state")
            for port in study.varied
            if port not in begun
        ]
        if problems:
            raise ConfigError(problems)
        self.instances = [one for one, *_ in plans]
        rows = np.zeros((len(plans), COLUMNS), np.int64)
        values: list[float] = []
        for row, (one, states, rates, inputs, outputs, parameters, native) in zip(rows, plans, strict=True):
            self._place(row, one, states, inputs, outputs, parameters)
            values += [self._start(native, one, name) for name in states]
            self._bind(row, one, native, [*states, *inputs, *parameters], [*rates, *outputs])
        self.rows = rows
        self.start = np.array(values)
        self.measured = np.array([self.outputs.index(one) for one in self.compared], np.int64)
        self._take_numbers()
        self.wiring = self._wired(system.connections)

    def _place(
        self, row: Any, one: Instance, states: Sequence[str], inputs: Sequence[str], outputs: Sequence[str],
        parameters: Sequence[str] = (),
    ) -> None:  # fmt: skip
        """Append an instance's variables, and write where they stand into its row."""
        row[X : VERSION] = [
            len(self.states), len(states), len(self.inputs), len(inputs),
            len(self.parameters), len(parameters), len(self.outputs), len(outputs),
        ]  # fmt: skip
        self.states += [Port(one.name, name) for name in states]
        self.inputs += [Port(one.name, name) for name in inputs]
        self.outputs += [Port(one.name, name) for name in outputs]
        self.parameters += [Port(one.name, name) for name in parameters]

    def _take_numbers(self) -> None:
        """Values, tolerances and limits of the parameters, and noise of what is compared."""
        study = self.study
        self.nominal = np.array([study.nominal[str(one)].value for one in self.parameters])
        self.tolerance = np.array([study.nominal[str(one)].tolerance for one in self.parameters])
        self.noise = np.array([study.columns[one].noise for one in self.compared], np.float64)
        declared = [study.prepared.system.variable(one) for one in self.parameters]
        self.least = np.array([-np.inf if one.minimum is None else one.minimum for one in declared])
        self.most = np.array([np.inf if one.maximum is None else one.maximum for one in declared])

    def _plan(self, one: Instance, nominal: set[Port], problems: list[Problem]) -> Any:
        fmu = one.fmu
        remedy = "Build the component with `orchestrator build`, or let its master simulate the system."
        if (
            not isinstance(fmu, CompiledFmu)
            or fmu.run_options.isolated
            or fmu.description.fmi_version[0] == "1"
        ):
            problems.append(Problem(one.name, "the FMU cannot be evaluated in this process", "", remedy))
            return None
        from fmpy import read_model_description

        raw = read_model_description(str(fmu.path), validate=False)
        pairs = [(d.variable.derivative, d.variable) for d in raw.derivatives]
        variables = fmu.description.variables
        if any(state is None for state, _ in pairs) or (fmu.description.tool or "").startswith("PythonFMU"):
            problems.append(Problem(one.name, "the FMU names no continuous states", "", remedy))
            return None
        held = [
            name for name, v in variables.items()
            if v.variability is Variability.DISCRETE and v.causality in (Causality.OUTPUT, Causality.LOCAL)
        ]  # fmt: skip
        read = {port for leg in self.study.prepared.system.connections for port in leg.sources}
        own = [port for port in {*read, *self.compared} if port.instance == one.name]
        if held and not set(own) <= set(self.fed):
            # Evaluations between events know neither ticks nor what variables were before.
            what = f"its discrete variables {listed(held)} change at events only"
            feed = "Feed all of its outputs, as signals with `hold: true`, to find laws in other components."
            problems.append(Problem(one.name, what, "", feed))
            return None
        locked = [state.name for state, _ in pairs if state.initial not in ("exact", "approx")]
        if locked:
            problems.append(Problem(one.name, f"states {locked} take no start value", "", remedy))
            return None
        real = {
            name: v for name, v in variables.items()
            if v.kind is Kind.REAL and v.variability is Variability.CONTINUOUS
        }  # fmt: skip
        states, rates = [state.name for state, _ in pairs], [rate.name for _, rate in pairs]
        inputs = [name for name, v in real.items() if v.causality is Causality.INPUT]
        outputs = [name for name, v in real.items() if v.causality is Causality.OUTPUT]
        parameters = [
            port.variable for port in sorted(nominal)
            if port.instance == one.name and port.variable not in states
        ]  # fmt: skip
        inputs += [
            port.variable for port in self.study.varied
            if port.instance == one.name and variables[port.variable].causality is Causality.PARAMETER
        ]  # fmt: skip
        native: Any = fmu.instantiate(one.name)
        self._kept.callback(native.free)
        given = {**one.start, **{n.variable: self.study.nominal[str(n)].value for n in nominal
                                 if n.instance == one.name}}  # fmt: skip
        native.enter_initialisation(0.0, given)
        return states, rates, inputs, outputs, parameters, native

    def _start(self, native: Any, one: Instance, name: str) -> float:
        return float(native.get_values([name])[name])

    def _bind(self, row: Any, one: Instance, native: Any, sets: list[str], gets: list[str]) -> None:
        import ctypes

        variables = one.fmu.description.variables
        version = int(one.fmu.description.fmi_version[0])
        names = ("fmi2SetReal", "fmi2GetReal") if version == 2 else ("fmi3SetFloat64", "fmi3GetFloat64")
        arrays = []
        for at, name, wanted in ((0, names[0], sets), (1, names[1], gets)):
            function = ctypes.cast(getattr(native._slave.dll, name), ctypes.c_void_p).value
            references = np.array([variables[one].reference for one in wanted], np.uint32)
            memory = np.zeros(max(1, len(wanted)))
            arrays += [references, memory]
            row[SET + at] = function
            row[(SET_REFS, GET_REFS)[at]] = references.ctypes.data
            row[(SETS, GETS)[at]] = len(wanted)
            row[(SET_VALUES, GET_VALUES)[at]] = memory.ctypes.data
        component = native._component
        row[SELF] = component if isinstance(component, int) else component.value
        row[VERSION] = version
        self._memory += [native, *arrays]

    def _wired(self, connections: tuple[Connection, ...]) -> tuple[Any, ...]:
        system = self.study.prepared.system
        by_target = {one.target: one for one in connections}
        first, source, gain = [0], [], []
        constant = np.zeros(len(self.inputs))
        for index, port in enumerate(self.inputs):
            one = by_target.get(port)
            if one is None:
                constant[index] = system.start(port)
            else:
                legs = [(one.source, 1.0, 0.0)] if one.wire is None else [
                    (leg.port, leg.gain, leg.offset) for leg in one.wire.legs
                ]  # fmt: skip
                constant[index] = one.offset
                for leg, factor, offset in legs:
                    source.append(self.outputs.index(leg))
                    gain.append(one.gain * factor)
                    constant[index] += one.gain * offset
            first.append(len(source))
        fed = {port: index for index, port in enumerate(self.fed)}
        u_ext = np.array([fed.get(one, -1) for one in self.inputs], np.int64)
        y_ext = np.array([fed.get(one, -1) for one in self.outputs], np.int64)
        whole = np.array(first, np.int64), np.array(source, np.int64), np.array(gain, np.float64)
        return (*whole, constant, u_ext, y_ext, self._schedule(*whole[:2], y_ext))

    def _schedule(self, first: Any, source: Any, y_ext: Any) -> NDArray[np.int64]:
        """Components in the order of their evaluation, some twice.

        Once for the outputs that their states give, once for the derivatives that their inputs give.
        """
        right = y_ext >= 0
        done, turns = set[int](), list[int]()
        through = [one.feedthrough for one in self.instances]
        for _ in range(2 * len(self.rows) + 1):
            for c, row in enumerate(self.rows):
                if c in done:
                    continue
                ready = {
                    self.inputs[i].variable: bool(right[source[first[i] : first[i + 1]]].all())
                    for i in range(row[U], row[U] + row[NU])
                }
                fresh = [
                    k for k in range(row[Y], row[Y] + row[NY])
                    if not right[k] and all(ready.get(one, True) for one in
                                            through[c].get(self.outputs[k].variable, ()))
                ]  # fmt: skip
                if fresh or all(ready.values()):
                    turns.append(c)
                    right[fresh] = True
                    if all(ready.values()):
                        done.add(c)
            if len(done) == len(self.rows):
                break
        return np.array(turns, np.int64)

    def external(self, run: PortRun) -> tuple[Array, NDArray[np.bool_]]:
        """Fed signals of a run, shape (samples, fed), and which are held between samples."""
        ports = self.study.held
        count = len(run)
        found = {port: run.logs[port] for port in self.study.fed if port in run.logs}
        # What a run sets may be compared, too: its log does not count here.
        found |= {port: np.full(count, value) for port, value in run.values.items()}
        columns = [
            found[port] if port in found else np.full(count, self._unlogged(port)) for port in self.fed
        ]
        held = np.array([port in ports for port in self.fed], np.bool_)
        return np.ascontiguousarray(np.array(columns, np.float64).reshape(len(self.fed), count).T), held

    def _unlogged(self, port: Port) -> float:
        return float(self.study.prepared.system.start(port))

    def logged(self, run: PortRun) -> Array:
        """Compared signals of a run, shape (samples, compared); NaN where it lacks one."""
        columns = [run.logs.get(port, np.full(len(run), np.nan)) for port in self.compared]
        return np.ascontiguousarray(np.array(columns).T)

    def started(self, run: PortRun) -> Array:
        """States at the begin of a run, by the logs where the study takes them from there."""
        x = self.start.copy()
        for port, column in self.study.columns.items():
            if column.start and port in run.logs and port in self.states:
                x[self.states.index(port)] = run.logs[port][0]
        for port, value in run.values.items():
            if port in self.states:
                x[self.states.index(port)] = value
        return x

    @cached_property
    def speeds(self) -> dict[int, int]:
        """See `speeds_by_definition`; none where the master simulates the system."""
        return speeds_by_definition(self) if self.filters else {}

    def places(self) -> list[Place]:
        """Every input, derivative, output, pair of states and inner equation on which an input can act."""
        found = []
        for c, row in enumerate(self.rows):
            found += [Place(str(self.inputs[i]), Kinds.INPUT, c, i) for i in self.inputs_of(row)]
            found += [
                Place(f"der({self.states[i]})", Kinds.RATE, c, i)
                for i in range(row[X], row[X] + row[NX]) if i not in self.speeds
            ]  # fmt: skip
            found += [Place(str(self.outputs[i]), Kinds.OUTPUT, c, i) for i in self.outputs_of(row)]
        return [*found, *exchanges(self), *inner_places(self)] if self.filters else found

    def seen_at(self, place: Place) -> list[int]:
        """What is compared that a law at a place may change, as indices of `compared`."""
        return list(range(len(self.compared)))

    def states_of(self, row: Any) -> range:
        """Indices of a component's states, by its row."""
        return range(row[X], row[X] + row[NX])

    def inputs_of(self, row: Any) -> list[int]:
        """Indices of a component's inputs, by its row; without parameters that runs set, and openings."""
        others = {*self.study.varied, *self.study.openings}
        return [i for i in range(row[U], row[U] + row[NU]) if self.inputs[i] not in others]

    def outputs_of(self, row: Any) -> list[int]:
        """Indices of a component's outputs, by its row; without those of openings."""
        others = {
            Port(port.instance, name)
            for port, one in self.study.openings.items()
            for name in (one.before, *one.signals)
        }
        return [i for i in range(row[Y], row[Y] + row[NY]) if self.outputs[i] not in others]

    def signals_of(self, place: Place) -> dict[str, int]:
        """Signals of a place's component: index into [states, inputs, outputs] by name."""
        row, nx, nu = self.rows[place.component], len(self.states), len(self.inputs)
        if place.kind is Kinds.EXCHANGE:
            return {str(self.states[i]): i for i in (place.index, place.other)}
        found = {str(self.states[i]): i for i in range(row[X], row[X] + row[NX])}
        found |= {str(self.inputs[i]): nx + i for i in self.inputs_of(row)}
        if place.kind is not Kinds.INPUT:
            for i in self.outputs_of(row):
                found.setdefault(str(self.outputs[i]), nx + nu + i)
        for name in self.opening_at(place).signals:
            port = Port(self.instances[place.component].name, name)
            found[str(port)] = nx + nu + self.outputs.index(port)
        return found

    def opening_at(self, place: Place) -> Opening:
        """The opening that a place is, or an empty one."""
        return self.study.openings.get(Port.of(place.name), Opening("", ""))

    def own_signal(self, place: Place) -> int | None:
        """Index of the signal at an input or an output, or of what an inner equation calculates."""
        nx, nu = len(self.states), len(self.inputs)
        if Port.of(place.name) in self.study.openings:
            before = Port(self.instances[place.component].name, self.opening_at(place).before)
            return nx + nu + self.outputs.index(before) if before.variable else None
        if place.kind is Kinds.INPUT:
            return nx + place.index
        return nx + nu + place.index if place.kind is Kinds.OUTPUT else None
