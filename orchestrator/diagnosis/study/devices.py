"""Devices that change at events only, as thermostats and sampled controllers, replaced by their logs.

A system with such a device is simulated by its master, with laws at ports only, and a small law moves each
switching of its loop. With the device's outputs fed from their logs, all other components can be searched.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...fmi import Causality, CompiledFmu, Variability
from ...system.connection import Port
from ...system.system import Instance
from .mistakes import Warned
from .replay import Replay
from .study import PortStudy, Role

# Misfit of a device driven by the logs, over the variance of its log, up to which it is taken as right.
_RIGHT = 0.25


def with_devices_fed(study: PortStudy) -> tuple[PortStudy, list[Warned]]:
    """The study with the compared outputs of devices fed, where these do what their logs say.

    Returns: the study, and which devices are not searched.
    """
    warned = []
    connections = study.prepared.system.connections
    read = {port for one in connections for port in one.sources}
    for one in study.prepared.system.instances:
        own = [port for port in study.compared if port.instance == one.name]
        unlogged = {port for port in read if port.instance == one.name} - {*own, *study.fed}
        others = [port for port in study.compared if port not in own]
        whole = all(port in run.logs and port not in run.gaps for run in study.runs for port in own)
        if not own or unlogged or not others or not whole or not _is_device(one):
            continue
        if not _as_logged(study, own, others):
            continue
        study = _fed(study, own)
        warned.append(
            Warned(
                place=one.name,
                what="changes at events only; its logged outputs are fed, so that laws are found inside the "
                "other components, and none inside this one",
                remedy="It does about what its logs say; a small fault of it is not found.",
            )
        )
    return study, warned


def _is_device(one: Instance) -> bool:
    if not isinstance(one.fmu, CompiledFmu) or one.fmu.description.states:
        return False
    return any(
        each.variability is Variability.DISCRETE and each.causality in (Causality.OUTPUT, Causality.LOCAL)
        for each in one.fmu.description.variables.values()
    )


def _as_logged(study: PortStudy, own: list[Port], others: list[Port]) -> bool:
    """Whether a device that reads what is logged gives what is logged."""
    run = study.of(Role.TRAIN)[0]
    alone = replace(study, fed=(*study.fed, *others), compared=tuple(own))
    given = Replay(alone).signals(run)
    for port in own:
        log, found = run.logs[port][study.settled :], given[port][study.settled :]
        if not float(np.mean((log - found) ** 2)) <= _RIGHT * float(np.var(log)):
            return False
    return True


def _fed(study: PortStudy, own: list[Port]) -> PortStudy:
    """The study with a device's outputs fed: held between samples or not, as other signals fit better."""
    made = []
    run = study.of(Role.TRAIN)[0]
    for hold in (True, False):
        columns = {
            port: one.model_copy(update={"hold": hold}) if port in own else one
            for port, one in study.columns.items()
        }
        compared = tuple(port for port in study.compared if port not in own)
        fed = replace(study, columns=columns, fed=(*study.fed, *own), compared=compared)
        given = Replay(fed).signals(run)
        left = sum(
            float(np.mean(((run.logs[port] - given[port]) / (study.columns[port].noise or 1.0)) ** 2))
            for port in compared
            if port in run.logs
        )
        made.append((left if np.isfinite(left) else np.inf, fed))
    return min(made, key=lambda one: one[0])[1]
