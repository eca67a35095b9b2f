"""Python components are replayed in their native form where they have one, and give the same."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from orchestrator.diagnosis.study.native import in_native_form
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.replay import Replay, player_of
from orchestrator.system.system import Port
from orchestrator.translate.inserted import own_source
from orchestrator.translate.python_fmu import build_python_fmu

TANK = '''"""A tank with an outlet."""

import math

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real


class Tank(Fmi2Slave):
    description = "A tank with an outlet"
    requirements = ("numpy>=2.0",)

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.area, self.inflow, self.level = 2.0, 0.0, 1.0
        {hidden}
        parameter = {{"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}}
        self.register_variable(Real("area", description="of the outlet", **parameter))
        self.register_variable(Real("inflow", causality=Fmi2Causality.input, description="into the tank"))
        out = {{"causality": Fmi2Causality.output, "initial": Fmi2Initial.exact}}
        self.register_variable(Real("level", description="of the water", **out))
        self.type_attributes = {{"area": {{"unit": "m2"}}, "inflow": {{"unit": "m3/s"}},
                                "level": {{"unit": "m"}}}}
        self.dependencies = {{"level": ()}}
        self.initial_dependencies = {{"level": ()}}

    def do_step(self, current_time, step_size):
        {memory}
        self.level += step_size * (self.inflow - self.area * math.sqrt(max(self.level, 0.0)))
        return True
'''
SYSTEM = {
    "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "10 s"},
    "instances": {"tank": {"fmu": "tank.fmu", "start": {"inflow": "2 m3/s"}}},
    "connections": [],
}
STUDY = {
    "format": "port-study/1",
    "system": "system.yaml",
    "columns": {"tank.inflow": "q", "tank.level": {"column": "h", "noise": "1 mm"}},
    "runs": [{"file": "a.csv", "role": "train"}],
}


def made(folder, hidden="", memory=""):
    """A study of a tank whose code may remember what it does not tell."""
    source = TANK.format(hidden=hidden or "pass", memory=memory or "pass")
    (folder / "tank.py").write_text(source)
    build_python_fmu(folder / "tank.py", folder / "tank.fmu")
    assert own_source(folder / "tank.fmu").split() == source.split()
    (folder / "system.yaml").write_text(yaml.safe_dump(SYSTEM))
    (folder / "study.yaml").write_text(
        yaml.safe_dump({**STUDY, "columns": {"time": "t", **STUDY["columns"]}})
    )
    time = 0.01 * np.arange(1001)
    rows = np.column_stack([time, 2.0 + np.sin(time), 1.0 + 0.1 * np.cos(time)])
    np.savetxt(folder / "a.csv", rows, delimiter=",", header="t [s],q [m3/s],h [m]", comments="")
    return load_port_study(folder / "study.yaml")


def test_a_python_component_is_replayed_without_python_and_gives_the_same(tmp_path):
    study = made(tmp_path)
    native, reported = in_native_form(study)
    assert not reported
    assert [one.name for one in native.natives] == ["tank.fmu"]
    given, found = (player_of(one, one.fed, one.compared) for one in (study, native))
    assert found.parallel and not given.parallel
    level = Port("tank", "level")
    one, other = (Replay(each).signals(study.runs[0])[level] for each in (study, native))
    assert np.ptp(one) > 0.1 and one == pytest.approx(other, rel=1e-12)
    # What is written of the system names the user's own file.
    assert native.prepared is study.prepared


def test_numbers_that_a_component_does_not_register_are_remembered(tmp_path):
    study = made(
        tmp_path, "self.turned = 0.0", "self.turned += 0.1; self.level += 1e-3 * math.sin(self.turned)"
    )
    native, reported = in_native_form(study)
    assert not reported
    assert [one.name for one in native.natives] == ["tank.fmu"]
    one, other = (Replay(each).signals(study.runs[0]) for each in (study, native))
    assert one[Port("tank", "level")] == pytest.approx(other[Port("tank", "level")], rel=1e-12)


def test_a_component_that_remembers_what_is_no_number_stays_in_python(tmp_path):
    memory = "self.turns.append(0.1); self.level += 1e-3 * math.sin(len(self.turns))"
    study = made(tmp_path, "self.turns = []", memory)
    same, (reported,) = in_native_form(study)
    assert same is study and reported.place == "tank"
    assert reported.what.startswith("is replayed in Python") and "native form: level differs" in reported.what
