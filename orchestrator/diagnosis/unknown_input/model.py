"""A system of FMUs in state form: derivatives and outputs of all components, in machine code.

FMUs stay in initialisation mode. There FMI lets the importer set states, inputs and parameters and read
derivatives and outputs, so that one pair of calls evaluates a component at any point.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...base.compiled_functions import njit
from ...base.errors import ConfigError, Problem
from ...fmi import Causality, CompiledFmu, Kind, Variability
from ...simulation.native.foreign_calls import call_fmi2_values, call_fmi3_values, load, store
from ...system.connection import Connection, Port
from ...system.system import Instance
from ..study.study import PortRun, PortStudy
from .calls import call_law
from .effort import Effort

__all__ = ["COLUMNS", "Inserted", "Kinds", "Place", "StateModel", "acts_of", "evaluate", "past_of"]

Array = NDArray[np.float64]
# Columns of a component's row.
_SET, _GET, _SELF, _SET_REFS, _SETS, _SET_VALUES, _GET_REFS, _GETS, _GET_VALUES = range(9)
_X, _NX, _U, _NU, _P, _NP, _Y, _NY, _VERSION = range(9, 18)
COLUMNS = 18
# Columns of what acts: where, and which law.
_KIND, _COMPONENT, _INDEX, _HAS_W, _LAW, _SIGNAL, _COUNT, _NUMBER, _HIDDEN, _STATES = range(10)
_INTERVAL, _DELAY = 10, 11


class Kinds(IntEnum):
    """Where an unknown input acts."""

    NONE = 0
    INPUT = 1
    RATE = 2
    OUTPUT = 3


@dataclass(frozen=True)
class Place:
    """Where physics can be missing.

    Attributes:
        name: of the input, the output or the state's derivative.
        component: index of the instance.
        index: among all inputs, states or outputs, by `kind`.
    """

    name: str
    kind: Kinds
    component: int
    index: int


@dataclass(frozen=True)
class Inserted:
    """A law at a place: its machine code's address, the signals it reads, its numbers and states.

    Attributes:
        settled: states that start at the first signal.
        delay: whether its first number delays the first signal. Open simulations then look the signal up in
            the past, filters take the law's states.
    """

    place: Place
    address: int
    signals: tuple[int, ...]
    numbers: int
    states: int = 0
    settled: tuple[int, ...] = ()
    delay: bool = False


@njit()
def past_of(acts, steps):
    """Memory of laws: signals that they delay over so many steps, the present (see `_delayed`), one call.

    Without steps no signal is kept: filters and derivatives take the states of such laws.
    """
    kept = steps + 1 if steps > 0 and np.any(acts[:, _DELAY]) else 0
    return np.zeros((len(acts), kept, 3)), np.zeros(4), np.zeros((2, 8))


@njit(allocates=False)
def _summed(past, step, now, signal, at):
    """Integral of a signal up to a point of time [steps]; see `_delayed`."""
    if at <= 0.0:
        return at * (past[0, 0] if step > 0 or now[3] > 0.0 else signal)
    before = int(at)
    if before < step:
        part = at - before
        begin, end = past[before, 0], past[before + 1, 1]
        return past[before, 2] + part * (begin + 0.5 * part * (end - begin))
    begin = past[step, 0] if now[3] > 0.0 else signal
    return past[step, 2] + (at - step) * 0.5 * (begin + signal)


@njit(allocates=False)
def _delayed(past, now, time, signal):
    """A signal some time ago, the mean over one step; writes `past`.

    A jump within a step then counts by its part of the step, so that fits see it move.

    Args:
        past: values at the begin and at the end of each step, and the integral up to its begin, shape
            (steps + 1, 3). Where the signal jumps at a step's begin, both differ.
        now: step, its part that is over, its length [s], and 1 where it begins, 2 where it ends.
        signal: its present value.
    """
    step = int(now[0])
    if now[3] == 1.0:
        past[step, 0] = signal
    elif now[3] == 2.0:
        past[step + 1, 1] = signal
        past[step + 1, 2] = past[step, 2] + 0.5 * (past[step, 0] + signal)
    at = now[0] + now[1] - abs(time) / now[2]
    half = min(0.5, now[0] + now[1] - at)
    if half < 1e-9:
        return signal
    late = _summed(past, step, now, signal, at + half)
    return (late - _summed(past, step, now, signal, at - half)) / (2.0 * half)


@njit(allocates=False)
def _acting(act, x, u, y, t, w, signals, theta, hidden, extra, past, now, call):
    """What one row of `acts` adds at its place; writes the derivatives of its law's states."""
    total = w if act[_HAS_W] else 0.0
    if act[_LAW] != 0:
        s, out = call
        nx, nu = len(x), len(u)
        for k in range(act[_COUNT]):
            j = signals[act[_SIGNAL] + k]
            s[k] = x[j] if j < nx else (u[j - nx] if j < nx + nu else y[j - nx - nu])
        s[2] = 1e-9 * act[_INTERVAL]
        numbers = theta.ctypes.data + 8 * act[_NUMBER]
        states = hidden.ctypes.data + 8 * act[_HIDDEN]
        call_law(act[_LAW], t, s.ctypes.data, numbers, states, out.ctypes.data)
        if act[_DELAY] and len(past) > 0:
            out[0] = _delayed(past, now, theta[act[_NUMBER]], s[0]) - s[0]
        total += out[0]
        for k in range(act[_STATES]):
            extra[act[_HIDDEN] + k] = out[1 + k]
    return total


@njit(allocates=False)
def _passes(acts, signals, nx, nu):
    """How often components are evaluated: twice with laws whose inputs or outputs read other inputs.

    The order of evaluation knows only what the components themselves pass on at once.
    """
    for a in range(len(acts)):
        for k in range(acts[a, _SIGNAL], acts[a, _SIGNAL] + acts[a, _COUNT]):
            own = acts[a, _KIND] == 1 and signals[k] == nx + acts[a, _INDEX]
            if acts[a, _LAW] != 0 and acts[a, _KIND] != 2 and signals[k] >= nx and not own:
                if signals[k] < nx + nu or acts[a, _KIND] == 1:
                    return 2
    return 1


@njit(allocates=False)
def evaluate(rows, wiring, x, ext, p, t, acts, w, signals, theta, hidden, u, y, rate, extra, past, now, call):
    """Derivatives and outputs at one point.

    Args:
        rows: components, shape (n, 18). wiring: see `StateModel`. x, ext, p: states, fed signals, parameters.
        acts: what acts where, shape (n, 12), see `acts_of`. w: the unknown input.
        signals: which of [x, u, y] the laws read. theta, hidden: their numbers and their states.
        u, y, rate: written, inputs, outputs and derivatives. extra: written, derivatives of `hidden`.
        past, now, call: memory of laws; see `past_of`.
    """
    first, source, gain, constant, u_ext, y_ext, schedule = wiring
    for turn in range(_passes(acts, signals, len(x), len(u)) * len(schedule)):
        c = schedule[turn % len(schedule)]
        row = rows[c]
        for i in range(row[_U], row[_U] + row[_NU]):
            if u_ext[i] >= 0:
                u[i] = ext[u_ext[i]]
            else:
                value = constant[i]
                for k in range(first[i], first[i + 1]):
                    value += gain[k] * (y[source[k]] if y_ext[source[k]] < 0 else ext[y_ext[source[k]]])
                u[i] = value
        for a in range(len(acts)):
            if acts[a, _COMPONENT] == c and acts[a, _KIND] == 1:
                u[acts[a, _INDEX]] += _acting(
                    acts[a], x, u, y, t, w, signals, theta, hidden, extra, past[a], now, call
                )  # fmt: skip
        at = row[_SET_VALUES]
        for i in range(row[_NX]):
            store(at, x[row[_X] + i])
            at += 8
        for i in range(row[_NU]):
            store(at, u[row[_U] + i])
            at += 8
        for i in range(row[_NP]):
            store(at, p[row[_P] + i])
            at += 8
        if row[_VERSION] == 2:
            if row[_SETS] > 0:
                call_fmi2_values(row[_SET], row[_SELF], row[_SET_REFS], row[_SETS], row[_SET_VALUES])
            call_fmi2_values(row[_GET], row[_SELF], row[_GET_REFS], row[_GETS], row[_GET_VALUES])
        else:
            if row[_SETS] > 0:
                call_fmi3_values(
                    row[_SET], row[_SELF], row[_SET_REFS], row[_SETS], row[_SET_VALUES], row[_SETS]
                )
            call_fmi3_values(row[_GET], row[_SELF], row[_GET_REFS], row[_GETS], row[_GET_VALUES], row[_GETS])
        at = row[_GET_VALUES]
        for i in range(row[_NX]):
            rate[row[_X] + i] = load(at, 0.0)
            at += 8
        for i in range(row[_NY]):
            y[row[_Y] + i] = load(at, 0.0)
            at += 8
        for a in range(len(acts)):
            if acts[a, _COMPONENT] == c and acts[a, _KIND] > 1:
                added = _acting(
                    acts[a], x, u, y, t, w, signals, theta, hidden, extra, past[a], now, call
                )  # fmt: skip
                if acts[a, _KIND] == 2:
                    rate[acts[a, _INDEX]] += added
                else:
                    y[acts[a, _INDEX]] += added


@dataclass
class StateModel:
    """A study's system in state form; a context manager, which frees the FMUs.

    Attributes:
        states, inputs, outputs: ports, in the order of their vectors. parameters: calibrated ones.
        fed, compared: ports whose logs are fed or compared.
        rows: one a component, in the order of direct feedthrough.
        wiring: first leg of each input, source and gain of each leg, constants of inputs, fed index of
            inputs and of outputs, order of evaluation.
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
                str(one), "the connection has effects with memory", "", "Diagnose it with the port search."
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
        row[_X : _VERSION] = [
            len(self.states), len(states), len(self.inputs), len(inputs),
            len(self.parameters), len(parameters), len(self.outputs), len(outputs),
        ]  # fmt: skip
        self.states += [Port(one.name, name) for name in states]
        self.inputs += [Port(one.name, name) for name in inputs]
        self.outputs += [Port(one.name, name) for name in outputs]
        self.parameters += [Port(one.name, name) for name in parameters]

    def _take_numbers(self) -> None:
        """Values and tolerances of the parameters, and noise of what is compared, from the study."""
        study = self.study
        self.nominal = np.array([study.nominal[str(one)].value for one in self.parameters])
        self.tolerance = np.array([study.nominal[str(one)].tolerance for one in self.parameters])
        self.noise = np.array([study.columns[one].noise for one in self.compared], np.float64)

    def _plan(self, one: Instance, nominal: set[Port], problems: list[Problem]) -> Any:
        fmu = one.fmu
        remedy = "Build the component with `orchestrator build`, or diagnose it with the port search."
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
            row[_SET + at] = function
            row[(_SET_REFS, _GET_REFS)[at]] = references.ctypes.data
            row[(_SETS, _GETS)[at]] = len(wanted)
            row[(_SET_VALUES, _GET_VALUES)[at]] = memory.ctypes.data
        component = native._component
        row[_SELF] = component if isinstance(component, int) else component.value
        row[_VERSION] = version
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
                    for i in range(row[_U], row[_U] + row[_NU])
                }
                fresh = [
                    k for k in range(row[_Y], row[_Y] + row[_NY])
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

    def places(self) -> list[Place]:
        """Every input, state derivative and output that an unknown input can act on."""
        found = []
        for c, row in enumerate(self.rows):
            found += [Place(str(self.inputs[i]), Kinds.INPUT, c, i) for i in self.inputs_of(row)]
            found += [
                Place(f"der({self.states[i]})", Kinds.RATE, c, i) for i in range(row[_X], row[_X] + row[_NX])
            ]
            found += [
                Place(str(self.outputs[i]), Kinds.OUTPUT, c, i) for i in range(row[_Y], row[_Y] + row[_NY])
            ]
        return found

    def seen_at(self, place: Place) -> list[int]:
        """What is compared that a law at a place may change, as indices of `compared`."""
        return list(range(len(self.compared)))

    def states_of(self, row: Any) -> range:
        """Indices of a component's states, by its row."""
        return range(row[_X], row[_X] + row[_NX])

    def inputs_of(self, row: Any) -> list[int]:
        """Indices of a component's inputs, by its row; without parameters that runs set."""
        varied = self.study.varied
        return [i for i in range(row[_U], row[_U] + row[_NU]) if self.inputs[i] not in varied]

    def outputs_of(self, row: Any) -> range:
        """Indices of a component's outputs, by its row."""
        return range(row[_Y], row[_Y] + row[_NY])

    def signals_of(self, place: Place) -> dict[str, int]:
        """Signals of a place's component: index into [states, inputs, outputs] by name."""
        row, nx, nu = self.rows[place.component], len(self.states), len(self.inputs)
        found = {str(self.states[i]): i for i in range(row[_X], row[_X] + row[_NX])}
        found |= {str(self.inputs[i]): nx + i for i in self.inputs_of(row)}
        if place.kind is not Kinds.INPUT:
            for i in range(row[_Y], row[_Y] + row[_NY]):
                found.setdefault(str(self.outputs[i]), nx + nu + i)
        return found


def acts_of(laws: Sequence[Inserted], w: Place | None, interval: float) -> tuple[Any, Any]:
    """Rows of what acts, and the signals that laws read: inserted laws, then the unknown input.

    Args:
        interval: of the logs [s], for laws that need it.
    """
    rows, signals, number, hidden = [], list[int](), 0, 0
    for one in laws:
        where = one.place
        rows.append([
            int(where.kind), where.component, where.index, 0, one.address, len(signals), len(one.signals),
            number, hidden, one.states, round(1e9 * interval), int(one.delay),
        ])  # fmt: skip
        signals += one.signals
        number, hidden = number + one.numbers, hidden + one.states
    if w is not None:
        rows.append([int(w.kind), w.component, w.index, 1, 0, 0, 0, 0, 0, 0, 0, 0])
    return np.array(rows, np.int64).reshape(len(rows), 12), np.array(signals, np.int64)
