"""The runs of a study, simulated as configured with their logs played in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ...base.errors import ConfigError, StepError
from ...fmi import Value
from ...simulation.run import prepare
from ...system.connection import Port
from .player import Player
from .study import Array, PortRun, PortStudy


def player_of(study: PortStudy, fed: Sequence[Port], compared: Sequence[Port]) -> Player:
    """What runs the system of a study."""
    prepared, interval = study.prepared, study.prepared.grid.step_size * study.parts
    instances = tuple(
        replace(one, fmu=study.natives.get(getattr(one.fmu, "path", Path()), one.fmu))
        for one in prepared.system.instances
    )
    system = replace(prepared.system, instances=instances)
    return Player(system, prepared.master, interval, fed, compared, study.parts, study.held)


class Replay:
    """A study's system, driven by the logs of fed ports, seen at the compared ports."""

    def __init__(self, study: PortStudy) -> None:
        self.study = study
        self._player = player_of(study, study.fed, study.compared)

    def signals(
        self,
        run: PortRun,
        calibrated: Mapping[str, float] | None = None,
        stops: list[StepError] | None = None,
    ) -> dict[Port, Array]:
        """Simulated signals of the compared ports in their units, each of shape (samples,).

        Args:
            calibrated: values of calibrated parameters, by name; others are as the study says.
            stops: see `Player.run`.
        """
        study = self.study
        start: dict[Port, Value] = {
            Port.of(name): (calibrated or {}).get(name, one.value) for name, one in study.nominal.items()
        }
        for port, column in study.columns.items():
            if column.start and port in run.logs:
                start[port] = float(run.logs[port][0])
        start.update(run.values)
        return self._player.run(run.logs, len(run), start, stops=stops)


def with_steps(study: PortStudy, parts: int) -> PortStudy | None:
    """The study with so many communication steps where it has one; None if an FMU cannot take such steps.

    Instances whose `step_size` the config gives keep it.
    """
    step = float(study.prepared.grid.step_size / parts)
    try:
        prepared = prepare(study.prepared.config, [f"run.step_size={step!r} s"])
    except ConfigError:
        return None
    return replace(study, prepared=prepared, parts=study.parts * parts)
