"""The public interface, as users of notebooks meet it."""

from __future__ import annotations

import copy
import inspect
import pickle
import subprocess
import sys

import numpy as np
import pytest

import orchestrator as orc

SHORT = {"run.stop_time": "0.5 s"}


@pytest.fixture(scope="module")
def result():
    return orc.run("docking-1d", set={**SHORT, "robot.tau_m": "6 ms"}, halving=False)


def test_what_is_public_is_there_typed_and_documented():
    for name in orc.__all__:
        one = getattr(orc, name)
        if name == "__version__":
            continue
        assert inspect.getdoc(one), name
        if inspect.isfunction(one):
            signature = inspect.signature(one)
            assert signature.return_annotation is not inspect.Signature.empty, name
            assert all(p.annotation is not inspect.Parameter.empty for p in signature.parameters.values()), (
                name
            )
    assert set(orc.__all__) <= set(dir(orc))
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        orc.absent  # noqa: B018


def test_the_package_loads_nothing_heavy():
    heavy = "('numpy', 'pydantic', 'matplotlib')"
    code = f"import orchestrator, sys; print([one for one in {heavy} if one in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_run_gives_signals_that_numpy_works_on(result):
    force = result["contact.force"]
    assert force.unit == "N"
    assert len(force) == len(result.time) == len(force.time)
    assert np.max(np.abs(force)) == np.max(np.abs(force.values)) > 1.0
    assert type(force * 2) is np.ndarray
    assert np.array_equal(force * 2, 2 * force.values)
    assert np.array_equal(np.asarray(force), force.values)
    middle = 0.5 * (force.time[10] + force.time[11])
    assert force.at(middle) == pytest.approx(0.5 * (force[10] + force[11]))
    assert force.at("250 ms") == force.at(0.25)
    with pytest.raises(ValueError, match="cannot be converted to s"):
        force.at("3 N")
    assert repr(force).startswith("Signal contact.force [N]: ")
    with pytest.raises(KeyError, match=r"contact\.force"):
        result["contact.forse"]


def test_changes_take_texts_and_numbers(result):
    assert result.summary.parameters["robot.tau_m"] == 0.006
    plain = orc.run("docking-1d", set={"run.stop_time": 0.5, "robot.tau_m": 0.006}, halving=False)
    assert np.array_equal(plain["contact.force"], result["contact.force"])


def test_plain_values_take_numbers_in_si_units_and_problems_come_together(result):
    config = orc.load("docking-1d").data
    config["run"] |= {"step_size": 0.0005, "stop_time": 0.5}
    config["instances"]["robot"]["start"]["tau_m"] = 0.006
    plain = orc.run(config, halving=False)
    assert np.array_equal(plain["contact.force"], result["contact.force"])
    assert config["run"]["stop_time"] == 0.5
    config["instances"]["robot"]["fmu"] = "RobotRespons"
    del config["run"]["master"]
    with pytest.raises(orc.ConfigError) as raised:
        orc.run(config)
    assert "master is missing" in str(raised.value) and "RobotRespons" in str(raised.value)


def test_the_summary_has_keys_as_attributes(result):
    summary = result.summary
    assert summary.run.steps == summary["run"]["steps"] > 0
    assert summary.stiffness_estimate == summary["stiffness_estimate"]
    with pytest.raises(AttributeError, match="stiffness_estimate"):
        summary.stifness_estimate  # noqa: B018
    assert pickle.loads(pickle.dumps(summary)) == summary
    assert copy.deepcopy(summary).run.steps == summary.run.steps
    assert "run.steps" in summary._repr_html_()
    assert "stiffness_estimate" in repr(summary) and "config" not in repr(summary)
    assert "<table>" in result._repr_html_()
    assert "signals" in repr(result)


def test_tables_hold_times_values_and_units(result):
    pandas = pytest.importorskip("pandas")
    frame = result.to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    assert np.array_equal(frame.index, result.time)
    assert np.array_equal(frame["contact.force"], result["contact.force"].values)
    assert frame.attrs["units"]["contact.force"] == "N"


def test_datasets_hold_times_values_and_units(result):
    pytest.importorskip("xarray")
    made = result.to_xarray()
    assert np.array_equal(made["contact.force"], result["contact.force"].values)
    assert made["contact.force"].attrs["units"] == "N"


def test_figures_have_one_pair_of_axes_for_each_unit(result):
    figure = result.plot("satellite.velocity", "contact.force")
    assert len(figure.axes) == 2
    assert len(result["contact.force"].plot().axes) == 1
    with pytest.raises(KeyError, match="there are"):
        result.plot("nothing.here")


def test_a_run_is_read_back(result, tmp_path):
    made = orc.run("docking-1d", set={**SHORT, "robot.tau_m": "6 ms"}, out=tmp_path / "out", halving=False)
    back = orc.read_results(tmp_path / "out")
    assert back.folder == made.folder
    assert np.array_equal(back["contact.force"], result["contact.force"])
    assert back.summary.run.steps == made.summary.run.steps
    assert back["contact.force"].unit == "N"


def test_a_system_is_looked_at_and_drawn(tmp_path):
    system = orc.load("docking-1d", set={"robot.tau_m": "6 ms"})
    robot = system.instances["robot"]
    assert robot.model == "DockingHIL.RobotResponse"
    assert robot.parameters["tau_m"].value == 0.006
    assert robot.parameters["tau_m"].unit == "s"
    assert "position" in robot.outputs
    with pytest.raises(KeyError, match="robot"):
        system.instances["robbot"]
    assert any("contact.force" in one for one in system.connections)
    drawing = system.graph()
    assert drawing._repr_svg_().lstrip().startswith("<svg")
    assert "RobotResponse" in drawing.svg
    drawing.save(tmp_path / "system.svg")
    assert (tmp_path / "system.svg").read_text(encoding="utf-8") == drawing.svg
    assert "robot" in repr(system) and "<table>" in system._repr_html_()
    assert "tau_m" in robot._repr_html_()


def test_a_system_is_built_without_a_file_and_written(tmp_path, monkeypatch):
    """A mass that bounces on the bundled contact, once in Python and once from the YAML that it writes."""
    system = orc.System(step_size="1 ms", stop_time=0.5, master="gauss-seidel", title="A loop")
    config = orc.load("docking-1d-uncompensated").data
    for name, one in config["instances"].items():
        system.add(name, one["fmu"], **one.get("start", {}))
    for link in config["connections"]:
        source, _, target = link.partition("->")
        system.connect(source.strip(), target.strip())
    direct = orc.run(system, halving=False)
    path = tmp_path / "loop.yaml"
    text = system.to_yaml(path)
    assert text == path.read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    again = orc.run(path, halving=False)
    assert np.array_equal(again["contact.force"], direct["contact.force"])
    late = orc.run(system, set={"robot.tau_m": "9 ms"}, halving=False)
    assert not np.array_equal(late["contact.force"], direct["contact.force"])
    assert orc.run(system, halving=False)["contact.force"][-1] == direct["contact.force"][-1]


def test_effects_are_put_on_connections():
    system = orc.System(step_size="1 ms", stop_time="1 s", master="jacobi")
    system.add("noise", "SensorNoise").add("robot", "RobotResponse", tau_m=0.006)
    assert "tau_m: 0.006 s" in system.to_yaml()
    source, target = (
        next(iter(system.instances["noise"].outputs)),
        next(iter(system.instances["robot"].inputs)),
    )
    system.connect(f"noise.{source}", f"robot.{target}", {"delay": "3 ms"}, {"low-pass": {"cutoff": 50.0}})
    through = [{"delay": "3 ms"}, {"low-pass": {"cutoff": "50.0 Hz"}}]
    assert system.data["connections"] == [
        {"from": f"noise.{source}", "to": f"robot.{target}", "through": through}
    ]


def test_all_problems_of_a_system_are_reported():
    system = orc.System(step_size="1 ms", stop_time="1 s").add("one", "NoSuchFmu").add("two", "AlsoNot")
    with pytest.raises(orc.ConfigError) as raised:
        system.check()
    assert "NoSuchFmu" in str(raised.value) and "AlsoNot" in str(raised.value)


def test_a_sweep_is_a_table(tmp_path):
    over = {"robot.tau_m": ["2 ms", "4 ms"], "contact.stiffness": np.array([1e5, 2e5])}
    swept = orc.sweep(
        "docking-1d-uncompensated",
        over,
        set=SHORT,
        derived={"peak": "max(abs(contact.force))"},
        store=tmp_path / "store",
        jobs=1,
        step_halving=False,
    )
    columns = swept.columns()
    assert len(columns["peak"]) == 4 and np.all(columns["peak"] > 0.0)
    pytest.importorskip("pandas")
    frame = swept.to_dataframe()
    assert list(frame["robot.tau_m"]) == [0.002, 0.002, 0.004, 0.004]
    assert "4 runs made" in repr(swept) and "<th>peak</th>" in swept._repr_html_()


def test_a_sweep_without_quantities_has_the_numbers_of_its_summaries(tmp_path):
    swept = orc.sweep("docking-1d", {"robot.tau_m": [0.002, "4 ms"]}, set=SHORT, jobs=1, step_halving=False)
    alone = orc.run("docking-1d", set={**SHORT, "robot.tau_m": "4 ms"}, halving=False)
    assert swept.columns()["stiffness_estimate"][1] == alone.summary.stiffness_estimate
    assert not any("[" in name for name in swept.columns())


def test_an_fmu_is_built_and_run(tmp_path):
    pytest.importorskip("rumoca")
    model = tmp_path / "Decay.mo"
    model.write_text(
        "model Decay\n  output Real x(start = 1, fixed = true);\nequation\n  der(x) = -x;\nend Decay;\n",
        encoding="utf-8",
    )
    made = orc.build(model, tmp_path / "Decay.fmu")
    assert str(made).startswith(f"{made.path}: Decay, FMI 2.0 co-simulation\n  1 state, 0 inputs")
    result = orc.run(made.path, set={"run.stop_time": 1.0}, halving=False)
    name = next(one for one in result.names if one.endswith(".x"))
    assert result[name][-1] == pytest.approx(np.exp(-1.0), rel=1e-5)


def test_mistakes_in_arguments_are_named():
    assert "robot.der(position)" in orc.run("docking-1d", set=SHORT, record="robot.*", halving=False).names
    with pytest.raises(orc.ConfigError, match="set: got"):
        orc.run("docking-1d", set=["run.stop_time=1 s"])
    with pytest.raises(orc.ConfigError, match=r"kg .* cannot be converted to s"):
        orc.linearise("emps", at_time="1 kg")


def test_a_run_to_a_folder_loads_no_pandas(tmp_path):
    code = (
        "import sys, orchestrator as orc; "
        f"orc.run('emps', set={{'run.stop_time': '0.1 s'}}, out={str(tmp_path / 'out')!r}, halving=False); "
        "print('pandas' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == "False"
