"""Linear systems of python-control and scipy as instances, against python-control."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy import signal

import orchestrator as orc
from orchestrator.base.errors import ConfigError
from orchestrator.frequency import DelaySystem, sampled_system
from orchestrator.translate.linear_model import linear_text

PLANT = control.tf([2.0], [1.0, 3.0, 2.0])


@pytest.fixture(autouse=True, scope="module")
def _cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


def loop(controller, step, *through):
    system = orc.System(step_size=step, stop_time="2 s")
    system.add("plant", PLANT, x1=0.5).add("pi", controller)
    return system.connect("plant.y", "pi.u", {"gain": -1}).connect("pi.y", "plant.u", *through)


def test_a_loop_has_the_roots_and_margins_of_python_control():
    pi = signal.TransferFunction([1.5, 1.0], [1.0, 0.0])
    linear = orc.linearise(loop(pi, "1 ms", {"delay": "0.2 s"}))
    expected = DelaySystem.loop(PLANT * control.tf([1.5, 1.0], [1.0, 0.0]), 0.2)
    assert linear.modes().modes[0].root == pytest.approx(expected.modes().modes[0].root, rel=1e-12)
    found = linear.open("plant.u").margins()
    assert found.delay_margin == pytest.approx(expected.margins("loop").delay_margin, rel=1e-9)


def test_a_run_is_the_response_of_python_control():
    space = control.ss(
        [[-1.0, 2.0], [0.0, -3.0]],
        [[1.0, 0.0], [0.0, 1e-5]],
        [[1.0, 0.0]],
        [[0.0, 0.5]],
        inputs=["force", "heat"],
        outputs=["place"],
        states=["one", "two"],
    )
    system = orc.System(step_size="10 ms", stop_time="2 s")
    system.add("plant", space, force=2.0, heat=1.0, one=0.3)
    result = orc.run(system, halving=False)
    time = result["plant.place"].time
    expected = control.forced_response(space, time, [2.0 + 0.0 * time, 1.0 + 0.0 * time], [0.3, 0.0]).outputs[
        0
    ]
    np.testing.assert_allclose(result["plant.place"].values, expected, atol=1e-7)
    assert list(system.instances["plant"].inputs) == ["force", "heat"]


def test_a_discrete_controller_is_sampled_and_held():
    controller = control.ss([[0.0]], [[1.0]], [[1.5]], [[0.0]], 0.1)
    system = loop(controller, "10 ms")
    sampled = sampled_system(system.check(), orc.linearise(system), resting=1)
    held = control.sample_system(control.ss(PLANT), 0.1, "zoh")
    poles = control.poles(control.feedback(held * controller, 1))
    expected = max(np.log(poles.astype(complex)) / 0.1, key=lambda one: (one.real, one.imag))
    assert sampled.modes()[0].root == pytest.approx(expected, rel=1e-9)


def test_an_fmu_of_a_linear_system_is_built_for_config_files(tmp_path):
    report = orc.build(PLANT, tmp_path / "plant.fmu", model="Plant")
    assert report.model == "Plant" and report.counts["states"] == 2
    result = orc.run(str(report.path), halving=False, set={"Plant.u": 1.0})
    assert result["Plant.y"].at(1.0) == pytest.approx(1.0 - 2.0 * np.exp(-1.0) + np.exp(-2.0), rel=1e-6)


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (control.tf([1.0, 0.0, 0.0], [1.0, 1.0]), "it has no state space"),
        (control.tf([1.0], [1.0, 0.5], True), "its sampling time is not known"),
        (control.frd([1.0, 0.5], [1.0, 2.0]), "it is a FrequencyResponseData"),
        (control.ss([[np.nan]], [[1.0]], [[1.0]], [[0.0]]), "a coefficient is not finite"),
        (control.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["my input"]), "'my input' is no name"),
    ],
)
def test_what_is_no_linear_system_is_refused(system, message):
    with pytest.raises(ConfigError, match=message):
        linear_text(system, "Plant")
