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
from collections.abc import Callable
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


def seconds(call: Callable[[], Any], clock: Callable[[], float]) -> float:
    """Median time of a call, after a first one."""
    call()
    found = []
    for _ in range(ROUNDS):
        begin = clock()
        call()
        found.append(clock() - begin)
    return median(found)


def costs(model: StateModel, study: PortStudy) -> tuple[float, float, float]:
    """Of one set, of one of 64, and of a derivative's column [us a step]."""
    runs = Runs(model, study.runs[:1])
    replays = Replays(runs, ())
    steps = len(replays.data[0][2]) * study.parts
    random = np.random.default_rng(0)
    start = replays.starts[0]
    sets = [model.nominal + 0.1 * model.tolerance * random.standard_normal(len(model.nominal))
            for _ in range(SETS)]  # fmt: skip

    def all_sets() -> None:
        in_parallel([partial(replays.found, 0, start, one) for one in sets])

    one = seconds(lambda: replays.found(0, start, model.nominal), process_time)
    many = seconds(all_sets, perf_counter) / SETS
    columns = len(model.nominal) + len(start)
    column = seconds(lambda: replays.sensitivity(model.nominal), process_time) / columns
    return tuple(1e6 * each / steps for each in (one, many, column))  # type: ignore[return-value]


def row(system: str) -> str:
    """One line of the table."""
    with tempfile.TemporaryDirectory() as folder:
        study = study_of(system, Path(folder))
        with PlayedModel(study) as model:
            master, *_ = made = costs(model, study)
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
