"""The communication step of a study: its error is no effect's, and logs may be sampled more coarsely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from ports_bench import STEP, friction, study

from orchestrator.base.errors import ConfigError
from orchestrator.config import load_config
from orchestrator.diagnosis.diagnose import diagnose
from orchestrator.diagnosis.finding import NOMINAL
from orchestrator.diagnosis.ports import steps
from orchestrator.diagnosis.ports.diagnose import diagnose_ports
from orchestrator.diagnosis.ports.numerics import doubts, doubts_of_answer, numerics
from orchestrator.diagnosis.ports.player import Inserted, between
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay
from orchestrator.diagnosis.ports.steps import told_of_step, weighed_without_step, with_steps
from orchestrator.diagnosis.ports.tempering import Tempering
from orchestrator.diagnosis.ports.weigh import weigh_ports
from orchestrator.effects.quantise import Quantise
from orchestrator.simulation.run import run
from orchestrator.system.system import Port

POSITION, VOLTAGE = Port("drive", "position"), Port("controller", "voltage")
FEW = {"only": ["drive.position.offset", "drive.voltage.delay", "drive.coulomb"]}
COULOMB = friction("Coulomb", level="12 N", width="1 mm/s")


def changed(path, name="changed.yaml", **keys):
    """The study with other keys; None takes one out."""
    data = yaml.safe_load((path / "study.yaml").read_text()) | keys
    data = {key: value for key, value in data.items() if value is not None}
    (path / name).write_text(yaml.safe_dump(data))
    return path / name


@pytest.fixture(scope="module")
def smooth(tmp_path_factory):
    """A machine with nothing hidden, that knows no steps."""
    return study(tmp_path_factory.mktemp("smooth"), finer=20, candidates=FEW)


def told(made):
    return [one.what for one in made.diagnosis.data if "error of the configured step" in one.what]


def test_what_the_step_is_too_long_for_is_no_effect(smooth):
    """With its own steps the study takes what they miss for an offset."""
    alone = load_port_study(smooth)
    assert weigh_ports(alone).finding.effects == ("drive.position.offset",)
    own = numerics(alone, {"nominal": NOMINAL})
    made = diagnose_ports(smooth / "study.yaml", lambda stage: None, report=False)
    assert made.diagnosis.verdict.effects == [] and made.diagnosis.which[0].probability > 0.9
    assert made.study.parts > 1 and made.study.interval == STEP
    (said,) = told(made)
    step = float(made.study.prepared.grid.step_size)
    assert said.startswith("the error of the configured step, 2 ms, shows") and f"{1e3 * step:g} ms" in said
    assert made.diagnosis.numerics.fraction < own["fraction"]


def test_nothing_is_sought_with_the_error_of_the_step_where_it_is_all_there_is(smooth, monkeypatch):
    """Else the whole search is made first, and again without that error, for the same answer."""
    alone, weighed = load_port_study(smooth), []
    monkeypatch.setattr(steps, "weigh_ports", lambda *args: weighed.append(args) or weigh_ports(*args))
    at_once = weighed_without_step(alone, Tempering())
    assert len(weighed) == 1 and at_once.study.parts > 1
    monkeypatch.setattr(steps, "_plainly", lambda study: None)
    later = weighed_without_step(alone, Tempering())
    assert len(weighed) == 3 and later.study.parts == at_once.study.parts
    first, second = (
        {one.effects: one.probability for one in found.weighed.finding.candidates}
        for found in (at_once, later)
    )
    assert first[()] == pytest.approx(second[()], abs=0.01) and first[()] > 0.9


def test_a_step_is_not_doubted_where_there_is_no_gap():
    told = {"error": 1.0, "gap": 0.0, "noise": 0.1, "fraction": None, "step_size": 1e-3, "interval": 1e-3,
            "halved": True}  # fmt: skip
    assert doubts(told) == []
    assert doubts(told | {"gap": 0.12, "fraction": 0.5, "error": 0.06}) == []  # a gap that noise makes
    (said,) = doubts(told | {"gap": 2.0, "fraction": 0.5})
    assert "50 % of the gap and 10 times the noise" in said.what and "1 ms" in said.remedy


def rubbing(folder, step=1e-3, level=20.0):
    """A study of a mass with dry friction, moved by a voltage that is held.

    Logs are of a solver of its own, whose friction stops the mass exactly, in steps of 10 us.
    """
    mass, damping, gain, fine = 95.1, 203.5, 35.15, 1e-5
    folder.mkdir()
    draw, runs, parts = np.random.default_rng(1), [], round(step / fine)
    for number, (role, size) in enumerate((("train", 4.0), ("held-out", 3.5))):
        times = step * np.arange(round(2.0 / step) + 1)
        voltage = size * (np.sin(2 * np.pi * times) + 0.4 * np.sin(6.2 * np.pi * times + 0.5))
        x = v = 0.0
        rows = []
        for time, volt in zip(times.tolist(), voltage.tolist(), strict=True):
            rows.append((time, volt, x, v))
            for _ in range(parts):
                free = v + fine / mass * (gain * volt - damping * v)
                now = np.copysign(max(abs(free) - fine / mass * level, 0.0), free)
                x, v = x + 0.5 * fine * (v + now), now
        noise = draw.standard_normal((len(rows), 2)) * [2e-6, 1e-4]
        columns = np.array(rows) + np.column_stack([np.zeros((len(rows), 2)), noise])
        text = "time [s],u [V],x [m],v [m/s]\n" + "\n".join(
            ",".join(map(repr, row)) for row in columns.tolist()
        )
        (folder / f"run-{number}.csv").write_text(text + "\n")
        runs.append({"file": f"run-{number}.csv", "role": role})
    start = {"mass": "95.1 kg", "viscous_friction": "203.5 N.s/m", "force_per_voltage": f"{gain} N/V"}
    start |= {"voltage": "0 V", "load": "0 N"}
    motor = {
        "run": {"master": "gauss-seidel", "step_size": f"{1e3 * step:g} ms", "stop_time": "2 s"},
        "instances": {"drive": {"fmu": "LinearDrive", "start": start}},
        "connections": [],
    }
    (folder / "motor.yaml").write_text(yaml.safe_dump(motor))
    data = {
        "format": "port-study/1",
        "system": "motor.yaml",
        "columns": {
            "time": "time",
            "drive.voltage": {"column": "u", "hold": True},
            "drive.position": {"column": "x", "noise": "2 um", "feed": False},
            "drive.velocity": {"column": "v", "noise": "0.1 mm/s", "feed": False},
        },
        "calibrated": {
            "drive.mass": {"tolerance": "2 kg"},
            "drive.viscous_friction": {"tolerance": "10 N.s/m"},
        },
        "settle": "50 ms",
        "candidates": {"only": ["drive.coulomb", "drive.viscous"]},
        "runs": runs,
    }
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    return folder


def test_what_the_answer_alone_makes_of_the_step_is_taken_off(tmp_path):
    """As believed the model is exact in any steps; with dry friction it is not."""
    path = rubbing(tmp_path / "case")
    own = load_port_study(path)
    assert numerics(own, {"nominal": NOMINAL})["fraction"] < 1e-9
    alone = weigh_ports(own).finding
    made = diagnose_ports(path, lambda stage: None, report=False)
    assert alone.effects == tuple(made.diagnosis.verdict.effects) == ("drive.coulomb",)
    assert made.study.parts > 1 and len(told(made)) == 1
    before, after = alone.misfit["drive.position"], made.diagnosis.misfit["drive.position"]
    assert before > 20.0 and after < 0.6 * before


def test_a_step_that_the_answer_makes_much_of_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(steps, "_limit", lambda *_: None)
    path = rubbing(tmp_path / "case")
    made = diagnose_ports(path, lambda stage: None, report=False)
    (said,) = [one for one in made.diagnosis.data if one.place == "numerics"]
    assert said.what.startswith("with the answer, halving the step of 1 ms changes drive.position by ")
    assert said.what.endswith("what is left, and the answer's numbers, may be the step's")
    assert said.remedy.startswith("Set run.step_size to a part of 1 ms") and "hold" not in said.remedy
    port = made.diagnosis.numerics.ports["drive.position"]
    assert port["changes"] > 0.5 * port["leaves"] > 1.0


def test_an_answer_whose_steps_hardly_matter_is_not_doubted():
    told = {"error": 0.01, "gap": 1.0, "noise": 0.01, "step_size": 1e-3, "interval": 1e-3, "halved": True,
            "models": {"nominal": 0.0, "answer": 0.01},
            "ports": {"a.x": {"changes": 2.0, "leaves": 5.0}}}  # fmt: skip
    assert doubts_of_answer(told) == []  # most of what is left is of something else
    assert doubts_of_answer(told | {"ports": {"a.x": {"changes": 0.9, "leaves": 1.0}}}) == []  # noise
    (said,) = doubts_of_answer(told | {"ports": {"a.x": {"changes": 3.0, "leaves": 5.0}}}, ["b.u"])
    assert (
        "a.x by 3 times its noise, where the answer leaves 5, and the signals by 1 % of the gap" in said.what
    )
    assert said.remedy.endswith(" Of what a digital controller gave (b.u), say `hold: true`.")
    (said,) = doubts_of_answer(told | {"models": {"nominal": 0.0, "answer": 0.2}})
    assert "20 % of the gap" in said.what
    (said,) = doubts_of_answer(told | {"models": {"nominal": 0.0, "answer": None}, "ports": {}})
    assert said.what.startswith("the answer runs away in steps of half of 1 ms")
    assert doubts_of_answer(told | {"error": None, "models": {"nominal": None, "answer": None}}) == []


def test_a_model_that_runs_away_in_shorter_steps_says_nothing_of_the_step(smooth, monkeypatch):
    own = load_port_study(smooth)
    wild = [replace(run, errors={POSITION: np.full(len(run), np.nan)}) for run in own.runs]
    monkeypatch.setattr(steps, "_corrected", lambda study, *_: replace(study, runs=tuple(wild)))
    found = weighed_without_step(own, Tempering())
    assert found.study is own and found.worse == 0.0 and told_of_step(found, own) is None


def test_a_study_goes_on_with_no_shorter_steps_than_its_fmus_take(smooth, monkeypatch):
    own, taken = load_port_study(smooth), []

    def halved(study, parts):
        taken.append(parts)
        return with_steps(study, parts) if parts == 2 else None

    monkeypatch.setattr(steps, "with_steps", halved)
    assert weighed_without_step(own, Tempering()).study.parts in (1, 2) and taken[:2] == [2, 4]


def test_an_interval_keeps_no_step_that_is_too_long(smooth):
    made = diagnose_ports(changed(smooth, interval="2 ms"), lambda stage: None, report=False)
    assert made.diagnosis.verdict.effects == [] and len(told(made)) == 1


@pytest.mark.parametrize("parts", [1, 4])
def test_what_acts_at_a_log_acts_on_the_error_of_the_step_too(smooth, parts):
    """A coarse resolution rounds what the machine did, not what the step made of it."""
    own = with_steps(load_port_study(smooth), parts)
    run, player = own.runs[0], PortReplay(own, own.runs[:1]).player
    error = {POSITION: np.full(len(run), 4e-5)}
    plain, shifted = (player.run(run.logs, len(run), errors=one)[POSITION] for one in ({}, error))
    assert shifted == pytest.approx(plain + 4e-5, abs=1e-15)
    rounding = [Inserted(Quantise(resolution=1e-4), POSITION)]
    counts = player.run(run.logs, len(run), inserted=rounding, errors=error)[POSITION] / 1e-4
    assert counts == pytest.approx(np.round(counts), abs=1e-6) and np.ptp(counts) > 100
    without = player.run(run.logs, len(run), inserted=rounding)[POSITION] / 1e-4
    assert 0.2 < np.mean(counts - without) < 0.6


def test_a_hidden_effect_is_found_behind_the_error_of_the_step(tmp_path, monkeypatch):
    folder, weighed = study(tmp_path / "case", [COULOMB], finer=20, candidates=FEW), []
    monkeypatch.setattr(steps, "weigh_ports", lambda *args: weighed.append(args) or weigh_ports(*args))
    made = diagnose(folder, tmp_path / "out")
    # With that error it leaves more than noise, without it nothing else: all is weighed once.
    assert len(weighed) == 1
    assert made.diagnosis.verdict.effects == ["drive.coulomb"] and len(told(made)) == 1
    # The system with the effect runs with the steps that it was found with, and comes close to the machine.
    augmented = load_config(tmp_path / "out" / "augmented.yaml")
    parts = round(STEP / float(made.study.prepared.grid.step_size))
    results = run(augmented, overrides=["path.stroke=170 mm", "path.frequency=0.5 Hz"], halving=False).results
    log = np.loadtxt(folder / "run-2.csv", delimiter=",", skiprows=1)[:, 2]
    position = np.asarray(results["drive.position"])[::parts][: len(log)]
    assert np.std(position[50:] - log[50 : len(position)]) < 3e-6


@pytest.mark.parametrize("hidden", [[], [COULOMB]])
def test_a_step_that_is_right_is_kept(tmp_path, hidden):
    folder = study(tmp_path, hidden, candidates=FEW)
    made = diagnose_ports(folder, lambda stage: None, report=False)
    assert made.diagnosis.verdict.effects == (["drive.coulomb"] if hidden else [])
    assert made.study.parts == 1 and told(made) == []


def test_logs_may_be_sampled_more_coarsely_than_the_system_steps(tmp_path):
    """What is fed lies on a curve through samples, or stays: what a system that steps so gave replays."""
    folder = study(tmp_path, seed=None)
    for log in folder.glob("run-*.csv"):
        header, *rows = log.read_text().splitlines()
        log.write_text("\n".join([header, *rows[::4]]) + "\n")
    with pytest.raises(
        ConfigError, match=r"(?s)samples are 0\.008 s apart.*Set the study's interval, `interval: 0\.008 s`"
    ):
        load_port_study(folder)
    columns = yaml.safe_load((folder / "study.yaml").read_text())["columns"]
    columns["path.position"] = {"column": "path.position"}
    left = {}
    for hold in (False, True):
        columns["path.position"]["hold"] = hold
        coarse = load_port_study(changed(folder, interval="8 ms", columns=columns))
        assert (coarse.parts, coarse.interval) == (4, 4 * STEP)
        assert coarse.settled == round(0.05 / (4 * STEP))
        (replayed,) = [PortReplay(coarse, coarse.runs[:1])]
        left[hold] = np.abs(np.concatenate(replayed.of(NOMINAL))).max()
    # The path is smooth.
    assert left[False] < 0.01 * left[True]


def test_what_a_digital_controller_gave_is_held(tmp_path):
    """Voltages that stay for 4 ms, logged when they change, replay to rounding with steps of 2 ms."""
    made = study(tmp_path, seed=None)
    data = load_config(
        "emps", ["run.step_size=2 ms", "run.stop_time=2 s", "path.stroke=0.2 m"]
    ).model.to_data()
    data["instances"]["controller"]["step_size"] = data["instances"]["path"]["step_size"] = "4 ms"
    (tmp_path / "digital.yaml").write_text(yaml.safe_dump(data))
    results = run(data, halving=False).results
    names = ("path.position", "drive.position", "controller.voltage")
    rows = np.column_stack([np.asarray(results.time), *(np.asarray(results[name]) for name in names)])[::2]
    text = "\n".join(
        [
            ",".join(("time [s]", "a [m]", "b [m]", "c [V]")),
            *(",".join(map(repr, row.tolist())) for row in rows),
        ]
    )
    (tmp_path / "run-0.csv").write_text(text + "\n")
    left = {}
    for hold in (False, True):
        columns = {
            "time": "time",
            "drive.position": {"column": "b", "noise": "2 um", "feed": False},
            "controller.voltage": {"column": "c", "feed": True, "hold": hold},
        }
        path = changed(made, columns=columns, interval="4 ms", runs=[{"file": "run-0.csv", "role": "train"}],
                       system="digital.yaml", set=None)  # fmt: skip
        found = load_port_study(path)
        left[hold] = np.abs(PortReplay(found, found.runs).of(NOMINAL)[0]).max()
    assert left[True] < 1e-6 < left[False]


def test_samples_between_samples():
    samples = np.array([0.0, 2.0, 6.0])
    assert between(samples, 1) is samples
    assert between(samples, 2)[::2].tolist() == samples.tolist() and len(between(samples, 2)) == 5
    assert between(samples, 2, held=True).tolist() == [0.0, 0.0, 2.0, 2.0, 6.0]


def test_a_smooth_signal_has_no_corners_at_samples():
    """A controller that differentiates would be driven by them; and nothing goes beyond what jumps."""
    fine = np.linspace(0.0, 2.0, 401)
    for parts in (4, 10):
        smooth = np.sin(4.0 * fine)
        line = np.interp(fine, fine[::parts], smooth[::parts])
        curve = between(smooth[::parts], parts)
        assert np.abs(curve - smooth).max() < 0.1 * np.abs(line - smooth).max()
    jump = between(np.repeat([0.0, 1.0], 5), 4)
    assert jump.min() == 0.0 and jump.max() == 1.0 and jump[16] == 0.0 and jump[20] == 1.0


def test_an_interval_is_of_whole_steps(tmp_path):
    folder = study(tmp_path, seed=None)
    allowed = "a whole number of communication steps, as 0.004 s, 0.006 s"
    with pytest.raises(ConfigError, match=r"yaml:\d+: interval: got '5 ms'") as caught:
        load_port_study(changed(folder, interval="5 ms"))
    assert allowed in str(caught.value)
    with pytest.raises(ConfigError, match="interval: got '1 ms'"):
        load_port_study(changed(folder, interval="1 ms"))


def test_shorter_steps_leave_samples_where_they_are(smooth):
    found = load_port_study(smooth)
    finer = with_steps(found, 5)
    assert (finer.parts, finer.interval) == (5, found.interval)
    assert float(finer.prepared.grid.step_size) == STEP / 5
    own, short, shortest = (
        PortReplay(each, each.runs[:1]).of(NOMINAL)[0] for each in (found, finer, with_steps(found, 40))
    )
    assert len(own) == len(short) == len(shortest)
    assert np.std(short - shortest) < 0.2 * np.std(own - shortest)
