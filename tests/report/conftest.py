"""Folders that reports are made of."""

from __future__ import annotations

import pytest

from orchestrator.simulation.run import run


@pytest.fixture(scope="session")
def line_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports") / "line"
    run(
        "docking-1d-uncompensated",
        out=folder,
        overrides=("run.step_size=0.5 ms", "run.stop_time=2 s", "connections[3].through=[{delay: 1 ms}]"),
        figures=False,
    )
    return folder


@pytest.fixture(scope="session")
def space_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports") / "space"
    run("docking-6d", out=folder, overrides=("run.stop_time=0.5 s",), figures=False)
    return folder


@pytest.fixture(scope="session")
def paced_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports") / "paced"
    changes = ("run.step_size=1 ms", "run.stop_time=1 s", "satellite.form=native", "run.realtime.speed=20")
    run("docking-1d-uncompensated", out=folder, overrides=changes, halving=False, figures=False)
    return folder
