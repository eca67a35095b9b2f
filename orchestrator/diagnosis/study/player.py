"""Runs of a system in which logged signals stand in for its own, and effects are inserted at its ports."""

from __future__ import annotations

import weakref
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from ...base.errors import StepError
from ...effects import Effect
from ...effects.gain import Gain
from ...effects.offset import Offset
from ...fmi import Causality, Point, Value
from ...fmi.loading import CompiledFmu
from ...master import MasterAlgorithm
from ...master.gauss_seidel import GaussSeidel
from ...simulation.grid import Grid
from ...simulation.loop import Report, simulate
from ...system.connection import Connection, Leg, Link, Port, Wire
from ...system.instance_pool import InstancePool, resets_well
from ...system.signal_vector import Layout, Signals, Wired
from ...system.system import Instance, System
from .idle import without_idle
from .playback import Playback
from .study import Array


@dataclass(frozen=True)
class Inserted:
    """An effect at a port.

    Attributes:
        effect: of those that connections take.
        port: an input: it acts on what that is fed; an output: on what it gives, to others and to the log.
        reads: further ports whose signals it reads, as its component sees them.
    """

    effect: Effect
    port: Port
    reads: tuple[Port, ...] = ()


class Player:
    """Plays logs into a system, in several threads at once where it is `parallel`.

    Attributes:
        parallel: whether all FMUs are the product's own, whose instances share nothing. Those of other
            tools may, whatever they declare.

    Args:
        system: all its numeric outputs recorded.
        interval: what samples of logs are apart [s].
        fed: ports whose logged signals take the place of the system's own: of an output for all that read it,
            of an input for that alone.
        compared: outputs that are compared with their logs, as the effects at them leave them; of an input
            what connections give it, before units are converted.
        parts: communication steps from one sample to the next.
        held: fed ports whose signals stay at each sample until the next one; others go along a curve through
            them.
    """

    def __init__(
        self,
        system: System,
        master: MasterAlgorithm,
        interval: Fraction,
        fed: Sequence[Port],
        compared: Sequence[Port],
        parts: int = 1,
        held: Collection[Port] = (),
    ) -> None:
        self.system, self.step_size, self._parts, self._held = system, interval / parts, parts, held
        self.fed, self.compared = tuple(fed), tuple(compared)
        self._master = master
        fmus = {id(one.fmu): one.fmu for one in system.instances}.values()
        self.parallel = all(map(resets_well, fmus))
        for fmu in fmus:
            if isinstance(fmu, CompiledFmu):
                # Many short runs: unpacked once.
                kept = ExitStack()
                kept.enter_context(fmu.unpacked())
                weakref.finalize(self, kept.close)
        self._pool = InstancePool() if self.parallel else None
        if self._pool is not None:
            weakref.finalize(self, self._pool.close)

    def run(
        self,
        logs: Mapping[Port, Array],
        samples: int,
        start: Mapping[Port, Value] | None = None,
        inserted: Sequence[Inserted] = (),
        stops: list[StepError] | None = None,
    ) -> dict[Port, Array]:
        """Run from 0 s over so many samples.

        Args:
            logs: of the fed ports; those without keep the system's own signal. In the units of the ports.
            start: start values in place of the config's, in the units of the variables.
            inserted: in the order in which they act.
            stops: is given what ended the run before its last sample: an FMU that failed, or that asked to.
        Returns: what the compared ports give, each of shape (samples,); NaN after what ended the run.
        """
        logs = {port: between(log, self._parts, port in self._held) for port, log in logs.items()}
        system = self._system(logs, start or {}, inserted, float(self.step_size))
        layout, places = self._layout(system, logs, inserted)
        taken = np.full((len(places), (samples - 1) * self._parts + 1), np.nan)
        seen = _Seen(np.array(places, np.intp), taken)
        grid = Grid(Fraction(0), self.step_size, (samples - 1) * self._parts)

        report, stop = Report(), None
        # Of a model that runs away, what it gave until then is there.
        try:
            simulate(
                system, self._master, grid, (seen,), report, loop="prefer native", layout=layout,
                pool=self._pool,
            )  # fmt: skip
        except StepError as error:
            stop = error
        stop = report.ended or stop
        if stops is not None and stop is not None:
            stops.append(stop)
        return dict(zip(self.compared, taken[:, :: self._parts], strict=True))

    def feeding(self, port: Port) -> Connection | None:
        """The connection that feeds an input."""
        return next((one for one in self.system.connections if one.target == port), None)

    def is_input(self, port: Port) -> bool:
        """Whether a port is an input."""
        return self.system.variable(port).causality is Causality.INPUT

    def _system(
        self,
        logs: Mapping[Port, Array],
        start: Mapping[Port, Value],
        inserted: Sequence[Inserted],
        step: float,
    ) -> System:
        at: dict[Port, list[Inserted]] = {}
        for one in inserted:
            at.setdefault(one.port, []).append(one)
        connections = [self._passing(one, logs, at, step) for one in self.system.connections]
        driven = {one.target for one in connections}
        instances = {one.name: one for one in self.system.instances}
        given: dict[str, dict[str, Value]] = {}
        for port, value in start.items():
            given.setdefault(port.instance, {})[port.variable] = value
        begin = {name: {**one.start, **given.get(name, {})} for name, one in instances.items()}
        loose = [port for port in (*self.fed, *at) if self.is_input(port) and port not in driven]
        for port in dict.fromkeys(loose):
            if port not in logs and port not in at:
                continue
            own = next(one for one in self.system.recorded if one.instance == port.instance)
            held = begin[port.instance].pop(port.variable, 0.0)
            samples = logs[port] if port in logs else np.array([float(held)])
            links = [
                _undelayed(_playback(samples, step, self._at_end(instances[port.instance], port.variable))),
                *(self._link(one) for one in at.get(port, ())),
            ]
            connections.append(Connection(own, port, wire=Wire((Leg(own),), tuple(links))))
        system = replace(
            self.system,
            connections=tuple(connections),
            instances=tuple(replace(one, start=begin[name]) for name, one in instances.items()),
            longest_step=None,
            bonds=(),
        )
        replaced = {port for port in self.fed if port in logs}
        unread = {port for port in replaced if self._is_log(port, logs)}
        seen = {*self.compared, *(port for one in inserted for port in one.reads)} - unread
        return without_idle(system, self._master, seen, replaced, unread)

    def _is_log(self, port: Port, logs: Mapping[Port, Array]) -> bool:
        """Whether a log takes the place of an output's signal itself, for all who look at it."""
        return port in self.fed and port in logs and port not in self.compared and not self.is_input(port)

    def _passing(
        self,
        connection: Connection,
        logs: Mapping[Port, Array],
        at: Mapping[Port, Sequence[Inserted]],
        step: float,
    ) -> Connection:
        """A connection with what is inserted at its ends, and logs in place of its sources' signals.

        What acts on an output acts before the gain of the leg that it is; legs are summed; the connection's
        own effects follow, or in place of all this a log of the input itself; then those at the input. These
        have the unit of the output where nothing but the units differs, else that of the input.
        """

        def leg_of(leg: Leg) -> Leg:
            links = [self._link(one) for one in at.get(leg.port, ())]
            if leg.port in self.fed and leg.port in logs:
                links.append(_playback(logs[leg.port], step))
            return leg._replace(links=(*links, *leg.links))

        legs, links = connection.wire or Wire((Leg(connection.source),))
        legs = tuple(leg_of(leg) for leg in legs)
        last = tuple(self._link(one) for one in at.get(connection.target, ()))
        if connection.target in self.fed and connection.target in logs:
            log = logs[connection.target]
            if connection.wire is None:
                log = (log - connection.offset) / connection.gain
            last = (_playback(log, step), *last)
        if last and connection.wire is not None and (connection.gain, connection.offset) != (1.0, 0.0):
            converted = Gain(factor=connection.gain), Offset(value=connection.offset)
            last = (*(Link(effect, "conversion") for effect in converted), *last)
            connection = replace(connection, gain=1.0, offset=0.0)
        if connection.wire is None and not last and not any(leg.links for leg in legs):
            return connection
        return replace(connection, wire=Wire(legs, (*links, *last)))

    def _at_end(self, instance: Instance, name: str) -> bool:
        """Whether an input that nothing else feeds is given the log as a step ends, not as it begins.

        Gauss-Seidel gives so what passes at once to an output, and what comes from instances that have
        stepped; the log comes as these do. What integrates over the step would be early by half of it instead
        of late, and by all of it where the log is held. FMUs made of Python declare no states: that they hold
        some is recognised by outputs that no input passes to at once.
        """
        about = instance.fmu.description
        if not isinstance(self._master, GaussSeidel) or about.states:
            return False
        if Port(instance.name, name) in self._held and any(
            at in about.assumed or not inputs for at, inputs in instance.feedthrough.items()
        ):
            return False
        if any(name in inputs for at, inputs in instance.feedthrough.items() if at not in about.assumed):
            return True
        order = [self.system.instances[index].name for index in self.system.order]
        before = order[: order.index(instance.name)]
        return any(
            port.instance in before
            for one in self.system.connections
            if one.target.instance == instance.name
            for port in one.sources
        )

    @staticmethod
    def _link(one: Inserted) -> Link:
        # What it reads is put in by `_layout`, which knows the places of signals that logs replace.
        return Link(one.effect, "candidate", (), True)

    def _layout(
        self,
        system: System,
        logs: Mapping[Port, Array],
        inserted: Sequence[Inserted],
    ) -> tuple[Layout, list[int]]:
        """The layout, with signals that logs replace in place, and the places of the compared signals."""
        plain, step = Layout.of(system), float(self.step_size)
        wire_of = {one.connection.target: one.place for one in plain.wired}
        feed_of = {one.target: one.source for one in system.connections}

        def place(port: Port) -> int:
            if self.is_input(port):
                return wire_of[port] if port in wire_of else plain.index[feed_of[port]]
            return plain.index[port]

        reads = {id(one.effect): np.array([place(port) for port in one.reads], np.intp) for one in inserted}
        wired = [
            replace(
                one, links=tuple((effect, reads.get(id(effect), old)) for effect, old in one.links)
            )
            for one in plain.wired
        ]  # fmt: skip
        for port in self.fed:
            if self._is_log(port, logs):
                # Who reads the port sees the log, not only who is connected to it.
                link = _playback(logs[port], step)
                wired.append(_extra(port, plain.index[port], plain.index[port], ((link.effect, _NONE),)))
        size, seen = plain.size, [port for port in self.compared if not self.is_input(port)]
        places = []
        for port in self.compared:
            if self.is_input(port):
                places.append(place(port))
                continue
            own = tuple((one.effect, reads[id(one.effect)]) for one in inserted if one.port == port)
            wired.append(_extra(port, plain.index[port], size, own))
            places.append(size)
            size += 1
        more = size - plain.size
        layout = replace(
            plain,
            size=size,
            wired=tuple(wired),
            owners=(*plain.owners, *seen),
            nominal=np.concatenate([plain.nominal, np.ones(more)]),
            smooth=np.concatenate([plain.smooth, np.ones(more, np.bool_)]),
        )
        return layout, places


def between(samples: Array, parts: int, held: bool = False) -> Array:
    """Samples with others between them, shape ((n - 1) * parts + 1,).

    Args:
        samples: shape (n,).
        held: whether the signal stays at each sample until the next one; else along a smooth curve through
            them: what is driven by a line's corners is not what a smooth signal drives.
    """
    if parts == 1:
        return samples
    if held:
        return np.repeat(samples, parts)[: (len(samples) - 1) * parts + 1]
    from scipy.interpolate import Akima1DInterpolator

    curve = Akima1DInterpolator(np.arange(len(samples)), samples)
    found: Array = curve(np.arange((len(samples) - 1) * parts + 1) / parts)
    found[::parts] = samples
    return found


_NONE = np.zeros(0, np.intp)


def _playback(samples: Array, step: float, ahead: bool = False) -> Link:
    return Link(Playback.of(0.0, step, samples, ahead), "log", (), True)


def _undelayed(link: Link) -> Link:
    """A link whose value does not wait for the signal that it replaces."""
    return link._replace(at_once=False)


def _extra(port: Port, source: int, place: int, links: tuple[tuple[Effect, np.ndarray], ...]) -> Wired:
    """A signal of its own that no instance is fed."""
    wire = Wire((Leg(port),), tuple(Link(effect, "log") for effect, _ in links))
    return Wired(
        connection=Connection(port, port, wire=wire),
        place=place,
        source=np.array([source], np.intp),
        gain=np.ones(1),
        offset=np.zeros(1),
        links=links,
    )


class _Seen:
    """Keeps some signals of all points."""

    def __init__(self, places: np.ndarray, taken: Array) -> None:
        self._places, self._taken = places, taken

    def __call__(self, point: Point, signals: Signals) -> None:
        """See `BlockObserver`."""
        self._taken[:, point.index] = signals.values[self._places]

    def observe_block(self, first: int, times: Array, values: Array) -> None:
        """See `BlockObserver`."""
        self._taken[:, first : first + len(times)] = values[:, self._places].T
