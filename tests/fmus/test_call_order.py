"""Python FMUs and their native forms refuse what FMI forbids where an instance stands, in the same words."""

from __future__ import annotations

import pytest
from fmpy.fmi1 import FMICallException

FORMS = pytest.mark.parametrize("form", ["", "-native"], ids=["python", "native"])
# What is asked for in an order that FMI forbids, and what the log says of it.
ILLEGAL = {
    "a step before initialisation": (
        lambda one: one.doStep(0.0, 1e-3),
        "fmi2DoStep: illegal call in state Instantiated; allowed in: Step Mode",
    ),
    "a second initialisation": (
        lambda one: (_initialised(one), one.enterInitializationMode()),
        "fmi2EnterInitializationMode: illegal call in state Step Mode; allowed in: Instantiated",
    ),
    "the end of an initialisation that did not begin": (
        lambda one: one.exitInitializationMode(),
        "fmi2ExitInitializationMode: illegal call in state Instantiated; allowed in: Initialization Mode",
    ),
    "an experiment after initialisation": (
        lambda one: (_initialised(one), one.setupExperiment()),
        "fmi2SetupExperiment: illegal call in state Step Mode; allowed in: Instantiated",
    ),
    "a step after termination": (
        lambda one: (_initialised(one), one.terminate(), one.doStep(0.0, 1e-3)),
        "fmi2DoStep: illegal call in state Terminated; allowed in: Step Mode",
    ),
    "an input after termination": (
        lambda one: (_initialised(one), one.terminate(), one.setReal([0], [1.0])),
        "fmi2SetReal: illegal call in state Terminated; allowed in: "
        "Instantiated, Initialization Mode, Step Mode",
    ),
    "a parameter between steps": (
        lambda one: (_initialised(one), one.setReal([1], [2.0])),
        "Set: mass is a fixed parameter: it can be set before the end of initialisation only",
    ),
    "a start value between steps": (
        lambda one: (_initialised(one), one.setReal([0, 2], [2.0, 2.0])),
        "Set: position is a start value: it can be set before the end of initialisation only",
    ),
    "an output that is computed": (
        lambda one: one.setReal([4], [2.0]),
        "Set: kinetic_energy (value reference 4) cannot be set; inputs, independent parameters and "
        "free start values can",
    ),
    "a variable that is not there": (
        lambda one: one.setReal([99], [2.0]),
        "Set: unknown value reference 99; SatelliteDynamics has 0 to ",
    ),
    "a step backwards": (
        lambda one: (_initialised(one), one.doStep(0.5, -1e-3)),
        "from 0.5 s by -0.001 s: both have to be finite, the step size above 0 s",
    ),
}


def _initialised(one):
    one.setupExperiment()
    one.enterInitializationMode()
    one.exitInitializationMode()


@FORMS
@pytest.mark.parametrize("what", ILLEGAL)
def test_what_is_illegal_is_refused_with_the_reason(what, form, instantiate):
    call, reported = ILLEGAL[what]
    instance = instantiate("SatelliteDynamics", form)
    with pytest.raises(FMICallException):
        call(instance.fmu)
    assert any(reported in message for _, message in instance.log), instance.log


@FORMS
def test_a_reset_and_a_saved_state_go_back_to_what_is_legal_there(form, instantiate):
    one = instantiate("SatelliteDynamics", form).fmu
    _initialised(one)
    state = one.getFMUState()
    one.terminate()
    one.setFMUState(state)
    one.doStep(0.0, 1e-3)
    one.freeFMUState(state)
    one.reset()
    one.setReal([1], [2.0])
    _initialised(one)
    one.doStep(0.0, 1e-3)
    assert one.getReal([1]) == [2.0]
    one.reset()
    with pytest.raises(FMICallException):
        one.doStep(0.0, 1e-3)
