"""Studies as a rig would log them: closed loop, with noise that passes through the rig's software."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import yaml
from rigs import NOMINAL

from orchestrator.diagnosis.model import Laws, RigModel, begin_state
from orchestrator.diagnosis.rig import CHANNELS, HISTORY, run_rig
from orchestrator.diagnosis.study import Role, Run, Study

TICK = 0.001
RUNS = (
    ("train-1", Role.TRAIN, 279.07, 0.02),
    ("train-2", Role.TRAIN, 404.49, 0.02),
    ("heldout-1", Role.HELDOUT, 340.0, 0.024),
    ("repeat-1", Role.REPEAT, 340.0, 0.024),
)


def logged_study(effects=(), theta=(), ticks=2000, seed=1):
    """Runs with effects, sensor noise of 0.5 N and encoder noise of 2 um."""
    made = []
    for number, (name, role, mass, speed) in enumerate(RUNS):
        blank = {one: np.zeros(ticks) for one in ("time", *CHANNELS[:6])}
        run = Run(name, role, mass, speed, blank)
        study = Study("own", TICK, NOMINAL, (run,))
        model, laws = RigModel(study, [run]), Laws.of(tuple(effects))
        p = model.parameters(0, {}, tuple(effects), np.array(theta, float))
        commands = np.zeros(HISTORY + ticks)
        commands[:HISTORY] = speed * TICK * np.arange(1 - HISTORY, 1)
        random = np.random.default_rng([seed, number])
        inject, out = np.zeros((4, ticks + 1)), np.zeros((len(CHANNELS), ticks))
        inject[1] = 0.5 * random.standard_normal(ticks + 1)
        run_rig(p, True, commands, begin_state(study, run), laws.table, *laws.room(np.array(theta, float)),
                inject, 0, out)  # fmt: skip
        columns = dict(zip(CHANNELS[:6], out, strict=False), time=np.arange(ticks) * TICK)
        made.append(replace(run, columns=columns))
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
    unit = {"contact_stiffness": "N/m", "contact_damping": "N.s/m", "damping_ratio": "1", "force_bias": "N",
            "force_noise": "N", "force_resolution": "N", "natural_frequency": "rad/s",
            "sensor_cutoff": "rad/s", "response_delay": "s", "sensor_delay": "s"}  # fmt: skip
    nominal = {
        name: {"value": float(one.value), "unit": unit.get(name, "m"), "tolerance": float(one.tolerance)}
        for name, one in study.nominal.items()
    }
    data = {"format": "gap-case/1", "rig": "docking-1d", "tick": study.tick, "nominal": nominal, "runs": runs}
    (folder / "case.yaml").write_text(yaml.safe_dump(data))
    return folder
