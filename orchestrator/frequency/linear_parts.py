"""The linear equations of each instance of a system where it stands.

Each FMU by its directional derivatives, or without them by measured responses. An input that acts on nothing
at once stands behind a delay within the FMU: two runs of the FMU that differ in a step of the input measure
it. Instances whose law a measure of the config knows are not measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ..base.errors import ConfigError, Problem, listed
from ..master.running_instances import Instances
from ..simulation.run import Prepared
from ..system.system import Instance
from .alone import Alone
from .closing import sources
from .inner_delays import InnerDelay, inner_delays, uneven
from .late_inputs import MEASURE, acts, find_late_input, idle_together
from .measured_part import measured_part
from .measured_samples import sampled_law, sampling
from .measured_states import from_start_values, start_outputs
from .statespace import LateInput, Law, StateSpace, linearised, real_ports, without_idle_integrators

if TYPE_CHECKING:
    from ..fmi import FmuInstance

# Laws by instance; a function gives that of a running instance where it stands.
KnownLaws = Mapping[str, "Law | Callable[[FmuInstance], Law]"]

# A shorter delay, in communication steps, is none: directional derivatives miss what acts in one direction.
_AT_ONCE = 1e-6
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


@dataclass
class LinearParts:
    """What is found of the instances of a system, one after the other.

    Attributes:
        prepared: the checked system.
        time: of the run that it is linear around [s]; None: its start.
        spaces: the state space of each instance, by its name.
        laws: of instances whose equations a measure of the config knows, or that sample.
        late: inputs that act after a delay within their FMU, as "robot.command".
        inner: delays between states of instances, by their name.
        point: values of states and connected inputs, by name, in the FMUs' units.
        breaks: instances whose equations jump or bend, or depend on what was before in a way that was not
            found.
        notes: what was measured, assumed or left out, one sentence each.
        problems: why instances have no linear equations.
    """

    prepared: Prepared
    time: float | None
    spaces: dict[str, StateSpace] = field(default_factory=dict)
    laws: dict[str, Law] = field(default_factory=dict)
    late: dict[str, LateInput] = field(default_factory=dict)
    inner: dict[str, tuple[InnerDelay, ...]] = field(default_factory=dict)
    point: dict[str, float] = field(default_factory=dict)
    breaks: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)

    def find(self, instances: Instances, known: KnownLaws) -> None:
        """Find the equations of all instances where a run has brought them."""
        connections = self.prepared.system.connections
        fed = {str(connection.target) for connection in connections}
        seen = {str(leg) for connection in connections for leg in sources(connection)}
        for one, running in zip(instances.system.instances, instances.running, strict=True):
            ports = real_ports(one.fmu)
            inputs = tuple(name for name, _ in ports if f"{one.name}.{name}" in fed)
            outputs = tuple(name for name, is_output in ports if is_output)
            read = tuple(name for name in outputs if f"{one.name}.{name}" in seen)
            law = known.get(one.name)
            if law is not None:
                law = law if isinstance(law, Law) else law(running)
                self._add_law(one.name, law)
                part = law.space
            elif refusal(one) is None:
                part = linearised(one.fmu, running, inputs, outputs)
            else:
                none = np.zeros((0, 0))
                part = StateSpace(none, none, none, none, (), (), ())
            names = [name for name in part.states if name in one.fmu.description.variables]
            values = running.get_values([*names, *inputs])
            self.point |= {f"{one.name}.{name}": float(value) for name, value in values.items()}
            self.spaces[one.name] = part
            if law is None:
                self._examine(Alone(one, self.prepared, inputs, read, values), part, running)
        for one in instances.system.instances:
            if one.name not in self.laws and not self.inner.get(one.name):
                self._leave_idle_integrators_out(one.name, seen)

    def _add_law(self, name: str, law: Law) -> None:
        self.laws[name], self.spaces[name] = law, law.space
        self.notes += [f"{name}: {note}" for note in law.notes]

    def _examine(self, at: Alone, part: StateSpace, running: FmuInstance) -> None:
        """Measure what an FMU's directional derivatives do not show."""
        one, derivatives = at.one, refusal(at.one) is None
        why = "" if derivatives else "offers no directional derivatives"
        if derivatives and not part.states and at.inputs:
            if any(not part.d[part.outputs.index(name)].any() for name in at.read):
                why = "names no states"
        here = at
        if self.time is not None and (why or not all(acts(part, name) for name in at.inputs)):
            resumed = at.resumed(running, self.time)
            if resumed is None and why:
                what = f"it {why}, and cannot save its state, which a measurement at that time begins with"
                self.problems.append(Problem(one.name, what, "", _REMEDY))
                return
            here = resumed or at
        if why:
            try:
                found = _measured(here, one, running, why)
            except _NotMeasured as refused:
                if not derivatives or refused.samples or not all(acts(part, name) for name in at.inputs):
                    remedy = MEASURE if derivatives and not refused.samples else _REMEDY
                    self.problems.append(Problem(one.name, f"it {why}, and {refused}", "", remedy))
                    return
            else:
                if isinstance(found, Law):
                    self._add_law(one.name, found)
                    return
                if not derivatives or found[0].states:
                    self.spaces[one.name], late, notes = found
                    self.late |= late
                    self.notes += notes
                    return
        if derivatives:
            self._find_bends_and_delays(at, part)
        self._find_late_inputs(here, part)

    def _find_bends_and_delays(self, at: Alone, part: StateSpace) -> None:
        name = at.one.name
        if broken := uneven(at, part):
            self.breaks.append(name)
            self.notes.append(
                f"{name}: {listed(broken)} jumps or bends at the operating point, as at an event; "
                "roots and margins hold without that"
            )
            return
        self.inner[name], unknown = inner_delays(at, part)
        self.notes += [_inner_note(at.one, part, each) for each in self.inner[name]]
        if unknown:
            self.breaks.append(name)
            self.notes.append(f"{name}: {unknown}")

    def _find_late_inputs(self, at: Alone, part: StateSpace) -> None:
        name, idle = at.one.name, [port for port in at.inputs if not acts(part, port)]
        if len(idle) < 2 or not idle_together(at, part, idle):
            for port in tuple(idle):
                try:
                    late = find_late_input(at, part, port)
                except ConfigError as error:
                    self.problems += error.problems
                    idle.remove(port)
                    continue
                if late is None:
                    continue
                idle.remove(port)
                if late.delay < _AT_ONCE * at.step:
                    self.breaks.append(name)
                    self.notes.append(
                        f"{name}: {port} acts at once in one direction only, as where a contact just begins; "
                        "roots and margins hold without that"
                    )
                else:
                    self.late[f"{name}.{port}"] = late
                    self.notes.append(
                        f"{name}.{port} acts after a delay of {late.delay:.9g} s within the FMU (measured)"
                    )
        if idle:
            self.notes.append(
                f"{name}: nothing depends on {listed(idle)} at the operating point, as in an open "
                "contact; loops through them are left open"
                + (". --at-time takes a time of the run instead" if self.time is None else "")
            )

    def _leave_idle_integrators_out(self, name: str, seen: set[str]) -> None:
        part = self.spaces[name]
        shown = [port for port in part.outputs if f"{name}.{port}" in seen] or part.outputs
        self.spaces[name], idle, kept = without_idle_integrators(part, shown)
        for port in (f"{name}.{port}" for port in part.inputs):
            if port in self.late:
                self.late[port] = replace(self.late[port], gains=self.late[port].gains[kept])
        if idle:
            self.notes.append(f"{name}: no connection shows {listed(idle)}: the roots at 0 are left out")


class _NotMeasured(Exception):
    """Why an instance has no linear equations by measured responses; `samples`: because of its samples."""

    def __init__(self, why: str, samples: bool = False) -> None:
        super().__init__(why)
        self.samples = samples


def _measured(
    at: Alone, one: Instance, running: FmuInstance, why: str
) -> Law | tuple[StateSpace, dict[str, LateInput], list[str]]:
    """The equations of an instance by measured responses.

    Args: one: from its start, where `at` goes on from a saved state; why: it is measured.
    Returns: the law of an FMU that samples; or the state space, inputs behind a delay, and notes.
    Raises: _NotMeasured.
    """
    when = sampling(at) if at.inputs and at.read else None
    if when is not None:
        sampled = when if isinstance(when, str) else sampled_law(at, when)
        if isinstance(sampled, str):
            raise _NotMeasured(sampled, samples=True)
        return _with_note(*sampled)
    found = measured_part(at)
    if not isinstance(found, str):
        return _with_notes(at, why, *found)
    states = start_outputs(one)
    if not states:
        raise _NotMeasured(found)
    started = from_start_values(replace(at, one=one, values={**at.values, **running.get_values(states)}))
    if isinstance(started, str):
        raise _NotMeasured(f"{found}; {started}")
    part, error = started
    text = (
        f"{at.one.name} {why}; its outputs with start values are its {len(part.states)} states; runs from "
        f"changed values were measured, error {100 * error:.2g} %"
    )
    return part, {}, [text]


def _with_note(law: Law, error: float) -> Law:
    states = _counted(law.sampled.states if law.sampled is not None else ())
    text = (
        f"samples every {law.period:.6g} s; its response from sample to sample was measured: {states}, error "
        f"{100 * error:.2g} %; a held output counts as half a period late"
    )
    return replace(law, notes=(text,))


def _with_notes(
    at: Alone, why: str, part: StateSpace, delays: dict[str, float], error: float
) -> tuple[StateSpace, dict[str, LateInput], list[str]]:
    """Delays [s] by input, which act there in place of the input at once."""
    name, late = at.one.name, {}
    for port, delay in delays.items():
        column = at.inputs.index(port)
        late[f"{name}.{port}"] = LateInput(delay, part.b[:, column].copy(), part.d[:, column].copy())
        part.b[:, column], part.d[:, column] = 0.0, 0.0
    if not at.inputs:
        return part, late, [f"{name} {why} and has no connected input: its own motion is left out"]
    within = f", after delays of {listed(f'{delay:.6g} s' for delay in delays.values())}" if delays else ""
    states = _counted(part.states)
    text = f"{name} {why}; its step response was measured: {states}{within}, error {100 * error:.2g} %"
    return part, late, [text, _UNSEEN] if at.read else []


def _counted(states: tuple[str, ...]) -> str:
    return f"{len(states)} state{'' if len(states) == 1 else 's'}"


def _inner_note(one: Instance, part: StateSpace, inner: InnerDelay) -> str:
    columns = np.array([*part.states, *part.inputs])[np.flatnonzero(inner.seen)]
    rows = np.array([*part.states, *part.outputs])[np.flatnonzero([*inner.gains, *inner.through])]
    return (
        f"{one.name}: {listed(map(str, columns))} acts on {listed(map(str, rows))} after a delay of "
        f"{inner.delay:.9g} s within the FMU (measured)"
    )
