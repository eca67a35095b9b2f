"""Studies as a rig would log them: closed loop, with noise that passes through the rig's software."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import yaml
from rigs import NOMINAL, TICK, own_run

from orchestrator.diagnosis.rig.rig import Inject
from orchestrator.diagnosis.rig.study import UNITS, Role, Study

RUNS = (
    ("train-1", Role.TRAIN, 279.07, 0.02),
    ("train-2", Role.TRAIN, 404.49, 0.02),
    ("heldout-1", Role.HELDOUT, 340.0, 0.024),
    ("repeat-1", Role.REPEAT, 340.0, 0.024),
)


def logged_study(effects=(), theta=(), ticks=2000, seed=1):
    """Runs with effects and sensor noise of 0.5 N."""
    made = []
    for number, entry in enumerate(RUNS):
        random = np.random.default_rng([seed, number])
        inject = np.zeros((4, ticks + 1))
        inject[Inject.FORCE] = 0.5 * random.standard_normal(ticks + 1)
        made.append(own_run(*entry, ticks, effects, theta, inject))
    return Study("own", TICK, NOMINAL, tuple(made))


def with_column(study, name, change, run=0):
    """The study, with a column of one run changed by a function of it."""
    runs = list(study.runs)
    columns = dict(runs[run].columns)
    columns[name] = change(columns[name].copy())
    runs[run] = replace(runs[run], columns=columns)
    return replace(study, runs=tuple(runs))


def write_case(study, folder):
    """A study as a case folder, as a lab would keep it."""
    folder.mkdir(parents=True)
    runs = []
    for run in study.runs:
        units = ("s", "m", "m/s", "m", "N", "N", "N/m")
        names = ("time", "desired_position", "desired_velocity", "encoder_position", "sensor_force",
                 "compensated_force", "stiffness_estimate")  # fmt: skip
        text = ",".join(f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)) + "\n"
        rows = np.column_stack([run[name] for name in names])
        text += "\n".join(",".join(repr(float(value)) for value in row) for row in rows) + "\n"
        (folder / f"{run.name}.csv.gz").write_bytes(gzip.compress(text.encode()))
        runs.append({"file": f"{run.name}.csv.gz", "role": run.role.value, "mass": run.mass,
                     "approach_speed": run.approach_speed})  # fmt: skip
    nominal = {
        name: {"value": float(one.value), "unit": UNITS[name], "tolerance": float(one.tolerance)}
        for name, one in study.nominal.items()
    }
    data = {"format": "gap-case/1", "rig": "docking-1d", "tick": study.tick, "nominal": nominal, "runs": runs}
    (folder / "case.yaml").write_text(yaml.safe_dump(data))
    return folder
