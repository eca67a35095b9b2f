"""What logs take the place of altogether does not step in replays, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import pytest
from ports_bench import COULOMB, POSITION, VELOCITY, VOLTAGE, study

from orchestrator.diagnosis.study import player
from orchestrator.diagnosis.study.idle import without_idle
from orchestrator.diagnosis.study.player import Inserted
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.replay import player_of
from orchestrator.effects.delay import Delay
from orchestrator.effects.gain import Gain
from orchestrator.master.iterative import Iterative
from orchestrator.master.jacobi import Jacobi
from orchestrator.system.connection import Connection, Leg, Link, Port, Wire

PATH = Port("path", "position")


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    return load_port_study(study(tmp_path_factory.mktemp("idle"), [COULOMB]))


def idle(system):
    """Names of the instances that never step."""
    return {one.name for one in system.instances if one.ratio > Fraction(1 << 30)}


def test_signals_are_equal_to_the_bit_where_idle_instances_step(rubbing, monkeypatch):
    reported = []

    def noting(*args):
        found = without_idle(*args)
        reported.append(idle(found))
        return found

    def given():
        run, own = rubbing.runs[0], player_of(rubbing, rubbing.fed, rubbing.compared)
        models = [[], [Inserted(Gain(factor=0.9), VOLTAGE)], [Inserted(Gain(factor=0.9), POSITION, (PATH,))]]
        return [own.run(run.logs, len(run), inserted=one) for one in models]

    monkeypatch.setattr(player, "without_idle", noting)
    quick = given()
    assert reported == 3 * [{"path"}]
    monkeypatch.setattr(player, "without_idle", lambda system, *_: system)
    for one, other in zip(quick, given(), strict=True):
        assert all(one[port].tobytes() == other[port].tobytes() for port in (POSITION, VOLTAGE))


def test_what_is_looked_at_steps(rubbing):
    system, master = rubbing.prepared.system, rubbing.prepared.master
    assert idle(without_idle(system, master, {POSITION}, {PATH}, {PATH})) == {"path"}
    assert idle(without_idle(system, master, {POSITION, Port("path", "velocity")}, {PATH}, {PATH})) == set()
    assert idle(without_idle(system, master, {POSITION}, set(), set())) == set()
    # A chain of what drives only what is fed is idle; what feeds a signal that is seen is not.
    assert idle(without_idle(system, master, {POSITION}, {VOLTAGE}, {VOLTAGE})) == {"path", "controller"}
    assert idle(without_idle(system, master, {VOLTAGE}, {POSITION, VELOCITY, PATH}, set())) == {
        "path",
        "drive",
    }
    target = Port("controller", "reference")
    assert idle(without_idle(system, master, {POSITION}, {target}, set())) == {"path"}
    assert idle(without_idle(system, master, {POSITION, target}, {target}, set())) == set()


def test_what_effects_read_steps(rubbing):
    reading = Wire((Leg(VOLTAGE),), (Link(Delay(time=0.01), "delay", (PATH,)),))
    fed = Connection(VOLTAGE, Port("drive", "voltage"), wire=reading)
    system = rubbing.prepared.system
    others = [one for one in system.connections if one.target != fed.target]
    system = replace(system, connections=(*others, fed))
    master, seen = rubbing.prepared.master, {POSITION}
    assert idle(without_idle(system, master, seen, {PATH}, set())) == set()
    assert idle(without_idle(system, master, seen, {PATH}, {PATH})) == {"path"}


def test_masters_that_know_no_slow_instances_step_all(rubbing):
    system = rubbing.prepared.system
    asked = {POSITION}, {PATH}, {PATH}
    assert idle(without_idle(system, Jacobi(), *asked)) == {"path"}
    assert without_idle(system, Jacobi(extrapolation=1), *asked) is system
    assert without_idle(system, Iterative(tolerance=1e-6), *asked) is system
