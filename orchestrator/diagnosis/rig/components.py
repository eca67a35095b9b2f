"""Residuals of the rig's components, each driven by its measured inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .finding import Augmented
from .model import RigModel
from .rig import Inject
from .software import ControllerReplay, DynamicsReplay
from .study import Array, Run, Study

# What lies between two logged signals, and the places of the catalogue in it.
COMPONENTS: Mapping[str, tuple[str, ...]] = {
    "link+robot": ("link", "robot"),
    "structure+contact+sensor": ("structure", "contact", "sensor"),
    "controller": ("controller",),
    "dynamics": ("dynamics",),
}
# Power over that of the noise from which a residual counts as more than noise.
_SIGNIFICANT = 1.5
# Frequencies whose power is averaged.
_AVERAGED = 9


@dataclass(frozen=True)
class Residuals:
    """Residuals of a run by component.

    Attributes:
        values: measured minus replayed, by `Inject`: position [m], force [N], compensated force [N], change
            of velocity over the tick [m/s]; shape (4, n + 1); the last column is none of
            the log's.
        noise: standard deviation that each has by itself, shape (4,).
        force: the same as `values`, as forces on the satellite [N]: a position counts by the contact's
            stiffness, a change of velocity by mass over tick; shape (4, n).
        force_noise: of `force`, shape (4,) [N].
    """

    values: Array
    noise: Array
    force: Array
    force_noise: Array


def component_of(place: str) -> str:
    """The component that a place of the catalogue lies in.

    Raises: ValueError for another place.
    """
    for name, places in COMPONENTS.items():
        if place in places:
            return name
    raise ValueError(f"no component holds the place {place!r}; places: {sum(COMPONENTS.values(), ())}")


def residuals_of(study: Study, run: Run, model: Augmented) -> Residuals:
    """Residuals of a run.

    The force's replay is given the measured position: of the encoder's residual what is more than its noise,
    which, multiplied by the contact's stiffness, would hide the sensor's.
    """
    n = len(run)
    nominal = study.nominal
    rig = RigModel(study, [run])
    values = np.zeros((4, n + 1))
    encoder, sensor = rig.noise
    position = correct(rig, model)
    values[Inject.POSITION] = rig.correction[0]
    force = run["sensor_force"] - rig.replay(0, model.calibrated, model.effects, model.theta)[3]
    values[Inject.FORCE, :n] = force
    controller = ControllerReplay(study, [run])
    out, _ = controller.replay(0, model.effects, model.theta)
    values[Inject.COMPENSATED_FORCE, :n] = run["compensated_force"] - out[0]
    dynamics = DynamicsReplay(study, [run])
    values[Inject.VELOCITY, : n - 1] = (
        dynamics.residuals({}, model.effects, model.theta)[0] * dynamics.noise[0]
    )
    noise = np.array([encoder, sensor, controller.noise[0][0], dynamics.noise[0]])
    # What the encoder's noise adds to the replayed force is none of the sensor's doing.
    to_force = np.array([nominal["contact_stiffness"].value, 1.0, 1.0, run.mass / study.tick])
    as_force = values[:, :n].copy()
    as_force[Inject.POSITION] = position
    values[Inject.FORCE, :n] = significant(force, sensor)
    return Residuals(values, noise, as_force * to_force[:, None], noise * to_force)


def correct(rig: RigModel, model: Augmented) -> Array:
    """Make replays of a rig's only run follow the measured position except for its noise.

    Returns: measured minus replayed position, shape (n,) [m].
    """
    (run,) = rig.runs
    rig.correction[0] = np.zeros(len(run) + 1)
    residual = run["encoder_position"] - rig.replay(0, model.calibrated, model.effects, model.theta)[2]
    rig.correction[0][:-1] = significant(residual, rig.noise[0])
    rig.correction[0][-1] = rig.correction[0][-2]
    return residual


def significant(residual: Array, noise: float) -> Array:
    """Part of a residual beyond white noise, by a Wiener filter, shape (n,).

    Args:
        noise: standard deviation.
    """
    spectrum = np.fft.rfft(residual)
    power = np.abs(spectrum) ** 2 / len(residual)
    mean = np.convolve(np.pad(power, _AVERAGED // 2, mode="edge"), np.ones(_AVERAGED) / _AVERAGED, "valid")
    gain = np.clip(1.0 - _SIGNIFICANT * noise**2 / np.maximum(mean, 1e-300), 0.0, 1.0)
    return np.fft.irfft(gain * spectrum, len(residual))
