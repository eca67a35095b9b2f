"""Components of a system, each driven by what was measured, and the loop closed anew in short windows."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ...fmi import Causality, Kind, Value
from ...system.connection import Port
from ..finding import Augmented
from ..study import Array
from .playback import Release
from .player import Inserted, between
from .replay import PortReplay, player_of
from .study import PortRun, PortStudy

__all__ = ["Apart", "Component", "Window", "closed", "components", "driven_of", "estimates", "modelled"]

# Windows of a run, and the fewest samples of one, where the study does not tell.
_WINDOWS, _SHORTEST = 20, 25


@dataclass(frozen=True)
class Component:
    """An instance whose outputs were logged and compared, with those that stand unlogged before it.

    Attributes:
        places: the instances, the compared one first.
        ports: outputs of the compared one that are compared, or drive others.
    """

    places: tuple[str, ...]
    ports: tuple[Port, ...]

    @property
    def name(self) -> str:
        """Of all its places."""
        return "+".join(reversed(self.places))


@dataclass(frozen=True)
class Window:
    """Samples of a run: from `lead` on measured signals drive, from `begin` on the model goes ahead, until
    `end`, which is excluded.
    """

    lead: int
    begin: int
    end: int


def components(study: PortStudy) -> tuple[Component, ...]:
    """The components that the compared ports of a study distinguish, in the order of the system."""
    system = study.prepared.system
    given = set(study.given)
    measured = list(dict.fromkeys(port.instance for port in study.compared))
    feeders: dict[str, list[str]] = {}
    for connection in system.connections:
        for source in connection.sources:
            if source not in given:
                feeders.setdefault(connection.target.instance, []).append(source.instance)
    driven = driven_of(study)
    found, taken = [], set(measured)
    for name in (one.name for one in system.instances if one.name in measured):
        chain = [name]
        for member in chain:
            for feeder in feeders.get(member, ()):
                if feeder not in taken and feeder in driven:
                    taken.add(feeder)
                    chain.append(feeder)
        sources = {port for one in system.connections for port in one.sources} - given
        variables = next(one for one in system.instances if one.name == name).fmu.description.variables
        ports = [Port(name, variable) for variable in variables]
        real = [port for port in ports if system.variable(port).kind is Kind.REAL]
        own = tuple(port for port in real if port in study.compared or port in sources)
        found.append(Component(tuple(chain), own))
    return tuple(found)


def driven_of(study: PortStudy) -> set[str]:
    """Instances that something is fed to."""
    targets = {one.target.instance for one in study.prepared.system.connections}
    return targets | {
        port.instance
        for port in study.fed
        if study.prepared.system.variable(port).causality is Causality.INPUT
    }


def estimates(study: PortStudy, run: PortRun, model: Augmented) -> dict[Port, Array]:
    """Signals of a run at all ports that `Apart` needs: as logged, else as a model gives them.

    Those of the outputs of components, of sources that nothing drives, and of outputs that take start values,
    each of shape (n,).
    """
    return {port: run.logs.get(port, values) for port, values in modelled(study, run, model).items()}


def closed(study: PortStudy) -> PortStudy:
    """The study with its loops closed: nothing fed that comes from what is compared."""
    return replace(study, fed=study.given)


def modelled(study: PortStudy, run: PortRun, model: Augmented) -> dict[Port, Array]:
    """The signals of `estimates` as a model gives them, each of shape (n,)."""
    system, given = study.prepared.system, set(study.given)
    wanted = dict.fromkeys(port for one in components(study) for port in one.ports)
    sources = {port for one in system.connections for port in one.sources}
    driven = driven_of(study)
    wanted |= dict.fromkeys(
        port for port in sources if port.instance not in driven and system.variable(port).kind is Kind.REAL
    )
    wanted |= dict.fromkeys(_startable(study))
    seen = [port for port in wanted if port not in given]
    return PortReplay(study, [run], seen=seen).signals(run, model.calibrated, model.effects, model.theta)


def _startable(study: PortStudy) -> list[Port]:
    """Outputs of driven instances that take start values: states that can be taken up anew."""
    driven = driven_of(study)
    return [
        Port(one.name, name)
        for one in study.prepared.system.instances
        if one.name in driven
        for name, variable in one.fmu.description.variables.items()
        if variable.causality is Causality.OUTPUT
        and variable.kind is Kind.REAL
        and not variable.shape
        and variable.settable
        and variable.start is not None
    ]


class Apart:
    """A run taken apart: windows in which each component is driven by measured signals, or the loop closed.

    Components are taken up at a window's lead by the start values of their outputs, where they take any, and
    led by measured signals up to its begin; what they remember beyond that is lost; see `where.lasting`.

    Args:
        signals: see `estimates`.
        base: the model whose residuals are sought; without effects.
    """

    def __init__(
        self, study: PortStudy, run: PortRun, signals: Mapping[Port, Array], base: Augmented
    ) -> None:
        self.study, self.run, self.signals = study, run, signals
        self.components = components(study)
        self.ports = tuple(port for one in self.components for port in one.ports)
        given = {port: run.logs[port] for port in study.given if port in run.logs}
        driven = driven_of(study)
        given |= {port: values for port, values in signals.items() if port.instance not in driven}
        self._given = given
        replay = PortReplay(study, [run])
        self._start, self._inserted = replay.made(base.calibrated, base.effects, base.theta)
        self._open, self._closed = (
            player_of(study, fed, self.ports) for fed in ((*given, *self.ports), tuple(given))
        )

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        """Side by side from the end of settling on."""
        n, first = len(self.run), max(self.study.settled, 1)
        size = self.study.window or max((n - first) // _WINDOWS, _SHORTEST)
        count = max((n - first) // size, 1)
        edges = np.linspace(first, n, count + 1).astype(int).tolist()
        lead = self.study.leads * size
        return tuple(Window(max(begin - lead, 0), begin, end) for begin, end in pairwise(edges))

    def residuals(self, window: Window) -> dict[Port, Array]:
        """Measured minus given by each component driven by measured signals, from the lead on."""
        logs = self._logs(window) | {
            port: self.signals[port][window.lead : window.end] for port in self.ports
        }
        found = self._open.run(logs, window.end - window.lead, self._taken_up(window), self._inserted)
        return {port: logs[port] - found[port] for port in self.ports}

    def ahead(
        self, window: Window, residuals: Mapping[Port, Array], injected: Collection[int]
    ) -> dict[Port, Array]:
        """The loop closed at the begin of a window, with the residuals of some components injected.

        Returns: what the components' ports give, from the begin on.
        """
        parts, first = self.study.parts, window.begin - window.lead
        step = self.study.interval / parts
        inserted = list(self._inserted)
        for number, component in enumerate(self.components):
            for port in component.ports:
                added = residuals[port] if number in injected else np.zeros(window.end - window.lead)
                held = self.signals[port][window.lead : window.end]
                hold = port in self.study.held
                held, added = (between(values, parts, hold) for values in (held, added))
                inserted.append(Inserted(Release.of(step, held[: first * parts], added), port))
        found = self._closed.run(
            self._logs(window), window.end - window.lead, self._taken_up(window), inserted
        )
        return {port: values[first:] for port, values in found.items()}

    def _logs(self, window: Window) -> dict[Port, Array]:
        return {port: values[window.lead : window.end] for port, values in self._given.items()}

    def _taken_up(self, window: Window) -> dict[Port, Value]:
        """Start values at a window's lead."""
        values = {**self.run.logs, **self.signals}
        start: dict[Port, Value] = {
            port: float(values[port][window.lead]) for port in _startable(self.study) if port in values
        }
        return {**start, **self._start}
