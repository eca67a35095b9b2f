"""A diagnosis of any system of FMUs: replay of its logs, effects hidden in it, none, and one struck out."""

from __future__ import annotations

import json
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from ports_bench import change_log, friction, study

from orchestrator.__main__ import main
from orchestrator.diagnosis.catalogue import in_words
from orchestrator.diagnosis.channels import clipped
from orchestrator.diagnosis.diagnose import diagnose
from orchestrator.diagnosis.finding import NOMINAL, Augmented, Candidate, Finding
from orchestrator.diagnosis.headline import headline
from orchestrator.diagnosis.ports.candidates import candidates
from orchestrator.diagnosis.ports.closure import how_far
from orchestrator.diagnosis.ports.diagnose import diagnose_ports
from orchestrator.diagnosis.ports.given import check_logs
from orchestrator.diagnosis.ports.page import _figure
from orchestrator.diagnosis.ports.player import Inserted, Player
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay, measure
from orchestrator.diagnosis.ports.seek import carries
from orchestrator.diagnosis.ports.simulated import simulated
from orchestrator.diagnosis.ports.study import Role
from orchestrator.diagnosis.ports.weigh import foremost, weigh_ports
from orchestrator.diagnosis.verdict import read_diagnosis
from orchestrator.effects.gain import Gain
from orchestrator.errors import ConfigError
from orchestrator.run import run
from orchestrator.system import Port

POSITION, VOLTAGE = Port("drive", "position"), Port("controller", "voltage")
# Each law is compiled when it is first used, so that fewer of them are quicker.
FEW = {"only": ["drive.coulomb", "drive.stribeck", "drive.viscous", "drive.voltage.*"]}
COULOMB = friction("Coulomb", level="12 N", width="1 mm/s")


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A study whose logs the system itself made, without noise."""
    return study(tmp_path_factory.mktemp("plain"), seed=None)


def fed(path, *ports):
    """The study with outputs fed, too."""
    data = yaml.safe_load((path / "study.yaml").read_text())
    for port in ports:
        data["columns"][port]["feed"] = True
    (path / "fed.yaml").write_text(yaml.safe_dump(data))
    return path / "fed.yaml"


@pytest.mark.parametrize("ports", [(), ("drive.position",), ("controller.voltage",),
                                   ("drive.position", "controller.voltage")])  # fmt: skip
def test_logs_of_the_system_itself_replay_exactly(plain, ports):
    """As one chain, and component by component."""
    found = load_port_study(fed(plain, *ports))
    replay = PortReplay(found, found.runs)
    # The logs are those of other strokes than the config's: nothing but they can have brought the motion.
    for run_ in found.runs:
        given = replay.signals(run_, {}, (), np.zeros(0))
        for port in (POSITION, VOLTAGE):
            assert np.abs(given[port] - run_.logs[port]).max() <= 1e-9 * np.abs(run_.logs[port]).max()
            assert np.ptp(run_.logs[port]) > 0.1


def test_only_the_faulty_component_leaves_a_residual(tmp_path):
    """Driven by what was measured each, the controller is as it should be, the drive is not."""
    path = study(tmp_path, [COULOMB], seed=None)
    found = load_port_study(fed(path, "controller.voltage"))
    found = replace(found, fed=tuple(dict.fromkeys((*found.fed, VOLTAGE))))
    replay = PortReplay(found, found.of(Role.TRAIN))
    given = replay.signals(replay.runs[0], {}, (), np.zeros(0))
    assert np.abs(given[POSITION] - replay.runs[0].logs[POSITION]).max() > 1e-3
    law = next(one for one in candidates(found, measure(found, replay.runs[0])) if one.id == "drive.coulomb")
    given = replay.signals(replay.runs[0], {}, (law,), np.array([12.0, 1e-3]))
    # The hidden law's corner is rounded off by another width.
    assert np.abs(given[POSITION] - replay.runs[0].logs[POSITION]).max() < 2e-4


@pytest.mark.parametrize("width", ["3 mm/s", "0.1 mm/s"])
def test_a_sharp_corner_and_a_round_one_are_coulombs(tmp_path, width):
    """No spring of a micrometre, nor a curve that falls a little."""
    few = {"only": [f"drive.{one}" for one in ("coulomb", "stribeck", "dahl", "maxwell-slip")]}
    path = study(tmp_path, [friction("Coulomb", level="60 N", width=width)], candidates=few)
    first = weigh_ports(load_port_study(path)).finding.candidates[0]
    assert first.effects == ("drive.coulomb",)
    assert first.parameters["drive.coulomb.level"] == pytest.approx(60.0, rel=5e-3)
    assert 1e3 * first.parameters["drive.coulomb.width"] == pytest.approx(float(width.split()[0]), rel=0.3)


def test_a_hidden_friction_is_found(tmp_path):
    path = study(tmp_path / "case", [COULOMB], candidates=FEW)
    made = diagnose(path, tmp_path / "out")
    found = read_diagnosis(tmp_path / "out")
    assert made.diagnosis.verdict.effects == ["drive.coulomb"]
    assert found.verdict.places == ["drive"] and len(found.verdict.effects) == 1
    assert found.which[0].probability > 0.5
    assert found.which[0].parameters[f"{found.verdict.effects[0]}.level"] == pytest.approx(12.0, rel=0.05)
    # The gap on the run that no fit saw goes down to the noise; other masses and dampings do not get there.
    assert found.how_far.closure > 0.97 > found.how_far.recalibration_only
    assert sum(one.share for one in found.ledger) == pytest.approx(1.0, abs=1e-9)
    assert found.calibration["drive.mass"]["fitted"] == pytest.approx(95.1, abs=1.0)
    page = (tmp_path / "out" / "report.html").read_text()
    assert found.verdict.effects[0] in page and page.count("<svg") == 2 and "one contact ahead" not in page
    # What was changed is told, in words of a system, not of the docking rig.
    assert found.augmented.changed[0].startswith(f"{found.verdict.effects[0]}: level 1")
    assert " N" in found.augmented.changed[0] and "duration of" not in page
    # The system with the effect added runs, and gives what was logged.
    config = yaml.safe_load((tmp_path / "out" / "augmented.yaml").read_text())
    config["instances"]["path"]["start"] = {"stroke": "0.17 m", "frequency": "0.5 Hz"}
    config["run"]["stop_time"] = "2 s"
    results = run(config, halving=False).results
    log = np.genfromtxt(path / "run-2.csv", delimiter=",", names=True)
    left = np.asarray(results["controller.voltage"]) - log["controllervoltage_V"]
    assert np.std(left) < 0.02 < 0.1 < np.std(log["controllervoltage_V"])
    # So it does with the law as an FMU, and can be exported then.
    config = yaml.safe_load((tmp_path / "out" / "augmented-fmus.yaml").read_text())
    assert config["instances"]["friction_drive"]["fmu"] == "FrictionForce"
    config["instances"]["path"]["start"] = {"stroke": "0.17 m", "frequency": "0.5 Hz"}
    config["run"]["stop_time"] = "2 s"
    as_fmu = run(config, halving=False).results
    assert np.std(np.asarray(as_fmu["controller.voltage"]) - log["controllervoltage_V"]) < 0.05
    exported = str(tmp_path / "augmented.fmu")
    assert main(["export", str(tmp_path / "out" / "augmented-fmus.yaml"), "-o", exported]) == 0
    # The gap lies in the drive, and is not the step's own.
    assert found.where[0].place == "drive" and found.where[0].share > 0.95
    assert {one.phase for one in found.ledger} == {"forth", "back", "reversal", "rest"}
    assert 0.0 < found.numerics.fraction < 0.1
    assert "step halving" in page and "Residual energy" in page


def test_a_hidden_effect_on_a_connection_is_found(tmp_path):
    hidden = {"from": "controller.voltage", "to": "drive.voltage", "through": [{"dead-band": "0.2 V"}]}
    weighed = weigh_ports(load_port_study(study(tmp_path, [hidden], candidates=FEW)))
    assert weighed.finding.effects == ("drive.voltage.dead-band",)
    parameters = weighed.finding.candidates[0].parameters
    assert parameters["drive.voltage.dead-band.threshold"] == pytest.approx(0.2, rel=0.05)


def test_two_threads_find_what_one_finds(tmp_path):
    hidden = {"from": "controller.voltage", "to": "drive.voltage", "through": [{"backlash": "0.2 V"}]}
    found = load_port_study(study(tmp_path, [hidden], candidates={"only": ["drive.voltage.*"]}))
    assert PortReplay(found, found.runs).player.parallel
    one, two = (weigh_ports(found, workers=workers) for workers in (1, 2))
    assert one.finding.effects == ("drive.voltage.backlash",)
    assert [(each.effects, each.gain) for each in one.answers] == [
        (each.effects, each.gain) for each in two.answers
    ]


def test_fmus_of_other_tools_are_not_run_in_threads(plain):
    found = load_port_study(plain)
    system = found.prepared.system
    fmu = system.instances[0].fmu
    foreign = copy(fmu)
    foreign.description = replace(fmu.description, tool="another tool")
    instances = (replace(system.instances[0], fmu=foreign), *system.instances[1:])
    player = Player(
        replace(system, instances=instances), found.prepared.master, found.prepared.grid.step_size, (), ()
    )
    assert not player.parallel


def test_what_counts_most_stands_first(tmp_path):
    found = load_port_study(study(tmp_path, [COULOMB], seed=None))
    replay = PortReplay(found, found.of(Role.TRAIN))
    named = {one.id: one for one in candidates(found, measure(found, replay.runs[0]))}
    viscous, coulomb = named["drive.viscous"], named["drive.coulomb"]
    one = Candidate(
        (viscous.id, coulomb.id),
        0.9,
        {},
        (),
        0.0,
        Augmented({}, (viscous, coulomb), np.array([0.1, 12.0, 1e-3])),
    )
    weights = {POSITION: 1.0, VOLTAGE: 1.0}
    ordered = foremost(replay, weights, one)
    assert ordered.effects == (coulomb.id, viscous.id) and ordered.model is one.model
    alone = replace(one, effects=(viscous.id,), model=None)
    assert foremost(replay, weights, alone) is alone


@pytest.mark.parametrize("seed", [1, 2])
def test_none_is_found_where_nothing_is_hidden(tmp_path, seed):
    weighed = weigh_ports(load_port_study(study(tmp_path, seed=seed, candidates=FEW)))
    assert weighed.finding.effects == ()
    assert weighed.finding.candidates[0].probability > 0.8
    assert not weighed.finding.doubtful_tolerances


def test_outside_is_told_where_the_effect_is_struck(tmp_path):
    strike = {"only": ["controller.reference.*", "controller.voltage.*", "drive.position.*"]}
    found = load_port_study(study(tmp_path, [COULOMB], candidates=strike))
    weighed = weigh_ports(found)
    assert weighed.finding.effects == ("outside",)
    assert weighed.finding.outside_place in ("drive", "controller")


def test_what_stands_unlogged_before_a_port_may_be_outside_as_well(tmp_path):
    path = study(tmp_path, [COULOMB], candidates={"only": ["drive.position.*"]})
    data = yaml.safe_load((path / "study.yaml").read_text())
    del data["columns"]["controller.voltage"]
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    made = diagnose_ports(path, lambda stage: None, report=False)
    assert made.finding.outside_place == "controller+drive"
    assert made.diagnosis.verdict.places == ["controller", "drive"]
    assert "acts at the controller or the drive" in headline(made.diagnosis)


def test_another_parameter_than_configured_is_found(tmp_path):
    path = study(
        tmp_path,
        [],
        candidates={
            "only": [*FEW["only"], "drive.force_per_voltage"],
            "parameters": {"drive.force_per_voltage": "5 N/V"},
        },
    )
    # The study believes in a drive that is 8 % weaker than the one that made the logs.
    text = (path / "study.yaml").read_text().replace(
        "- run.step_size=2 ms", "- run.step_size=2 ms\n- drive.force_per_voltage=32.5 N/V"
    )  # fmt: skip
    (path / "study.yaml").write_text(text)
    weighed = weigh_ports(load_port_study(path))
    best = weighed.finding.candidates[0]
    # More force per volt is as good as more volts.
    assert {"drive.force_per_voltage", "drive.voltage.gain"} & {*best.effects, *best.ties}
    assert best.effects != ()


def test_what_residuals_carry():
    draw = np.random.default_rng(3)
    white = draw.standard_normal(20000)
    assert carries(white) == 1.0
    assert carries(3.0 * white) == pytest.approx(9.0, rel=0.1)
    slow = np.convolve(white, np.ones(50) / np.sqrt(50), "same")
    # The correlation time of a moving average over 50 samples is 50.
    assert carries(slow) == pytest.approx(50.0, rel=0.35)


def test_effects_of_size_zero_change_nothing(plain):
    found = load_port_study(plain)
    replay = PortReplay(found, found.of(Role.TRAIN))
    before = replay.of(NOMINAL)
    seen = 0
    for effect in candidates(found, measure(found, replay.runs[0])):
        theta = np.array([(one.starts or (0.0,))[0] if one.shape else 0.0 for one in effect.parameters])
        after = replay.of(Augmented({}, (effect,), theta))
        for a, b in zip(before, after, strict=True):
            assert np.array_equal(a, b), effect.id
        seen += 1
    assert seen > 50


def test_all_that_is_wrong_with_a_study_is_told_at_once(plain, capsys):
    data = yaml.safe_load((plain / "study.yaml").read_text())
    data["columns"]["drive.positon"] = data["columns"].pop("drive.position")
    data["columns"]["drive.voltage"] = {"column": "controller.voltage", "unit": "V", "noise": "1 V"}
    data["calibrated"] = {"drive.mass": {"tolerance": "2 N"}, "drive.masss": {"tolerance": "2 kg"}}
    data["settle"] = "2 m"
    (plain / "wrong.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError) as caught:
        load_port_study(plain / "wrong.yaml")
    places = [one.place.partition(": ")[2] for one in caught.value.problems]
    assert places == ["calibrated.drive.mass.tolerance", "calibrated.drive.masss.tolerance",
                      "columns.drive.positon", "columns.drive.voltage", "settle"]  # fmt: skip
    told = str(caught.value)
    assert "Did you mean drive.position" in told and "drive.voltage: an input is fed what was logged" in told
    assert main(["diagnose", str(plain / "wrong.yaml")]) == 2
    assert "drive.positon" in capsys.readouterr().err


def test_refused_runs_and_patterns(plain):
    data = yaml.safe_load((plain / "study.yaml").read_text())
    data["set"] = ["run.step_size=1 ms"]
    (plain / "step.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match=r"samples are 0\.002 s apart"):
        load_port_study(plain / "step.yaml")
    data["set"] = ["run.step_size=2 ms"]
    data["runs"][0] |= {"from": "1 s", "to": "0.5 s"}
    (plain / "empty.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match="holds no samples"):
        load_port_study(plain / "empty.yaml")
    data["runs"][0] |= {"from": "0 s", "to": "1 s"}
    data["candidates"] = {"without": ["drive.friction-*"]}
    (plain / "pattern.yaml").write_text(yaml.safe_dump(data))
    found = load_port_study(plain / "pattern.yaml")
    with pytest.raises(ConfigError, match=r"without\[0\]: drive.friction-\* fits no candidate"):
        candidates(found, measure(found, found.runs[0]))
    data["runs"][0]["rolle"] = "train"
    (plain / "key.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(
        ConfigError, match=r"(?s)key\.yaml:\d+: runs\[0\]\.rolle: unknown key .*allowed: file, role"
    ):
        load_port_study(plain / "key.yaml")


def test_logs_that_break_off_or_stand_twice_are_refused(plain):
    data = yaml.safe_load((plain / "study.yaml").read_text())
    lines = (plain / data["runs"][0]["file"]).read_text().splitlines(keepends=True)
    (plain / "gap.csv").write_text("".join([*lines[:301], *lines[331:]]))
    (plain / "copy.csv").write_text("".join(lines))
    changed = [data["runs"][0] | {"file": "gap.csv"}, *data["runs"][1:]]
    for name, runs, said in (
        ("gap", changed, r"gap.csv: time: row 300 comes 0\.062 s after the one before; 1 such in all"),
        ("copy", [*data["runs"], data["runs"][0] | {"file": "copy.csv"}], "hold the same log"),
        ("repeat", [*data["runs"], data["runs"][1] | {"repeats": "r9", "name": "again", "to": "1 s"}],
         "again repeats r9, which is no run"),
        ("short", [data["runs"][0] | {"to": "0.1 s"}, *data["runs"][1:]], "has 50 samples"),
    ):  # fmt: skip
        (plain / f"{name}.yaml").write_text(yaml.safe_dump(data | {"runs": runs}))
        with pytest.raises(ConfigError, match=said) as caught:
            load_port_study(plain / f"{name}.yaml")
        # A run of training that cannot be read is one all the same.
        assert "no run has the role train" not in str(caught.value)


def test_a_sign_or_unit_that_the_study_gives_is_to_be_corrected_there(tmp_path):
    folder = study(tmp_path)
    data = yaml.safe_load((folder / "study.yaml").read_text())
    data["columns"]["drive.position"] |= {"sign": -1}
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    (problem,) = check_logs(load_port_study(folder))[0]
    assert problem.remedy.endswith("The study file says `sign: -1`: take that out.")
    data["columns"]["drive.position"] |= {"sign": 1, "unit": "mm"}
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    (problem,) = check_logs(load_port_study(folder))[0]
    assert problem.remedy.endswith("The study file says `unit: mm`: correct that.")


def test_runs_that_were_driven_otherwise_repeat_nothing(tmp_path):
    folder = study(tmp_path)
    data = yaml.safe_load((folder / "study.yaml").read_text())
    first, second = (one["file"].partition(".")[0] for one in data["runs"][:2])
    again = folder / "again.csv"
    again.write_text((folder / f"{second}.csv").read_text())
    with change_log(again) as columns:
        columns["drive.position"] += 1e-6
    data["runs"].append({"file": again.name, "role": "repeat", "repeats": first})
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    own = load_port_study(folder)
    (found,) = [one for one in check_logs(own)[1] if one.place == "again"]
    said = f"path.position differs from that of {first}, which it is said to repeat, by "
    assert found.what.startswith(said)
    assert found.what.endswith("; the noise is told without this run")
    alike = [replace(run, repeats=second) if run.name == "again" else run for run in own.runs]
    assert not [one for one in check_logs(replace(own, runs=tuple(alike)))[1] if one.place == "again"]


@pytest.mark.parametrize("like", [True, False])
def test_only_a_repeat_that_was_driven_alike_tells_the_noise(tmp_path, like):
    """Another motion would hide any gap as noise."""
    folder = study(tmp_path, [COULOMB])
    data = yaml.safe_load((folder / "study.yaml").read_text())
    heldout = data["runs"][2]["file"]
    draw = np.random.default_rng(3)
    (tmp_path / "again.csv").write_text((folder / (heldout if like else "run-1.csv")).read_text())
    with change_log(tmp_path / "again.csv") as columns:
        columns["drive.position"] += 3e-6 * draw.standard_normal(1001)
    data["runs"].append({"file": "again.csv", "role": "repeat", "repeats": Path(heldout).stem})
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    found = load_port_study(folder)
    of = Candidate((), 1.0, {}, (), 0.0, NOMINAL)
    far = how_far(found, Finding((of,), (), (), "", (), NOMINAL))
    assert far["noise_floor_from"] == ("repeats" if like else "specified")
    assert far["noise_floor"] < 1e-2 < far["after"] and not far["within_floor"]
    made, _, _ = simulated(found, [], np.random.default_rng(1))
    rough = np.diff(made.runs[0].logs[POSITION], 3) / np.sqrt(20.0)
    assert np.std(rough) == pytest.approx(3e-6 / np.sqrt(2.0) if like else 2e-6, rel=0.2)


def test_the_page_counts_an_offset_as_a_gap(plain):
    found = load_port_study(plain)
    log = found.runs[2].logs[POSITION]
    _, words = _figure(found, found.runs[2], POSITION, log - 0.05, log)
    share = 0.05 / float(log[found.settled :].std())
    assert share > 0.5 and f"is {100 * share:.3g} % of the signal's spread before and 0 % after" in words


def test_noise_that_is_fed_is_warned_of(tmp_path):
    """The voltage drives the drive by as much noise as the log has, where it is fed."""
    folder = study(tmp_path)
    data = yaml.safe_load((folder / "study.yaml").read_text())

    def told(noise: str) -> list[str]:
        data["columns"]["controller.voltage"] |= {"feed": True, "noise": noise}
        (folder / "study.yaml").write_text(yaml.safe_dump(data))
        return [one.what for one in check_logs(load_port_study(folder))[1] if "is fed" in one.what]

    assert told("0.05 mV") == []
    (what,) = told("5 mV")
    assert "which moves drive.position by" in what


@pytest.mark.parametrize(
    ("column", "factor", "said"),
    [
        ("drive.position", -1.0, "(?s)drive.position: .*All fits if its sign is reversed"),
        ("path.position", 1e3, "(?s)path.position: .*1000 times too large"),
        ("controller.voltage", 1e-3, "(?s)controller.voltage: .*1000 times too small"),
    ],
)
def test_a_wrong_sign_or_unit_is_named_although_something_is_hidden(tmp_path, column, factor, said):
    path = study(tmp_path, [COULOMB])
    assert check_logs(load_port_study(path)) == ([], [])
    for log in tmp_path.glob("run-*.csv"):
        with change_log(log) as columns:
            columns[column] *= factor
    with pytest.raises(ConfigError, match=said):
        diagnose_ports(path, lambda stage: None, report=False)


def test_exchanged_and_stuck_columns_are_named(tmp_path):
    path = study(tmp_path, [COULOMB])
    with change_log(tmp_path / "run-0.csv") as columns:
        columns["controller.voltage"][400:471] = columns["controller.voltage"][400]
    refused, warned = check_logs(load_port_study(path))
    assert refused == []
    assert [(one.place, one.what.partition(": ")[2]) for one in warned] == [
        ("run-0: controller.voltage", "frozen for 71 rows")
    ]
    with change_log(tmp_path / "run-0.csv") as columns:
        columns["controller.voltage"], columns["drive.position"] = (
            columns["drive.position"],
            columns["controller.voltage"],
        )
    refused, _ = check_logs(load_port_study(path))
    assert [one.place for one in refused] == ["run-0: controller.voltage, drive.position"]
    assert "exchanged" in refused[0].remedy


@pytest.mark.parametrize("listed", [{}, {"only": ["drive.coulomb"]}])
def test_logs_in_which_nothing_moves_are_refused(tmp_path, capsys, listed):
    """Candidates are made from what moves, those that a study lists before its logs are looked at."""
    path = study(tmp_path, candidates=listed)
    data = yaml.safe_load((path / "study.yaml").read_text())
    del data["columns"]["controller.voltage"]
    with change_log(tmp_path / "run-0.csv") as columns:
        columns["drive.position"][20:] = 0.25
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    assert main(["diagnose", str(path), "--quiet"]) == 2
    assert capsys.readouterr().err.partition("study.yaml:")[2].partition(" ")[2] == (
        "columns: the logs of all compared ports are constant in the runs of the role train "
        "(drive.position: 0.25 m)\n  one that moves. Check the columns, or take runs in which something "
        "moves; settle less.\n"
    )


def test_a_limit_is_told_in_its_unit(plain):
    found = load_port_study(plain)
    words = {one.id: in_words(one) for one in candidates(found, measure(found, found.runs[0]))}
    peak = np.abs(found.runs[0].logs[VOLTAGE]).max()
    assert words["controller.voltage.saturate"] == f"|y| at most (1 - cut) of the peak, {peak:.4g} V"
    assert words["drive.position.rate-limit"].endswith(" m per second")


def test_an_axis_at_rest_is_not_frozen(tmp_path):
    """Its encoder tells one value for as long; of a channel that stopped, the model moves on."""
    path = study(tmp_path, seed=None)
    rest = 200
    with change_log(tmp_path / "run-0.csv") as columns:
        for name, values in columns.items():
            if name != "time":
                values[rest:] = values[:-rest].copy()
                values[:rest] = 0.0
        position = columns["drive.position"]
        position[:] = np.round(position / 5e-6) * 5e-6
        (one,) = clipped(position)
    assert one.first == 0 and rest <= one.end < rest + 50 and "the lowest" in one.what
    assert check_logs(load_port_study(path)) == ([], [])
    # A sensor at the end of its range is told.
    with change_log(tmp_path / "run-1.csv") as columns:
        columns["drive.position"][:] = np.minimum(columns["drive.position"], 0.1)
    assert ["clipped" in one.what for one in check_logs(load_port_study(path))[1]] == [True]
    with change_log(tmp_path / "run-0.csv") as columns:
        columns["drive.position"][500:700] = columns["drive.position"][500]
    refused, warned = check_logs(load_port_study(path))
    assert refused == [] and any(one.what.endswith("frozen for 200 rows") for one in warned)


def test_the_command(tmp_path, capsys):
    path = study(tmp_path / "case", candidates={"only": ["controller.voltage.*"]})
    (tmp_path / "out").mkdir()
    for name in ("report.html", "notes.txt"):
        (tmp_path / "out" / name).write_text("old")
    assert main(["diagnose", str(path / "study.yaml"), "--out", str(tmp_path / "out"), "--no-report"]) == 0
    assert "No unmodelled effect is needed" in capsys.readouterr().out
    names = sorted(one.name for one in (tmp_path / "out").iterdir())
    # The page of an earlier diagnosis would not be this one's; what is not ours stays.
    assert names == ["augmented.yaml", "diagnosis.json", "notes.txt"]
    data = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert data["how_far"]["within_floor"] and set(data["left_out"]) == {"energy"}


class Slow(Gain):
    """A gain that the native loop refuses."""

    jittable = False


def test_a_model_that_runs_away_is_told_in_both_loops(plain):
    found = load_port_study(plain)
    run = found.runs[0]
    player = PortReplay(found, [run]).player
    for kind in (Gain, Slow):
        given = player.run(run.logs, 200, {}, [Inserted(kind(factor=-1e200), VOLTAGE)])
        assert np.isnan(given[POSITION][-1]) and given[POSITION][0] == 0.0


def test_logs_that_replay_exactly_need_no_effect(plain):
    weighed = weigh_ports(load_port_study(plain))
    assert weighed.finding.effects == () and weighed.answers[0].effects == ()
