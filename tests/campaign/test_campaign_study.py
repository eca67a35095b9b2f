"""Studies: the identity of their runs, units, and refusals before the first run."""

from __future__ import annotations

import numpy as np
import pytest
from archives import repack
from campaign_bench import QUICK, one_body, quick, with_mass_in

from orchestrator.base.errors import ConfigError
from orchestrator.campaign import Study
from orchestrator.config import dump, load_config
from orchestrator.fmi import bundled


def test_a_run_has_one_identity_however_it_is_written():
    def key(design, **changes):
        return quick(design={"list": [design]}, **changes).task(0)[0].key

    one = key({"robot.tau_m": "4 ms"})
    assert one == key({"robot.tau_m": "0.004 s"})
    assert one == key({"robot.tau_m": "4 ms", "run.step_size": "0.008 s"})
    assert one == key({"robot.tau_m": "4 ms"}, set=QUICK | {"run.loop": "native"}, title="another")
    assert one == key({"robot.tau_m": "4 ms"}, time_limit="9 s", retry={"attempts": 2})
    assert one != key({"robot.tau_m": "4.0000001 ms"})
    assert one != key({"robot.tau_m": "4 ms"}, step_halving=False)
    assert one != key({"robot.tau_m": "4 ms"}, derived={})
    assert one != key({"robot.tau_m": "4 ms"}, record="all")
    python = {path: value for path, value in QUICK.items() if path != "satellite.form"}
    assert one != key({"robot.tau_m": "4 ms"}, set=python)  # another FMU
    assert one == key({"robot.tau_m": "4 ms", "satellite.form": "native"}, set=python)


def refused(**changes):
    with pytest.raises(ConfigError) as caught:
        quick(**changes)
    return str(caught.value)


def test_everything_that_is_wrong_is_reported_at_once():
    reported = refused(
        design={
            "multiply": [
                {
                    "grid": {
                        "robots.tau_m": ["1 ms"],
                        "contact.stiffness": ["1 N", 5],
                        "run.step_size": ["3 ms"],
                    }
                },
                {"random": {"count": 2, "seed": 1, "over": {"robot.xi_n": {"uniform": [0.9, 0.8]}}}},
                {"list": [{"robot.omega_n": float("nan")}, {"robot.omega_n": float("inf")}]},
            ]
        },
        derived={"peak": "max(contact.forse)", "status": "1"},
    )
    assert reported.splitlines() == [
        "study: derived.status: 'status' cannot name a quantity",
        "  the store has a column of it",
        "study: derived.peak: peak: no signal 'contact.forse'",
        "  recorded are: satellite.position, satellite.velocity, satellite.kinetic_energy, robot.position, "
        "robot.velocity, contact.force, contact.penetration. Did you mean contact.force?",
        "study: design: no 'robots.tau_m' to set",
        "  instances: satellite, robot, contact; sections: run, external, connections[...].through, bonds, "
        "measures, title. Did you mean robot.tau_m or robot.xi_n?",
        "study: design.multiply[0].grid.contact.stiffness: contact.stiffness [N/m]: cannot take '1 N', "
        "N [kg.m.s-2] cannot be converted to N/m [kg.s-2]",
        "  its unit is N/m",
        "study: design.multiply[0].grid.contact.stiffness: contact.stiffness [N/m]: 5 has no unit",
        "  a unit must be given, for zero too; its unit is N/m. Write 5 N/m.",
        "study: design.multiply[1].random.over.robot.xi_n: robot.xi_n: 0.9 is not below 0.8",
        "study: design.multiply[2].list[0].robot.omega_n: robot.omega_n: nan is not finite",
        "study: design.multiply[2].list[1].robot.omega_n: robot.omega_n: inf is not finite",
        "study: design.multiply[0].grid.run.step_size: docking-1d-uncompensated.yaml:4: run: "
        "stop_time 0.8 s is 266.667 steps of 3 ms away",
        "  a whole number of steps after start_time is needed. Nearest stop times: 0.798 s, 0.801 s.",
    ]


def test_what_is_wrong_in_one_part_of_a_study_hides_nothing_in_others(tmp_path):
    path = tmp_path / "study.yaml"
    text = """\
format: sweep/1
system: docking-1d-uncompensated
set: {run.stop_time: 0.8 s}
repeats: {count: 0, seed: 1, into: [robot.x]}
design:
  multiply:
    - grid: {robots.tau_m: [1 ms], contact.stiffness: [1 N], run.step_size: {from: 1 ms, to: 2 ms, cout: 3}}
    - random: {count: 2, seed: 1, over: {robot.xi_n: {uniform: [0.9, 0.8]}, robot.tau_m: {unifrm: [1]}}}
derived: {peak: max(contact.forse), status: "1", x: "max("}
time_limit: 3
time_limit: 3 s
bogus: 3
"""
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        Study.load(path)
    assert [one.place.removeprefix("study.yaml:") for one in caught.value.problems] == [
        "4: repeats.count",
        "5: design",
        "7: design.multiply[0].grid.run.step_size.cout",
        "7: design.multiply[0].grid.contact.stiffness",
        "8: design.multiply[1].random.over.robot.tau_m.unifrm",
        "8: design.multiply[1].random.over.robot.xi_n",
        "9: derived.status",
        "9: derived.peak",
        "9: derived.x",
        "10: time_limit",
        "11: time_limit",
        "12: bogus",
    ]
    assert caught.value.unchecked == ()
    # With problems of the system, what is known of it is enough for most.
    design = [f"{one.place}: {one.what}" for one in caught.value.problems]
    path.write_text(text.replace("0.8 s}", "0.8 s, robot.tau_m: [1], robt.xi_n: 3}"))
    with pytest.raises(ConfigError) as caught:
        Study.load(path)
    assert [f"{one.place}: {one.what}" for one in caught.value.problems] == [
        "--set robt.xi_n=3: no 'robt.xi_n' to set",
        "study.yaml:3: set.robot.tau_m: [1] is no value",
        *design,
    ]
    assert caught.value.unchecked == (
        "the system with the design's values",
        "numbers and instants of quantities",
    )
    # Without a system, what it is not needed for is looked at.
    path.write_text(text.replace("docking-1d-uncompensated", "docking-2d"))
    with pytest.raises(ConfigError) as caught:
        Study.load(path)
    reported = [one.place for one in caught.value.problems]
    assert any("derived.x" in one for one in reported) and not any("derived.peak" in one for one in reported)
    assert caught.value.unchecked == ("the design's values, and signals and numbers of quantities",)


def test_values_of_a_design_are_read_beside_what_is_wrong_with_its_system():
    """Not those of an instance whose FMU is missing."""
    system = load_config("docking-1d-uncompensated").model.to_data()
    system["run"] |= {"step_size": 1, "master": "jacoby"}
    system["instances"]["robot"]["fmu"] = "RobotRespons"
    system["connections"][3] = "contact.forse -> satellite.force"
    grid = {"contact.stiffness": ["1 N", 5], "robot.tau_m": ["1 N"], "run.stop_time": ["1 m"], "robt.x": [1]}
    with pytest.raises(ConfigError) as caught:
        Study(system=system, design={"grid": grid}, derived={"a": "max(contact.x)", "b": "max("})
    assert [f"{one.place}: {one.what}" for one in caught.value.problems] == [
        "config: run.step_size: 1 has no unit; write it as in '1 s' or '1 ms'",
        "config: run.master: no master 'jacoby'",
        "config: instances.robot.fmu: no FMU 'RobotRespons'",
        "config: connections[3]: contact has no variable 'forse'",
        "study: derived.b: b: 'max(': cannot be read ('(' was never closed)",
        "study: design.grid.contact.stiffness: contact.stiffness [N/m]: cannot take '1 N', "
        "N [kg.m.s-2] cannot be converted to N/m [kg.s-2]",
        "study: design.grid.contact.stiffness: contact.stiffness [N/m]: 5 has no unit",
        "study: design.grid.run.stop_time: run.stop_time: cannot take '1 m', "
        "m [m] cannot be converted to s [s]",
    ]
    assert str(caught.value).splitlines()[-1] == (
        "Not checked because of these problems: whether the run is a whole number of steps; ports and start "
        "values of robot; what the master asks of the system; step sizes of FMUs; "
        "the system with the design's values; signals, numbers and instants of quantities."
    )


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({"design": {"grid": {}}}, "at least 1 item"),
        ({"design": {"grid": {"robot.tau_m": []}}}, "at least 1 item"),
        (
            {"design": {}},
            "exactly one of grid, list, random, latin-hypercube, sobol, multiply, add is needed",
        ),
        ({"design": {"grid": {"run.step_size": ["3 ms"]}}}, "stop_time 0.8 s is 266.667 steps of 3 ms away"),
        ({"design": {"grid": {"run.step_size": [0.004]}}}, "0.004 has no unit"),
        ({"design": {"grid": {"run.loop": ["native"]}}}, "cannot be varied: no result depends on it"),
        ({"design": {"grid": {"contact.force": ["1 N"]}}}, "cannot be set"),
        ({"design": {"grid": {"robot.command": ["1 m"]}}}, "has two sources"),
        (
            {"design": {"grid": {"contact.front": ["1 mm"], "instances.contact.start.front": ["2 mm"]}}},
            "set the same",
        ),
        ({"design": {"grid": {"run.master": ["gauss", "jacobi"]}}}, "no master 'gauss'"),
        ({"design": {"grid": {"satellite.form": ["compiled"]}}}, "no form 'compiled'"),
        ({"system": "docking-2d"}, "no config 'docking-2d'"),
        ({"time_limit": "0 s"}, "'0 s' is not positive"),
        ({"time_limit": 60}, "60 has no unit; write it as in '60 s'"),
        ({"derived": {"x": "__import__('os').system('true')"}}, "no function"),
        ({"derived": {"x": "max(contact.force"}}, "cannot be read"),
        ({"record": {"signals": ["contact.forces"]}}, "no signal 'contact.forces'"),
        ({"repeats": {"count": 2, "seed": 1, "into": ["robot.tau_m"]}}, "has no unit"),
        ({"repeats": {"count": 2, "seed": 1}}, "into is missing"),
        ({"steps": 5}, "unknown key 'steps'"),
        (
            {"set": QUICK | {"run.realtime.speed": 2}},
            "run.realtime: runs of a sweep are not paced by the clock",
        ),
        ({"design": {"grid": {"robot.tau_m": {"from": "1 ms", "to": "2 ms"}}}}, "count"),
    ],
)
def test_bad_studies_are_refused(changes, reported):
    assert reported in refused(**changes)


def test_names_that_the_store_would_not_tell_apart_are_refused():
    body = {"fmu": "SatelliteDynamics", "form": "native", "start": {"force": "0 N"}}
    system = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "0.1 s"},
        "instances": {"m": body, "M": body},
    }
    reported = refused(
        system=system,
        set={},
        design={"grid": {"m.mass": ["1 kg"]}},
        derived={"peak": "m.mass", "Peak": "M.mass", "Attempts": "m.mass"},
        record="all",
    )
    assert reported.splitlines() == [
        "study: derived.Attempts: 'Attempts' cannot name a quantity",
        "  the store has a column of it",
        "study: derived.Peak: 'Peak' and 'peak' differ in case only",
        "  the store's columns do not distinguish them. Rename one of them.",
        *(
            line
            for name in ("position", "velocity", "kinetic_energy")
            for line in (
                f"study: record: 'M.{name}' and 'm.{name}' differ in case only",
                "  the store's columns do not distinguish them. Keep one of them, by record.signals.",
            )
        ),
    ]


def test_names_that_no_run_has_a_number_for_are_refused():
    reported = refused(
        design={"grid": {"robot.omegas": ["1 Hz"]}},
        derived={"a": "satellite.masss + robot.nothing", "b": "contact.force * contact.stiffness"},
    )
    assert reported.splitlines()[2:] == [
        "study: derived.a: a: no number 'satellite.masss'",
        "  parameters of satellite: mass, position, velocity. Did you mean satellite.mass?",
        "study: derived.a: a: no number 'robot.nothing'",
        "  parameters of robot: omega_n, xi_n, tau_m",
        "study: derived.b: b: no number 'contact.force'",
        "  it is a signal: outside max, final and so on stand parameters and numbers of the summary. "
        "Write final(contact.force).",
    ]


def test_instants_that_a_run_does_not_record_are_refused():
    late = {"late": 'at(robot.position, "1 s") - at(robot.position, "0.8 s")', "soon": 'at(time, "-1 ms")'}
    assert refused(derived=late).splitlines() == [
        "study: derived.late: late: at 1 s nothing is recorded",
        "  the run is recorded from 0 s to 0.8 s; run.stop_time is 0.8 s",
        "study: derived.soon: soon: at -0.001 s nothing is recorded",
        "  the run is recorded from 0 s to 0.8 s; run.stop_time is 0.8 s",
    ]
    end = {"end": 'at(robot.position, "800 ms")'}
    assert len(quick(derived=end)) == 12
    assert refused(derived=end, set=QUICK | {"run.record_every": 7}).splitlines() == [
        "study: derived.end: end: at 0.8 s nothing is recorded",
        "  the run is recorded from 0 s to 0.784 s; run.stop_time is 0.8 s",
    ]


def test_instants_are_judged_by_the_stop_time_of_each_point():
    two = {"two": 'at(robot.position, "2 s")'}
    assert len(quick(derived=two, design={"grid": {"run.stop_time": ["2 s", "4 s"]}})) == 2
    short = {
        "add": [{"grid": {"run.stop_time": ["2 s", "1600 ms", "1.2 s"]}}, {"list": [{"robot.xi_n": 0.9}]}]
    }
    assert refused(derived=two, design=short).splitlines() == [
        "study: derived.two: two: at 2 s nothing is recorded",
        "  point 1 of the design is recorded from 0 s to 1.6 s; run.stop_time is 1.6 s",
    ]
    delays = {"list": [{"robot.xi_n": 0.9}]}
    mixed = {"add": [{"grid": {"run.stop_time": ["2 s"]}}, delays]}
    assert "point 1 of the design is recorded from 0 s to 0.8 s" in refused(derived=two, design=mixed)


def test_numbers_of_measures_and_of_varied_start_values_are_let_pass(tmp_path):
    # What a measure finds only a run tells; the force is an input that only the design gives a value.
    quick(derived={"growth": "contacts[1].cor / robot.tau_m", "never": "contacts[99].nothing"})
    body = one_body(
        "SatelliteDynamics", derived={"force": "m.force"}, design={"grid": {"m.force": ["1 N", "2 N"]}}
    )
    assert body.run(tmp_path / "store", jobs=1).columns()["force"].tolist() == [1.0, 2.0]
    with pytest.raises(ConfigError, match=r"the system has no measures; parameters: m\.mass"):
        one_body(
            "SatelliteDynamics", derived={"cor": "contacts[0].cor"}, design={"grid": {"m.mass": ["1 kg"]}}
        )


def test_parameters_of_a_varied_fmu_are_known(tmp_path):
    def renamed(name, data):
        return name, data.replace(b'name="mass"', b'name="weight"') if name.endswith(".xml") else data

    other = repack(bundled.fmu_forms("SatelliteDynamics")["native"], tmp_path / "other.fmu", renamed)
    design = {"grid": {"m.fmu": ["SatelliteDynamics", str(other)]}}
    study = one_body("SatelliteDynamics", derived={"mass": "m.mass", "weight": "m.weight"}, design=design)
    columns = study.run(tmp_path / "store", jobs=1).columns()
    assert columns["weight"][1] == columns["mass"][0] > 0.0
    assert np.isnan([columns["weight"][0], columns["mass"][1]]).all()


def test_fmus_in_a_study_are_beside_it(tmp_path):
    """Not beside its system, and not in the working directory."""
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    for folder, mass in ((mine, "2"), (theirs, "3")):
        folder.mkdir()
        with_mass_in("kg", folder / "light.fmu", mass)
    body = {"fmu": "SatelliteDynamics", "form": "native", "start": {"force": "1 N"}}
    run = {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "0.1 s"}
    system = {"run": run, "instances": {"m": {"fmu": "light.fmu", "start": body["start"]}, "n": body}}
    (theirs / "system.yaml").write_text(dump(system))
    study = {
        "format": "sweep/1",
        "system": "../theirs/system.yaml",
        "design": {"list": [{"n.fmu": "./light.fmu"}]},
    }
    study["derived"] = {"m": "m.mass", "n": "n.mass"}
    for set_, mass in (({}, 3.0), ({"m.fmu": "light.fmu"}, 2.0)):
        (mine / "study.yaml").write_text(dump(study | {"set": set_}))
        columns = Study.load(mine / "study.yaml").run(tmp_path / "store", jobs=1).columns()
        assert (columns["m"], columns["n"]) == (mass, 2.0)
    study["design"] = {"list": [{"n.fmu": "./none.fmu"}]}
    (mine / "study.yaml").write_text(dump(study))
    with pytest.raises(ConfigError) as caught:
        Study.load(mine / "study.yaml")
    fmus = bundled.fmu_names()
    assert str(caught.value).splitlines() == [
        "study.yaml:5: design.list[0].n.fmu: n.fmu: no FMU './none.fmu'",
        f"  no file {mine}/none.fmu; bundled FMUs: {', '.join(fmus[:20])} and {len(fmus) - 20} more",
    ]


def test_what_is_in_misspelt_sections_of_a_study_is_reported():
    data = {"format": "sweep/1", "system": "docking-1d", "derivd": {"late": "max(contact.forse)"}}
    with pytest.raises(ConfigError) as caught:
        Study(data | {"desing": {"grid": {"robot.tau_m": ["1 N"]}}})
    assert [one.place for one in caught.value.problems] == [
        "study: derivd",
        "study: desing",
        "study: derived.late",
        "study: design.grid.robot.tau_m",
    ]
    assert caught.value.unchecked == ()


def test_only_the_form_of_values_that_was_meant_is_reported():
    grid = {"robot.tau_m": [], "robot.omega_n": {"from": "1 Hz", "to": "2 Hz", "cout": 3}}
    with pytest.raises(ConfigError) as caught:
        quick(design={"multiply": [{"grid": grid}]})
    where = "design.multiply[0].grid.robot"
    assert [(one.place, one.what) for one in caught.value.problems] == [
        (f"study: {where}.tau_m", "list should have at least 1 item after validation, not 0, got []"),
        (f"study: {where}.omega_n.cout", "unknown key 'cout'"),
    ]
    last = caught.value.problems[-1]
    assert last.allowed == "allowed: from, to, count, spacing" and last.remedy == "Did you mean count?"


def test_a_study_file_is_reported_with_its_lines(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text("format: sweep/1\nsystem: docking-1d\ndesign:\n  grid:\n    robot.tau_m: [1 N]\n")
    with pytest.raises(
        ConfigError, match=r"study.yaml:5: design.grid.robot.tau_m: robot.tau_m \[s\]: cannot take '1 N'"
    ):
        Study.load(path)
    path.write_text("- 1\n")
    with pytest.raises(ConfigError, match="not a study"):
        Study.load(path)
