"""Figures and terminal output."""

from __future__ import annotations

import io

import numpy as np

from orchestrator.base.text_tables import summary_text
from orchestrator.fmi import Point
from orchestrator.plotting.figures import draw_signals, save
from orchestrator.results import progress
from orchestrator.results.recorders import Results
from orchestrator.system.signal_vector import Signals

TIME = np.linspace(0.0, 1.0, 100_001)


def results(**signals) -> Results:
    units = {name: name[0] for name in signals}
    return Results(TIME, signals, units)


def test_one_pair_of_axes_per_unit_with_every_signal_named():
    wave = np.sin(TIME)
    figure = draw_signals(
        results(m_1=wave, N_1=wave, m_2=-wave, count=np.ones(len(TIME), np.int64)), "a title"
    )
    labels = [(axes.get_ylabel(), [line.get_label() for line in axes.lines]) for axes in figure.axes]
    assert labels == [("[m]", ["m_1", "m_2"]), ("[N]", ["N_1"])]
    assert figure.axes[-1].get_xlabel() == "time [s]"
    assert figure.get_suptitle() == "a title"
    colors = {line.get_color() for axes in figure.axes for line in axes.lines if line.get_label() != "N_1"}
    assert len(colors) == 2


def test_thinning_loses_no_peak():
    spike = np.zeros(len(TIME))
    spike[54_321], spike[12_345] = 7.0, -3.0
    (line,) = draw_signals(results(m_1=spike)).axes[0].lines
    assert len(line.get_xdata()) < 50_000
    assert (line.get_ydata().max(), line.get_ydata().min()) == (7.0, -3.0)
    assert line.get_xdata()[line.get_ydata().argmax()] == TIME[54_321]
    assert (line.get_xdata()[0], line.get_xdata()[-1]) == (0.0, 1.0)


def test_what_is_not_drawn_is_reported(tmp_path):
    wave = np.sin(TIME)
    figure = draw_signals(results(**{f"m_{n}": wave for n in range(20)}))
    assert figure.axes[0].get_legend().get_title().get_text() == "20 signals, 6 not drawn"
    save(figure, tmp_path / "x.png")
    assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")


def test_no_signals_are_an_empty_figure():
    assert len(draw_signals(Results(TIME, {})).axes) == 1


class Terminal(io.StringIO):
    def isatty(self):
        return True


def shown(file, seconds, monkeypatch) -> str:
    now = iter(np.arange(0.0, 1e6, seconds))
    monkeypatch.setattr(progress, "monotonic", lambda: float(next(now)))
    bar = progress.Progress(1000, "two tanks", file)
    for index in range(1000):
        bar(Point(index, 0.0, 0.1), Signals(np.zeros(0)))
    bar.close()
    return file.getvalue()


def test_a_bar_is_shown_on_terminals_after_two_seconds(monkeypatch):
    assert "two tanks" in shown(Terminal(), 0.5, monkeypatch)
    assert shown(Terminal(), 0.01, monkeypatch) == ""
    assert shown(io.StringIO(), 0.5, monkeypatch) == ""


def counted(file, seconds, monkeypatch) -> str:
    monkeypatch.setattr(progress.sys, "stderr", file)
    monkeypatch.setattr(progress, "_SECONDS_UNTIL_SHOWN", seconds)
    with progress.counting(100, "delays", "run") as tell:
        tell(40, 80)  # found in the store
        for done in range(41, 81):
            tell(done, 80, "3 failed")
    return file.getvalue()


def test_tasks_are_counted_on_terminals_alone(monkeypatch):
    reported = counted(Terminal(), 0.0, monkeypatch)
    assert "delays" in reported and "80/80" in reported and "run/s" in reported and "3 failed" in reported
    assert counted(Terminal(), 3600.0, monkeypatch) == ""
    assert counted(io.StringIO(), 0.0, monkeypatch) == ""


SUMMARY = {
    "title": "t",
    "config": {},
    "run": {
        "steps": 10,
        "step_size": 0.1,
        "master": "jacobi",
        "wall_time": 2.0,
        "stepping_time": 0.04,
        "real_time_factor": 25.0,
    },
    "contacts": [
        {"side": "front", "ratio": -1.25, "peak": 10.0},
        {"side": "rear", "ratio": 1.5, "peak": None},
    ],
    "estimate": 3.5,
    "ideal": {"cor": 1.0},
    "numerics": {
        "step_size": 0.05,
        "contacts": [
            {"side": None, "ratio": 0.01, "peak": -0.5},
            {"side": None, "ratio": -0.02, "peak": None},
        ],
        "estimate": -0.25,
        "ideal": {"cor": 0.0},
        "signals": {},
    },
}


def test_a_summary_as_text():
    assert summary_text(SUMMARY).splitlines() == [
        "t",
        "10 steps of 0.1 s, jacobi, in 40 ms: 25 times real time; 2.00 s with loading",
        "contacts:",
        "       side    ratio     peak",
        "   1  front    -1.25       10",
        "   2   rear      1.5        -",
        "  +-         2.0e-02  5.0e-01",
        "estimate: 3.5 +- 2.5e-01",
        "ideal:",
        "  cor: 1",
        "+-: change at half the step size; under a table, the largest of each column.",
    ]
    alone = {key: value for key, value in SUMMARY.items() if key != "numerics"}
    assert "+-" not in summary_text(alone)


def test_a_run_of_which_nothing_is_recorded():
    empty = {key: SUMMARY[key] for key in ("title", "run", "numerics")}
    assert summary_text(empty).splitlines()[-1] == (
        "No signal was recorded: no FMU has an output, or run.record is empty. It takes any variable."
    )


def test_a_failed_second_run_is_reported():
    summary = {**SUMMARY, "numerics": {"step_size": 0.05, "error": {"message": "one: x is nan\n  more"}}}
    assert summary_text(summary).splitlines()[-1] == (
        "The run with half the step size failed, so nothing is known of the step's effect: one: x is nan"
    )
