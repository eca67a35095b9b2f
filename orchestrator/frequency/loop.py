"""The closed loop of a configured docking system, from the very config that the co-simulation runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ..base.errors import ConfigError, Problem, listed, nearest
from ..effects import Effect
from ..results.recorders import parameters_of
from ..simulation.run import Prepared, prepare
from ..system.connection import Connection
from ..system.system import System
from .connections import effect_note, effect_path, known_effects
from .plant import ACTIVE, MODELS, Paths, problems_of
from .quasi import QuasiPolynomial, characteristic
from .transfer import Transfer

__all__ = ["Loop", "Wire"]


_ANY_SYSTEM = "This analyses docking loops alone; `orchestrator.linearise` takes any system."


@dataclass(frozen=True)
class Wire:
    """A connection: (instance, variable) to (instance, variable); several to one target add up.

    Attributes:
        gain: of unit conversions and of a leg in a sum.
        effects: through which it goes, in turn, and their names.
    """

    source: tuple[str, str]
    target: tuple[str, str]
    gain: float = 1.0
    effects: tuple[tuple[str, Effect], ...] = ()

    def path(self, loop: str) -> Transfer:
        """What it makes of its source. Raises: ConfigError if an effect's law is not known here."""
        total = Transfer.gain(self.gain)
        for name, effect in self.effects:
            law = effect_path(effect)
            if law is None:
                place = f"{loop}: connection to {'.'.join(self.target)}"
                what = f"the effect {name} has no transfer function that is known here"
                allowed = f"known effects: {listed(known_effects())}"
                remedy = "Measure the response with orchestrator.frequency.sweep_system."
                raise ConfigError([Problem(place, what, allowed, remedy)])
            total = total * law
        return total


@dataclass(frozen=True)
class Loop:
    """The loop through a satellite, opened where the force acts on it; in contact, linear, small steps.

    Attributes:
        name: of the system, for messages and figures.
        models: instance -> model name, one of `plant.MODELS`; instances of other models are left out.
        wires: connections.
        parameters: "instance.parameter" -> value, SI. Arrays of one shape make a chart of loops. Where a
            controller is active, its `stiffness_estimate` and `damping_estimate` are the contact's own
            unless set.
        notes: what of the system the linear loop leaves out.
        others: instances of models that are unknown here, with the model's name.
        order: of all instances, in which the master gauss-seidel steps them.
    """

    name: str
    models: Mapping[str, str]
    wires: tuple[Wire, ...]
    parameters: Mapping[str, Any]
    notes: tuple[str, ...] = ()
    others: Mapping[str, str] = field(default_factory=dict)
    order: tuple[str, ...] = ()

    @staticmethod
    def of(config: str | Path | Mapping[str, Any] | Prepared, overrides: Iterable[str] = ()) -> Loop:
        """The loop of a config, as `orchestrator.simulation.run.prepare` takes it.

        Raises: ConfigError with all problems: of the config, of parameters, or that there is no such loop.
        """
        prepared = config if isinstance(config, Prepared) else prepare(config, overrides)
        return Loop.of_system(prepared.system, prepared.config.name)

    @staticmethod
    def of_system(system: System, name: str = "system") -> Loop:
        """The loop of a checked system. Raises: ConfigError as `of`."""
        models, others = {}, {}
        for one in system.instances:
            model = one.fmu.description.name.rpartition(".")[2]
            (models if model in MODELS else others)[one.name] = model
        wires = tuple(wire for one in system.connections for wire in _wires(one))
        order = tuple(system.instances[index].name for index in system.order)
        loop = Loop(name, models, wires, parameters_of(system), (), others, order)
        loop = replace(loop, notes=tuple(loop._left_out()))
        loop.gain()
        return loop

    @staticmethod
    def fits(system: System) -> bool:
        """Whether a system is one of those that are analysed here."""
        names = {one.fmu.description.name.rpartition(".")[2] for one in system.instances}
        return "SatelliteDynamics" in names

    def named(self, model: str) -> list[str]:
        """Names of the instances of a model."""
        return [name for name, one in self.models.items() if one == model]

    def with_parameters(self, changes: Mapping[str, Any]) -> Loop:
        """The same loop with other parameters, SI.

        Raises: ConfigError if one does not exist.
        """
        known = [
            *self.parameters,
            *(
                f"{name}.{kind}_estimate"
                for name in self.named("ComplianceController")
                for kind in ("stiffness", "damping")
            ),
        ]
        problems = [
            Problem(self.name, f"no parameter {name}", f"there are {listed(known)}", nearest(name, known))
            for name in changes
            if name not in known
        ]
        if problems:
            raise ConfigError(problems)
        return replace(self, parameters={**self.parameters, **changes})

    def only(self, model: str) -> str:
        """The name of the one instance of a model. Raises: ConfigError if there are none or several."""
        found = self.named(model)
        if len(found) != 1:
            raise ConfigError(
                [
                    Problem(
                        self.name,
                        f"{len(found)} instances of {model}: {listed(found)}"
                        if found
                        else f"no {model} in it",
                        "exactly one is needed",
                        "" if found else _ANY_SYSTEM,
                    )
                ]
            )
        return found[0]

    def parameters_of(self, name: str) -> Mapping[str, Any]:
        """Parameters of one instance."""
        own = {
            key.partition(".")[2]: value
            for key, value in self.parameters.items()
            if key.partition(".")[0] == name
        }
        if self.models[name] == "ComplianceController":
            contact = self.only("DockingContact")
            for kind in ("stiffness", "damping"):
                own.setdefault(f"{kind}_estimate", self.parameters[f"{contact}.{kind}"])
        return MappingProxyType(own)

    def transfers(self) -> dict[str, Paths]:
        """Per instance, the transfers between its ports. Raises: ConfigError for parameters out of range."""
        parameters = {name: self.parameters_of(name) for name in self.models}
        problems = [
            problem
            for name, model in self.models.items()
            for problem in problems_of(name, model, parameters[name])
        ]
        if problems:
            raise ConfigError(problems)
        return {name: MODELS[model](parameters[name]) for name, model in self.models.items()}

    def gain(self) -> Transfer:
        """L(s), the loop opened at the satellite's force: force that comes back = -L(s) * force that is
        given.

        Raises: ConfigError if there is no loop, if it runs through an unknown model, or if a part of it is a
            loop of its own.
        """
        satellite = self.only("SatelliteDynamics")
        motion = self.transfers()[satellite]
        back = self.force_from(
            {(satellite, name): motion["force", name] for name in ("position", "velocity")}
        )
        if not back.terms:
            raise ConfigError(
                [
                    Problem(
                        self.name,
                        f"no loop leads back to {satellite}.force",
                        "what is connected to it does not depend on the satellite's motion",
                    )
                ]
            )
        return -back

    def force_from(self, outputs: Mapping[tuple[str, str], Transfer]) -> Transfer:
        """The force on the satellite that follows from given outputs.

        Args:
            outputs: (instance, output) -> Laplace transform; the paths that lead to them are cut.
        Raises: ConfigError as `gain`.
        """
        transfers = self.transfers()
        incoming: dict[tuple[str, str], list[Wire]] = {}
        for wire in self.wires:
            incoming.setdefault(wire.target, []).append(wire)
        seen = dict(outputs)
        under_way: list[tuple[str, str]] = []

        def at(port: tuple[str, str]) -> Transfer:
            total = Transfer()
            for wire in incoming.get(port, ()):
                total += along(wire)
            return total

        def along(wire: Wire) -> Transfer:
            if wire.source in under_way:
                begin = under_way.index(wire.source)
                hops = " -> ".join(".".join(one) for one in [wire.source, *reversed(under_way[begin:])])
                what = f"algebraic loop, or one that does not pass through the satellite: {hops}"
                raise ConfigError(
                    [Problem(self.name, what, "only the loop through the satellite can be analysed")]
                )
            if wire.source not in seen:
                under_way.append(wire.source)
                seen[wire.source] = through(*wire.source)
                under_way.pop()
            # A path that carries nothing may hold what it likes.
            return seen[wire.source] * wire.path(self.name) if seen[wire.source].terms else Transfer()

        def through(name: str, output: str) -> Transfer:
            if name in self.others:
                what = f"{name} is a {self.others[name]}, whose transfer function is not known here"
                allowed = f"known models: {listed(MODELS)}"
                remedy = "Give the loop as orchestrator.frequency.Transfer, or measure it with sweep_system."
                raise ConfigError([Problem(self.name, what, allowed, remedy)])
            total = Transfer()
            for (source, target), path in transfers[name].items():
                if target == output:
                    total += path * at((name, source))
            return total

        return at((self.only("SatelliteDynamics"), "force"))

    def characteristic(self) -> QuasiPolynomial:
        """The closed loop's characteristic quasi-polynomial. Raises: ConfigError as `gain`."""
        return characteristic(self.gain(), self.name)

    def switching(self) -> list[str]:
        """Names of active controllers that give work of onset back, which is not linear and left out."""
        return [
            name
            for name in self.named("ComplianceController")
            if int(self.parameters[f"{name}.mode"]) == ACTIVE
            and self.parameters[f"{name}.switching_compensation"]
        ]

    def _left_out(self) -> list[str]:
        notes = []
        for name in self.named("ForceSensor"):
            if self.parameters.get(f"{name}.resolution"):
                notes.append(f"{name}.resolution: rounding is not linear and is left out")
        for name in self.named("ComplianceController"):
            notes.append(
                f"{name}: its sample hold counts as a delay of half a period; estimates stand still, "
                "by default at the true values"
            )
            if name in self.switching():
                notes.append(f"{name}.switching_compensation is not linear and is left out")
        for wire in self.wires:
            for name, effect in wire.effects:
                note = effect_note(effect)
                if note:
                    notes.append(f"{'.'.join(wire.source)} -> {'.'.join(wire.target)}: {name} {note}")
        return notes


def _wires(connection: Connection) -> list[Wire]:
    """A connection as one wire from each of its sources."""
    target = (*connection.target,)
    if connection.wire is None:
        return [Wire((*connection.source,), target, connection.gain)]
    effects = tuple((link.name, link.effect) for link in connection.wire.links)
    return [Wire((*leg.port,), target, leg.gain * connection.gain, effects) for leg in connection.wire.legs]
