"""Replay of the logs of any system: exact where nothing is hidden, and through any effect."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
import yaml
from ports_bench import COULOMB, POSITION, VOLTAGE, simulated, study, system

from orchestrator.diagnosis.study.player import Inserted, Player
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.replay import Replay, player_of
from orchestrator.effects.gain import Gain


def fed(path, *ports):
    """The study with outputs fed, too."""
    data = yaml.safe_load((path / "study.yaml").read_text())
    for port in ports:
        data["columns"][port]["feed"] = True
    (path / "fed.yaml").write_text(yaml.safe_dump(data))
    return path / "fed.yaml"


@pytest.mark.parametrize("ports", [(), ("drive.position",), ("controller.voltage",),
                                   ("drive.position", "controller.voltage")])  # fmt: skip
def test_logs_of_the_system_itself_replay_exactly(noiseless, ports):
    """As one chain, and component by component."""
    found = load_port_study(fed(noiseless, *ports))
    replay = Replay(found)
    # The logs are those of other strokes than the config's: nothing but they can have brought the motion.
    for run_ in found.runs:
        given = replay.signals(run_)
        for port in (POSITION, VOLTAGE):
            assert np.abs(given[port] - run_.logs[port]).max() <= 1e-9 * np.abs(run_.logs[port]).max()
            assert np.ptp(run_.logs[port]) > 0.1


def test_only_the_faulty_component_leaves_a_residual(tmp_path):
    """Driven by what was measured each, the controller is as it should be, the drive is not."""
    path = study(tmp_path, [COULOMB], seed=None)
    found = load_port_study(fed(path, "controller.voltage"))
    found = replace(found, fed=tuple(dict.fromkeys((*found.fed, VOLTAGE))))
    given, log = simulated(found), found.runs[0].logs
    assert np.abs(given[POSITION] - log[POSITION]).max() > 1e-3
    data = yaml.safe_load((path / "fed.yaml").read_text())
    (path / "machine.yaml").write_text(yaml.safe_dump(system(0.2, [COULOMB])))
    (path / "fed.yaml").write_text(yaml.safe_dump(data | {"system": "machine.yaml"}))
    right = simulated(load_port_study(path / "fed.yaml"))
    assert np.abs(right[POSITION] - log[POSITION]).max() < 1e-9


def test_fmus_of_other_tools_are_not_run_in_threads(noiseless):
    found = load_port_study(noiseless)
    system = found.prepared.system
    fmu = system.instances[0].fmu
    foreign = copy(fmu)
    foreign.description = replace(fmu.description, tool="another tool")
    instances = (replace(system.instances[0], fmu=foreign), *system.instances[1:])
    player = Player(
        replace(system, instances=instances), found.prepared.master, found.prepared.grid.step_size, (), ()
    )
    assert not player.parallel


class Slow(Gain):
    """A gain that the native loop refuses."""

    jittable = False


def test_a_model_that_runs_away_is_reported_in_both_loops(noiseless):
    found = load_port_study(noiseless)
    run = found.runs[0]
    player = player_of(found, found.fed, found.compared)
    for kind in (Gain, Slow):
        given = player.run(run.logs, 200, {}, [Inserted(kind(factor=-1e200), VOLTAGE)])
        assert np.isnan(given[POSITION][-1]) and given[POSITION][0] == 0.0
