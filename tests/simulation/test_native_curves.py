"""Inputs along curves in the native loop: the same bits, the same errors as the interpreter's."""

from __future__ import annotations

import ctypes
from fractions import Fraction
from pathlib import Path

import foreign
import numpy as np
import pytest
from assembled import assemble
from test_native_loop import CURVED, Kept, both, every_version, ring
from unruly import unruly_fmu

from orchestrator.base.errors import ConfigError
from orchestrator.fmi import load_fmu
from orchestrator.fmi.fmi2 import Fmi2Instance
from orchestrator.master.jacobi import Jacobi
from orchestrator.master.running_instances import instantiate
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import Report, simulate
from orchestrator.simulation.native import choice
from orchestrator.system.assembly import Part

FOLDER = Path(__file__).parents[2] / "fmus"


@pytest.mark.parametrize("master", CURVED)
@every_version
@pytest.mark.parametrize("effect", ["delay", "noise"])
def test_bits_are_the_same_along_curves_through_effects_and_parts_of_a_step(effect, master, version):
    """What an effect makes of signals that are yet to come is made of those that are supposed to come."""
    fmu = load_fmu(unruly_fmu(version))
    given = {"delay": {"time": "5 ms"}, "noise": {"deviation": "1 mm", "period": "3 ms", "seed": 4}}[effect]
    through = [{"effect": effect, **given}]
    starts = zip(("one", "two", "three"), ({}, {}, {"rate": "0.1 mm"}), (1, 7, 1), strict=True)
    parts = [Part(name, fmu, start, ratio=Fraction(1, own)) for name, start, own in starts]
    links = [
        {"from": "three.level", "to": "one.rate", "through": through},
        {"from": "one.level", "to": "two.rate", "through": through},
    ]
    kept = both(assemble(parts, links), master, 2100)
    assert kept.error is None and len(np.unique(kept.results["two.level"])) > 2000


def followed_in_other_units(ratio=Fraction(1)):
    """A response that follows the course of its input, given in mm, in a ring."""
    command = Part("source", load_fmu(unruly_fmu(2, "mm", "mm")))
    response = load_fmu(FOLDER / "RobotResponse" / "RobotResponse.fmu")
    assert response.description.followed == {"command"}
    start = Part("start", load_fmu(unruly_fmu(3, "m", "m")), {"rate": "1 mm"})
    back = {"from": ["robot.position", "start.level"], "to": "source.rate"}
    robot = Part("robot", response, ratio=ratio)
    return assemble([command, robot, start], ["source.level -> robot.command", back])


whole_or_in_parts = pytest.mark.parametrize("ratio", [Fraction(1), Fraction(1, 3)])


@whole_or_in_parts
@pytest.mark.parametrize("master", CURVED)
def test_fmus_that_follow_their_inputs_are_reported_the_same_derivatives(master, ratio):
    kept = both(followed_in_other_units(ratio), master, 2100)
    assert kept.error is None and len(np.unique(kept.results["robot.position"])) > 2000


@whole_or_in_parts
@pytest.mark.parametrize("name", ["fmi2SetReal", "fmi2SetRealInputDerivatives"])
@pytest.mark.parametrize("master", CURVED)
def test_inputs_and_derivatives_that_are_refused_are_reported_the_same(master, name, ratio, monkeypatch):
    """In parts of a step, the 1500th call is in a later one."""
    calls = []

    arrays = 2 if name.endswith("Derivatives") else 1

    @ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * 2, ctypes.c_size_t, *[ctypes.c_void_p] * arrays)
    def refuse(*_):
        calls.append(1)
        return 3 if len(calls) == 1500 else 0

    refuse.__name__ = name

    def found(self, find=Fmi2Instance._find_functions):
        find(self)
        if self.name == "robot":
            self._slave._functions[name] = refuse

    monkeypatch.setattr(Fmi2Instance, "_find_functions", found)
    seen = []
    for loop in ("native", "python"):
        calls.clear()
        seen.append(Kept(followed_in_other_units(ratio), master, 2100, loop))
    assert seen[0].seen == seen[1].seen
    assert seen[0].error[1] == "robot" and f"{name} returned error" in seen[0].error[0]


@pytest.mark.parametrize("master", CURVED)
def test_what_jumps_is_held_in_the_same_bits_where_an_fmu_follows_its_other_inputs(master):
    response, contact = (
        load_fmu(FOLDER / name / f"{name}.fmu") for name in ("RobotResponse", "DockingContact")
    )
    parts = [
        Part("source", load_fmu(unruly_fmu(2)), {"rate": "1 m"}),
        Part("robot", response),
        Part("contact", contact, ratio=Fraction(1, 3)),
    ]
    through = [{"effect": "quantise", "resolution": "0.3 mm"}]
    jumping = {"from": "robot.position", "to": "contact.position", "through": through}
    links = ["source.level -> robot.command", jumping, "robot.velocity -> contact.velocity"]
    kept = both(assemble(parts, links), master, 2100)
    assert kept.error is None and len(np.unique(kept.results["contact.force"])) > 1000


def test_what_curves_do_in_python_is_left_to_it(tmp_path):
    """FMUs of FMI 3 ask for values within a step; the books of bonds need the course of each input."""
    fmu = load_fmu(foreign.within(tmp_path / "Within.fmu"))
    parts = [Part("one", fmu, {"w": 0, "u": 1}), Part("two", fmu, {"w": 0})]
    system = assemble(parts, ["one.x -> two.u"])
    report, grid = Report(), Grid(Fraction(0), Fraction(1, 700), 10)
    with pytest.raises(ConfigError, match="instance one takes the course of its inputs in Python"):
        simulate(system, Jacobi(extrapolation=1), grid, loop="native")
    simulate(system, Jacobi(extrapolation=1), grid, report=report)
    assert report.loop == "python"
    simulate(system, Jacobi(), grid, loop="native")
    with instantiate(ring(2)) as instances:
        assert not choice.obstacle(instances, Jacobi(extrapolation=1))
        assert "in Python" in choice.obstacle(instances, Jacobi(extrapolation=1), ledger=True)
