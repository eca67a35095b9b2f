"""What is known of contacts in space for stability: the rod in light touch, the controller's law."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..frequency.from_system import LinearPoint
from ..frequency.statespace import Law, StateSpace
from ..results.recorders import parameters_of
from .options import SpaceOptions

if TYPE_CHECKING:
    from ..fmi import FmuInstance
    from ..simulation.run import Prepared

__all__ = ["touching_point"]

Array = NDArray[np.float64]

# How deep the rod stands in its frame [m]: deeper, the push itself would turn the satellites.
_DEPTH = 1e-6
_OFF, _ACTIVE = 1, 3
_MEASURED = (("measured_force", 3), ("measured_torque", 3))
_POSE = (("position", 3), ("orientation", 4), ("velocity", 3), ("angular_velocity", 3))
_INPUTS = (*_MEASURED, *_POSE, *((f"desired_{name}", size) for name, size in _POSE))
_OUTPUTS = (("force", 3), ("torque", 3))
# Change of an input for differences of the law [SI].
_CHANGE = 1e-6


def _elements(entries: Sequence[tuple[str, int]]) -> tuple[str, ...]:
    return tuple(f"{name}[{index}]" for name, size in entries for index in range(1, size + 1))


def touching_point(prepared: Prepared, options: SpaceOptions) -> LinearPoint:
    """The satellites at rest where they start, a frame's surface at the tip of the rod; the controller's law.

    The surface comes to the rod, so that robots of any kind keep their start values.
    """
    values = parameters_of(prepared.system)

    def vector(instance: str, name: str, size: int = 3) -> Array:
        return np.array([float(values[f"{instance}.{name}[{index}]"]) for index in range(1, size + 1)])

    turn = Rotation.from_quat(np.roll(vector(options.satellites, "start_orientation", 4), -1))
    place = vector(options.satellites, "start_position") + turn.apply(vector(options.contact, "tip"))
    normal = vector(options.contact, "normal")
    normal = normal / np.linalg.norm(normal)
    front = float(-normal @ place) - _DEPTH
    rear = min(float(values[f"{options.contact}.rear"]), front - 1.0)
    still = {f"start_{kind}velocity[{index}]": 0.0 for kind in ("", "angular_") for index in (1, 2, 3)}
    start: dict[str, Mapping[str, Any]] = {
        options.satellites: still,
        options.contact: {"front": front, "rear": rear, "start_in_contact": True},
    }
    if options.controller is None:
        return LinearPoint(start, {})
    own = {
        key.partition(".")[2]: value
        for key, value in values.items()
        if key.startswith(f"{options.controller}.")
    }
    touched = (normal, *(float(values[f"{options.contact}.{kind}"]) for kind in ("stiffness", "damping")))
    return LinearPoint(start, {options.controller: lambda running: _law(own, running, touched)})


def _law(p: Mapping[str, Any], running: FmuInstance, touched: tuple[Array, float, float]) -> Law:
    """The controller's law where it stands; before its first sample that of a contact.

    Its normal and its estimates stand still. The restoration of work that was missed at onset is no linear
    law and is left out.

    Args:
        p: its parameters; touched: the contact's normal in O_t, stiffness [N/m] and damping [N.s/m].
    """
    inputs = _elements(_INPUTS)
    at = np.array([float(value) for value in running.get_values(inputs).values()])
    mode, period, lead = (p["mode"], float(p["sample_period"]), float(p["tau_s"]))
    sensor = Rotation.from_quat(np.roll([float(p[f"sensor_orientation[{i}]"]) for i in (1, 2, 3, 4)], -1))
    normal, stiffness, damping = touched
    normal, touches = sensor.inv().apply(normal), True
    if running.get_values(["state.samples"])["state.samples"]:
        names = [*_elements((("normal", 3),)), "stiffness_estimate", "damping_estimate", "contact_state"]
        *found, stiffness, damping, contact = (float(v) for v in running.get_values(names).values())
        normal, touches = np.array(found), bool(contact)
    ahead = float(p["transfer_delay"]) + (0.5 * period if p["hold_compensation"] else 0.0)
    tip, origin = (
        np.array([float(p[f"{name}[{i}]"]) for i in (1, 2, 3)]) for name in ("tip", "sensor_position")
    )

    def moved(pose: Array) -> tuple[Array, Array]:
        arm = Rotation.from_quat(np.roll(pose[3:7], -1)).apply(tip)
        speed = pose[7:10] + np.cross(pose[10:13], arm)
        return sensor.inv().apply(pose[:3] + arm - origin), sensor.inv().apply(speed)

    def put_out(u: Array) -> Array:
        force, torque = u[:3], u[3:6]
        if int(mode) != _ACTIVE:
            return u[:6]
        if not touches:
            return np.zeros(6)
        (place, speed), (wanted, wanted_speed) = moved(u[6:19]), moved(u[19:32])
        wanted = wanted + ahead * wanted_speed
        push = stiffness * (normal @ (wanted - place)) + max(damping, 0.0) * (normal @ (wanted_speed - speed))
        made = force - push * normal
        return np.concatenate([made, torque + np.cross(wanted - place, made) + np.cross(place, made - force)])

    changes = _CHANGE * np.eye(len(at))
    direct = np.array([put_out(at + one) - put_out(at - one) for one in changes]).T / (2.0 * _CHANGE)
    limit, sampled = _led(direct, period, float(p["lead_filter_time"]), 0.0 if int(mode) == _OFF else lead)
    notes = [
        f"its law is that {'in contact' if touches else 'without contact'}; its sample hold counts as a "
        "delay of half a period; its normal and its estimates stand still, at the start at the true values"
    ]
    if int(mode) == _ACTIVE and p["switching_compensation"]:
        notes.append("switching_compensation is not linear and is left out")
    return Law(limit, 0.5 * period, sampled, period, tuple(notes))


def _led(direct: Array, period: float, lag: float, lead: float) -> tuple[StateSpace, StateSpace]:
    """A law without memory behind the phase lead of the measured wrench: in the limit of short samples, and
    from sample to sample.

    Args: direct: outputs by inputs, the measured wrench first; lag, lead: [s].
    """
    inputs, outputs = _elements(_INPUTS), _elements(_OUTPUTS)
    wrench, eye = direct[:, :6], np.eye(6, len(inputs))
    if not lead:
        empty = np.zeros((0, 0)), np.zeros((0, len(inputs))), np.zeros((len(outputs), 0))
        space = StateSpace(*empty, direct, (), inputs, outputs)
        return space, space
    # Without filter the derivative is one up to frequencies that no loop passes.
    rate = 1.0 / max(lag, 1e-7)
    limit = StateSpace(
        -rate * np.eye(6),
        rate * eye,
        -lead * rate * wrench,
        direct + lead * rate * wrench @ eye,
        tuple(f"wrench_rate[{index}]" for index in range(1, 7)),
        inputs,
        outputs,
    )
    keep = math.exp(-period / lag) if lag > 0.0 else 0.0
    fed = (1.0 - keep) / period
    block, nothing = np.eye(6), np.zeros((6, 6))
    sampled = StateSpace(
        np.block([[nothing, nothing], [-fed * block, keep * block]]),
        np.vstack([eye, fed * eye]),
        lead * wrench @ np.hstack([-fed * block, keep * block]),
        direct + lead * fed * wrench @ eye,
        tuple(f"{name}[{index}]" for name in ("previous_wrench", "wrench_rate") for index in range(1, 7)),
        inputs,
        outputs,
    )
    return limit, sampled
