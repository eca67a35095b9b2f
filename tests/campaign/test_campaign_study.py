"""Studies: designs, units, and refusals before the first run."""

from __future__ import annotations

import math

import numpy as np
import pytest
from archives import repack
from campaign_bench import QUICK, one_body, quick, with_mass_in
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator import bundled
from orchestrator.campaign import Study
from orchestrator.campaign.derived import Derived
from orchestrator.campaign.execute import flat
from orchestrator.config import dump, load_config
from orchestrator.errors import ConfigError
from orchestrator.results import Results


def points(design, **changes):
    study = quick(design=design, **changes)
    return [{path: level.shown for path, level in study.task(n)[1].items()} for n in range(len(study))]


def test_blocks_multiply_and_add():
    delays = {"grid": {"robot.tau_m": ["1 ms", "2 ms"]}}
    rates = {"list": [{"robot.omega_n": "50 Hz"}, {"robot.omega_n": "75 Hz", "robot.xi_n": 0.5}]}
    made = points({"multiply": [delays, rates]})
    assert [one["robot.tau_m"] for one in made] == [0.001, 0.001, 0.002, 0.002]
    assert [one["robot.omega_n"] / (2 * math.pi) for one in made] == pytest.approx([50, 75, 50, 75])
    assert ["robot.xi_n" in one for one in made] == [False, True, False, True]
    made = points({"add": [delays, rates, {"multiply": [delays, rates]}]})
    assert len(made) == 8
    assert made[2].keys() == {"robot.omega_n"}


def test_ranges_are_linear_or_logarithmic_and_keep_their_ends():
    linear = {"from": "100 N/mm", "to": "200 N/mm", "count": 5}
    made = points({"grid": {"contact.stiffness": linear}})
    assert [one["contact.stiffness"] for one in made] == [100e3, 125e3, 150e3, 175e3, 200e3]
    made = points({"grid": {"contact.stiffness": linear | {"spacing": "log"}}})
    values = [one["contact.stiffness"] for one in made]
    assert values[0] == 100e3 and values[-1] == 200e3
    assert np.diff(np.log(values)) == pytest.approx([math.log(2) / 4] * 4)


@pytest.mark.parametrize("kind", ["random", "latin-hypercube", "sobol"])
def test_samples_keep_to_their_distributions(kind):
    over = {
        "contact.stiffness": {"uniform": ["100 N/mm", "200 N/mm"]},
        "robot.omega_n": {"log-uniform": ["10 Hz", "1000 Hz"]},
        "robot.tau_m": {"normal": {"mean": "4 ms", "std": "1 ms", "low": "2 ms"}},
        "run.master": {"choice": ["jacobi", "gauss-seidel"]},
    }
    design = {kind: {"count": 256, "seed": 3, "over": over}}
    made = points(design)
    assert made == points(design)
    assert made != points({kind: design[kind] | {"seed": 4}})
    stiffness = np.array([one["contact.stiffness"] for one in made])
    assert stiffness.min() >= 100e3 and stiffness.max() <= 200e3
    assert stiffness.mean() == pytest.approx(150e3, rel=0.04)
    decades = np.log10([one["robot.omega_n"] / (2 * math.pi) for one in made])
    assert decades.min() >= 1 - 1e-12 and decades.max() <= 3 + 1e-12
    assert decades.mean() == pytest.approx(2.0, abs=0.12)
    delay = np.array([one["robot.tau_m"] for one in made])
    assert delay.min() >= 0.002
    assert np.median(delay) == pytest.approx(0.00403, abs=2e-4)
    assert 90 <= sum(one["run.master"] == "jacobi" for one in made) <= 166
    if kind == "latin-hypercube":  # one point in each of 256 slices
        assert sorted(((stiffness - 100e3) / 100e3 * 256).astype(int)) == list(range(256))


def drawn(study, path):
    return np.array([study.task(n)[1][path].shown for n in range(len(study))])


def sample(path, distribution, count=4000):
    return {"random": {"count": count, "seed": 1, "over": {path: distribution}}}


@pytest.mark.parametrize("std", ["2 K", "2 degC"])
def test_a_deviation_is_a_difference_which_scales_begin_anywhere_alike(tmp_path, std):
    # Of a value that is at least 100 K: a deviation of 2 K is none the less one.
    fmu = with_mass_in("K", tmp_path / "K.fmu", "300", 'min="100"')
    values = drawn(
        one_body(fmu, design=sample("m.mass", {"normal": {"mean": "20 degC", "std": std}})), "m.mass"
    )
    assert values.mean() == pytest.approx(293.15, abs=0.2)
    assert values.std() == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize(
    ("std", "told"),
    [
        ("0 K", "m.mass: std '0 K' is not positive"),
        ("-1 K", "m.mass: std '-1 K' is not positive"),
        ("1 kg", "m.mass: std: cannot take '1 kg'"),
        (2, "m.mass: std: 2 has no unit"),
        (True, "m.mass: std True is no number"),
    ],
)
def test_deviations_that_are_none_are_refused(tmp_path, std, told):
    fmu = with_mass_in("K", tmp_path / "K.fmu", "300")
    with pytest.raises(ConfigError) as caught:
        one_body(fmu, design=sample("m.mass", {"normal": {"mean": "20 degC", "std": std}}))
    assert told in str(caught.value)


def noisy(design, master="jacobi"):
    run = {"master": master, "step_size": "1 ms", "stop_time": "10 ms"}
    return Study(system={"run": run, "instances": {"n": {"fmu": "SensorNoise"}}}, design=design)


ITERATIVE = {"name": "iterative", "tolerance": 1e-6}


@pytest.mark.parametrize(
    ("distribution", "weights"),
    [
        ({"uniform": [1, 4]}, [1.0, 1.0, 1.0, 1.0]),
        ({"log-uniform": [1, 4]}, [math.log((n + 0.5) / (n - 0.5)) for n in (1, 2, 3, 4)]),
        ({"normal": {"mean": 2, "std": 100.5, "low": 1, "high": 4}}, [1.0, 1.0, 1.0, 1.0]),
    ],
)
@pytest.mark.parametrize(("path", "master"), [("n.seed", "jacobi"), ("run.master.max_iterations", ITERATIVE)])
def test_whole_numbers_are_drawn_with_their_ends_as_often_as_the_rest(distribution, weights, path, master):
    study = noisy(sample(path, distribution), master)
    levels = [study.task(n)[1][path] for n in range(len(study))]
    assert all(type(one.canonical) is int for one in levels)
    counts = [sum(one.shown == n for one in levels) for n in (1, 2, 3, 4)]
    expected = np.array(weights) / sum(weights) * len(levels)
    # Chi-squared with 3 degrees of freedom exceeds 16.3 once in a thousand; the seed is fixed.
    assert (((np.array(counts) - expected) ** 2) / expected).sum() < 16.3


def test_options_that_take_fractions_are_drawn_between_whole_numbers():
    path = "run.master.tolerance"
    values = drawn(noisy(sample(path, {"uniform": [1, 4]}, 100), ITERATIVE), path)
    assert len(set(values)) == 100 and values.min() >= 1 and values.max() <= 4


def test_a_range_of_whole_numbers_is_one(tmp_path):
    path = "run.master.max_iterations"
    linear = noisy({"grid": {path: {"from": 10, "to": 50, "count": 5}}}, ITERATIVE)
    assert drawn(linear, path).tolist() == [10, 20, 30, 40, 50]
    assert linear.run(tmp_path / "store", jobs=1).failed == {}
    ratios = {"from": 1, "to": 256, "count": 9, "spacing": "log"}
    assert drawn(noisy({"grid": {path: ratios}}, ITERATIVE), path).tolist() == [2**n for n in range(9)]
    assert drawn(noisy({"grid": {"n.seed": ratios}}), "n.seed").tolist() == [2**n for n in range(9)]
    with pytest.raises(ConfigError) as caught:
        noisy({"grid": {path: {"from": 10, "to": 20, "count": 4}}}, ITERATIVE)
    assert str(caught.value).splitlines() == [
        "study: design.grid.run.master.max_iterations: run.master.max_iterations takes whole numbers; "
        "the range holds others",
        "  10, 13.3333, 16.6667, 20. Choose another count, or list the values.",
    ]


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


def test_everything_that_is_wrong_is_told_at_once():
    told = refused(
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
    assert told.splitlines() == [
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
    told = [one.place for one in caught.value.problems]
    assert any("derived.x" in one for one in told) and not any("derived.peak" in one for one in told)
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
    ("changes", "told"),
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
def test_bad_studies_are_refused(changes, told):
    assert told in refused(**changes)


def test_names_that_the_store_would_not_tell_apart_are_refused():
    body = {"fmu": "SatelliteDynamics", "form": "native", "start": {"force": "0 N"}}
    system = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "0.1 s"},
        "instances": {"m": body, "M": body},
    }
    told = refused(
        system=system,
        set={},
        design={"grid": {"m.mass": ["1 kg"]}},
        derived={"peak": "m.mass", "Peak": "M.mass", "Attempts": "m.mass"},
        record="all",
    )
    assert told.splitlines() == [
        "study: derived.Attempts: 'Attempts' cannot name a quantity",
        "  the store has a column of it",
        "study: derived.Peak: 'Peak' and 'peak' differ in case only",
        "  the store's columns do not tell them apart. Rename one of them.",
        *(
            line
            for name in ("position", "velocity", "kinetic_energy")
            for line in (
                f"study: record: 'M.{name}' and 'm.{name}' differ in case only",
                "  the store's columns do not tell them apart. Keep one of them, by record.signals.",
            )
        ),
    ]


def test_names_that_no_run_has_a_number_for_are_refused():
    told = refused(
        design={"grid": {"robot.omegas": ["1 Hz"]}},
        derived={"a": "satellite.masss + robot.nothing", "b": "contact.force * contact.stiffness"},
    )
    assert told.splitlines()[2:] == [
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


def test_what_is_in_misspelt_sections_of_a_study_is_told():
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


def test_only_the_form_of_values_that_was_meant_is_told():
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


def test_a_study_file_is_told_with_its_lines(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text("format: sweep/1\nsystem: docking-1d\ndesign:\n  grid:\n    robot.tau_m: [1 N]\n")
    with pytest.raises(
        ConfigError, match=r"study.yaml:5: design.grid.robot.tau_m: robot.tau_m \[s\]: cannot take '1 N'"
    ):
        Study.load(path)
    path.write_text("- 1\n")
    with pytest.raises(ConfigError, match="not a study"):
        Study.load(path)


TIME = np.linspace(0.0, 1.0, 101)
RESULTS = Results(TIME, {"a.y": np.sin(TIME), "a.q[1]": TIME**2, "a.q[1,2]": -TIME}, {}, {"a.k": 4.0})
MEASURED = {"contacts": [{"cor": 0.5}, {"cor": 0.25}], "estimate": 7, "text": "x", "none": None}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("max(a.y)", math.sin(1.0)),
        ("min(-a.y)", -math.sin(1.0)),
        ("rms(a.y - a.y)", 0.0),
        ("final(a.q[1]) + first(a.q[1,2])", 1.0),
        ("max(abs(a.q[1,2]) * 2)", 2.0),
        ('at(a.q[1], "500 ms")', 0.25),
        ("integral(2 * time)", 1.0),
        ("time_of_max(a.y)", 1.0),
        ("contacts[1].cor / contacts[0].cor", 0.5),
        ("estimate ** 2 - 1", 48.0),
        ("sqrt(a.k)", 2.0),
        ("'contacts[0].cor'", 0.5),
        ("max(1)", 1.0),
        ("contacts[5].cor", None),
        ("text", None),
        ("none + 1", None),
        ("1 / 0", None),
        ("log(-1)", None),
        ('at(a.y, "2 s")', None),
    ],
)
def test_expressions(text, value):
    found = Derived("x", text).value(RESULTS, MEASURED)
    assert found == (None if value is None else pytest.approx(value, abs=1e-12))


@pytest.mark.parametrize(
    "text",
    [
        "", "a.y.__class__()", "(lambda: 1)()", "[1, 2]", "max(a.y, a.y)", "max(max(a.y))",
        "a.y if a.y else 1", "9**999", "2**a.k", "at(a.y, 0.5)", 'at(a.y, "5 kg")', "f'{1}'", "a.y[x]",
        "max(key=1)", "1e999",
        "1 < 2", "x := 1", "(" * 500, "+".join(["1"] * 900), "-" * 1500 + "1", "open('x')",
    ],
)  # fmt: skip
def test_what_is_no_expression_is_refused(text):
    with pytest.raises(ValueError):
        Derived("x", text)


@settings(max_examples=200, deadline=None)
@given(st.text("abcmaxin()[].,+-*/0123456789 '\"_", max_size=60))
def test_any_text_is_an_expression_or_refused(text):
    try:
        made = Derived("x", text)
    except ValueError:
        return
    assert made.value(RESULTS, MEASURED) is None or math.isfinite(made.value(RESULTS, MEASURED))


def test_numbers_of_a_summary_go_by_their_paths():
    assert flat({"a": [{"b": 1, "c": "x"}, None, True], "d": 2.5}) == [("a[0].b", 1.0), ("d", 2.5)]
