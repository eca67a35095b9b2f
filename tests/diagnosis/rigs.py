"""Studies made of the model's own runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.rig import CHANNELS
from orchestrator.diagnosis.rig.study import Nominal, Role, Run, Study

NOMINAL = {
    "contact_stiffness": Nominal(176000.0, 2640.0),
    "contact_damping": Nominal(100.0, 5.0),
    "front_wall": Nominal(0.005, 8e-6),
    "rear_wall": Nominal(-0.005, 8e-6),
    "natural_frequency": Nominal(2 * np.pi * 75.0, 2 * np.pi * 0.45),
    "damping_ratio": Nominal(0.8, 0.01),
    "response_delay": Nominal(0.002, 3e-5),
    "sensor_delay": Nominal(0.001, 3e-5),
    "sensor_cutoff": Nominal(2 * np.pi * 200.0, 0.0),
    "force_bias": Nominal(0.0, 0.15),
    "force_noise": Nominal(0.5, 0.0),
    "force_resolution": Nominal(0.1, 0.0),
    "encoder_noise": Nominal(2e-6, 0.0),
    "encoder_resolution": Nominal(1e-6, 0.0),
}
TICK = 0.001


def own_run(name, role, mass, speed, ticks, effects=(), theta=(), inject=None):
    """A run that the model itself made, in closed loop; inject as in `RigModel.closed_loop`."""
    blank = {column: np.zeros(ticks) for column in ("time", *CHANNELS[:6])}
    run = Run(name, role, mass, speed, blank)
    model = RigModel(Study("own", TICK, NOMINAL, (run,)), [run])
    out = model.closed_loop(0, {}, tuple(effects), np.array(theta, dtype=float), inject)
    return replace(run, columns=dict(zip(CHANNELS[:6], out, strict=False), time=np.arange(ticks) * TICK))


def study(effects=(), theta=(), ticks=1500, runs=((279.07, 0.02), (404.49, 0.02))):
    """A study whose logs the model itself made, without noise."""
    made = [
        own_run(f"train-{number}", Role.TRAIN, mass, speed, ticks, effects, theta)
        for number, (mass, speed) in enumerate(runs, start=1)
    ]
    return Study("own", TICK, NOMINAL, tuple(made))
