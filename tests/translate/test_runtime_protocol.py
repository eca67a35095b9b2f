"""The C runtime's FMI protocol: saved states, legal calls, refusals with their whole message."""

from __future__ import annotations

import ctypes
import math
import re
import subprocess
from pathlib import Path
from shutil import which
from sys import executable

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from runtime_bench import MODELS, PLATFORM, Instance, needs_compiler, unpacked

from orchestrator.translate.package import binary_member

pytestmark = needs_compiler
VERSIONS = pytest.mark.parametrize("version", ["2.0", "3.0"])

# Model -> what is set before each step, and what is compared after it.
DRIVEN = {
    "oscillator": (("u",), ("x", "v", "energy", "der(v)")),
    "feedback": ((), ("x",)),
    "lines": (("u", "lag"), ("q", "y1", "y2")),
    "contact": ((), ("x", "v", "force")),
    "gap": (("x", "v", "lag"), ("force", "y")),
    "robot": (("command",), ("position", "velocity")),
    "pantograph": ((), ("x",)),
}


def drive(
    instance: Instance, inputs: tuple[str, ...], outputs: tuple[str, ...], seed: int, count: int
) -> list[bytes]:
    """Bits of the outputs after each of `count` steps of varying size, 1 us to 40 ms."""
    random, seen = np.random.default_rng(seed), []
    for _ in range(count):
        for name in inputs:
            value = random.uniform(0.0, 0.4) if name == "lag" else random.normal()
            # Some steps keep their inputs, so that a step can go on with the last stage of the one before.
            if random.random() < 0.7:
                instance.set(**{name: value})
        instance.step(math.exp(random.uniform(math.log(1e-6), math.log(0.04))))
        seen.append(np.array([instance.get(name) for name in outputs]).tobytes())
    return seen


@VERSIONS
@pytest.mark.parametrize("model", DRIVEN)
def test_steps_after_a_restored_state_are_bit_identical(model, version):
    inputs, outputs = DRIVEN[model]
    instance = Instance(model, version).initialise()
    drive(instance, inputs, outputs, 1, 120)
    time, state = instance.time, instance.save()
    data = instance.serialise(state)
    expected = drive(instance, inputs, outputs, 2, 300)
    assert len(set(expected)) > 100

    instance.restore(state, time)
    assert drive(instance, inputs, outputs, 2, 300) == expected
    instance.fmu.freeFMUState(state)

    # A second instance, in the middle of a different life.
    other = Instance(model, version).initialise()
    drive(other, inputs, outputs, 5, 37)
    other.restore(other.deserialise(data), time)
    assert drive(other, inputs, outputs, 2, 300) == expected
    assert other.serialise(other.save()) == instance.serialise(instance.save())


def test_a_state_taken_between_setting_and_stepping():
    instance = Instance("lines").initialise(tau=0.01, lag=0.02)
    instance.step(0.05)
    instance.set(u=2.0)
    instance.fmu.setRealInputDerivatives([instance.references["u"]], [1], [3.0])
    time, state = instance.time, instance.save()
    instance.step(0.03)
    expected = instance.get("q"), instance.get("y1"), instance.get("u")
    instance.set(u=9.0)
    instance.step(0.04)
    instance.restore(state, time)
    instance.step(0.03)
    assert (instance.get("q"), instance.get("y1"), instance.get("u")) == expected
    assert expected[2] == pytest.approx(2.0 + 3.0 * 0.03)


def test_a_saved_state_is_reused_and_a_life_starts_over_from_it():
    instance = Instance("contact")
    state = instance.save()
    for _ in range(2):
        instance.initialise(gap=0.2)
        instance.step(0.5)
        assert instance.get("x") == pytest.approx(0.2 + math.sin(10 * 0.3) / 10, abs=1e-9)
        instance.restore(state, 0.0)


def test_foreign_and_damaged_states_are_refused():
    instance = Instance("contact").initialise()
    data = instance.serialise(instance.save())
    other = Instance("feedback").initialise()
    damaged = data[:-5] + bytes([data[-5] ^ 1]) + data[-4:]
    for receiver, received in [(other, data), (instance, damaged), (instance, data[:-8]), (instance, b"")]:
        name = receiver.fmu.modelIdentifier
        assert receiver.fails("deserialise", received) == (
            f"DeserializeFMUState: these {len(received)} bytes are no undamaged state of {name} "
            f"(token {{{name}}})"
        )


@VERSIONS
def test_reset_is_a_new_instance(version):
    def life(instance):
        instance.initialise(omega=3.0)
        instance.set(u=0.5)
        for size in (0.1, 0.013, 0.2):
            instance.step(size)
        return [instance.get(name) for name in ("x", "v", "u", "energy")]

    instance = Instance("oscillator", version)
    fresh = life(instance)
    instance.fmu.reset()
    assert life(instance) == fresh
    instance.fmu.reset()
    instance.initialise()
    assert [instance.get(name) for name in ("x", "v", "u", "omega")] == [1.0, 0.0, 0.0, 2.0]


def test_calls_out_of_order_are_refused_and_change_nothing():
    instance = Instance("oscillator")
    assert instance.fails("step", 0.1) == (
        "fmi2DoStep: illegal call in state Instantiated; allowed in: Step Mode"
    )
    assert instance.fails("get", "x") == (
        "fmi2GetReal: illegal call in state Instantiated; "
        "allowed in: Initialization Mode, Step Mode, Step Discarded, Terminated, Error"
    )
    assert instance.fails("exitInitializationMode") == (
        "fmi2ExitInitializationMode: illegal call in state Instantiated; allowed in: Initialization Mode"
    )
    instance.initialise()
    assert instance.fails("enterInitializationMode") == (
        "fmi2EnterInitializationMode: illegal call in state Step Mode; allowed in: Instantiated"
    )
    instance.step(0.1)
    instance.fmu.terminate()
    assert instance.get("x") == pytest.approx(math.cos(0.2))
    assert instance.fails("step", 0.1) == (
        "fmi2DoStep: illegal call in state Terminated; allowed in: Step Mode"
    )
    third = Instance("oscillator", "3.0")
    assert third.fails("step", 0.1) == "fmi3DoStep: illegal call in state Instantiated; allowed in: Step Mode"


def test_values_that_cannot_be_set():
    instance = Instance("oscillator").initialise()
    fmu = instance.fmu
    computed = "cannot be set; inputs, independent parameters and free start values can"
    cases = [
        (
            ("set", "omega"),
            "Set: omega is a fixed parameter: it can be set before the end of initialisation only",
        ),
        (("set", "x"), "Set: x is a start value: it can be set before the end of initialisation only"),
        (("set", "energy"), f"Set: energy (value reference 6) {computed}"),
        (("set", "v"), f"Set: v (value reference 2) {computed}"),
        (("setReal", 10), "Set: unknown value reference 10; oscillator has 0 to 9"),
        (("setReal", 8), "Set: gear (value reference 8) is of type Integer, not Real"),
        (("setBoolean", 3), "Set: u (value reference 3) is of type Real, not Boolean"),
        (("getInteger", 1), "Get: x (value reference 1) is of type Real, not Integer"),
        (("getReal", 4711), "Get: unknown value reference 4711; oscillator has 0 to 9"),
    ]
    for (call, what), message in cases:
        if call == "set":
            with pytest.raises(FMICallException):
                instance.set(**{what: 1.0})
            assert instance.texts[-1] == message
        elif call.startswith("set"):
            assert instance.fails(call, [what], [1]) == message
        else:
            assert instance.fails(call, [what]) == message
    for value, text in ((math.nan, "nan"), (math.inf, "inf"), (-math.inf, "-inf")):
        with pytest.raises(FMICallException):
            instance.set(u=value)
        assert instance.texts[-1].replace("-nan", "nan") == f"Set: u cannot be {text}; give a finite number"
    assert {(status, category) for status, category, _ in instance.messages} == {(3, "logStatusError")}
    # None of it did any harm.
    instance.step(0.1)
    assert instance.get("x") == pytest.approx(math.cos(0.2), abs=1e-10)
    assert (fmu.getInteger([8]), fmu.getBoolean([9])) == ([1], [1])


def test_steps_that_cannot_be_made():
    instance = Instance("oscillator").initialise(stop=1.0)
    instance.step(0.5)
    bounds = "both must be finite, the step size above 0 s"
    cases = [
        ((0.5, 0.0), f"communication point 0.5 s, step size 0 s: {bounds}"),
        ((0.5, -0.1), f"communication point 0.5 s, step size -0.1 s: {bounds}"),
        ((0.4, 0.1), "communication point 0.40000000000000002 s is not the instance's time 0.5 s"),
        ((0.5, 0.6), "step from 0.5 s to 1.1 s passes the stop time 1 s"),
        ((0.5, 1e-20), "step size 1e-20 s is lost in rounding at t = 0.5 s"),
    ]
    for arguments, message in cases:
        assert instance.fails("doStep", *arguments) == f"DoStep: {message}"
    instance.step(0.5)


@VERSIONS
def test_a_binary_of_another_build_is_refused(version):
    instance = Instance("oscillator", version)
    instance.fmu.guid = "{other}"
    with pytest.raises(Exception, match="instantiate"):
        instance.instantiate()
    call = {"2.0": "fmi2Instantiate", "3.0": "fmi3InstantiateCoSimulation"}[version]
    assert instance.texts == [
        f"{call}: the GUID or instantiation token is not that of this binary: modelDescription.xml belongs "
        "to another build"
    ]


def test_what_is_not_offered_says_so():
    third = Instance("oscillator", "3.0").initialise()
    library, component = third.fmu.dll, ctypes.c_void_p(third.fmu.component)
    one = (ctypes.c_uint32 * 1)(1)
    cases = [
        ("EnterEventMode", (), "belongs to Event Mode, which is not offered (hasEventMode is false)"),
        ("GetFloat32", (one, 1, None, 1), "there are no variables of this type"),
        ("GetClock", (one, 1, None), "there are no Clock variables"),
        ("GetOutputDerivatives", (one, 1, None, None, 1), "maxOutputDerivativeOrder is 0"),
        ("SetTime", (ctypes.c_double(1.0),), "belongs to Model Exchange, which is not offered"),
        ("EnterConfigurationMode", (), "there are no structural parameters"),
        ("ActivateModelPartition", (1, ctypes.c_double(1.0)), "Scheduled Execution is not offered"),
    ]
    for name, arguments, message in cases:
        # Bound anew: some of these fmpy knows with other argument types.
        function = ctypes.CDLL(library._name)[f"fmi3{name}"]
        assert function(component, *arguments) == 3
        assert third.texts[-1] == f"fmi3{name}: {message}"

    second = Instance("oscillator").initialise()
    library, component = second.fmu.dll, ctypes.c_void_p(second.fmu.component)
    cases = [
        ("EnterEventMode", (), "belongs to Model Exchange, which is not offered"),
        ("GetRealOutputDerivatives", (one, 1, None, None), "maxOutputDerivativeOrder is 0"),
        ("CancelStep", (), "steps are not asynchronous, there is none to cancel"),
        ("GetString", (one, 1, None), "there are no String variables"),
        ("GetReal", (None, 1, None), "argument vr is NULL"),
        ("GetFMUstate", (None,), "argument FMUstate is NULL"),
    ]
    for name, arguments, message in cases:
        assert ctypes.CDLL(library._name)[f"fmi2{name}"](component, *arguments) == 3
        assert second.texts[-1] == f"fmi2{name}: {message}"
    assert second.fails("getDirectionalDerivative", [6], [4], [1.0]) == (
        "GetDirectionalDerivative: omega cannot be a known; Real inputs and states can"
    )


def test_other_interface_types_are_refused():
    third = Instance("oscillator", "3.0")
    for options, message in [
        ({"eventModeUsed": True}, "Event Mode is not offered (hasEventMode is false)"),
        (
            {"requiredIntermediateVariables": [1]},
            "intermediate update is not offered (providesIntermediateUpdate is false)",
        ),
    ]:
        with pytest.raises(Exception, match="instantiate"):
            third.instantiate(**options)
        assert third.texts[-1] == f"fmi3InstantiateCoSimulation: {message}"


def status_of(instance: Instance, call: str, *arguments: float) -> int:
    with pytest.raises(FMICallException) as caught:
        getattr(instance.fmu, call)(*arguments)
    return caught.value.status


def test_an_error_assertion_ends_the_run_and_a_warning_is_reported_once():
    instance = Instance("contact").initialise(soft=0.2, hard=0.39)
    instance.step(0.25)
    # %%: an FMI 2.0 logger takes a format.
    text = "assertion violated at t = 0.25 s (told once): x is beyond soft (100 %% used)"
    assert instance.messages == [(1, "logStatusWarning", text)]
    instance.step(0.1)
    assert len(instance.messages) == 1
    assert status_of(instance, "doStep", instance.time, 0.2) == 3
    status, category, text = instance.messages[-1]
    assert (status, category) == (3, "logStatusError")
    assert text.startswith("DoStep: assertion violated at t = ") and text.endswith(" s: x is beyond hard")
    assert instance.fails("step", 0.1) == "fmi2DoStep: illegal call in state Error; allowed in: Step Mode"
    # What was reached can still be read, and a reset begins anew.
    assert instance.get("x") > 0.39
    instance.fmu.reset()
    instance.initialise()
    instance.step(0.1)


def test_an_assertion_that_fails_at_the_start():
    instance = Instance("contact")
    instance.set(x=2.0, hard=1.0)
    instance.enter()
    assert instance.fails("exitInitializationMode") == (
        "ExitInitializationMode: assertion violated at t = 0 s: x is beyond hard"
    )


@VERSIONS
def test_finite_escape_discards_the_step_and_tells_how_far_it_came(version):
    # x' = x^2 from 1 is infinite at t = 1.
    instance = Instance("trouble", version).initialise(escape=1.0)
    instance.step(0.5)
    assert instance.get("x") == pytest.approx(2.0, abs=1e-9)
    assert status_of(instance, "doStep", 0.5, 1.0) == 2
    status, category, text = instance.messages[-1]
    assert (status, category) == (2, "logStatusDiscard")
    assert text.startswith("DoStep: the internal step size fell below ") and "state x" in text
    if version == "2.0":
        reached = instance.fmu.getRealStatus(2)
        assert reached == pytest.approx(1.0, abs=1e-6)
        assert instance.get("time") == reached


def test_chattering_is_an_error():
    # x' = -sign(x) reaches 0 at t = 1 and cannot leave it.
    instance = Instance("trouble").initialise(slide=1.0)
    instance.step(0.9)
    assert status_of(instance, "doStep", 0.9, 0.2) == 3
    assert instance.texts[-1] == (
        "DoStep: chattering at t = 1 s: 100 events within less than 2e-09 s of each other"
    )


@VERSIONS
def test_a_communication_step_without_progress_is_an_error(version):
    # A time constant of 1e-12 s, and a slope that is steep over less than ten tolerances of x only.
    instance = Instance("steep", version).initialise(speed=1.0, width=1e-12)
    instance.step(0.9)
    assert status_of(instance, "doStep", 0.9, 0.2) == 3
    status, category, text = instance.messages[-1]
    assert (status, category) == (3, "logStatusError")
    at, took, longer = re.findall(r"(?:at t =|steps took|in one of) (\S+)", text)
    assert 1 < float(at) < 1.0001 and float(took) < 1e-4 and float(longer) < 1e-9
    assert text == (
        f"DoStep: no progress at t = {at} s: the last 2000000 internal steps took {took} s together, "
        f"less than 0.05 of the communication step of 0.2 s; in one of {longer} s the error of state x "
        "exceeds the relative tolerance 1e-10. A derivative jumps or grows without bound there, or is too "
        "stiff: keep roots and divisions away from zero, write a jump as an event (if, without noEvent), "
        "give it a finite slope, or take shorter communication steps if it is but stiff"
    )


def test_modes_that_contradict_themselves_are_an_error():
    instance = Instance("trouble").initialise()
    instance.step(0.1)
    instance.set(flip=1.0)
    with pytest.raises(FMICallException):
        instance.get("y")
    message = "event iteration at t = 0.1 s does not converge: after 16 rounds relation 2 still changes"
    assert instance.texts[-1] == f"Get y: {message}"
    assert instance.fails("doStep", 0.1, 0.1) == f"DoStep: {message}"


def test_delay_times_that_cannot_be():
    instance = Instance("trouble").initialise()
    instance.step(0.1)
    # Zero but for a rounding error.
    instance.set(lag=-1e-17)
    assert instance.get("y") == 1.0
    for lag, message in (
        (-0.1, "delay time is -0.1 s; it must be 0 s or more"),
        (2.5, "delay time 2.5 s exceeds its maximum 2 s"),
    ):
        instance.set(lag=lag)
        with pytest.raises(FMICallException):
            instance.get("y")
        assert instance.texts[-1] == f"Get y: delay operator 1 at t = 0.1 s: {message}"
    assert instance.fails("doStep", 0.1, 0.1) == f"DoStep: delay operator 1 at t = 0.1 s: {message}"


def test_a_value_that_is_not_finite_is_a_warning():
    instance = Instance("trouble").initialise(x=-1.0)
    assert math.isnan(instance.get("root"))
    ((status, category, text),) = instance.messages
    assert (status, category) == (1, "logStatusWarning")
    assert text.replace("-nan", "nan") == "Get: root is nan at t = 0 s"


def test_unknown_log_category():
    instance = Instance("contact").initialise()
    instance.fmu.fmi2SetDebugLogging(instance.fmu.component, 1, 1, (fmpy.fmi2.fmi2String * 1)(b"logMoon"))
    assert instance.texts == [
        "SetDebugLogging: unknown category logMoon; "
        "known: logStatusWarning, logStatusDiscard, logStatusError, logEvents"
    ]


@pytest.fixture(scope="session")
def driver(tmp_path_factory) -> Path:
    """The C program models/driver.c."""
    program = tmp_path_factory.mktemp("driver") / "driver"
    headers = Path(fmpy.__file__).parent / "c-code"
    compiler = [executable, "-m", "ziglang", "cc", "-O1", "-g0", f"-I{headers}"]
    subprocess.run([*compiler, "-o", program, MODELS / "driver.c", "-ldl"], check=True)
    return program


def library(model: str) -> Path:
    return unpacked(model) / binary_member(PLATFORM, model, "2.0")


@pytest.mark.parametrize(("model", "output"), [("contact", 1), ("lines", 5), ("gap", 7)])
def test_memory_is_clean(driver, model, output):
    if which("valgrind") is None:
        pytest.skip("needs valgrind")
    checker = ["valgrind", "-q", "--error-exitcode=9", "--leak-check=full"]
    command = [*checker, driver, library(model), f"{{{model}}}", str(output)]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
