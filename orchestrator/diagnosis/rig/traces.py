"""Measured and modelled signals before and after effects are added, for a report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .finding import NOMINAL, Augmented
from .model import RigModel
from .software import ControllerReplay, DynamicsReplay
from .study import Array, Run, Study

# The signal in which a place's residual is looked for.
CHANNEL_OF = {
    "link": "encoder_position",
    "robot": "encoder_position",
    "structure": "sensor_force",
    "contact": "sensor_force",
    "sensor": "sensor_force",
    "controller": "compensated_force",
    "dynamics": "body_force",
}


@dataclass(frozen=True)
class Trace:
    """One signal of a run, and its models, each driven by what was logged at the component's inputs.

    Attributes:
        name, unit: of the signal; body_force is what moves the satellite, from the logged velocities.
        time: shape (n,) [s].
        measured: shape (n,).
        before, after: by the model as calibrated, and with effects and refitted calibration, shape (n,).
        noise: standard deviation that the log has by itself: noise and rounding.
    """

    name: str
    unit: str
    time: Array
    measured: Array
    before: Array
    after: Array
    noise: float

    def misfit(self) -> tuple[float, float]:
        """Root mean square residual of the models before and after, over the noise."""
        return tuple(
            float(np.sqrt(np.mean(np.square(self.measured - model))) / self.noise)
            for model in (self.before, self.after)
        )  # type: ignore[return-value]


def traces(study: Study, run: Run, model: Augmented) -> dict[str, Trace]:
    """All signals of a run that a model predicts, by name."""
    rig = RigModel(study, [run])
    found = {}
    before, after = (
        rig.replay(0, one.calibrated, one.effects, np.asarray(one.theta, float)) for one in (NOMINAL, model)
    )
    time = run["time"]
    signals = (("encoder_position", "m", "encoder"), ("sensor_force", "N", "force"))
    for row, (name, unit, signal) in enumerate(signals, start=2):
        found[name] = Trace(name, unit, time, run[name], before[row], after[row], study.noise(signal))
    controller = ControllerReplay(study, [run])
    outputs = [
        controller.replay(0, one.effects, np.asarray(one.theta, float))[0][0] for one in (NOMINAL, model)
    ]
    found["compensated_force"] = Trace(
        "compensated_force", "N", time, run["compensated_force"], *outputs, controller.noise[0][0]
    )
    found["body_force"] = _body(study, run, model)
    return found


def _body(study: Study, run: Run, model: Augmented) -> Trace:
    """Force from the logged velocities, and the force that the software received."""
    replay = DynamicsReplay(study, [run])
    change = run.mass / study.tick * np.diff(run["desired_velocity"])
    noise = replay.noise[0] * run.mass / study.tick
    left = [
        replay.residuals({}, one.effects, np.asarray(one.theta, float))[0] * noise for one in (NOMINAL, model)
    ]
    return Trace("body_force", "N", run["time"][:-1], change, change - left[0], change - left[1], noise)
