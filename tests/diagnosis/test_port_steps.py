"""The communication step of a study: its error is reported, and logs may be sampled more coarsely."""

from __future__ import annotations

import re

import numpy as np
import pytest
import yaml
from ports_bench import STEP, residuals, study

from orchestrator.base.errors import ConfigError
from orchestrator.config import load_config
from orchestrator.diagnosis.study.checks import check_logs
from orchestrator.diagnosis.study.player import between
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.replay import with_steps
from orchestrator.simulation.run import run


def changed(path, name="changed.yaml", **keys):
    """The study with other keys; None takes one out."""
    data = yaml.safe_load((path / "study.yaml").read_text()) | keys
    data = {key: value for key, value in data.items() if value is not None}
    (path / name).write_text(yaml.safe_dump(data))
    return path / name


@pytest.fixture(scope="module")
def smooth(tmp_path_factory):
    """A machine with nothing hidden, that knows no steps."""
    return study(tmp_path_factory.mktemp("smooth"), finer=20)


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
        left[hold] = np.abs(np.concatenate(residuals(coarse))).max()
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
        left[hold] = np.abs(residuals(found)[0]).max()
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
    own, short, shortest = (residuals(each)[0] for each in (found, finer, with_steps(found, 40)))
    assert len(own) == len(short) == len(shortest)
    assert np.std(short - shortest) < 0.2 * np.std(own - shortest)


def test_what_half_the_step_changes_is_reported(smooth, noiseless):
    """As much as the logs of a machine that knows no steps differ, within a factor of two."""

    def warnings(study):
        return [one.what for one in check_logs(study)[1] if "half the communication step" in one.what]

    own = load_port_study(smooth)
    (what,) = warnings(own)
    change = float(re.search(r"changes \S+ by (\S+) times its noise", what)[1])
    error = max(float(np.sqrt(np.mean(r**2))) for r in residuals(own)[:2])
    assert 0.5 * error < 2.0 * change < 2.0 * error
    # Steps that are a twentieth have a twentieth of the error, which is within the noise.
    assert warnings(with_steps(own, 20)) == []
