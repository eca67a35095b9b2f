"""What is wrong with a study of ports is reported: all of it at once, where it stands, with what to do."""

from __future__ import annotations

import json
import shutil
from copy import deepcopy

import numpy as np
import pytest
import yaml
from mcap.writer import Writer
from ports_bench import change_log, study

from orchestrator.base.errors import ConfigError
from orchestrator.cli.diagnosis import _folders
from orchestrator.cli.main import main
from orchestrator.diagnosis.study.checks import check_logs
from orchestrator.diagnosis.study.mistakes import wrong_scales
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.fmi import bundled


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a study with nothing wrong."""
    return study(tmp_path_factory.mktemp("made"))


@pytest.fixture
def reported(made, tmp_path):
    """Problems of a study that a function changes, `line: problem` each; "" if it is accepted."""
    data = deepcopy(yaml.safe_load((made / "study.yaml").read_text()))
    for one in data["runs"]:
        one["file"] = str(made / one["file"])

    def problems(change, read=load_port_study):
        change(data)
        path = tmp_path / "wrong.yaml"
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        try:
            read(path)
        except ConfigError as error:
            return str(error).replace(f"{tmp_path}/", "").replace(f"{made}/", "")
        return ""

    return problems


def placed(said):
    """Paths of problems, each with the text of its line in the study."""
    heads = [line for line in said.splitlines() if not line.startswith(("  ", "Not checked "))]
    assert all(line.startswith("wrong.yaml:") for line in heads), said
    return [line.split(": ")[1] for line in heads]


def within(*path, **values):
    """A change of the values at a path."""

    def change(data):
        for one in path:
            data = data[one]
        data.update(values)

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (within("calibrated", "drive.mass", value="-3 kg"),
         "calibrated.drive.mass.value: drive.mass = -3 kg is out of range\n  allowed: at least 0.0 kg"),
        (within("calibrated", "drive.mass", tolerance="0 kg"),
         "calibrated.drive.mass.tolerance: got '0 kg'\n  above 0"),
        (within("columns", "drive.position", hold=True),
         "columns.drive.position.hold: drive.position is compared at its samples, not fed\n"
         "  what is fed. Leave it out, or feed it."),
        (within("columns", "controller.voltage", start=True),
         "columns.controller.voltage.start: controller.voltage takes no start value\n"
         "  an output whose start value can be set. Set what it starts from under "
         "instances.controller.start of the system, and leave out the begin of each run by `settle`."),
        (within(settle="-1 s"), "settle: got '-1 s'\n  0 s or more"),
        (within(settle=100), "settle: 100 has no unit\n  a unit must be given, for zero too; "
         "its unit is s. Write 100 s."),
        (within("runs", 0, **{"from": "-1 s"}), "runs[0].from: got '-1 s'\n  0 s or more"),
        (within("runs", 0, to="2.1 s"), "runs[0].to: got '2.1 s', but run-0.csv ends before\n"
         "  up to 2 s. Leave it out to take all that was logged."),
        (within("runs", 0, **{"from": "9 s"}), "runs[0]: from 9 s to its end holds no samples\n"
         "  up to 2 s, and at least three"),
        (within("runs", 0, without=["drive.positon"]), "runs[0].without: drive.positon has no column\n"
         "  controller.voltage, drive.position, path.position, time. Did you mean drive.position"),
        *((within("runs", number, without=["controller.voltage", "drive.position"]),
           f"runs[{number}].without: `without` leaves nothing of run-{number}.csv to compare\n"
           "  at least one of controller.voltage, drive.position. Leave one of them in, or leave the run "
           "out.")
          for number in (0, 2)),
        (within("runs", 0, role="heldout"), "runs[0].role: input should be 'train', 'validation', 'held-out' "
         "or 'repeat', got 'heldout'\n  Did you mean held-out?"),
        (within("runs", 1, role="repeat"), "runs[1]: a run of the role repeat has no `repeats`\n"
         "  run-0, run-2. Add it, or give the run another role."),
        (within("runs", 1, name="run-0"), "runs[1]: two runs are called run-0\n  Give one of them a `name`."),
        (within("columns", "drive.position", unit="N"), "columns.drive.position.unit: N [kg.m.s-2] cannot be "
         "converted to m [m]\n  the unit of the column's values, one that can be converted to m"),
        (within(system="emp"), "system: no config 'emp'\n  neither a file nor a bundled system; "),
        (within(set=["run.step_size=2 ms", "drive.mas=3 kg"]),
         "set[1]: instances.drive.start.mas: drive has no variable 'mas'"),
        (within(set=["run.step_size=2 ms", "path.stroke=[1"]), "set[1]: not YAML: "),
        (within("columns", **{"drive.position": ["x"]}), "columns.drive.position: got ['x']\n  keys and "
         "their values: column, unit, sign, offset, clock, noise, feed, start"),
        (within(runs=["run-0.csv"]), "runs[0]: got 'run-0.csv'\n  keys and their values: file, role, from, "
         "to, without, repeats, name"),
        (within(runs=[]), "runs: no run has the role train\n  at least one"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_where_it_stands(reported, change, said):
    found = reported(change)
    assert found.partition(": ")[2].startswith(said), found
    assert len(placed(found)) == 1
    number = int(found.partition(": ")[0].removeprefix("wrong.yaml:"))
    assert number > 1


@pytest.mark.parametrize(
    "change",
    [within(settle="0 s"), within("runs", 0, to="2.002 s")],
)
def test_what_is_at_the_bounds_is_taken(reported, change):
    assert reported(change) == ""


def test_keys_without_effect_are_taken_and_named(made, tmp_path, reported):
    keys = {
        "candidates": {"only": ["drive.coulomb"], "parameters": {"drive.mass": "1 kg"}},
        "motion": {"port": "drive.position"},
        "window": "3 ms",
        "experiments": [{"name": "slow", "set": ["path.stroke=1 mm"]}],
        "practice": "practice.json",
    }
    assert reported(within(**keys)) == ""
    _, warned = check_logs(load_port_study(tmp_path / "wrong.yaml"))
    warned = [one for one in warned if "no effect" in one.what]
    assert [one.place.rpartition(": ")[2] for one in warned] == list(keys)
    assert "under `calibrated`" in warned[0].remedy


@pytest.mark.parametrize("options", [["--effects"], ["--practice", "60"], ["--seed", "2"], ["--jobs", "2"]])
def test_options_of_the_search_that_is_gone_name_what_to_use(made, capsys, options):
    assert main(["diagnose", str(made), *options]) == 2
    said = capsys.readouterr().err
    assert f"{options[0]}: is gone" in said and "Leave it out: `orchestrator diagnose STUDY` searches" in said


def test_a_model_that_runs_away_is_reported_before_anything_is_blamed(reported):
    """The controller's loop is unstable at this gain and step: no effect could be distinguished from that."""

    def change(data):
        data["set"] = ["run.step_size=2 ms", "controller.velocity_gain=50000 V.s/m"]

    def read(path):
        (problem,), _ = check_logs(load_port_study(path))
        raise ConfigError([problem])

    found = reported(change, read)
    assert found.startswith("run-0: the model as configured runs away: controller.voltage from 0.0")
    assert "it does in 2 more runs\n" in found and "step below 0.002 s" in found


def test_what_is_in_misspelt_sections_is_reported(reported):
    def change(data):
        data["colums"] = data.pop("columns")
        data["colums"]["drive.speed"] = "x"
        data["run"] = data.pop("runs")
        data["run"][1]["file"] = "run-9.csv"

    assert sorted(placed(reported(change))) == ["columns.drive.speed", "colums", "run", "runs[1].file"]


def test_files_under_set_are_beside_the_study(reported, tmp_path):
    """Not beside the system, here a bundled one."""
    shutil.copy(bundled.find_fmu("LinearDrive"), tmp_path / "mine.fmu")

    def change(data):
        data["set"] += ["drive.fmu=mine.fmu"]

    assert reported(change) == ""

    def mistaken(data):
        data["set"][-1] = "drive.fmu=my.fmu"

    fmus = bundled.fmu_names()
    assert (
        reported(mistaken)
        .partition(": ")[2]
        .startswith(
            "set[1]: instances.drive.fmu: no file my.fmu\n"
            f"  bundled FMUs: {', '.join(fmus[:20])} and {len(fmus) - 20} more\n"
        )
    )


def test_what_is_wrong_in_one_part_hides_nothing_in_others(reported):
    def change(data):
        data["settel"] = data.pop("settle")
        data["set"] += ["drive.mas=3 kg", "path.stroke=[1"]
        data["columns"]["drive.position"]["nois"] = "1 mm"
        data["columns"]["drive.speed"] = "x"
        data["columns"]["path.velocity"] = "v"
        data["calibrated"]["drive.mass"]["tol"] = "1 kg"
        data["calibrated"]["drive.viscous_friction"]["tolerance"] = "1 N"
        data["runs"][0]["rol"] = data["runs"][0].pop("role")
        data["runs"][0]["to"] = "-1 s"
        data["runs"][1]["file"] = "run-9.csv"
        data["runs"][2]["role"] = "repeat"

    found = reported(change)
    heads = [line for line in found.splitlines() if not line.startswith("  ")]
    assert [line.split(": ")[1] for line in heads if line.startswith("wrong")] == [
        "calibrated.drive.mass.tol",
        "calibrated.drive.viscous_friction.tolerance",
        "columns.drive.position.nois",
        "columns.drive.speed",
        "runs[0].rol",
        "runs[0].to",
        "runs[1].file",
        "runs[2]",
        "set[1]",
        "set[2]",
        "settel",
    ]
    # The step is not known, but columns are; time is mapped.
    assert [line for line in heads if not line.startswith("wrong")] == [
        "run-2.csv: path.velocity: no column v"
    ]


def test_without_a_system_files_and_times_are_looked_at(reported):
    def change(data):
        data["system"] = "emp"
        data["settle"] = "2"
        data["runs"][0]["file"] = "run-9.csv"
        data["runs"][1]["from"] = "-2 s"
        data["calibrated"]["drive.mass"]["tol"] = "1 kg"

    found = reported(change)
    wrong = ["system", "calibrated.drive.mass.tol", "runs[0].file", "runs[1].from"]
    assert sorted(placed(found)) == sorted([*wrong, "settle"])
    last = "Not checked because of these problems: ports and parameters of the study."
    assert found.splitlines()[-1] == last


def test_keys_of_a_study_that_stand_twice_hide_nothing_else(made, tmp_path):
    text = (made / "study.yaml").read_text()
    (tmp_path / "twice.yaml").write_text(f"{text}\nsystem: emps\nbogus: 1\n")
    with pytest.raises(ConfigError) as caught:
        load_port_study(tmp_path / "twice.yaml")
    said = [one.what for one in caught.value.problems]
    assert said[-2:] == ["given twice", "unknown key 'bogus'"]


@pytest.mark.parametrize("key", ["format", "system", "columns", "runs"])
def test_what_is_missing_is_reported_alone(reported, key):
    found = reported(lambda data: data.pop(key)).partition("\nNot checked")
    assert found[0] == f"wrong.yaml: {key} is missing\n  it has no default"
    assert bool(found[1]) is (key == "system")


@pytest.mark.parametrize("text", ["- a\n- b\n", "format: [\n", "\xff"])
def test_files_that_are_no_study(tmp_path, text):
    (tmp_path / "a.yaml").write_bytes(text.encode("latin-1"))
    with pytest.raises(
        ConfigError, match=r"a.yaml(:2)?: (is no study|not YAML|cannot be read: it is no text)"
    ):
        load_port_study(tmp_path / "a.yaml")


def test_a_time_that_is_not_mapped_is_not_taken_for_the_step(reported):
    def change(data):
        data["columns"].pop("time", None)
        data["set"] = ["run.step_size=1 ms"]

    # Of three logs the first is named.
    assert reported(change) == (
        "run-0.csv: time is not mapped, and column time rises by 0.002 s from row to row; "
        "the same in 2 more runs\n  0.001 s, of run.step_size. Map `time: time` under columns, or set "
        "run.step_size; rename the column if it holds no time."
    )
    assert reported(within(set=["run.step_size=2 ms"])) == ""


def test_only_what_is_taken_of_a_log_need_be_right(made, reported, tmp_path):
    header, *rows = (made / "run-0.csv").read_text().splitlines(keepends=True)
    rows[700] = "1.4,lost,0.1,0.1\n"
    (tmp_path / "gap.csv").write_text("".join([header, *rows[:100], *rows[130:]]))
    found = reported(within("runs", 0, file="gap.csv"))
    assert "gap.csv: time: row 100 comes 0.062 s after the one before; 1 such in all" in found
    found = reported(within("runs", 0, **{"from": "0.3 s"}))
    assert found.startswith("gap.csv:672: path.position: row 670 of column path.position holds 'lost'\n")
    assert "by `from` and `to`" in found
    assert reported(within("runs", 0, to="1.3 s")) == ""
    # By the log's time, not by its rows.
    read = load_port_study(tmp_path / "wrong.yaml").runs[0]
    whole = np.loadtxt(made / "run-0.csv", delimiter=",", skiprows=1)
    assert len(read) == 500 and read.name == "gap-120"
    assert next(v for p, v in read.logs.items() if str(p) == "path.position")[0] == whole[150, 1]


def test_a_folder_in_place_of_a_log(reported):
    found = reported(within("runs", 0, file="."))
    assert "is a folder, and no ROS bag" in found and "name a file, of .csv" in found


def test_studies_in_one_folder_are_called_after_their_files(made, tmp_path, capsys):
    text = (made / "study.yaml").read_text()
    (made / "slow.yaml").write_text(text)
    cases = [made / "slow.yaml", made / "study.yaml", made]
    assert _folders(cases[:2], tmp_path) == [tmp_path / "slow", tmp_path / made.name]
    # The folder of a study and its study.yaml are one.
    assert main(["diagnose", *map(str, cases), "--out", str(tmp_path)]) == 2
    assert f"several cases are called {made.name}" in capsys.readouterr().err


@pytest.fixture
def recorded(made, reported, tmp_path):
    """What is reported about a study of messages: rows of a log, recorded at given stamps [s]."""
    log = np.loadtxt(made / "run-0.csv", delimiter=",", skiprows=1)

    def said(rows, stamps, **run):
        with (tmp_path / "a.mcap").open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            channel = writer.register_channel(
                "/all", "json", writer.register_schema("x", "jsonschema", b"{}")
            )
            for row, after in zip(log[rows].tolist(), np.asarray(stamps).tolist(), strict=True):
                stamp = 1_700_000_000_000_000_000 + round(after * 1e9)
                writer.add_message(channel, stamp, json.dumps(row[1:]).encode(), stamp)
            writer.finish()

        def change(data):
            entries = {"path.position": ("m", {}), "drive.position": ("m", {"noise": "2 um"})}
            data["columns"] = {
                name: {"column": f"/all[{number}]", "unit": unit, **more}
                for number, (name, (unit, more)) in enumerate(entries.items())
            }
            data["runs"] = [{"file": "a.mcap", "role": "train", **run}]

        return reported(change)

    return said


STEP_OF_STUDY = "\n  the communication step of the system, or the study's interval, 0.002 s. "
ROWS = np.arange(1001)


def test_messages_at_another_step_are_not_taken_for_the_step(made, recorded, tmp_path):
    """Their stamps jitter, so that only the step on the whole counts where they are not mapped."""
    jitter = 1e-5 * (ROWS % 3)
    assert recorded(ROWS, 2e-3 * ROWS + jitter, **{"from": "0.4 s"}) == ""
    run = load_port_study(tmp_path / "wrong.yaml").runs[0]
    log = np.loadtxt(made / "run-0.csv", delimiter=",", skiprows=1)
    assert (run.name, len(run)) == ("a-200", 801)
    assert np.array_equal(next(iter(run.logs.values())), log[200:, 1])
    assert recorded(ROWS, 4e-3 * ROWS + jitter, **{"from": "0.4 s"}) == (
        f"a.mcap: time: samples are 0.00401 s apart{STEP_OF_STUDY}"
        "Set the study's interval, `interval: 0.004 s`, or resample the log."
    )


@pytest.mark.parametrize("delay", [4e-4, 4e-3, 2e-2])
def test_late_messages_are_no_lost_ones(recorded, delay):
    """A recorder that stalls writes down many at once, and loses none; its own delays come and go."""
    late = 2e-3 * ROWS + np.random.default_rng(4).exponential(delay, len(ROWS))
    for first, end in ((0, 120), (300, 550)):
        late[first:end] = np.maximum(late[first:end], 2e-3 * end)
    assert recorded(ROWS, np.maximum.accumulate(late)) == ""


def test_lost_messages_are_reported_with_their_place(recorded):
    kept = np.delete(ROWS, np.arange(300, 600))
    jitter = np.random.default_rng(4).exponential(2e-3, len(kept))
    assert recorded(kept, np.maximum.accumulate(2e-3 * kept)) == (
        "a.mcap: time: row 300 comes 0.602 s after the one before, at 1.2 s; none after it makes up for "
        f"0.6 s: some are missing{STEP_OF_STUDY}"
        "Take the run up to there, by `to`, or the one after, by `from`."
    )
    found = recorded(kept, np.maximum.accumulate(2e-3 * kept + jitter))
    assert found.startswith("a.mcap: time: row 300 comes 0.60") and "some are missing" in found
    assert recorded(kept, 2e-3 * kept, to="0.59 s") == ""
    # As much too many: of each of a hundred a copy came, too.
    twice = np.sort(np.concatenate([ROWS, np.arange(300, 400)]))
    assert "1101 rows take 2 s, 9.1 % less than as many steps of 0.002 s" in recorded(twice, 2e-3 * twice)


def test_a_clock_that_gains_little_by_little_is_refused(made, reported, recorded, tmp_path):
    """Each step is right to 1 %, or messages jitter by more; over the run it is nine steps."""
    said = "by their stamps 1001 rows take 2.018 s, 0.9 % more than as many steps of 0.002 s" + STEP_OF_STUDY
    said += "Set run.step_size under `set`, or `interval`, so that samples are 0.002018 s apart; or correct "
    said += "the clock that the stamps are of."
    assert recorded(ROWS, 2e-3 * 1.009 * ROWS) == f"a.mcap: time: {said}"
    (tmp_path / "fast.csv").write_bytes((made / "run-0.csv").read_bytes())
    for gain, found in ((1.009, f"fast.csv: time: {said}"), (1.0 + 1e-4, "")):
        with change_log(tmp_path / "fast.csv") as columns:
            columns["time"] = 2e-3 * gain * ROWS

        def change(data):
            data["columns"]["time"] = "time"
            for name in ("path.position", "drive.position", "controller.voltage"):
                data["columns"][name] = {"column": name, "noise": "1 um" if name[0] == "d" else None}
            data["columns"]["controller.voltage"]["noise"] = "5 mV"
            data["runs"] = [{"file": "fast.csv", "role": "train"}]

        assert reported(change) == found


def test_a_temperature_on_another_scale_is_a_mistake_of_its_own():
    found = {reported.split(". ")[0]: (gain, offset) for gain, offset, reported in wrong_scales("K")}
    assert len(found) == 6
    gain, offset = found["All fits if its values are in K, not in degC"]
    assert (gain, offset) == pytest.approx((1.0, -273.15))
    # 68 degF taken for degC came out as 341.15 K, and is 293.15 K.
    gain, offset = found["All fits if its values are in degF, not in degC"]
    assert gain * 341.15 + offset == pytest.approx(293.15)
    stated = [reported for _, _, reported in wrong_scales("K", "degC")]
    assert len(stated) == 2 and all("`unit: degC`: correct that" in reported for reported in stated)
    assert list(wrong_scales("m")) == [] == list(wrong_scales("N.m"))
