"""SatelliteDynamics: exact motion, its FMU, what it refuses."""

from __future__ import annotations

import math

import pytest
from conftest import Instance
from docking_bench import EFFECTIVE_MASS
from hypothesis import given
from hypothesis import strategies as st


def test_default_mass_is_the_effective_mass_of_300_and_4000_kg(instantiate):
    (mass,) = instantiate("SatelliteDynamics").initialise().get("mass")
    assert mass == EFFECTIVE_MASS == pytest.approx(1.0 / (1.0 / 300.0 + 1.0 / 4000.0), rel=1e-15)


@given(
    force=st.floats(-1e3, 1e3),
    mass=st.floats(1.0, 1e4),
    velocity=st.floats(-1.0, 1.0),
    steps=st.lists(st.floats(1e-6, 0.1), min_size=1, max_size=30),
)
def test_constant_force_is_integrated_exactly_whatever_the_steps(
    satellite_model, force, mass, velocity, steps
):
    x, v = 0.0, velocity
    for step in steps:
        x, v = satellite_model.advance(x, v, force, mass, step)
    t = math.fsum(steps)
    scale = abs(velocity) * t + 0.5 * abs(force) / mass * t * t + 1e-290
    assert v == pytest.approx(velocity + force / mass * t, rel=1e-12, abs=1e-12 * (abs(velocity) + scale / t))
    assert x == pytest.approx(velocity * t + 0.5 * force / mass * t * t, rel=1e-12, abs=1e-12 * scale)


@given(forces=st.lists(st.floats(-200.0, 200.0), min_size=1, max_size=50), step=st.floats(1e-5, 1e-2))
def test_momentum_and_work_balance(satellite_model, forces, step):
    mass, x, v = EFFECTIVE_MASS, 0.0, 0.02
    work = 0.0
    for force in forces:
        before = x
        x, v = satellite_model.advance(x, v, force, mass, step)
        work += force * (x - before)
    impulse = math.fsum(force * step for force in forces)
    assert mass * v == pytest.approx(mass * 0.02 + impulse, rel=1e-12, abs=1e-12)
    assert 0.5 * mass * v * v == pytest.approx(0.5 * mass * 0.02**2 + work, rel=1e-9, abs=1e-12)


def test_fmu_agrees_with_the_model_in_process_bit_for_bit(instantiate, satellite_model):
    fmu: Instance = instantiate("SatelliteDynamics").initialise(velocity=0.02, mass=123.4)
    model = satellite_model.SatelliteDynamics(instance_name="inside")
    model.velocity, model.mass = 0.02, 123.4
    model.exit_initialization_mode()
    time = 0.0
    for index in range(200):
        step = (1e-4, 5e-4, 3.3e-4)[index % 3]
        force = 30.0 * math.sin(0.1 * index)
        fmu.set(force=force)
        model.force = force
        fmu.fmu.doStep(time, step)
        assert model.do_step(time, step)
        time += step
        assert fmu.get("position", "velocity") == (model.position, model.velocity)
    assert fmu.get("kinetic_energy") == (0.5 * 123.4 * model.velocity**2,)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (
            {"mass": 0.0},
            "SatelliteDynamics_0: mass is 0.0 kg; a finite mass above 0 kg is needed, "
            "for example 279.06976744186045 kg",
        ),
        (
            {"mass": math.inf},
            "SatelliteDynamics_0: mass is inf kg; a finite mass above 0 kg is needed, "
            "for example 279.06976744186045 kg",
        ),
        (
            {"velocity": math.nan},
            "SatelliteDynamics_0: start value of velocity is nan m/s; a finite number is needed",
        ),
    ],
)
def test_refuses_start_values(instantiate, start, message):
    instance = instantiate("SatelliteDynamics")
    with pytest.raises(Exception, match="fmi2ExitInitializationMode failed with status 4"):
        instance.initialise(**start)
    assert [text.split("ValueError(")[1] for _, text in instance.log] == [f"'{message}')"]


def test_refuses_a_force_that_is_not_finite(instantiate):
    instance = instantiate("SatelliteDynamics").initialise(velocity=0.02)
    instance.set(force=math.nan)
    with pytest.raises(Exception, match="fmi2DoStep failed with status 4"):
        instance.fmu.doStep(0.25, 1e-3)
    assert [text.split("ValueError(")[1] for _, text in instance.log] == [
        "'SatelliteDynamics_0: input force is nan N in the step from 0.25 s; a finite number is needed. "
        "Look at what is connected to it')"
    ]
