"""FMUs without directional derivatives: states from step responses, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import foreign
import numpy as np
import pytest

import orchestrator as orc
from orchestrator.base.errors import ConfigError
from orchestrator.frequency import linearise
from orchestrator.translate.python_fmu import build_python_fmu


def mass_on_a_spring(step="1 ms", *effects):
    """A mass whose FMU is written in Python, on a spring whose FMU has derivatives."""
    system = orc.System(step_size=step, stop_time="1 s")
    system.add("mass", "SatelliteDynamics", mass="2 kg", position="10 mm")
    system.add("spring", "DockingContact", stiffness="800 N/m", damping="4 N.s/m", front="5 mm", rear="-5 mm")
    system.connect("mass.position", "spring.position")
    system.connect("mass.velocity", "spring.velocity")
    return system.connect("spring.force", "mass.force", *effects)


@pytest.mark.parametrize("step", ["0.2 ms", "1 ms", "10 ms"])
def test_a_mass_in_python_has_the_roots_of_its_equation(step):
    """m x'' = -k x - d x': measured at whatever communication step."""
    found = linearise(mass_on_a_spring(step).data)
    (note,) = (one for one in found.notes if one.startswith("mass offers no directional derivatives"))
    assert "2 states, error" in note and float(note.split()[-2]) < 1e-4
    expected = np.roots([2.0, 4.0, 800.0])
    assert found.modes().modes[0].root == pytest.approx(expected[0], rel=2e-5)


def test_a_delay_of_a_connection_stays_exact():
    late = linearise(mass_on_a_spring("1 ms", {"delay": "3.3 ms"}).data)
    root = late.modes().modes[0].root
    assert abs(2.0 * root**2 + (4.0 * root + 800.0) * np.exp(-3.3e-3 * root)) < 1e-3 * abs(800.0)


def test_hidden_states_of_a_foreign_fmu_are_found(tmp_path):
    """Y is the integral of u; the FMU names no states."""
    path = foreign.flawed(tmp_path / "Flawed.fmu")
    config = {
        "run": {"master": "jacobi", "step_size": "10 ms", "stop_time": "1 s"},
        "instances": {"one": {"fmu": str(path)}},
        "connections": [
            {"from": "one.y", "to": "one.u", "through": [{"gain": "-3 1/s"}, {"delay": "0.2 s"}]}
        ],
    }
    found = linearise(config).modes().modes[0].root
    assert found + 3.0 * np.exp(-0.2 * found) == pytest.approx(0.0, abs=1e-5)


TANK = '''
"""A tank whose outflow grows with the square of its level."""
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Tank(Fmi2Slave):
    """level' = inflow - level^2/2."""

    type_attributes = {"inflow": {"unit": "1"}, "level": {"unit": "1"}}
    dependencies = {"level": ()}
    initial_dependencies = {"level": ()}

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.inflow, self.level = 0.0, 0.2
        self.register_variable(Real("inflow", causality=Fmi2Causality.input, description="inflow", start=0.0))
        self.register_variable(Real("level", causality=Fmi2Causality.output, description="level"))

    def do_step(self, time, step):
        for _ in range(20):
            middle = self.level + step / 40 * (self.inflow - self.level**2 / 2)
            self.level += step / 20 * (self.inflow - middle**2 / 2)
        return True
'''


@pytest.fixture(scope="module")
def tank(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tank")
    (folder / "tank.py").write_text(TANK, encoding="utf-8")
    return build_python_fmu(folder / "tank.py", folder / "Tank.fmu")


def controlled(tank):
    """The level settles at 2, where level^2/2 = 4 - level; there level' = -2 level + inflow."""
    system = orc.System(step_size="20 ms", stop_time="20 s")
    system.add("tank", str(tank))
    through = [{"offset": -4.0}, {"gain": -1.0}, {"low-pass": {"time_constant": "0.5 s"}}]
    return system.connect("tank.level", "tank.inflow", *through)


def test_a_response_is_measured_where_the_run_has_brought_the_fmu(tank):
    found = linearise(controlled(tank).data, at_time=15.0)
    assert found.point["tank.inflow"] == pytest.approx(2.0, abs=1e-6)
    # (s + 2)^2 + 2 = 0
    assert found.modes().modes[0].root == pytest.approx(-2.0 + np.sqrt(2.0) * 1j, rel=5e-4)


def test_what_cannot_save_its_state_is_not_measured_at_a_later_time(tank):
    prepared = controlled(tank).check()
    (one,) = prepared.system.instances
    capabilities = replace(one.fmu.description.capabilities, serialise_state=False)
    fmu = Described(one.fmu, replace(one.fmu.description, capabilities=capabilities))
    system = replace(prepared.system, instances=(replace(one, fmu=fmu),))
    with pytest.raises(ConfigError, match="it offers no directional derivatives, and cannot save its state"):
        linearise(replace(prepared, system=system), at_time=15.0)


class Described:
    """An FMU with another description."""

    def __init__(self, fmu, description):
        self._fmu, self.description = fmu, description

    def __getattr__(self, name):
        return getattr(self._fmu, name)


def test_a_pulse_at_an_input_shows_roots_of_an_fmu_whose_states_have_no_names(tank):
    from orchestrator.frequency.verify import verified, verify_text

    config = controlled(tank).data
    found = verified(config, linearise(config, at_time=15.0))
    assert found["pulse"] and found["changed"] == "tank.inflow"
    assert all(one["difference"] < 2e-3 for one in found["sampled"])
    assert "after a short pulse at tank.inflow" in verify_text(found)
