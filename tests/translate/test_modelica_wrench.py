"""PointContact and WrenchSensor against closed forms that share nothing with them."""

from __future__ import annotations

import modelica_bench as bench
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from orchestrator.base.errors import StepError
from orchestrator.simulation.run import run

CONTACT, SENSOR = (bench.FMUS / name / f"{name}.fmu" for name in ("PointContact", "WrenchSensor"))


def vectors(columns, name, length=3):
    return np.column_stack([columns[f"{name}[{i}]"] for i in range(1, length + 1)])


def elements(name, values):
    return {f"{name}[{i}]": float(value) for i, value in enumerate(values, start=1)}


def given(start, name, length=3):
    return np.array([start[f"{name}[{i}]"] for i in range(1, length + 1)])


def contact_law(columns, start):
    """Force, point, depth and energy from the reference's inputs, by the equations of the README."""
    q = vectors(columns, "orientation", 4)
    arm = Rotation.from_quat(q[:, [1, 2, 3, 0]]).apply(given(start, "tip"))
    point = vectors(columns, "position") + arm
    speed = vectors(columns, "velocity") + np.cross(vectors(columns, "angular_velocity"), arm)
    normal = given(start, "normal") / np.linalg.norm(given(start, "normal"))
    x, v = -point @ normal, -speed @ normal
    k, c, gap = 176e3, start["damping"], 5e-3
    push = np.where(x > gap, -np.maximum(k * (x - gap) + c * v, 0.0), 0.0)
    push += np.where(x < -gap, np.maximum(k * (-gap - x) - c * v, 0.0), 0.0)
    slide = speed + np.outer(v, normal)
    size = np.sqrt((slide**2).sum(axis=1) + 1e-3**2)
    grip = np.where(push != 0.0, start["friction"] * np.abs(push) / size + start["tangential_damping"], 0.0)
    depth = np.maximum(np.abs(x) - gap, 0.0)
    return np.outer(-push, normal) - grip[:, None] * slide, point, depth, k * depth**2 / 2, push


def test_point_contact_is_the_contact_law():
    reference = bench.read("PointContact")
    force, point, depth, energy, push = contact_law(reference, bench.START["PointContact"])
    np.testing.assert_allclose(vectors(reference, "force"), force, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(vectors(reference, "point"), point, rtol=0, atol=1e-15)
    np.testing.assert_allclose(reference["penetration"], depth, rtol=0, atol=1e-15)
    np.testing.assert_allclose(reference["stored_energy"], energy, rtol=1e-10, atol=1e-15)
    # The reference holds what the model exists for: both frames, friction, a frame that would pull.
    assert push.min() < -400 and push.max() > 400
    assert ((push == 0) & (depth > 0)).any()


def test_on_a_line_it_is_docking_contact():
    columns = bench.read("DockingContact")
    with bench.instance(CONTACT, damping=500.0) as fmu:
        for row in range(0, 501, 5):
            x, v = columns["position"][row], columns["velocity"][row]
            fmu.set({"position[1]": x, "velocity[1]": v})
            found = fmu.get("force[1]", "force[2]", "force[3]", "penetration")
            assert found == [columns["force"][row], 0.0, 0.0, columns["penetration"][row]]


@pytest.mark.parametrize("sliding", [0.0, 2e-4, 1e-3, 0.5])
def test_friction_opposes_sliding_and_is_coulombs_in_the_end(sliding):
    moving = sliding * np.array([0.0, 0.6, -0.8])
    with bench.instance(CONTACT, friction=0.3) as fmu:
        fmu.set({"position[1]": 6e-3, **elements("velocity", moving)})
        force = np.array(fmu.get("force[1]", "force[2]", "force[3]"))
    assert force[0] == pytest.approx(-176.0, rel=1e-12)
    expected = -0.3 * 176.0 * moving / np.hypot(sliding, 1e-3)
    assert force[1:] == pytest.approx(expected[1:], rel=1e-12, abs=1e-15)
    assert force @ moving <= 0.0
    if sliding == 0.5:
        assert np.linalg.norm(force[1:]) == pytest.approx(0.3 * 176.0, rel=1e-5)


def test_the_beginning_of_contact_is_located_within_a_step():
    """The input moves on a line given by its derivative; the contact is found, so the step's end is exact."""
    with bench.instance(CONTACT) as fmu:
        fmu.set({"position[1]": 4.9e-3, "velocity[1]": 0.02})
        reference = [fmu.variables["position[1]"].valueReference]
        fmu.fmu.setRealInputDerivatives(reference, [1], [0.02])
        fmu.step(0.01)
        assert fmu.get("penetration") == pytest.approx([1e-4], rel=1e-9)
        assert fmu.get("force[1]") == pytest.approx([-17.6], rel=1e-9)


@pytest.mark.parametrize(
    ("start", "text"),
    [
        ({"position[1]": "6 mm"}, "the rod tip starts inside a frame"),
        ({"position[1]": "-6 mm"}, "the rod tip starts inside a frame"),
        ({"normal[1]": 0.0}, "normal has no length"),
        ({"friction": 0.1, "friction_velocity": "0 m/s"}, "friction_velocity is 0 m/s"),
        ({"front": "-10 mm"}, "front is not above rear"),
        ({"orientation[1]": 0.5}, "orientation is no unit quaternion"),
    ],
)
def test_refusals_of_the_contact(start, text):
    at_rest = {
        **dict.fromkeys(bench.elements("position", 3), "0 m"),
        **dict(zip(bench.elements("orientation", 4), (1.0, 0.0, 0.0, 0.0), strict=True)),
        **dict.fromkeys(bench.elements("velocity", 3), "0 m/s"),
        **dict.fromkeys(bench.elements("angular_velocity", 3), "0 rad/s"),
    }
    config = {
        "run": {"master": "gauss-seidel", "step_size": "1 ms", "stop_time": "1 ms", "loop": "python"},
        "instances": {"contact": {"fmu": "PointContact", "start": at_rest | start}},
    }
    with pytest.raises(StepError, match=text):
        run(config)


def test_a_start_in_contact_can_be_asked_for():
    with bench.instance(CONTACT, start_in_contact=True, **{"position[1]": 6e-3}) as fmu:
        assert fmu.get("force[1]", "stored_energy") == pytest.approx([-176.0, 0.088], rel=1e-12)
    # Later on, a rod inside a frame is what the model is for.
    with bench.instance(CONTACT) as fmu:
        fmu.set({"position[1]": 6e-3})
        fmu.step(1e-3)
        assert fmu.get("force[1]") == pytest.approx([-176.0], rel=1e-12)


def test_wrench_sensor_is_the_closed_form():
    columns, start = bench.read("WrenchSensor"), bench.START["WrenchSensor"]
    times = columns["time"]
    back = Rotation.from_quat(np.roll(given(start, "sensor_orientation", 4), -1)).inv()
    force = vectors(columns, "force")
    moment = np.cross(vectors(columns, "point") - given(start, "sensor_position"), force)
    weight = back.apply([0.0, 0.0, -2.5 * 9.80665])
    bias = {"force": weight, "torque": np.cross(given(start, "tool_center"), weight)}
    for name, raw in (("force", back.apply(force)), ("torque", back.apply(moment))):
        analog = np.zeros_like(raw)
        for i in range(1, len(times)):
            t = np.maximum(times - times[i - 1] - start["tau_s"], 0.0)
            analog += np.outer(1 - np.exp(-2 * np.pi * start["cutoff"] * t), raw[i] - raw[i - 1])
        analog += vectors(columns, f"{name}_noise") - bias[name]
        steps = analog / start[f"{name}_resolution"]
        expected = start[f"{name}_resolution"] * np.floor(steps + 0.5)
        # A value on the edge of a rounding step could fall on either side.
        clear = np.abs(steps + 0.5 - np.round(steps + 0.5)) > 1e-6
        assert clear.mean() > 0.99
        found = vectors(columns, f"measured_{name}")
        np.testing.assert_allclose(found[clear], expected[clear], rtol=0, atol=1e-10)
        assert np.ptp(found, axis=0).min() > 5.0


def test_the_weight_is_in_the_reading_unless_it_was_tared():
    tool = {"tool_mass": 3.0, **elements("tool_center", (0.1, 0.0, 0.2))}
    names = [f"measured_{kind}[{i}]" for kind in ("force", "torque") for i in (1, 2, 3)]
    with bench.instance(SENSOR, **tool) as fmu:
        assert fmu.get(*names) == [0.0] * 6
    # The frame's weight pulls the frame down; as a force on the rod it reads upwards.
    with bench.instance(SENSOR, tared=False, **tool) as fmu:
        weight = 3.0 * 9.80665
        assert fmu.get(*names) == pytest.approx([0.0, 0.0, weight, 0.0, -0.1 * weight, 0.0], rel=1e-12)


def test_on_a_line_it_is_force_sensor():
    columns, start = bench.read("ForceSensor"), bench.START["ForceSensor"]
    given = {"tau_s": start["tau_s"], "cutoff": start["cutoff"], "force_resolution": start["resolution"]}
    step = bench.STEPS["ForceSensor"]
    with bench.instance(SENSOR, **given) as fmu:
        for row in range(1, len(columns["time"])):
            fmu.set({"force[1]": columns["force"][row]})
            fmu.fmu.doStep(currentCommunicationPoint=columns["time"][row - 1], communicationStepSize=step)
            assert fmu.get("measured_force[1]", "measured_force[2]", "measured_torque[3]") == pytest.approx(
                [columns["measured_force"][row], 0.0, 0.0], abs=1e-9
            )
