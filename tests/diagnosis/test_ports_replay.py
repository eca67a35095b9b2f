"""Replay of the logs of any system: exact where nothing is hidden, and through any effect."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
import yaml
from ports_bench import COULOMB, POSITION, VOLTAGE, study

from orchestrator.diagnosis.finding import NOMINAL, Augmented
from orchestrator.diagnosis.ports.candidates import candidates
from orchestrator.diagnosis.ports.player import Inserted, Player
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay, measure
from orchestrator.diagnosis.ports.study import Role
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
    replay = PortReplay(found, found.runs)
    # The logs are those of other strokes than the config's: nothing but they can have brought the motion.
    for run_ in found.runs:
        given = replay.signals(run_, {}, (), np.zeros(0))
        for port in (POSITION, VOLTAGE):
            assert np.abs(given[port] - run_.logs[port]).max() <= 1e-9 * np.abs(run_.logs[port]).max()
            assert np.ptp(run_.logs[port]) > 0.1


def test_only_the_faulty_component_leaves_a_residual(tmp_path):
    """Driven by what was measured each, the controller is as it should be, the drive is not."""
    path = study(tmp_path, [COULOMB], seed=None)
    found = load_port_study(fed(path, "controller.voltage"))
    found = replace(found, fed=tuple(dict.fromkeys((*found.fed, VOLTAGE))))
    replay = PortReplay(found, found.of(Role.TRAIN))
    given = replay.signals(replay.runs[0], {}, (), np.zeros(0))
    assert np.abs(given[POSITION] - replay.runs[0].logs[POSITION]).max() > 1e-3
    law = next(one for one in candidates(found, measure(found, replay.runs[0])) if one.id == "drive.coulomb")
    given = replay.signals(replay.runs[0], {}, (law,), np.array([12.0, 1e-3]))
    # The hidden law's corner is rounded off by another width.
    assert np.abs(given[POSITION] - replay.runs[0].logs[POSITION]).max() < 2e-4


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


def test_effects_of_size_zero_change_nothing(noiseless):
    found = load_port_study(noiseless)
    replay = PortReplay(found, found.of(Role.TRAIN))
    before = replay.of(NOMINAL)
    seen = 0
    for effect in candidates(found, measure(found, replay.runs[0])):
        theta = np.array([(one.starts or (0.0,))[0] if one.shape else 0.0 for one in effect.parameters])
        after = replay.of(Augmented({}, (effect,), theta))
        for a, b in zip(before, after, strict=True):
            assert np.array_equal(a, b), effect.id
        seen += 1
    assert seen > 50


class Slow(Gain):
    """A gain that the native loop refuses."""

    jittable = False


def test_a_model_that_runs_away_is_told_in_both_loops(noiseless):
    found = load_port_study(noiseless)
    run = found.runs[0]
    player = PortReplay(found, [run]).player
    for kind in (Gain, Slow):
        given = player.run(run.logs, 200, {}, [Inserted(kind(factor=-1e200), VOLTAGE)])
        assert np.isnan(given[POSITION][-1]) and given[POSITION][0] == 0.0
