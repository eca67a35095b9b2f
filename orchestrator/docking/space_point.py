"""What is known of contacts in space for stability: equations of both satellites, the controller's law."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..base.arrays import Array
from ..frequency.from_system import LinearPoint
from ..frequency.statespace import Law, StateSpace
from ..results.recorders import parameters_of
from .options import POSE, SpaceOptions

if TYPE_CHECKING:
    from ..fmi import FmuInstance
    from ..simulation.run import Prepared

_OFF, _ACTIVE = 1, 3
_WRENCH = (("force", 3), ("torque", 3))
_SENSED = (
    *((f"measured_{name}", size) for name, size in _WRENCH),
    *POSE.items(),
    *((f"desired_{name}", size) for name, size in POSE.items()),
)
# A derivative by a complex step is exact: nothing is subtracted.
_STEP = 1e-30


def _elements(entries: Sequence[tuple[str, int]]) -> tuple[str, ...]:
    return tuple(f"{name}[{index}]" for name, size in entries for index in range(1, size + 1))


def _derivative(function: Callable[[Any], Any], at: Array) -> Array:
    """Of an analytic function, shape (values, len(at))."""
    return np.array([np.imag(function(at + 1j * _STEP * one)) for one in np.eye(len(at))]).T / _STEP


def _vector(values: Mapping[str, Any], name: str, size: int = 3) -> Array:
    return np.array([float(values[f"{name}[{index}]"]) for index in range(1, size + 1)])


def _turn(values: Mapping[str, Any], name: str) -> Array:
    """The rotation matrix of a quaternion w, x, y, z."""
    return Rotation.from_quat(_vector(values, name, 4), scalar_first=True).as_matrix()


def space_laws(prepared: Prepared, options: SpaceOptions) -> LinearPoint:
    """The laws of the satellites and the controller where a run has brought them."""
    laws: dict[str, Law | Callable[[FmuInstance], Law]] = {options.satellites: satellites_law}
    if options.controller is not None:
        prefix = f"{options.controller}."
        every = parameters_of(prepared.system).items()
        own = {key.removeprefix(prefix): value for key, value in every if key.startswith(prefix)}
        laws[options.controller] = lambda running: _controller(own, running)
    return LinearPoint({}, laws)


def satellites_law(running: FmuInstance) -> Law:
    """Eqs. (3) to (13) as seen from the target: the motion of O_Ai in O_Bi, and the target's spin.

    Forces and outputs do not depend on where the pair is in space. Of its orientation the three directions
    count in which it can turn, not the length of its quaternion.
    """
    tensors = [(f"inertia_{body}[{i},{j}]") for body in "ab" for i in (1, 2, 3) for j in (1, 2, 3)]
    places = [
        f"{name}_position{end}" for name, end in (("assembly", "_a"), ("assembly", "_b"), ("sensor", ""))
    ]
    vectors = [(one, 3) for one in (*places, "angular_velocity_b")]
    quaternions = [(one.replace("position", "orientation"), 4) for one in (*places, "position_b")]
    names = [*tensors, "mass_a", "mass_b", *_elements([*vectors, *quaternions, *POSE.items()])]
    values = {key: float(value) for key, value in running.get_values(names).items()}
    wrench = {key: float(value) for key, value in running.get_values(_elements(_WRENCH)).items()}
    inertia_a, inertia_b = np.reshape([values[one] for one in tensors], (2, 3, 3))
    mass_a, mass_b = values["mass_a"], values["mass_b"]
    arm, back, reach = (_vector(values, one) for one in places)
    in_a, in_b, sensor = (_turn(values, one.replace("position", "orientation")) for one in places)
    inertia_a, inertia_b = in_a.T @ inertia_a @ in_a, in_b.T @ inertia_b @ in_b
    arm, back = in_a.T @ arm, in_b.T @ back
    orientation = _turn(values, "orientation")
    spin = (_turn(values, "orientation_b") @ in_b).T @ _vector(values, "angular_velocity_b")
    motion = [_vector(values, one) for one in ("position", "velocity", "angular_velocity")]

    def crossed(a: Any) -> Any:
        return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])

    def rates(whole: Any) -> Any:
        """All resolved in O_Bi; `turn` is the rotation vector from the operating point."""
        place, turn, speed, relative, target, force, torque = np.reshape(whole, (7, 3))
        small = crossed(turn)
        attitude = (np.eye(3) + small + 0.5 * small @ small) @ orientation
        own = relative + target
        lever = attitude @ arm  # from A's centre of mass to O_Ai
        tensor = attitude @ inertia_a @ attitude.T
        force, torque = sensor @ force, sensor @ torque
        moment_a = torque + np.cross(reach - place + lever, force)
        moment_b = -torque - np.cross(reach + back, force)
        turning_a = np.linalg.solve(tensor, moment_a - np.cross(own, tensor @ own))
        turning_b = np.linalg.solve(inertia_b, moment_b - np.cross(target, inertia_b @ target))
        of_a = force / mass_a + np.cross(turning_a, lever) + np.cross(own, np.cross(own, lever))
        seen = back + place  # from B's centre of mass to O_Ai
        of_b = -force / mass_b + np.cross(turning_b, seen) + np.cross(target, np.cross(target, seen))
        return np.concatenate(
            [
                speed,
                relative - 0.5 * np.cross(turn, relative),
                of_a - of_b - 2.0 * np.cross(target, speed),
                turning_a - turning_b - np.cross(target, relative),
                turning_b,
            ]
        )

    at = np.concatenate(
        [motion[0], np.zeros(3), *motion[1:], spin, *np.reshape(list(wrench.values()), (2, 3))]
    )
    jacobian = _derivative(rates, at)
    w, *axis = _vector(values, "orientation", 4)
    c = np.zeros((13, 15))
    c[0:3, 0:3] = c[7:10, 6:9] = c[10:13, 9:12] = np.eye(3)
    c[3, 3:6], c[4:7, 3:6] = -0.5 * np.array(axis), 0.5 * (w * np.eye(3) - crossed(axis))
    states = (("position", 3), ("turn", 3), ("velocity", 3), ("angular_velocity", 3), ("target_spin", 3))
    space = StateSpace(
        jacobian[:, :15],
        jacobian[:, 15:],
        c,
        np.zeros((13, 6)),
        _elements(states),
        _elements(_WRENCH),
        _elements(list(POSE.items())),
    )
    notes = ["its equations are those of two rigid bodies, without the motion of the pair through space"]
    if np.any(rates(at)[6:]):
        notes.append(
            "it does not rest there: roots slower than the contact's are those of this moment's force"
        )
    return Law(space, notes=tuple(notes))


def _controller(p: Mapping[str, Any], running: FmuInstance) -> Law:
    """The controller's law where it stands, from its parameters.

    Its normal and its estimates stand still. The restoration of work that was missed at onset is no linear
    law and is left out.
    """
    inputs = _elements(_SENSED)
    at = np.array([float(value) for value in running.get_values(inputs).values()])
    mode, period, lead = int(p["mode"]), float(p["sample_period"]), float(p["tau_s"])
    sensor, origin, tip = _turn(p, "sensor_orientation").T, _vector(p, "sensor_position"), _vector(p, "tip")
    names = (*_elements((("normal", 3),)), "stiffness_estimate", "damping_estimate", "contact_state")
    *found, stiffness, damping, contact = (float(v) for v in running.get_values(names).values())
    normal, touches = np.array(found), bool(contact)
    ahead = float(p["transfer_delay"]) + (0.5 * period if p["hold_compensation"] else 0.0)

    def moved(pose: Any) -> tuple[Any, Any]:
        w, axis = pose[3], pose[4:7]
        reach = 2.0 * axis * (axis @ tip) + (w * w - axis @ axis) * tip + 2.0 * w * np.cross(axis, tip)
        reach = reach / (w * w + axis @ axis)
        return sensor @ (pose[:3] + reach - origin), sensor @ (pose[7:10] + np.cross(pose[10:13], reach))

    def put_out(u: Any) -> Any:
        force, torque = u[:3], u[3:6]
        if mode != _ACTIVE:
            return u[:6]
        (place, speed), (wanted, wanted_speed) = moved(u[6:19]), moved(u[19:32])
        wanted = wanted + ahead * wanted_speed
        push = stiffness * (normal @ (wanted - place)) + max(damping, 0.0) * (normal @ (wanted_speed - speed))
        made = force - push * normal
        return np.concatenate([made, torque + np.cross(wanted - place, made) + np.cross(place, made - force)])

    pushes = mode != _ACTIVE or (touches and put_out(at)[:3] @ normal >= 0.0)
    direct = _derivative(put_out, at) if pushes else np.zeros((6, len(at)))
    limit, sampled = _led(direct, period, float(p["lead_filter_time"]), 0.0 if mode == _OFF else lead)
    notes = [
        f"its law is that {'in contact' if pushes else 'without contact'}; its sample hold counts as a delay "
        "of half a period; its normal and its estimates stand still"
    ]
    if mode == _ACTIVE and p["switching_compensation"]:
        notes.append("switching_compensation is not linear and is left out")
    return Law(limit, 0.5 * period, sampled, period, tuple(notes))


def _led(direct: Array, period: float, lag: float, lead: float) -> tuple[StateSpace, StateSpace]:
    """A law without memory behind the phase lead of the measured wrench: in the limit of short samples, and
    from sample to sample.

    Args: direct: outputs by inputs, the measured wrench first; lag, lead: [s].
    """
    inputs, outputs = _elements(_SENSED), _elements(_WRENCH)
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
        _elements((("wrench_rate", 6),)),
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
        _elements((("previous_wrench", 6), ("wrench_rate", 6))),
        inputs,
        outputs,
    )
    return limit, sampled
