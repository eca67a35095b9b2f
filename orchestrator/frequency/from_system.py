"""Linearise a configured system around its start: a linear system with delays.

`linear_parts` gives the equations of each instance. Delays of connections are exact, and low-pass filters
become states. Sample and hold counts as a delay of half its period. Effects that are not linear count as a
gain of one and are named. Measures of the config may know a point and laws of instances.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.arrays import Complex
from ..base.errors import ConfigError, Problem
from ..master.running_instances import Instances, instantiate
from ..results.measures import choose_measures
from ..simulation.run import Prepared, prepare
from ..system.external import ExternalFmu
from ..system.signal_vector import Signals
from .closing import chains_of, closed_system
from .delay_system import DelaySystem
from .inner_delays import InnerDelay
from .linear_parts import KnownLaws, LinearParts, refusal
from .margins import DelayMargin, Margins
from .modes import Modes
from .open_loop import OpenLoop
from .statespace import LateInput, Law, StateSpace, linearised

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure

    from ..fmi import FmuInstance


@dataclass(frozen=True)
class LinearPoint:
    """What a measure knows of a system that is to be linearised.

    Attributes:
        start: start values of its operating point by instance and variable, FMU's units.
        laws: by instance; a function gives that of a running instance where it stands.
    """

    start: Mapping[str, Mapping[str, Any]]
    laws: KnownLaws


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
    known: KnownLaws = field(default_factory=dict)
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

    def roots(self, count: int = 6) -> Complex:
        """The rightmost characteristic roots, both of each pair, shape (k,) [rad/s]."""
        found = [one.root for one in self.modes(count).modes]
        return np.array([z for s in found for z in ((s, s.conjugate()) if s.imag else (s,))])

    def open(self, connection: str = "") -> OpenLoop:
        """The loop cut at a connection, named as "a.y -> b.u" or by its target; without one, at the weakest.

        Raises: ConfigError if there is no such connection.
        """
        if connection:
            return OpenLoop(self.system, self.system.connection(connection))
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


def linearise(
    config: str | Path | Mapping[str, Any] | Prepared,
    overrides: Iterable[str] = (),
    *,
    at_time: float | None = None,
    point: LinearPoint | None = None,
) -> Linearised:
    """Linearise a configured system: a linear system with delays, without communication steps.

    Args:
        config, overrides: as `orchestrator.simulation.run.prepare`.
        at_time: the point of a run that it is linear around [s]; None: its start.
        point: start values and laws in place of those that the config's measures know.
    Raises: ConfigError with all effects without a transfer function, and all FMUs that can neither be
        differentiated nor measured, or whose input acts on their states in no way that is known here.
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


def _linearised(prepared: Prepared, at_time: float | None, laws: KnownLaws) -> Linearised:
    system, reached = prepared.system, at_time
    with instantiate(system) as instances:
        # Runs that go on from a time of the run may last longer than it.
        stop = float(prepared.grid.stop) if at_time is None else None
        signals = instances.initialise(float(prepared.grid.start), stop)
        if at_time is not None:
            reached = _advanced(instances, prepared, signals, at_time)
        parts = LinearParts(prepared, reached)
        if reached is not None:
            parts.notes.append(f"linear around t = {reached:.9g} s of the run")
        parts.find(instances, laws)
    known, notes = parts.laws, parts.notes
    chains, wrong = chains_of(system.connections, notes)
    if parts.problems or wrong:
        raise ConfigError([*parts.problems, *wrong])
    chains = [
        replace(one, delay=one.delay + known[name].hold)
        if (name := one.target.partition(".")[0]) in known
        else one
        for one in chains
    ]
    paths: dict[str, tuple[LateInput, ...]] = {name: (one,) for name, one in parts.late.items()}
    for name, law in known.items():
        paths |= {f"{name}.{port}": late for port, late in law.late.items()}

    def closed(spaces: Mapping[str, StateSpace]) -> DelaySystem:
        return closed_system(spaces, chains, paths, parts.inner)

    return Linearised(
        closed(parts.spaces),
        parts.point,
        tuple(dict.fromkeys(notes)),
        parts.spaces,
        parts.late,
        known,
        inner=parts.inner,
        of_measures=tuple(laws),
        breaks=tuple(dict.fromkeys(parts.breaks)),
        time=reached,
        known=laws,
        closed=closed,
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
