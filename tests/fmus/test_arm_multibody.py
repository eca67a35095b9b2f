"""The arm by a rigid-body engine: energy, equilibrium, yielding to the contact, state, refusals, the loop."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import FMUS, load_model

from orchestrator.simulation.run import run

pinocchio = pytest.importorskip("pinocchio", reason="Pinocchio is not installed: pip install pin")
STEP = 5e-4
OFF = {f"omega_n[{index}]": 1e-9 for index in range(1, 8)}


def made(**start: float):
    """An instance of the model in this process, initialised."""
    model = load_model("ArmMultibody").ArmMultibody(instance_name="arm")
    variables = {one.name: one for one in model.vars.values()}
    for name, value in start.items():
        variables[name].setter(value)
    model.setup_experiment(0.0, None, None)
    model.enter_initialization_mode()
    model.exit_initialization_mode()
    return model


def test_rebuilding_gives_the_shipped_bytes(tmp_path):
    pytest.importorskip("pythonfmu", reason="pip install 'orchestrator[build]'")
    from orchestrator.translate.python_fmu import build_python_fmu

    rebuilt = build_python_fmu(FMUS / "ArmMultibody" / "model.py", tmp_path / "rebuilt.fmu")
    assert rebuilt.read_bytes() == (FMUS / "ArmMultibody" / "ArmMultibody.fmu").read_bytes()


def test_energy_holds_while_the_undriven_arm_falls():
    bare = {f"rotor_inertia[{index}]": 0.0 for index in range(1, 8)}
    moving = {"joint_velocity[2]": 0.3, "joint_velocity[5]": 0.5}
    model = made(**OFF, **bare, **moving, gravity_compensation=0.0)
    body = model._built()

    def energies() -> tuple[float, float]:
        q, v = model._now()
        kinetic = pinocchio.computeKineticEnergy(body.model, body.data, q, v)
        return kinetic, pinocchio.computePotentialEnergy(body.model, body.data, q)

    before = energies()
    for index in range(600):
        model.do_step(index * STEP, STEP)
    after = energies()
    assert after[0] > before[0] + 100.0
    assert sum(after) == pytest.approx(sum(before), abs=1e-9 * after[0])


def settled(**start: float):
    model = made(**start)
    for index in range(400):
        model.do_step(index * STEP, STEP)
    assert np.abs(model.joint_velocity).max() < 1e-9
    return model


def test_compensated_drives_hold_the_arm_and_others_let_it_sag():
    start = np.array(load_model("ArmMultibody").START)
    assert np.abs(np.array(settled().joint_position) - start).max() < 1e-12
    model = settled(gravity_compensation=0.0)
    sag = np.array(model.joint_position) - start
    body = model._built()
    expected = -body.weight(np.array(model.joint_position)) / (body.inertia * np.array(model.omega_n) ** 2)
    np.testing.assert_allclose(sag, expected, rtol=0, atol=1e-12)
    assert np.abs(sag[1:]).max() > 1e-6


def test_a_force_at_the_rod_displaces_the_joints_by_the_kinematics_of_the_other_fmus():
    arm = load_model("ArmInverse")
    force, point = (-100.0, 30.0, 20.0), (0.02, 0.03, -0.01)
    values = {f"force[{i + 1}]": one for i, one in enumerate(force)}
    model = settled(**values, **{f"point[{i + 1}]": one for i, one in enumerate(point)})
    q, place = model.joint_position, np.array(model.target_position) + point
    columns = arm.jacobian(arm.Geometry(), q, tuple(place))
    inertia = model._built().inertia
    expected = [np.dot(linear, force) for linear, _ in columns] / (inertia * np.array(model.omega_n) ** 2)
    way = np.array(q) - load_model("ArmMultibody").START
    np.testing.assert_allclose(way, expected, rtol=1e-6, atol=1e-12)
    assert np.abs(way).max() > 1e-7


def test_a_saved_state_goes_on_alike():
    model = made(**{"joint_command[3]": -1.74})
    for index in range(20):
        model.do_step(index * STEP, STEP)
    state = model._get_fmu_state()
    seen = []
    for _ in range(2):
        model._set_fmu_state(state)
        for index in range(20, 40):
            model.do_step(index * STEP, STEP)
        seen.append((model.joint_position, model.joint_velocity, model.joint_effort))
    assert seen[0] == seen[1]


def test_refusals_name_all_that_is_wrong():
    with pytest.raises(ValueError) as caught:
        made(**{"link_mass[2]": 0.0, "tool_mass": -1.0})
    assert str(caught.value) == (
        "arm: parameters: link_mass[2], of A1, is 0.0 kg; allowed: above 0 kg. tool_mass is -1.0 kg; "
        "allowed: not negative."
    )


def test_the_loop_through_rigid_bodies_keeps_its_energy():
    summary = run("docking-6d-multibody", overrides=["run.stop_time=0.6 s"], halving=False).summary
    (contact,) = summary["contacts"]
    assert contact["kinetic_energy_ratio"] == pytest.approx(1.0, abs=3e-4)
    # The arm yields to the contact: the peak is lower than that of docking-6d-arm, 0.9988.
    assert 0.9975 < contact["peak_force_ratio"] < 0.9985
    assert summary["momentum"]["linear_change"] < 1e-9
