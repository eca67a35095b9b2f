"""FMUs of every version and interface look alike, whatever their exporters left out."""

from __future__ import annotations

import re
import tempfile
from ctypes import c_uint8
from dataclasses import replace
from math import sqrt

import fmpy
import foreign
import numpy as np
import pytest
from archives import repack

from orchestrator.base.errors import ConfigError, FmuError, StepError
from orchestrator.config import load_config
from orchestrator.exchange.ssp.write import write_ssp
from orchestrator.fmi import Interface, Kind, Point, RunOptions, StepStatus, load_fmu
from orchestrator.fmi.block import Block
from orchestrator.simulation.run import prepare, run

GRAVITY, RESTITUTION = 9.81, 0.5
EXCHANGE = Interface.MODEL_EXCHANGE
TOLERANCE = 1e-8


def started(path, inputs=(), run_options=RunOptions(tolerance=TOLERANCE), **start):  # noqa: B008
    """An initialised instance, its inputs and outputs, and the names of the outputs."""
    instance = load_fmu(path, run_options).instantiate("one")
    outputs = [v.name for v in instance.description.outputs if v.kind.numeric]
    u, y = np.zeros(len(inputs)), np.zeros(len(outputs))
    instance.bind(inputs, u, outputs, y)
    instance.enter_initialisation(0.0, start, 10.0)
    instance.exit_initialisation()
    instance.read_outputs()
    return instance, u, y, outputs


def steps(instance, y, count, size, first=0):
    rows = []
    for n in range(first, first + count):
        instance.write_inputs()
        assert instance.do_step(Point(n, n * size, size)) is StepStatus.OK
        instance.read_outputs()
        rows.append(y.copy())
    return np.array(rows)


def fall(time):
    """Height and speed of a ball that is dropped from 1 m and bounces, while it bounces up to twice."""
    impact = sqrt(2.0 / GRAVITY)
    height, speed, since = 1.0, 0.0, time
    if time > impact:
        since, height, speed = time - impact, 0.0, RESTITUTION * GRAVITY * impact
        if since > 2.0 * speed / GRAVITY:
            since, speed = since - 2.0 * speed / GRAVITY, RESTITUTION * speed
    return height + speed * since - 0.5 * GRAVITY * since**2, speed - GRAVITY * since


@pytest.fixture(params=[1, 2, 3])
def ball(request, tmp_path):
    return foreign.bounce(tmp_path / "Bounce.fmu", request.param)


@pytest.mark.parametrize("size", [0.125, 0.03125])
def test_model_exchange_bounces_where_theory_says_whatever_the_step(ball, size):
    instance, _, y, _ = started(ball)
    rows = steps(instance, y, round(1.0 / size), size)
    times = size * np.arange(1, len(rows) + 1)
    expected = np.array([fall(time) for time in times])
    # The integrator's tolerance is local and speeds are up to 4.4 m/s.
    assert np.allclose(rows[:, :2], expected, rtol=0.0, atol=1e-5)
    instance.terminate()
    instance.free()


def test_a_row_at_a_time_event_shows_the_values_after_it(ball):
    instance, _, y, outputs = started(ball)
    rows = steps(instance, y, 8, 0.125)
    assert rows[:, outputs.index("count")].tolist() == [0, 1, 1, 2, 2, 3, 3, 4]
    instance.free()


def test_several_events_within_a_step_are_all_handled(ball):
    instance, _, y, outputs = started(ball)
    rows = steps(instance, y, 1, 1.0)
    assert rows[0, outputs.index("count")] == 4
    assert np.allclose(rows[0, :2], fall(1.0), rtol=0.0, atol=1e-5)
    instance.free()


def test_inputs_are_held_over_a_step_and_change_at_its_beginning(ball):
    # bounce.c of FMI 2 and 3 refuses to take its discrete input outside event mode.
    instance, u, y, _ = started(ball, ["u"], v=0.0)
    h = v = None
    h, v = 1.0, 0.0
    for n, acceleration in enumerate([2.0, 2.0, -1.0, 0.0]):
        u[0] = acceleration
        row = steps(instance, y, 1, 0.25, first=n)[0]
        h, v = h + v * 0.25 + 0.5 * acceleration * 0.25**2, v + acceleration * 0.25
        assert np.allclose(row[:2], (h, v), rtol=0.0, atol=1e-6)
    instance.free()


@pytest.mark.parametrize("isolated", [False, True])
@pytest.mark.parametrize("version", [1, 2, 3])
def test_continuous_inputs_follow_a_curve_within_the_integration(version, isolated, tmp_path):
    path = foreign.bounce(tmp_path / "Bounce.fmu", version, smooth=True)
    instance, u, y, _ = started(path, ["u"], RunOptions(tolerance=TOLERANCE, isolated=isolated), v=0.0)
    assert instance.description.followed == {"u"}
    h, v, size = 1.0, 0.0, 0.25
    # The acceleration is begin + slope t + bend t^2 / 2; the third step is held, and the last one jumps.
    curves = [(2.0, -3.0, 4.0), (1.0, 5.0, 0.0), (1.0, 0.0, 0.0), (-2.0, 8.0, 6.0)]
    for n, (begin, slope, bend) in enumerate(curves):
        u[0] = begin
        instance.write_inputs()
        for order, rate in enumerate((slope, bend), 1):
            if slope:
                instance.write_input_derivatives(order, np.array([rate]))
        instance.do_step(Point(n, n * size, size))
        instance.read_outputs()
        h += v * size + begin * size**2 / 2 + slope * size**3 / 6 + bend * size**4 / 24
        v += begin * size + slope * size**2 / 2 + bend * size**3 / 6
        assert np.allclose(y[:2], (h, v), rtol=0.0, atol=1e-6)
    instance.free()


def test_a_discrete_input_follows_no_curve(tmp_path):
    assert load_fmu(foreign.bounce(tmp_path / "Bounce.fmu", 2)).description.followed == frozenset()


def test_start_values_reach_a_model_exchange_fmu(ball):
    instance, _, y, _ = started(ball, restitution=0.25, h=0.5)
    impact = sqrt(1.0 / GRAVITY)
    since = 0.45 - impact  # it bounces again 0.48 s after the start
    row = steps(instance, y, 1, 0.45)[0]
    assert row[1] == pytest.approx(0.25 * GRAVITY * impact - GRAVITY * since, abs=1e-5)
    instance.free()


def test_an_error_within_the_integration_is_the_fmus(ball):
    instance, _, y, _ = started(ball, fail=1)
    steps(instance, y, 3, 0.125)  # until 0.375 s, h = 0.31
    with pytest.raises(StepError) as caught:
        steps(instance, y, 1, 0.125, first=3)
    assert caught.value.time == 0.375
    name = {"1": "fmi1GetDerivatives", "2": "fmi2GetDerivatives", "3": "fmi3GetContinuousStateDerivatives"}
    assert caught.value.what == f"{name[instance.description.fmi_version[0]]} returned error"
    instance.free()


def too_many(ball, monkeypatch, most, **start):
    """The message of a step of 100 s that may take so many integration steps and events."""
    monkeypatch.setattr("orchestrator.fmi.model_exchange._MOST_STEPS", most)
    instance, _, y, _ = started(ball, **start)
    with pytest.raises(StepError) as caught:
        steps(instance, y, 1, 100.0)
    instance.free()
    assert (caught.value.time, caught.value.status) == (0.0, "not integrated")
    # How far it comes is CVODE's matter.
    return re.sub(r"only [\d.e-]+ s", "only X s", re.sub(r"[1-9]\d* were", "N were", str(caught.value)))


def test_too_many_integration_steps_are_reported_with_a_remedy(ball, monkeypatch):
    assert too_many(ball, monkeypatch, 4, h=5.0) == (
        "one at time 0 s: the step of 100 s came only X s far in 4 integration steps and events, the most "
        "allowed; 0 were events\n"
        "  Loosen instances.one.tolerance, or take a smaller step size; if neither helps, a derivative of "
        "the FMU jumps or grows without bound there: make the jump an event, or give it a finite slope."
    )


def test_too_many_events_are_reported_with_a_remedy(ball, monkeypatch):
    assert too_many(ball, monkeypatch, 400) == (
        "one at time 0 s: the step of 100 s came only X s far in 400 integration steps and events, the most "
        "allowed; N were events\n"
        "  Its events come without an end: give what switches in the FMU a hysteresis or a least time "
        "between two events, or take a smaller step size if there are but many of them."
    )


def test_what_the_step_size_changes_is_within_the_tolerance(ball):
    """The integration begins anew with every step, so that a step depends on its beginning alone."""
    one, _, y, _ = started(ball)
    coarse = steps(one, y, 2, 0.125)[-1]
    one.free()
    two, _, y, _ = started(ball)
    fine = steps(two, y, 200, 0.00125)[-1]
    two.free()
    assert np.allclose(coarse[:2], fine[:2], rtol=0.0, atol=1e-5)


def test_an_fmu_without_states_and_indicators_needs_no_integrator(tmp_path):
    xml = foreign.document("bounce3")
    for drop in (
        '<ContinuousStateDerivative valueReference="7"/><ContinuousStateDerivative valueReference="8"/>',
        '<InitialUnknown valueReference="7"/><InitialUnknown valueReference="8"/>',
        '<EventIndicator valueReference="9"/>',
        ' derivative="1"',
        ' derivative="2"',
    ):
        assert drop in xml
        xml = xml.replace(drop, "")
    path = foreign.pack(tmp_path / "B.fmu", "bounce.c", 3, "Bounce", xml)
    instance, _, y, outputs = started(path)
    assert steps(instance, y, 4, 0.25)[:, outputs.index("count")].tolist() == [1, 2, 3, 4]
    instance.free()


def test_a_model_exchange_fmu_runs_from_a_config(ball, tmp_path):
    config = {
        "run": {"master": "jacobi", "step_size": "10 ms", "stop_time": "0.4 s"},
        "instances": {"ball": {"fmu": str(ball), "start": {"u": -GRAVITY}, "tolerance": TOLERANCE}},
    }
    results = run(config, halving=False).results
    assert np.allclose(results["ball.h"], 1.0 - 0.5 * GRAVITY * results.time**2, rtol=0.0, atol=1e-5)


def test_without_a_tolerance_a_stated_one_is_taken(ball):
    config = {
        "run": {"master": "jacobi", "step_size": "10 ms", "stop_time": "0.4 s"},
        "instances": {"ball": {"fmu": str(ball)}},
    }
    made = run(config, halving=False)
    assert made.summary["run"]["tolerance"] == {"ball": 1e-6}
    assert any(
        "ball is integrated with the relative tolerance 1e-06, since its FMU proposes none" in note
        for note in made.summary["notes"]
    )
    named = {**config, "instances": {"ball": {"fmu": str(ball), "tolerance": 1e-8}}}
    assert run(named, halving=False).summary["run"]["tolerance"] == {"ball": 1e-8}


# FMI 1.0.


@pytest.fixture
def slave(tmp_path):
    return foreign.bounce(tmp_path / "Bounce.fmu", 1, slave=True)


def test_fmi1_co_simulation(slave):
    description = load_fmu(slave).description
    assert (description.fmi_version, description.interface) == ("1.0", Interface.CO_SIMULATION)
    assert description.capabilities.variable_step_size and description.capabilities.once_per_process
    assert description.feedthrough["v"] == ()
    assert description.feedthrough["h"] == ("u",) and "h" in description.assumed
    instance, u, y, outputs = started(slave, ["u"], RunOptions(), restitution=0.25)
    u[0] = 4.0
    row = dict(zip(outputs, steps(instance, y, 1, 0.5)[0], strict=True))
    assert row == {"h": 1.5, "v": 2.0, "count": 1.0, "fall": -2.0, "rises": 1.0}
    assert instance.get_values(["rises", "fall", "count"]) == {"rises": True, "fall": -2.0, "count": 1}
    instance.terminate()
    instance.free()


def test_fmi1_status_of_initialisation_is_heeded(slave):
    instance = load_fmu(slave).instantiate("one")
    instance.enter_initialisation(0.0, {"restitution": -1.0})
    with pytest.raises(StepError) as caught:
        instance.exit_initialisation()
    assert caught.value.what == "fmi1InitializeSlave returned error"
    instance.free()


def test_fmi1_start_value_of_a_negated_alias(slave):
    instance, *_ = started(slave, (), RunOptions())
    instance.set_values({"fall": 3.0})
    assert instance.get_values(["v", "fall"]) == {"v": -3.0, "fall": 3.0}
    instance.free()


def test_fmi1_negated_alias_of_a_boolean_is_its_opposite(slave, tmp_path):
    path = tmp_path / "Aliases.fmu"

    def with_alias(name, data):
        if name == "modelDescription.xml":
            added = b"""<ScalarVariable name="falls" valueReference="8" causality="output"
                alias="negatedAlias" variability="discrete"><Boolean/></ScalarVariable>"""
            data = data.replace(b"</ModelVariables>", added + b"</ModelVariables>")
        return name, data

    repack(slave, path, with_alias)
    instance, u, y, outputs = started(path, ["u"], RunOptions())
    for speed, rises in ((4.0, True), (-9.0, False)):
        u[0] = speed
        row = dict(zip(outputs, steps(instance, y, 1, 0.25, first=int(not rises))[0], strict=True))
        assert row["rises"] == rises and row["falls"] == (not rises)
        assert instance.get_values(["rises", "falls"]) == {"rises": rises, "falls": not rises}
    instance.free()
    reported = load_fmu(path).description.variables["falls"]
    memory = np.array([1.0, 0.0])
    block = Block(
        "Boolean", c_uint8, "fmi1SetBoolean", [(0, reported), (1, replace(reported, reference=9))], memory
    )
    block.send()
    assert list(block.values) == [0, 1]


# Arrays and event mode.


def test_elements_of_arrays_are_ports(tmp_path):
    path = foreign.arrays(tmp_path / "Arrays.fmu")
    description = load_fmu(path).description
    names = [f"gain[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)]
    assert [v.name for v in description.parameters] == names
    assert [v.start for v in description.parameters] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert [v.start for v in description.inputs] == [1.0, 1.0, 1.0]
    assert description.feedthrough["y[2]"] == ("u[1]", "u[2]", "u[3]")
    # The second element is fed by nothing and keeps its start value; ports stand in another order.
    instance, u, y, outputs = started(path, ["u[3]", "u[1]"], **{"gain[1,2]": 10.0, "u[2]": 7.0})
    u[:] = 3.0, 2.0
    row = dict(zip(outputs, steps(instance, y, 1, 0.1)[0], strict=True))
    assert row["y[1]"] == 1.0 * 2 + 10.0 * 7 + 3.0 * 3
    assert row["y[2]"] == 4.0 * 2 + 5.0 * 7 + 6.0 * 3
    assert instance.get_values(["u[1]", "u[2]", "u[3]", "gain[2,1]"]) == {
        "u[1]": 2.0, "u[2]": 7.0, "u[3]": 3.0, "gain[2,1]": 4.0,
    }  # fmt: skip
    instance.free()


def test_whole_arrays_start_are_recorded_and_survive_an_ssp(tmp_path):
    path = foreign.arrays(tmp_path / "Arrays.fmu")
    data = {
        "run": {"master": "jacobi", "step_size": "0.5 s", "stop_time": "1 s", "record": ["s.y", "s.count"]},
        "instances": {"s": {"fmu": str(path), "start": {"u": [1, 2, 3], "gain": [[1, 0, 0], [0, 1, 1]]}}},
    }
    results = run(data, halving=False).results
    assert list(results.signals) == ["s.y[1]", "s.y[2]", "s.count"]
    assert [results["s.y[1]"][0], results["s.y[2]"][0]] == [1.0, 5.0]
    write_ssp(data, tmp_path / "X.ssp")
    back = load_config(tmp_path / "X.ssp")
    assert back.model.instances["s"].start == data["instances"]["s"]["start"] and back.notes == ()


def test_elements_of_arrays_are_connected(tmp_path):
    path = str(foreign.arrays(tmp_path / "Arrays.fmu"))
    config = {
        "run": {"master": "gauss-seidel", "step_size": "0.1 s", "stop_time": "0.2 s"},
        "instances": {
            "a": {"fmu": path, "start": {"u[1]": 1, "u[2]": 0, "u[3]": 0}},
            "b": {"fmu": path, "start": {"u[1]": 0}},
        },
        "connections": ["a.y[1] -> b.u[2]", "a.y[2] -> b.u[3]"],
    }
    results = run(config, halving=False).results
    assert results["b.y[1]"].tolist() == [2.0 * 1 + 3.0 * 4] * 3
    assert results["b.y[2]"].tolist() == [5.0 * 1 + 6.0 * 4] * 3
    with pytest.raises(ConfigError, match=r"input b\.u\[3\] \(no unit\) is not connected"):
        strict = {**config["run"], "unconnected": "error"}
        prepare({**config, "run": strict, "connections": ["a.y[1] -> b.u[2]"]})


@pytest.mark.parametrize("event_mode", [False, True])
def test_events_are_counted_with_and_without_event_mode(event_mode, tmp_path):
    path = foreign.arrays(tmp_path / "Arrays.fmu")
    instance, _, y, outputs = started(path, ["u[1]", "u[2]", "u[3]"], RunOptions(event_mode=event_mode))
    rows = steps(instance, y, 6, 0.25)
    # At 0.3, 0.6, 0.9, 1.2 and 1.5 s; a row at an event shows the values after it.
    assert rows[:, outputs.index("count")].tolist() == [0, 1, 2, 3, 4, 5]
    instance.terminate()
    instance.free()


def test_two_events_in_one_step_need_event_mode(tmp_path):
    path = foreign.arrays(tmp_path / "Arrays.fmu")
    counts = []
    for event_mode in (False, True):
        instance, _, y, outputs = started(path, [], RunOptions(event_mode=event_mode))
        counts.append(steps(instance, y, 1, 0.7)[0, outputs.index("count")])
        instance.free()
    assert counts == [1.0, 2.0]


def test_an_attribute_that_the_schema_does_not_know_is_reported_and_ignored(tmp_path):
    path = foreign.wild(tmp_path / "Wild.fmu", 'canHandelEvents="true"')
    assert load_fmu(path).description.deviations == (
        "line 3: The attribute 'canHandelEvents' is not allowed, which is ignored",
    )


def test_event_mode_where_there_is_none(tmp_path):
    path = foreign.wild(tmp_path / "Wild.fmu")
    with pytest.raises(FmuError) as caught:
        load_fmu(path, RunOptions(event_mode=True))
    assert str(caught.value) == (
        f"{path}: event_mode is asked for, which needs an FMI 3.0 co-simulation FMU that declares "
        "hasEventMode\n"
        "  It is run as co-simulation of FMI 2.0; take event_mode away."
    )


@pytest.mark.parametrize("tolerance", [None, 2e-8])
def test_a_tolerance_reaches_a_co_simulation_fmu(tolerance, tmp_path):
    path = foreign.arrays(tmp_path / "Arrays.fmu")
    instance, _, y, outputs = started(path, [], RunOptions(tolerance=tolerance))
    assert y[outputs.index("count")] == (0 if tolerance is None else 20)
    instance.free()


def test_co_simulation_of_fmi_1_cannot_be_reported_a_tolerance(slave):
    with pytest.raises(FmuError) as caught:
        load_fmu(slave, RunOptions(tolerance=1e-6))
    assert str(caught.value) == (
        f"{slave}: a tolerance is given, which cannot be handed to a co-simulation FMU of FMI 1.0\n"
        "  Take tolerance away, or set a parameter of the FMU that does the same."
    )


# Step sizes, tools, processes, paths.


def wild_config(path, step="0.1 s", **instance):
    return {
        "run": {"master": "jacobi", "step_size": step, "stop_time": "0.6 s"},
        "instances": {"one": {"fmu": str(path), "start": {"u": 1}, **instance}},
    }


def test_a_step_that_is_not_the_fmus_own_is_refused(tmp_path):
    path = foreign.wild(tmp_path / "Wild.fmu", "")
    with pytest.raises(ConfigError) as caught:
        prepare(wild_config(path, "0.2 s"))
    assert str(caught.value) == (
        "config: instances.one: one cannot take a step size of 0.2 s: its own is 0.1 s\n"
        "  the FMU does not declare canHandleVariableCommunicationStepSize. Set run.step_size, or "
        "instances.one.step_size, to 0.1 s; "
        "or, if the FMU takes any constant step, say so: instances.one.any_step: true."
    )
    prepare(wild_config(path, "0.1 s"))
    prepare(wild_config(path, "0.2 s", any_step=True))


def test_whole_multiples_of_an_internal_step_are_taken(tmp_path):
    def internal(name, data):
        step = b'canHandleVariableCommunicationStepSize="false" fixedInternalStepSize="0.1"'
        return name, data.replace(b'canHandleVariableCommunicationStepSize="true"', step)

    path = repack(foreign.arrays(tmp_path / "A.fmu"), tmp_path / "X.fmu", internal)
    start = {"u[1]": 0, "u[2]": 0, "u[3]": 0}
    for step in ("0.1 s", "0.3 s"):
        prepare(wild_config(path, step, start=start))
    with pytest.raises(ConfigError, match=r"to 0\.1 s or a whole multiple of it"):
        prepare(wild_config(path, "0.15 s", start=start))


def test_the_run_with_half_the_step_is_not_made_where_the_fmu_forbids_it(tmp_path):
    made = run(wild_config(foreign.wild(tmp_path / "Wild.fmu", "")))
    assert made.results["one.y"][-1] == pytest.approx(0.6)
    message = made.summary["numerics"]["error"]["message"]
    assert "cannot take a step size of 0.05 s: its own is 0.1 s" in message


def test_a_tool_that_is_needed_is_reported(tmp_path):
    capabilities = 'canHandleVariableCommunicationStepSize="true" needsExecutionTool="true"'
    path = foreign.wild(tmp_path / "W.fmu", capabilities)
    notes = prepare(wild_config(path)).system.notes
    assert notes == (
        "config: instances.one: runs only where the tool that made it is installed, Wild tool 1",
    )


def test_asynchronous_steps_are_waited_for(tmp_path):
    path = foreign.wild(tmp_path / "Wild.fmu")
    results = run(wild_config(path, start={"u": 2, "way": 3}), halving=False).results
    assert results["one.y"] == pytest.approx(2.0 * results.time)


def test_one_instance_per_process_unless_isolated(tmp_path):
    path = str(
        foreign.wild(
            tmp_path / "W.fmu",
            'canHandleVariableCommunicationStepSize="true" canBeInstantiatedOnlyOncePerProcess="true"',
        )
    )
    config = wild_config(path)
    config["instances"]["two"] = {"fmu": path, "start": {"u": 1}, "any_step": True}
    with pytest.raises(ConfigError, match=r"Give it a process of its own: instances\.two\.isolate: process"):
        prepare(config)
    config["instances"]["two"]["isolate"] = "process"
    assert run(config, halving=False).results["two.y"][-1] == pytest.approx(0.6)


@pytest.mark.parametrize("version", [1, 2, 3])
def test_paths_with_spaces(version, tmp_path, monkeypatch):
    folder, unpacked = tmp_path / "my FMUs (ö)", tmp_path / "temporary files"
    folder.mkdir()
    unpacked.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(unpacked))
    instance, _, y, _ = started(foreign.bounce(folder / "the ball.fmu", version))
    assert list(unpacked.glob("*/fmu-*"))
    assert steps(instance, y, 1, 0.1)[0, 1] == pytest.approx(-0.981, abs=1e-6)
    instance.free()
    assert not list(unpacked.glob("*/fmu-*"))


def test_binaries_are_looked_for_where_the_version_puts_them(tmp_path):
    for version in (1, 2, 3):
        load_fmu(foreign.bounce(tmp_path / f"{version}.fmu", version)).check()
    assert fmpy.platform != fmpy.platform_tuple


def test_kinds_survive_the_splitting_of_arrays(tmp_path):
    variables = load_fmu(foreign.arrays(tmp_path / "A.fmu")).description.variables
    assert variables["y[1]"].kind is Kind.REAL and variables["y[1]"].shape == ()
    assert (variables["gain[2,3]"].element, variables["gain[2,3]"].elements) == (5, 6)


@pytest.mark.parametrize("loop", ["auto", "native"])
def test_model_exchange_is_left_to_the_python_loop(loop, ball):
    config = {
        "run": {"master": "jacobi", "step_size": "0.5 ms", "stop_time": "0.4 s", "loop": loop},
        "instances": {"ball": {"fmu": str(ball), "start": {"u": -GRAVITY}, "tolerance": TOLERANCE}},
    }
    if loop == "native":
        with pytest.raises(ConfigError, match="instance ball is stepped by Python code"):
            run(config, halving=False)
    else:
        import orchestrator.simulation.native.kernel  # noqa: F401 (once it is there, auto takes the native loop at once)

        assert run(config, halving=False).summary["run"]["loop"] == "python"
