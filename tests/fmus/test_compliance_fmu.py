"""ComplianceController's FMU side: sample grid, modes, refusals with their whole messages."""

from __future__ import annotations

import math

import pytest

NAME = "ComplianceController"


def test_samples_fall_on_the_grid_whatever_divides_the_period(instantiate):
    """Outputs change at multiples of the period only, also where a running sum would miss them."""
    instance = instantiate(NAME).initialise(0.1, mode=1, sample_period=3e-4, identification_period=3e-3)
    seen = []
    for index in range(3000):
        instance.set(measured_force=float(index))
        instance.fmu.doStep(0.1 + index * 1e-4, 1e-4)
        seen.append(instance.get("force")[0])
    assert seen == [float(3 * ((index + 1) // 3) - 1) if index >= 2 else 0.0 for index in range(3000)]
    assert instance.get("state.samples") == (1000,)


def test_steps_of_unlike_size_may_reach_a_sample(instantiate):
    instance = instantiate(NAME).initialise(mode=1, sample_period=1e-3)
    instance.set(measured_force=3.5)
    for time, step in ((0.0, 3e-4), (3e-4, 5e-4), (8e-4, 1e-4)):
        instance.fmu.doStep(time, step)
        assert instance.get("force") == (0.0,)
    instance.fmu.doStep(9e-4, 1e-4)
    assert instance.get("force") == (3.5,)


def refusal(instance, time, step):
    """What the FMU logged about a step that it refused."""
    with pytest.raises(Exception, match="fmi2DoStep failed with status 4"):
        instance.fmu.doStep(time, step)
    ((status, text),) = instance.log
    assert status == 4
    return text.split("ValueError(")[1][1:-2]


@pytest.mark.parametrize("step", [1e-3, 7e-4, 0.2])
def test_a_step_that_leaves_out_a_sample_is_refused(instantiate, step):
    instance = instantiate(NAME).initialise(0.5)
    assert refusal(instance, 0.5, step) == (
        f"ComplianceController_0: the step from 0.5 s to {0.5 + step:.9g} s passes over the sample at 0.5005 "
        "s; steps have to end at every multiple of sample_period, 0.0005 s: take a step size that divides "
        "it, or set sample_period to the step size"
    )


@pytest.mark.parametrize("name", ["measured_force", "desired_velocity"])
@pytest.mark.parametrize("value", [math.nan, -math.inf])
def test_inputs_that_are_not_finite_are_refused(instantiate, name, value):
    instance = instantiate(NAME).initialise()
    instance.set(**{name: value})
    unit = {"measured_force": "N", "desired_velocity": "m/s"}[name]
    assert refusal(instance, 0.0, 5e-4) == (
        f"ComplianceController_0: input {name} is {value!r} {unit} at 0.0005 s; a finite number is needed. "
        "Look at what is connected to it"
    )


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"mode": 4}, "mode is 4; allowed: 1 (off), 2 (lead), 3 (active)"),
        ({"sample_period": 0.0}, "sample_period is 0.0 s; allowed: above 0 s"),
        ({"sample_period": -1e-3}, "sample_period is -0.001 s; allowed: finite and not negative"),
        ({"tau_s": -1e-3}, "tau_s is -0.001 s; allowed: finite and not negative"),
        ({"tau_s": math.nan}, "tau_s is nan s; allowed: finite and not negative"),
        ({"initial_stiffness": 0.0}, "initial_stiffness is 0.0 N/m; allowed: above 0 N/m"),
        ({"forgetting_factor": 1.0}, "forgetting_factor is 1.0; allowed: above 0 and below 1"),
        (
            {"release_threshold": 6.0},
            "release_threshold is 6.0 N; allowed: up to contact_threshold, 5.0 N",
        ),
        (
            {"identification_period": 1.2e-3},
            "identification_period is 0.0012 s; allowed: a multiple of sample_period, 0.0005 s",
        ),
        (
            {"restoration_time": 1e-4},
            "restoration_time is 0.0001 s; allowed: sample_period, 0.0005 s, or more",
        ),
        (
            {"mode": 0, "force_sigma": -2.0},
            "mode is 0; allowed: 1 (off), 2 (lead), 3 (active); "
            "force_sigma is -2.0 N; allowed: finite and not negative",
        ),
    ],
)
def test_refuses_parameters(instantiate, start, message):
    instance = instantiate(NAME)
    with pytest.raises(Exception, match="fmi2ExitInitializationMode failed with status 4"):
        instance.initialise(**start)
    assert [text.split("ValueError(")[1] for _, text in instance.log] == [
        f"'ComplianceController_0: {message}')"
    ]


def test_estimates_are_the_initial_ones_until_something_is_known(instantiate):
    instance = instantiate(NAME).initialise(initial_stiffness=3e4, initial_damping=7.0)
    assert instance.get("stiffness_estimate", "damping_estimate") == (3e4, 7.0)
    instance.fmu.doStep(0.0, 5e-4)
    assert instance.get("stiffness_estimate", "damping_estimate") == (3e4, 7.0)
