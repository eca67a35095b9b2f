"""The law in space: it is the one on a line there, does not know the axes, and gives the right moment."""

from __future__ import annotations

import math

import numpy as np
import pytest
from docking_bench import DockingBench, restitution
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

SAMPLE_PERIOD = 5e-4
X = np.array([1.0, 0.0, 0.0])


def make(model, **parameters):
    law = model.WrenchLaw(model.WrenchParameters(**parameters), model.WrenchState())
    assert law.parameters.all_problems() == ""
    return law


def inputs(model, axis, place, force, *along, side=0.0):
    """Inputs along an axis; the rod tip `place` off the sensor's origin, `side` more across the axis."""
    across = np.cross(axis, [0.3, -0.5, 0.8])
    vectors = [np.asarray(axis) * value for value in along]
    vectors[0] = vectors[0] + place + side * across
    vectors[2] = vectors[2] + place + side * across
    push = np.asarray(axis) * force
    made = [push, np.cross(vectors[0], push), *vectors]
    return model.WrenchInputs(*(model.Vector(*map(float, vector)) for vector in made))


def samples(model, seed, contacts=6, **bench):
    """Inputs of the law on a line, and its forces and estimates, in a closed loop."""
    law = model.ComplianceLaw(model.Parameters(tau_s=bench.get("tau_s", 0.0)), model.State())
    taken = []

    def control(*values):
        force = law.sample(model.Inputs(*values))
        taken.append((values, force, *law.estimates(), law.state.energy_error, law.state.contact_state))
        return force

    DockingBench(seed=seed, **bench).run(control, SAMPLE_PERIOD, contacts)
    return taken


BENCHES = [{}, {"damping": 100.0, "tau_s": 1e-3}, {"noise": 1.0, "resolution": 0.5}]


@pytest.mark.parametrize("bench", BENCHES, ids=str)
def test_on_a_line_it_is_the_law_on_a_line(controller_model, wrench_model, bench):
    law = make(wrench_model, tau_s=bench.get("tau_s", 0.0))
    taken = samples(controller_model, 3, **bench)
    for values, force, stiffness, damping, error, contact in taken:
        found = law.sample(inputs(wrench_model, X, np.zeros(3), *values))
        assert tuple(found) == pytest.approx((force, 0.0, 0.0), rel=1e-12, abs=0.0)
        assert law.estimates() == pytest.approx((stiffness, damping), rel=1e-12)
        assert law.state.energy_error == pytest.approx(error, rel=1e-12)
        assert law.state.contact_state == abs(contact) and law.state.normal.x == -contact
    assert law.state.updates > 40


@pytest.mark.parametrize("bench", BENCHES, ids=str)
def test_the_axes_do_not_matter(controller_model, wrench_model, bench):
    """Along an oblique axis, the rod tip off the sensor's origin: the same, and the moment of the force."""
    law = make(wrench_model, tau_s=bench.get("tau_s", 0.0))
    axis = np.array([2.0, -1.0, 3.0]) / math.sqrt(14.0)
    place = np.array([0.1, 0.25, -0.07])
    for values, force, stiffness, _, _, contact in samples(controller_model, 4, **bench):
        u = inputs(wrench_model, axis, place, *values)
        found = np.array(law.sample(u))
        assert found == pytest.approx(force * axis, rel=1e-7, abs=1e-6)
        assert law.estimates()[0] == pytest.approx(stiffness, rel=1e-8)
        moment = np.cross(place, force * axis)
        assert np.array(law.state.torque) == pytest.approx(moment, abs=1e-6 + 1e-6 * abs(force))
        assert np.array(law.state.normal) == pytest.approx(-contact * axis, abs=1e-12)


@given(
    values=st.lists(st.floats(-1.0, 1.0), min_size=12, max_size=12),
    damping=st.sampled_from([0.0, 200.0]),
)
@settings(max_examples=100, deadline=None)
def test_torque_is_the_moment_at_the_desired_contact_point(wrench_model, values, damping):
    """Recomputed: with M_S = r x F_S, M_comp has to be r_des x F_comp, whatever the wrench and the poses."""
    force = np.array(values[:3]) * 100.0 + [-150.0, 0.0, 0.0]
    place, offset = np.array(values[3:6]), 1e-4 * np.array(values[6:9])
    zero = np.zeros(3)
    law = make(wrench_model, initial_damping=damping, hold_compensation=False)
    rate = np.array(values[9:12])
    u = [force, np.cross(place, force), place, zero, place + offset, 0.01 * rate]
    found = np.array(law.sample(wrench_model.WrenchInputs(*(wrench_model.Vector(*v) for v in u))))
    e = force / np.linalg.norm(force)
    # Eq. (29) with the force that the frame's law has: more of it where the desired rod is deeper.
    expected = force - (1e5 * (offset @ e) + damping * (0.01 * rate @ e)) * e
    if expected @ e <= 0.0:
        expected = zero
    assert found == pytest.approx(expected, abs=1e-9)
    assert np.array(law.state.torque) == pytest.approx(np.cross(place + offset, expected), abs=1e-9)


def test_the_printed_sign_of_the_torque_would_be_wrong(wrench_model):
    """With the source's minus the moment is off by twice the lever times the change of force."""
    force, place, offset = np.array([-50.0, 0.0, 0.0]), np.array([0.0, 0.2, 0.0]), np.array([2e-4, 0.0, 0.0])
    law = make(wrench_model, hold_compensation=False)
    u = [force, np.cross(place, force), place, np.zeros(3), place + offset, np.zeros(3)]
    found = np.array(law.sample(wrench_model.WrenchInputs(*(wrench_model.Vector(*v) for v in u))))
    right = np.cross(place + offset, found)
    printed = np.cross(place, force) + np.cross(offset, found) - np.cross(place, found - force)
    assert np.array(law.state.torque) == pytest.approx(right, abs=1e-12)
    assert np.linalg.norm(printed - right) == pytest.approx(2.0 * 0.2 * 1e5 * 2e-4, rel=1e-9)


@pytest.mark.parametrize("mode", ["off", "lead"])
def test_modes_without_compensation(wrench_model, mode):
    law = make(wrench_model, mode=wrench_model.MODES[mode], tau_s=2e-3, lead_filter_time=0.0)
    previous = None
    for index in range(5):
        force, torque = np.array([index, -3.0 * index, 5.0]), np.array([2.0 * index, 1.0, -index])
        u = [force, torque, *[np.zeros(3)] * 4]
        law.sample(wrench_model.WrenchInputs(*(wrench_model.Vector(*map(float, v)) for v in u)))
        for name, now in (("force", force), ("torque", torque)):
            before = now if previous is None else previous[name]
            expected = now if mode == "off" else now + 2e-3 * (now - before) / SAMPLE_PERIOD
            assert np.array(getattr(law.state, name)) == pytest.approx(expected, abs=1e-9)
        previous = {"force": force, "torque": torque}


def test_normal_is_averaged_against_noise_and_found_anew_at_the_next_frame(wrench_model):
    """White noise of 1 N at 50 N turns the present force by 1 degree; the average by a third of that."""
    source = np.random.default_rng(1)
    true = np.array([0.6, 0.0, -0.8])
    found = {}
    for normal_time in (0.0, 5e-3):
        law, angles = make(wrench_model, normal_time=normal_time), []
        for _ in range(400):
            force = wrench_model.Vector(*(50.0 * true + source.standard_normal(3)))
            law.sample(wrench_model.WrenchInputs(force, *[wrench_model.ZERO] * 5))
            angles.append(math.acos(min(1.0, float(np.array(law.state.normal) @ true))))
        found[normal_time] = float(np.sqrt(np.mean(np.square(angles[20:]))))
    assert found[0.0] == pytest.approx(math.sqrt(2.0) / 50.0, rel=0.1)
    # sqrt((1 - a)/(1 + a)) of an average with a = exp(-0.5/5)
    assert found[5e-3] == pytest.approx(0.2236 * found[0.0], rel=0.15)
    law.sample(wrench_model.WrenchInputs(wrench_model.Vector(0.0, 20.0, 15.0), *[wrench_model.ZERO] * 5))
    assert tuple(law.state.normal) == pytest.approx((0.0, 0.8, 0.6), abs=1e-12)
    law.sample(wrench_model.WrenchInputs(*[wrench_model.ZERO] * 6))
    assert law.state.normal == wrench_model.ZERO and law.state.contact_state == 0


@pytest.mark.parametrize("slide", [0.02, 0.05])
def test_sliding_along_a_frictionless_frame_changes_nothing(wrench_model, slide):
    """An oblique approach: the rod slides across while the contact takes its course along the normal."""
    law = make(wrench_model)
    axis = Rotation.from_euler("yz", [20.0, -35.0], degrees=True).apply(X)
    clock = iter(range(100000))

    def control(*values):
        u = inputs(
            wrench_model, axis, np.array([0.0, 0.1, 0.0]), *values, side=slide * next(clock) * SAMPLE_PERIOD
        )
        return float(np.array(law.sample(u)) @ axis)

    bench = DockingBench(damping=100.0)
    ratios = np.abs(bench.run(control, SAMPLE_PERIOD, 8))
    theory = restitution(bench.mass, bench.stiffness, bench.damping) ** np.arange(1, 9)
    assert np.abs(ratios / theory - 1.0).max() < 0.006
    assert law.estimates()[0] == pytest.approx(176e3, rel=1e-3)
    assert law.estimates()[1] == pytest.approx(100.0, abs=4.0)


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"normal_time": -1.0}, "normal_time is -1.0 s; allowed: finite and not negative"),
        (
            {"tau_s": -1.0, "normal_time": math.nan},
            "tau_s is -1.0 s; allowed: finite and not negative; "
            "normal_time is nan s; allowed: finite and not negative",
        ),
    ],
)
def test_parameters_refused(wrench_model, parameters, text):
    assert wrench_model.WrenchParameters(**parameters).all_problems() == text


def test_geometry_refused(wrench_model):
    parameters = wrench_model.WrenchParameters(
        tip=wrench_model.Vector(math.inf, 0.0, 0.0),
        sensor_orientation=wrench_model.Quaternion(2.0, 0.0, 0.0, 0.0),
    )
    assert parameters.all_problems() == (
        "tip is (inf, 0.0, 0.0) m; allowed: finite; "
        "sensor_orientation has the squared length 4.0; allowed: 1, a unit quaternion w, x, y, z"
    )
