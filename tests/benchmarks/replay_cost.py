"""What a communication step costs in the replays of a diagnosis, for one set of numbers and for 64.

    python -m tests.benchmarks.replay_cost [SYSTEM...]

`orchestrator challenge` makes logs of each system. CPU or wall time per step and set [us]:

master    the master simulates the system, one set (all studies, before systems had a state form)
one       the state form in one compiled loop, one set
64        64 sets on all cores, by wall time: by the state form, or by the master where there is none
column    the derivative of all outputs by one number: along the run in the state form, else a difference
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

import numpy as np

from orchestrator.base.errors import ConfigError
from orchestrator.base.parallel import in_parallel
from orchestrator.diagnosis.blind.cases import make, write_study
from orchestrator.diagnosis.blind.given import given
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.study import PortStudy
from orchestrator.diagnosis.unknown_input.model import StateModel
from orchestrator.diagnosis.unknown_input.places import Runs
from orchestrator.diagnosis.unknown_input.played import PlayedModel
from orchestrator.diagnosis.unknown_input.polish import Replays

SYSTEMS = ("docking-1d", "docking-1d-uncompensated", "emps", "tank-level", "servo-compliant")
SETS, ROUNDS = 64, 5


def study_of(system: str, folder: Path) -> PortStudy:
    """A study of a system that lacks nothing."""
    held = given(Path(system))
    try:
        case = make(1, held.draft, "none")
        held.write_system(folder)
        write_study(case, folder)
    finally:
        held.close()
    return load_port_study(folder / "study.yaml")


def seconds(calls: Sequence[Callable[[], Any]], clock: Callable[[], float]) -> float:
    """Median time of calls, after the first one."""
    found = []
    for call in calls:
        begin = clock()
        call()
        found.append(clock() - begin)
    return median(found[1:])


def costs(model: StateModel, study: PortStudy) -> tuple[float, float, float]:
    """Of one set, of one of 64, and of a derivative's column [us a step]."""
    replays = Replays(Runs(model, study.runs[:1]), ())
    steps = len(replays.data[0][2]) * study.parts
    random, start = np.random.default_rng(0), replays.starts[0]
    # What was simulated last may be kept: each call has numbers of its own.
    away = 0.1 * random.standard_normal((SETS + 2 * ROUNDS, len(model.nominal)))
    sets = list(model.nominal + away * model.tolerance)
    tasks = [partial(replays.found, 0, start, one) for one in sets]
    one = seconds(tasks[:ROUNDS], process_time)
    column = seconds([partial(replays.sensitivity, each) for each in sets[ROUNDS : 2 * ROUNDS]], process_time)
    many = seconds([partial(in_parallel, tasks[2 * ROUNDS :])] * ROUNDS, perf_counter)
    columns = len(model.nominal) + len(start)
    return 1e6 * one / steps, 1e6 * many / steps / SETS, 1e6 * column / steps / columns


def row(system: str) -> str:
    """One line of the table."""
    with tempfile.TemporaryDirectory() as folder:
        study = study_of(system, Path(folder))
        with PlayedModel(study) as model:
            made = costs(model, study)
        master = made[0]
        one = "-"
        try:
            with StateModel(study) as model:
                made = costs(model, study)
            one = f"{made[0]:.2g}"
        except ConfigError:
            pass
    return f"| {system} | {master:.2g} | {one} | {made[1]:.2g} | {made[2]:.2g} |"


if __name__ == "__main__":
    print("| system | master | one | 64 | column |\n|---|---|---|---|---|")
    for name in sys.argv[1:] or SYSTEMS:
        print(row(name), flush=True)
