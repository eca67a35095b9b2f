"""Columns whose clock is off are reported as such, and are not confused with what delays."""

from __future__ import annotations

import re
from dataclasses import replace
from time import process_time

import numpy as np
import pytest
import yaml
from ports_bench import change_log, study

from orchestrator.diagnosis.study.checks import check_logs
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.study import Role
from orchestrator.system.system import Port

PATH, POSITION, VOLTAGE = Port("path", "position"), Port("drive", "position"), Port("controller", "voltage")


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return load_port_study(study(tmp_path_factory.mktemp("clocks")))


def late(study, ports, rows):
    """The study, with the stamps of some columns late by so many rows; all is at rest at the begin."""

    def moved(log):
        return np.concatenate([np.full(rows, log[0]), log[:-rows]]) if rows > 0 else log[-rows:]

    def of(run):
        n = len(run) + min(rows, 0)
        logs = {port: moved(log) if port in ports else log[:n] for port, log in run.logs.items()}
        return replace(run, logs=logs)

    return replace(study, runs=tuple(of(run) for run in study.runs))


def checked(study):
    refused, warned = check_logs(study)
    return refused, [one for one in warned if "clock" in one.remedy]


def test_clocks_that_are_right_are_not_doubted(plain):
    assert checked(plain) == ([], [])


@pytest.mark.parametrize("rows", [-5, 50])
def test_a_column_that_is_late_or_early_within_a_loop_is_reported(plain, rows):
    """The controller would have been given another position, had that been delayed itself."""
    (refused,), _ = checked(late(plain, {POSITION}, rows))
    assert refused.place == "drive.position" and "times its noise" in refused.what
    way = "late by 0.1 s" if rows > 0 else "early by 0.01 s"
    assert refused.remedy == (
        f"All fits if the clock of column drive.position is {way}: give it `clock: {0.002 * rows:g} s`."
    )


def test_a_fed_column_that_is_late_is_reported_and_corrected_by_the_clock(tmp_path):
    folder = study(tmp_path)
    for run in range(3):
        with change_log(folder / f"run-{run}.csv") as columns:
            columns["path.position"][5:] = columns["path.position"][:-5]
    (refused,), _ = checked(load_port_study(folder))
    assert refused.remedy.endswith("if that of path.position is late by as much, `clock: 0.01 s` there.")
    assert "columns controller.voltage, drive.position is early" in refused.remedy
    data = yaml.safe_load((folder / "study.yaml").read_text())
    data["columns"]["path.position"] = {"column": "path.position", "clock": "0.01 s"}
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    assert checked(load_port_study(folder)) == ([], [])


def test_columns_of_one_device_are_late_together(tmp_path):
    logged = {"drive.velocity": ("m/s", 1e-4)}
    both = {POSITION, Port("drive", "velocity")}
    (refused,), _ = checked(late(load_port_study(study(tmp_path, logged=logged)), both, 50))
    assert refused.place == "drive.position, drive.velocity"
    assert (
        "columns drive.position, drive.velocity is late by 0.1 s: give each `clock: 0.1 s`" in refused.remedy
    )


def test_what_a_delay_makes_as_well_is_mentioned_only(plain):
    """All that is compared late: so it is, too, if the command comes late to the machine."""
    refused, (warned,) = checked(late(plain, {POSITION, VOLTAGE}, 5))
    assert not refused and warned.place == "controller.voltage, drive.position"
    assert warned.what.endswith("and so may a delay or another dynamic effect of the machine")
    assert warned.remedy.startswith(
        "Rule out that the clock of columns controller.voltage, drive.position is"
    )


@pytest.mark.parametrize("port", ["drive.voltage", "controller.position"])
def test_a_delay_within_the_loop_is_no_mistake_of_the_logs(tmp_path, port):
    source = {"drive.voltage": "controller.voltage", "controller.position": "drive.position"}[port]
    hidden = [{"from": source, "to": port, "through": [{"delay": "2 ms"}]}]
    delayed = load_port_study(study(tmp_path, hidden))
    given = replace(delayed, runs=delayed.of(Role.TRAIN))
    assert checked(given)[0] == []


def test_a_clock_that_runs_fast_is_reported_with_its_rate(plain):
    """By 4 samples in each run, against the clock of the other columns."""

    def of(run):
        k = np.arange(len(run), dtype=float)
        late = k * (1.0 - 4.0 / len(run))
        return replace(run, logs={**run.logs, POSITION: np.interp(late, k, run.logs[POSITION])})

    (refused,), _ = checked(replace(plain, runs=tuple(of(run) for run in plain.runs)))
    rates = re.findall(
        r"fast by (\S+) ppm, (?:late|early) by (\S+) s at the begin of (\S+?)[;:]", refused.remedy
    )
    assert refused.place == "drive.position" and [name for *_, name in rates] == ["run-0", "run-1", "run-2"]
    assert all(float(ppm) == pytest.approx(4e6 / 1001, rel=0.03) for ppm, *_ in rates)
    assert all(float(shift) < 2e-4 for _, shift, _ in rates)


def test_logs_with_clocks_of_their_own_are_reported_one_by_one(plain):
    runs = [late(plain, {POSITION}, 10 + 20 * number).runs[number] for number in range(3)]
    (refused,), _ = checked(replace(plain, runs=tuple(runs)))
    assert "late by 0.02 s in run-0, late by 0.06 s in run-1, late by 0.1 s in run-2" in refused.remedy


@pytest.mark.parametrize("rows", [0, 50])
def test_a_single_wrong_sample_decides_nothing_and_takes_no_time(plain, rows):
    """As an overflow of a converter leaves it."""

    def of(run):
        log = run.logs[POSITION].copy()
        log[400] = -(2.0**31)
        return replace(run, logs={**run.logs, POSITION: log})

    assert checked(plain) == ([], [])  # compiles
    begin = process_time()
    shifted = late(plain, {POSITION}, rows) if rows else plain
    found = checked(replace(plain, runs=tuple(map(of, shifted.runs))))
    assert process_time() - begin < 50.0
    assert bool(found[0]) == bool(rows)
