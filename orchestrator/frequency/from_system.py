"""A configured system -> the linear system with delays that it is around its start.

Each FMU by its directional derivatives, or without them by its measured step responses. An input that acts
on nothing at once stands behind a delay within the FMU: the delay is measured, by two runs of the FMU that
differ in a step of the input. Delays of connections are exact, low-pass filters become states, sample and
hold counts as a delay of half its period, and effects that are not linear count as one and are named. What
the config's measures know beyond that, a point and laws of instances, is asked of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import ConfigError, Problem, listed, nearest
from ..master.running_instances import Instances, instantiate
from ..results.measures import choose_measures
from ..simulation.run import Prepared, prepare
from ..system.external import ExternalFmu
from ..system.signal_vector import Signals
from ..system.system import Instance
from .closing import chains_of, closed_system, sources
from .delay_equation import Modes
from .delay_system import FILTER, DelaySystem
from .inner_delays import InnerDelay, inner_delays, uneven
from .late_inputs import MEASURE, acts, find_late_input, idle_together
from .margins import DelayMargin, Margins
from .measured_part import measured_part
from .measured_samples import sampled_law, sampling
from .measured_states import from_start_values, start_outputs
from .open_loop import OpenLoop
from .statespace import LateInput, Law, StateSpace, linearised, real_ports, without_idle_integrators
from .twin_runs import resumed

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure

    from ..fmi import FmuInstance

__all__ = ["Law", "LinearPoint", "Linearised", "linearise", "refusal"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LinearPoint:
    """What a measure knows of a system that is to be linearised.

    Attributes:
        start: start values of its operating point by instance and variable, FMU's units.
        laws: by instance; a function gives that of a running instance where it stands.
    """

    start: Mapping[str, Mapping[str, Any]]
    laws: Mapping[str, Law | Callable[[FmuInstance], Law]]


@dataclass(frozen=True, repr=False)
class Linearised:
    """A linear system with delays, and what it was made of.

    Attributes:
        system: the closed system.
        point: values of states and connected inputs that it is linear around, by name, in the FMUs' units.
        notes: what was measured, assumed or left out, one sentence each.
        parts: the state space of each instance, by its name.
        late: inputs that act after a delay within their FMU, as "robot.command".
        inner: delays between states of instances, by their name.
        laws: of instances whose equations a measure of the config knows, or that sample.
        of_measures: those whose law a measure of the config knows.
        breaks: instances whose equations jump or bend at the operating point, as at an event, or depend on
            what was before in a way that was not found.
        start: start values of the operating point that a measure of the config chose, by instance and
            variable, FMU's units; None: the point is no start of a run.
        time: of the run, where the point is one of it [s]; None: its start.
        known: what a measure of the config knows of instances, by their name.
        closed: the closed system with other state spaces of the same instances.
    """

    system: DelaySystem
    point: Mapping[str, float]
    notes: tuple[str, ...]
    parts: Mapping[str, StateSpace]
    late: Mapping[str, LateInput]
    laws: Mapping[str, Law] = field(default_factory=dict)
    inner: Mapping[str, tuple[InnerDelay, ...]] = field(default_factory=dict)
    of_measures: tuple[str, ...] = ()
    breaks: tuple[str, ...] = ()
    start: Mapping[str, Mapping[str, Any]] | None = field(default_factory=dict)
    time: float | None = None
    known: Mapping[str, Law | Callable[[FmuInstance], Law]] = field(default_factory=dict)
    closed: Callable[[Mapping[str, StateSpace]], DelaySystem] = field(kw_only=True)

    @property
    def chosen(self) -> bool:
        """Whether a measure of the config chose the operating point."""
        return bool(self.start)

    def started(self, prepared: Prepared) -> Prepared:
        """The system with the start values of the operating point."""
        return _started(prepared, self.start or {})

    def parts_at(self, prepared: Prepared, instances: Instances) -> dict[str, StateSpace]:
        """The state space of each instance where a run has brought it; measured ones stay as they are."""
        parts = dict(self.parts)
        for one, running in zip(prepared.system.instances, instances.running, strict=True):
            part, law = parts[one.name], self.known.get(one.name)
            if law is not None:
                parts[one.name] = part if isinstance(law, Law) else law(running).space
            elif one.name not in self.laws and set(part.states) <= set(one.fmu.description.variables):
                if refusal(one) is None:
                    here = linearised(one.fmu, running, part.inputs, part.outputs)
                    parts[one.name] = here.of_states([here.states.index(name) for name in part.states])
        return parts

    def modes(self, count: int = 6) -> Modes:
        """The rightmost modes; see `DelaySystem.modes`."""
        return self.system.modes(count)

    def margins(self, modes: Modes | None = None, names: Sequence[str] = ()) -> dict[str, Margins]:
        """Margins of connections, the weakest first; see `DelaySystem.margins`.

        Args:
            modes: what `modes` gave; found here if they are not given.
            names: of connections; all within feedback loops if none is named.
        """
        modes = modes or self.modes()
        found = {name: self.system.margins(name, modes) for name in names or self.system.loops()}
        # Loops that are equal to rounding stay in the order of the config.
        return dict(sorted(found.items(), key=lambda item: float(f"{item[1].modulus_margin:.9e}")))

    def delay_margin(self, names: Sequence[str] = ()) -> DelayMargin:
        """By how much connections may be later all at once; see `DelaySystem.delay_margin`."""
        return self.system.delay_margin(names)

    def roots(self, count: int = 6) -> NDArray[np.complex128]:
        """The rightmost characteristic roots, both of each pair, shape (k,) [rad/s]."""
        found = [one.root for one in self.modes(count).modes]
        return np.array([z for s in found for z in ((s, s.conjugate()) if s.imag else (s,))])

    def open(self, connection: str = "") -> OpenLoop:
        """The loop cut at a connection, named as "a.y -> b.u" or by its target; without one, at the weakest.

        Raises: ConfigError if there is no such connection.
        """
        known = list(
            dict.fromkeys(one.connection for one in self.system.links if FILTER not in one.connection)
        )
        ends = {_ends(name): name for name in known} | {name.rpartition(" -> ")[2]: name for name in known}
        if connection:
            name = connection if connection in known else ends.get(connection)
            if name is None:
                allowed = f"there are {listed(known)}"
                what = f"no connection {connection!r}"
                raise ConfigError([Problem("open", what, allowed, nearest(connection, known))])
            return OpenLoop(self.system, name)
        found = self.margins()
        if not found:
            raise ConfigError([Problem("system", "no connection lies within a feedback loop")])
        return OpenLoop(self.system, next(iter(found)))

    def to_control(self, connection: str = "", order: int = 6) -> control.StateSpace:
        """The loop cut at a connection as python-control's StateSpace; see `DelaySystem.to_control`."""
        return self.open(connection).to_control(order)

    def bode(self, connection: str = "") -> Figure:
        """Bode diagram of the open loop at a connection; without one, at the weakest."""
        return self.open(connection).bode()

    def nyquist(self, connection: str = "") -> Figure:
        """Nyquist diagram of the open loop at a connection; without one, at the weakest."""
        return self.open(connection).nyquist()

    def nichols(self, connection: str = "") -> Figure:
        """Nichols diagram of the open loop at a connection; without one, at the weakest."""
        return self.open(connection).nichols()

    def __repr__(self) -> str:
        modes = self.modes().modes
        shown = ", ".join(f"{one.frequency:.4g} Hz (damping {one.damping:.3g})" for one in modes[:3])
        return f"{len(self.system.states)} states, {len(self.system.links)} links; modes at {shown or 'none'}"


def _ends(connection: str) -> str:
    """A connection without its effects: "a.y -> b.u"."""
    parts = connection.split(" -> ")
    return f"{parts[0]} -> {parts[-1]}"


def linearise(
    config: str | Path | Mapping[str, Any] | Prepared,
    overrides: Iterable[str] = (),
    *,
    at_time: float | None = None,
    point: LinearPoint | None = None,
) -> Linearised:
    """The linear system with delays of a configured system, without communication steps.

    Args:
        config, overrides: as `orchestrator.simulation.run.prepare`.
        at_time: the point of a run that it is linear around [s]; None: its start.
        point: start values and laws in place of those that the config's measures know.
    Raises: ConfigError with all FMUs that can neither be differentiated nor measured or whose input acts on
        their states in no way that is known here, and all effects without a transfer function.
    """
    prepared = config if isinstance(config, Prepared) else prepare(config, overrides)
    if outside := [
        Problem(one.name, "it is another program: nothing is known of what it does", "", "Leave it out.")
        for one in prepared.system.instances
        if isinstance(one.fmu, ExternalFmu)
    ]:
        raise ConfigError(outside)
    point = point or _known_point(prepared)
    if at_time is not None:
        return replace(_linearised(prepared, at_time, point.laws), start=None)
    made = _linearised(_started(prepared, point.start), None, point.laws)
    return replace(made, start=point.start)


def _known_point(prepared: Prepared) -> LinearPoint:
    """What the measures of a config know."""
    start: dict[str, Mapping[str, Any]] = {}
    laws: dict[str, Law | Callable[[FmuInstance], Law]] = {}
    for chosen in choose_measures(prepared.config):
        known = getattr(chosen.measure, "linear_point", None)
        if known is not None:
            one = known(prepared, chosen.options)
            start, laws = start | one.start, laws | one.laws
    return LinearPoint(start, laws)


def _started(prepared: Prepared, start: Mapping[str, Mapping[str, Any]]) -> Prepared:
    """The system with other start values."""
    instances = tuple(
        replace(one, start={**one.start, **start.get(one.name, {})}) for one in prepared.system.instances
    )
    return replace(prepared, system=replace(prepared.system, instances=instances))


def _linearised(
    prepared: Prepared, at_time: float | None, laws: Mapping[str, Law | Callable[[FmuInstance], Law]]
) -> Linearised:
    system = prepared.system
    problems: list[Problem] = []
    notes: list[str] = []
    parts: dict[str, StateSpace] = {}
    known: dict[str, Law] = {}
    hidden: dict[str, LateInput] = {}
    inner: dict[str, tuple[InnerDelay, ...]] = {}
    point: dict[str, float] = {}
    breaks: list[str] = []
    fed = {str(connection.target) for connection in system.connections}
    seen = {str(leg) for connection in system.connections for leg in sources(connection)}
    with instantiate(system) as instances:
        # Runs that go on from a time of the run may last longer than it.
        stop = float(prepared.grid.stop) if at_time is None else None
        signals = instances.initialise(float(prepared.grid.start), stop)
        if at_time is not None:
            reached = _advanced(instances, prepared, signals, at_time)
            notes.append(f"linear around t = {reached:.9g} s of the run")
        for one, running in zip(system.instances, instances.running, strict=True):
            inputs = tuple(name for name, _ in real_ports(one.fmu) if f"{one.name}.{name}" in fed)
            outputs = tuple(name for name, is_output in real_ports(one.fmu) if is_output)
            read = tuple(name for name in outputs if f"{one.name}.{name}" in seen)
            if one.name in laws:
                law = laws[one.name]
                known[one.name] = law if isinstance(law, Law) else law(running)
                part = known[one.name].space
                notes += [f"{one.name}: {note}" for note in known[one.name].notes]
            elif refusal(one) is None:
                part = linearised(one.fmu, running, inputs, outputs)
            else:
                none = np.zeros((0, 0))
                part = StateSpace(none, none, none, none, (), (), ())
            names = [name for name in part.states if name in one.fmu.description.variables]
            values = running.get_values([*names, *inputs])
            point |= {f"{one.name}.{name}": float(value) for name, value in values.items()}
            parts[one.name] = part
            if one.name in known:
                continue
            why = "offers no directional derivatives" if refusal(one) is not None else ""
            if (
                not why
                and not part.states
                and inputs
                and any(not part.d[outputs.index(key)].any() for key in read)
            ):
                why = "names no states"
            here: tuple[Instance, Prepared] | None = (one, prepared)
            if at_time is not None and (why or not all(acts(part, name) for name in inputs)):
                here = resumed(one, running, prepared, reached)
            if here is None and why:
                what = f"it {why}, and cannot save its state, which a measurement at that time begins with"
                problems.append(Problem(one.name, what, "", _REMEDY))
                continue
            here = here or (one, prepared)
            if why:
                sampled = _by_samples(here[0], inputs, read, values, here[1])
                if isinstance(sampled, Law):
                    known[one.name] = sampled
                    parts[one.name] = sampled.space
                    notes += [f"{one.name}: {note}" for note in sampled.notes]
                    continue
                if sampled:
                    problems.append(Problem(one.name, f"it {why}, and {sampled}", "", _REMEDY))
                    continue
                found = _by_steps(here[0], inputs, read, values, here[1], why)
                if isinstance(found, str) and (states := start_outputs(one)):
                    there = {**values, **running.get_values(states)}
                    found = _by_start_values(one, inputs, read, there, here[1], why, found)
                if isinstance(found, str) and refusal(one) is not None:
                    problems.append(Problem(one.name, f"it {why}, and {found}", "", _REMEDY))
                    continue
                if not isinstance(found, str) and (refusal(one) is not None or found[0].states):
                    parts[one.name], late, more = found
                    hidden |= late
                    notes += more
                    continue
                if isinstance(found, str) and not all(acts(part, name) for name in inputs):
                    problems.append(Problem(one.name, f"it {why}, and {found}", "", MEASURE))
                    continue
            if refusal(one) is None and (broken := uneven(one, part, values, prepared)):
                breaks.append(one.name)
                notes.append(
                    f"{one.name}: {listed(broken)} jumps or bends at the operating point, as at an event; "
                    "roots and margins hold without that"
                )
            elif refusal(one) is None:
                inner[one.name], unknown = inner_delays(one, part, values, prepared, read)
                notes += [_inner_note(one, part, each) for each in inner[one.name]]
                if unknown:
                    breaks.append(one.name)
                    notes.append(f"{one.name}: {unknown}")
            idle = [name for name in inputs if not acts(part, name)]
            if len(idle) < 2 or not idle_together(here[0], part, idle, values, here[1]):
                idle = [
                    name for name in idle
                    if find_late_input(here[0], part, name, values, here[1], hidden, notes, problems)
                ]  # fmt: skip
            if idle:
                notes.append(
                    f"{one.name}: nothing depends on {listed(idle)} at the operating point, as in an open "
                    "contact; loops through them are left open"
                    + (". --at-time takes a time of the run instead" if at_time is None else "")
                )
    for one in system.instances:
        if one.name not in known and not inner.get(one.name):
            outputs = parts[one.name].outputs
            shown = [name for name in outputs if f"{one.name}.{name}" in seen] or outputs
            parts[one.name], idle, kept = without_idle_integrators(parts[one.name], shown)
            hidden |= {
                name: replace(hidden[name], gains=hidden[name].gains[kept])
                for name in (f"{one.name}.{port}" for port in parts[one.name].inputs)
                if name in hidden
            }
            if idle:
                notes.append(f"{one.name}: no connection shows {listed(idle)}: the roots at 0 are left out")
    chains, wrong = chains_of(system.connections, notes)
    if problems or wrong:
        raise ConfigError([*problems, *wrong])
    chains = [
        replace(one, delay=one.delay + known[name].hold)
        if (name := one.target.partition(".")[0]) in known
        else one
        for one in chains
    ]
    paths: dict[str, tuple[LateInput, ...]] = {name: (one,) for name, one in hidden.items()}
    for name, law in known.items():
        paths |= {f"{name}.{port}": late for port, late in law.late.items()}

    def closed(parts: Mapping[str, StateSpace]) -> DelaySystem:
        return closed_system(parts, chains, paths, inner)

    return Linearised(
        closed(parts),
        point,
        tuple(dict.fromkeys(notes)),
        parts,
        hidden,
        known,
        inner=inner,
        of_measures=tuple(laws),
        breaks=tuple(breaks),
        time=reached if at_time is not None else None,
        known=laws,
        closed=closed,
    )


def _by_samples(
    one: Instance,
    inputs: tuple[str, ...],
    read: tuple[str, ...],
    values: Mapping[str, Any],
    prepared: Prepared,
) -> Law | str:
    """The law of an instance that samples; why it is not known; empty if the instance does not sample."""
    if not inputs or not read:
        return ""
    values = {name: values[name] for name in inputs}
    when = sampling(one, inputs, read, values, prepared)
    if isinstance(when, str) or when is None:
        return when or ""
    found = sampled_law(one, inputs, read, values, prepared, when)
    if isinstance(found, str):
        return found
    law, error = found
    count = len(law.sampled.states) if law.sampled is not None else 0
    states = f"{count} state{'' if count == 1 else 's'}"
    text = (
        f"samples every {law.period:.6g} s; its response from sample to sample was measured: {states}, error "
        f"{100 * error:.2g} %; a held output counts as half a period late"
    )
    return replace(law, notes=(text,))


def _by_steps(
    one: Instance,
    inputs: tuple[str, ...],
    read: tuple[str, ...],
    values: Mapping[str, Any],
    prepared: Prepared,
    why: str,
) -> tuple[StateSpace, dict[str, LateInput], list[str]] | str:
    """The state space of an instance by its step responses, inputs behind a delay, and notes."""
    found = measured_part(one, inputs, read, {name: values[name] for name in inputs}, prepared)
    if isinstance(found, str):
        return found
    part, delays, error = found
    late = {}
    for name, delay in delays.items():
        column = inputs.index(name)
        late[f"{one.name}.{name}"] = LateInput(delay, part.b[:, column].copy(), part.d[:, column].copy())
        part.b[:, column], part.d[:, column] = 0.0, 0.0
    if not inputs:
        return part, late, [f"{one.name} {why} and has no connected input: its own motion is left out"]
    within = f", after delays of {listed(f'{delay:.6g} s' for delay in delays.values())}" if delays else ""
    count = f"{len(part.states)} state{'' if len(part.states) == 1 else 's'}"
    text = f"{one.name} {why}; its step response was measured: {count}{within}, error {100 * error:.2g} %"
    return part, late, [text, _UNSEEN] if read else []


def _by_start_values(
    one: Instance,
    inputs: tuple[str, ...],
    read: tuple[str, ...],
    values: Mapping[str, Any],
    prepared: Prepared,
    why: str,
    before: str,
) -> tuple[StateSpace, dict[str, LateInput], list[str]] | str:
    """The state space of an instance whose outputs with start values are its state, and notes.

    Args: before: why its step responses do not give it.
    """
    found = from_start_values(one, inputs, read, values, prepared)
    if isinstance(found, str):
        return f"{before}; {found}"
    part, error = found
    text = (
        f"{one.name} {why}; its outputs with start values are its {len(part.states)} states, and runs from "
        f"changed ones were measured, error {100 * error:.2g} %"
    )
    return part, {}, [text]


def _inner_note(one: Instance, part: StateSpace, inner: InnerDelay) -> str:
    columns = np.array([*part.states, *part.inputs])[np.flatnonzero(inner.seen)]
    rows = np.array([*part.states, *part.outputs])[np.flatnonzero([*inner.gains, *inner.through])]
    return (
        f"{one.name}: {listed(map(str, columns))} acts on {listed(map(str, rows))} after a delay of "
        f"{inner.delay:.9g} s within the FMU (measured)"
    )


_UNSEEN = "of measured FMUs, motion that no connected input causes or no connected output shows is left out"
_REMEDY = (
    "Export it with providesDirectionalDerivative, or measure the loop with "
    "orchestrator.frequency.sweep_system."
)


def refusal(one: Instance) -> Problem | None:
    """Why an instance cannot be linearised by its directional derivatives."""
    if one.fmu.description.capabilities.directional_derivatives and one.fmu.path is not None:
        return None
    return Problem(
        one.name,
        "it offers no directional derivatives",
        "they give its linear equations",
        _REMEDY,
    )


def _advanced(instances: Instances, prepared: Prepared, signals: Signals, at_time: float) -> float:
    """Step the system to a time. Returns: the time that is reached [s].

    Raises: ConfigError if it lies outside the run; StepError if a step fails.
    """
    grid = prepared.grid
    if not float(grid.start) <= at_time <= float(grid.stop):
        allowed = f"between {float(grid.start):g} s and {float(grid.stop):g} s, the start and stop of the run"
        raise ConfigError([Problem("--at-time", f"{at_time:g} s lies outside the run", allowed)])
    for point in grid:
        if point.last or point.time >= at_time - 1e-9 * point.step_size:
            break
        signals, info = prepared.master.step(instances.system, instances, point, signals)
        info.raise_on_failure(point)
    return float(point.time)
