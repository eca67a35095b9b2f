"""FMUs that name no states, but whose outputs can be set before initialisation."""

from __future__ import annotations

import math

import numpy as np
import pytest

import orchestrator as orc
from orchestrator.frequency.alone import Alone
from orchestrator.frequency.measured_states import from_start_values, start_outputs
from orchestrator.simulation.run import prepare
from orchestrator.translate.python_fmu import build_python_fmu

PENDULUM = '''
"""A driven pendulum."""
import math

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Real


class Pendulum(Fmi2Slave):
    """angle'' = -9.81 sin(angle) - 0.3 rate + torque/(1 + angle^2)."""

    type_attributes = {name: {"unit": "1"} for name in ("torque", "angle", "rate", "pull")}
    dependencies = {"angle": (), "rate": (), "pull": ()}
    initial_dependencies = dependencies

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.torque, self.angle, self.rate, self.pull, self.before = 0.0, 0.8, 0.1, 0.0, 0.0
        self.register_variable(Real("torque", causality=Fmi2Causality.input, description="input", start=0.0))
        for name in ("angle", "rate", "pull"):
            exact = {"causality": Fmi2Causality.output, "initial": Fmi2Initial.exact}
            self.register_variable(Real(name, description=name, **exact))

    def slopes(self, angle, rate):
        driven = self.torque / (1 + angle**2) + HIDDEN * self.before
        return rate, driven - 9.81 * math.sin(angle) - 0.3 * rate

    def do_step(self, time, step):
        for _ in range(10):
            h = step / 10
            first = self.slopes(self.angle, self.rate)
            second = self.slopes(self.angle + h / 2 * first[0], self.rate + h / 2 * first[1])
            self.angle, self.rate = self.angle + h * second[0], self.rate + h * second[1]
        self.pull = 9.81 * math.cos(self.angle) + self.rate**2
        self.before += step * (self.angle - self.before) / 0.02
        return True
'''


def pendulum(folder, hidden):
    source = folder / f"pendulum_{hidden}.py"
    source.write_text(PENDULUM.replace("HIDDEN", str(hidden)), encoding="utf-8")
    system = orc.System(step_size="2 ms", stop_time="1 s")
    system.add("pendulum", str(build_python_fmu(source, folder / f"Pendulum{hidden}.fmu")))
    return system.connect("pendulum.angle", "pendulum.torque", {"gain": -2.0})


def measured(system, values):
    prepared = prepare(system.data)
    (one,) = prepared.system.instances
    return one, from_start_values(Alone(one, prepared, ("torque",), ("angle", "pull"), values))


@pytest.mark.parametrize(("angle", "rate", "torque"), [(0.8, 0.1, 0.0), (-0.4, 2.0, 3.0)])
def test_the_equations_of_a_pendulum_are_found_where_it_does_not_rest(tmp_path, angle, rate, torque):
    values = {"angle": angle, "rate": rate, "pull": 0.0, "torque": torque}
    one, found = measured(pendulum(tmp_path, 0.0), values)
    assert start_outputs(one) == ("angle", "rate", "pull")
    assert not isinstance(found, str), found
    part, error = found
    assert part.states == ("angle", "rate")  # `pull` is calculated anew at each step
    assert error < 1e-2
    stiffness = -9.81 * math.cos(angle) - 2.0 * torque * angle / (1 + angle**2) ** 2
    # The differences hold over a step, in which the pendulum moves on.
    near = {"rel": 5e-3, "abs": 5e-3}
    assert part.a == pytest.approx(np.array([[0.0, 1.0], [stiffness, -0.3]]), **near)
    assert part.b[:, 0] == pytest.approx([0.0, 1.0 / (1 + angle**2)], **near)
    assert part.c[0] == pytest.approx([1.0, 0.0], abs=1e-9)
    # Outputs are read at the end of the step.
    later = rate + 2e-3 * (-9.81 * math.sin(angle) - 0.3 * rate + torque / (1 + angle**2))
    assert part.c[1] == pytest.approx([-9.81 * math.sin(angle + 2e-3 * rate), 2.0 * later], rel=5e-3)
    assert part.d[:, 0] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_an_fmu_that_keeps_more_than_its_outputs_is_refused(tmp_path):
    values = {"angle": 0.8, "rate": 0.1, "pull": 0.0, "torque": 0.0}
    _, found = measured(pendulum(tmp_path, 60.0), values)
    assert found == "its outputs with start values do not determine how it goes on"
