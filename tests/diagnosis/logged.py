"""Studies as a rig would log them: closed loop, with noise that passes through the rig's software."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
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
