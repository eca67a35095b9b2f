"""FMUs without directional derivatives: states from step responses, and what is refused."""

from __future__ import annotations

import foreign
import numpy as np
import pytest

import orchestrator as orc
from orchestrator.frequency import linearise


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
