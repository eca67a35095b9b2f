"""Energy ledger of a system's interfaces: where force and velocity were both logged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...base.errors import listed
from ...fmi import Causality
from ...system.connection import Port
from ..finding import NOMINAL, Augmented, Finding
from ..study import Array
from .conjugate import Conjugate, conjugates
from .motion import phases
from .replay import PortReplay
from .study import PortRun, PortStudy, Role

__all__ = ["Pair", "energy", "pairs", "unclear"]


@dataclass(frozen=True)
class Pair:
    """A force and a velocity of one instance, one of them fed to it and the other given by it."""

    force: Port
    velocity: Port

    @property
    def name(self) -> str:
        """Of the pair."""
        return f"{self.force} x {self.velocity.variable}"


def pairs(study: PortStudy, run: PortRun) -> tuple[Pair, ...]:
    """Those of which a run has logged both, at the port itself or at the output that feeds it."""
    return tuple(Pair(one.force, one.velocity) for one in _logged(study, run) if one.alone)


def unclear(study: PortStudy) -> str:
    """Of which logged forces it is not known along which velocity they do work, and why; "" of none."""
    logged = (one for run in study.runs for one in _logged(study, run))
    forces = dict.fromkeys(str(one.force) for one in logged if not one.alone)
    if not forces:
        return ""
    return f"along which velocity the force acts is not known of {listed(list(forces), 9)}"


def _logged(study: PortStudy, run: PortRun) -> list[Conjugate]:
    """Forces and velocities that may go together, and that a run has logged both."""
    return [
        one
        for instance in study.prepared.system.instances
        for one in conjugates(instance)
        if all(_signal(study, port, run.logs, {}) is not None for port in (one.force, one.velocity))
    ]


def _signal(
    study: PortStudy, port: Port, logs: Mapping[Port, Array], given: Mapping[Port, Array]
) -> Array | None:
    """A port's signal from logs, else as given: its own, or that of the output that feeds it."""
    for signals in (logs, given):
        if port in signals:
            return signals[port]
    for one in study.prepared.system.connections:
        if one.target == port and one.wire is None:
            source = logs.get(one.source, given.get(one.source))
            return None if source is None else one.gain * source + one.offset
    return None


def energy(study: PortStudy, finding: Finding) -> dict[str, Any]:
    """Energy that goes into components at their measured interfaces, by phase of motion.

    The force as its port has it times the velocity, summed over the samples of the held-out runs (train runs
    where there are none).

    Returns: `interfaces`, pair and phase; by each of them `measured`, `nominal` (the model as handed over),
        `excess` (measured less nominal), `answer` (of the model with the effects) [J]; `change`, what each
        adds up to; `parts`, the excess of each split into what the force and what the velocity does of it,
        which add up to it. Empty where no interface was measured.
    """
    told: dict[str, dict[str, float]] = {name: {} for name in ("measured", "nominal", "excess", "answer")}
    parts: dict[str, dict[str, float]] = {}
    step = study.interval
    for run in study.of(Role.HELDOUT) or study.of(Role.TRAIN):
        among = pairs(study, run)
        if not among:
            continue
        names, labels = phases(study, run, {})
        models = {
            name: _modelled(study, run, model, among)
            for name, model in (("nominal", NOMINAL), ("answer", finding.answer))
        }
        for pair in among:
            signals = {"measured": _both(study, pair, run.logs, {})}
            kept = {port: log for port, log in run.logs.items() if port not in study.compared}
            signals |= {name: _both(study, pair, kept, given) for name, given in models.items()}
            for number, phase in enumerate(names):
                inside = labels == number
                inside[: study.settled] = False
                key = f"{pair.name}, {phase}"
                works = {
                    name: step * float(force[inside] @ velocity[inside])
                    for name, (force, velocity) in signals.items()
                }
                works["excess"] = works["measured"] - works["nominal"]
                for name, value in works.items():
                    told[name][key] = told[name].get(key, 0.0) + value
                (force, velocity), (force_0, velocity_0) = signals["measured"], signals["nominal"]
                mean = 0.5 * (velocity + velocity_0), 0.5 * (force + force_0)
                split = parts.setdefault(key, {"force": 0.0, "velocity": 0.0})
                split["force"] += step * float((force - force_0)[inside] @ mean[0][inside])
                split["velocity"] += step * float((velocity - velocity_0)[inside] @ mean[1][inside])
    if not parts:
        return {}
    return {
        "unit": "J",
        "interfaces": list(parts),
        **told,
        "change": {name: float(sum(values.values())) for name, values in told.items()},
        "parts": parts,
    }


def _both(
    study: PortStudy, pair: Pair, logs: Mapping[Port, Array], given: Mapping[Port, Array]
) -> tuple[Array, Array]:
    force, velocity = (_signal(study, port, logs, given) for port in (pair.force, pair.velocity))
    assert force is not None and velocity is not None
    return force, velocity


def _modelled(study: PortStudy, run: PortRun, model: Augmented, among: tuple[Pair, ...]) -> dict[Port, Array]:
    """What a model gives at the outputs that the pairs are made of, and that nothing replaces."""
    ports: dict[Port, None] = {}
    for port in (port for pair in among for port in (pair.force, pair.velocity)):
        for one in study.prepared.system.connections:
            if one.target == port:
                port = one.source
        given = port in study.given and port in run.logs
        if not given and study.prepared.system.variable(port).causality is Causality.OUTPUT:
            ports[port] = None
    replay = PortReplay(study, [run], seen=list(ports))
    return replay.signals(run, model.calibrated, model.effects, model.theta)
