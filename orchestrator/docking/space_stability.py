"""The linear equations of the compliance controller in space, where a run has brought it into contact.

He, Shen, Gao, Zhang, "Active Compliance Control of a Position-Controlled Industrial Robot for Simulating
Space Operations", Eqs. (25) and (27) to (30).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..frequency.from_system import LinearPoint
from ..frequency.statespace import Law, StateSpace
from ..results.recorders import parameters_of
from ..simulation.run import Prepared
from .options import POSE, SpaceOptions

__all__ = ["law_in_contact", "space_point"]

Array = NDArray[Any]

_ACTIVE = 3
# Of its initial value: the controller takes no lower stiffness.
_LEAST_STIFFNESS = 0.01
_WRENCH = ("measured_force", "measured_torque")
_OUTPUTS = ("force", "torque", "compensated_force", "compensated_torque", "normal")
# Of the complex step that gives derivatives to rounding.
_TINY = 1e-30


def space_point(prepared: Prepared, options: SpaceOptions) -> LinearPoint:
    """The law of an active compliance controller, taken where a run has brought it."""
    models = {one.name: one.fmu.description.name.rpartition(".")[2] for one in prepared.system.instances}
    name = options.controller
    if name is None or models.get(name) != "WrenchController":
        return LinearPoint({}, {})
    own = {
        key.partition(".")[2]: value
        for key, value in parameters_of(prepared.system).items()
        if key.startswith(f"{name}.")
    }

    def law(values: Callable[[list[str]], Mapping[str, Any]]) -> Law | None:
        return law_in_contact(own, values)

    return LinearPoint({}, {}, {name: law})


def law_in_contact(p: Mapping[str, Any], values: Callable[[list[str]], Mapping[str, Any]]) -> Law | None:
    """The controller's law from sample to sample, and in the limit of short samples.

    Estimates stand still. The restoration of work that was missed at onset is no linear law and is left out.

    Args:
        p: parameters; values: gives the FMU's variables by name.
    Returns: None if the controller is not active or not in contact: what it does then can be measured.
    """
    state = ("stiffness", "damping")
    scalars = values(["contact_state", *(f"state.{name}" for name in state)])
    if int(p["mode"]) != _ACTIVE or not int(scalars["contact_state"]):
        return None
    sizes = {name: 3 for name in _WRENCH}
    sizes |= {f"{kind}{name}": size for kind in ("", "desired_") for name, size in POSE.items()}
    inputs = _elements(sizes)
    memory = _elements({f"state.{name}": 3 for name in _MEMORY})
    outputs = _elements({name: 3 for name in _OUTPUTS})
    found = values([*memory, *inputs])
    point = np.array([float(found[name]) for name in (*memory, *inputs)])
    given = np.split(point[len(memory) :], np.cumsum(list(sizes.values()))[:-1])
    if not _Contact(p, scalars).pushes(np.split(point[: len(memory)], len(_MEMORY)), given):
        return None
    laws = []
    for limit in (True, False):
        contact = _Contact(p, scalars, limit)

        def answers(z: Array, contact: _Contact = contact) -> Array:
            parts = np.split(z[: len(memory)], len(_MEMORY))
            fed = np.split(z[len(memory) :], np.cumsum(list(sizes.values()))[:-1])
            return np.concatenate(contact.sample(parts, fed))

        whole = _jacobian(answers, point)
        n = len(memory)
        kept = _kept(whole, n)
        states = tuple(memory[index] for index in kept)
        laws.append(
            StateSpace(
                whole[np.ix_(kept, kept)],
                whole[kept, n:],
                whole[n:, kept],
                whole[n:, n:],
                states,
                tuple(inputs),
                tuple(outputs),
            )
        )
    period = float(p["sample_period"])
    notes = [
        "its law is that in contact; its sample hold counts as a delay of half a period; estimates stand "
        f"still, at {float(scalars['state.stiffness']):.6g} N/m and "
        f"{max(float(scalars['state.damping']), 0.0):.6g} N.s/m"
    ]
    if p["switching_compensation"]:
        notes.append("switching_compensation is not linear and is left out")
    return Law(laws[0], 0.5 * period, laws[1], period, tuple(notes))


# What the law remembers from sample to sample: the reading before, its filtered difference, the mean force.
_MEMORY = ("previous_measured", "force_rate", "previous_torque", "torque_rate", "mean_force")


class _Contact:
    """The law in contact, for real and complex numbers alike.

    In the limit of short samples the filtered difference's state is the reading through its low-pass.
    """

    def __init__(self, p: Mapping[str, Any], scalars: Mapping[str, Any], limit: bool = False) -> None:
        self.p, self.limit = p, limit
        self.period = float(p["sample_period"])
        least = _LEAST_STIFFNESS * float(p["initial_stiffness"])
        self.stiffness = max(float(scalars["state.stiffness"]), least)
        self.damping = max(float(scalars["state.damping"]), 0.0)
        self.tip, self.place = _vector(p, "tip"), _vector(p, "sensor_position")
        self.back = _vector(p, "sensor_orientation", 4) * np.array([1.0, -1.0, -1.0, -1.0])

    def pushes(self, memory: list[Array], given: list[Array]) -> bool:
        """Whether the law asks for a push, as it does unless the desired rod has left the frame."""
        _, _, _, _, _, force, _, _, _, normal = self.sample(memory, given)
        return bool(np.real(force @ normal) > 0.0)

    def sample(self, memory: list[Array], given: list[Array]) -> list[Array]:
        """What it remembers at the next sample, or in the limit the rates of that; and its outputs."""
        force, torque, *motion = given
        read_force, last_force, rate_force = self._lead(force, *memory[:2])
        read_torque, last_torque, rate_torque = self._lead(torque, *memory[2:4])
        normal_time = float(self.p["normal_time"])
        mean = memory[4]
        sees = math.sqrt(np.real(force @ force)) > float(self.p["contact_threshold"])
        if self.limit and normal_time > 0.0:
            kept, axis = (force - mean) / normal_time * float(sees), mean
        else:
            keep = math.exp(-self.period / normal_time) if normal_time > 0.0 else 0.0
            kept = axis = keep * mean + (1.0 - keep) * force if sees else mean
        normal = axis / np.sqrt(axis @ axis)
        place, speed = self._tip(*motion[:4])
        desired, desired_speed = self._tip(*motion[4:])
        ahead = float(self.p["transfer_delay"]) + (0.5 * self.period if self.p["hold_compensation"] else 0.0)
        gap = desired + desired_speed * ahead - place
        pull = self.stiffness * (gap @ normal) + self.damping * ((desired_speed - speed) @ normal)
        asked = read_force - normal * pull
        moment = read_torque + np.cross(gap, asked) + np.cross(place, asked - read_force)
        return [
            last_force, rate_force, last_torque, rate_torque, kept,
            asked, moment, read_force, read_torque, normal,
        ]  # fmt: skip

    def _lead(self, reading: Array, last: Array, rate: Array) -> tuple[Array, Array, Array]:
        lead, lag = float(self.p["tau_s"]), float(self.p["lead_filter_time"])
        if self.limit:
            # Without filter the derivative is one up to frequencies that no loop passes.
            lag = max(lag, 1e-7)
            difference = (reading - last) / lag
            return reading + lead * difference, difference, np.zeros(3)
        keep = math.exp(-self.period / lag) if lag > 0.0 else 0.0
        rate = keep * rate + (1.0 - keep) * (reading - last) / self.period
        return reading + lead * rate, reading, rate

    def _tip(self, position: Array, orientation: Array, velocity: Array, spin: Array) -> tuple[Array, Array]:
        """Place and velocity of the rod tip, from the sensor's origin and resolved in its frame."""
        arm = _turned(orientation, self.tip)
        place = _turned(self.back, position + arm - self.place)
        return place, _turned(self.back, velocity + np.cross(spin, arm))


def _turned(q: Array, v: Array) -> Array:
    """A vector turned by a quaternion of any length."""
    scalar, axis = q[0], q[1:]
    return ((scalar**2 - axis @ axis) * v + 2.0 * (axis @ v) * axis + 2.0 * scalar * np.cross(axis, v)) / (
        q @ q
    )


def _vector(p: Mapping[str, Any], name: str, size: int = 3) -> Array:
    return np.array([float(p[f"{name}[{index}]"]) for index in range(1, size + 1)])


def _elements(sizes: Mapping[str, int]) -> list[str]:
    return [f"{name}[{index}]" for name, size in sizes.items() for index in range(1, size + 1)]


def _jacobian(answers: Callable[[Array], Array], point: Array) -> NDArray[np.float64]:
    """Derivatives by a complex step, shape (answers, point)."""
    columns = []
    for index in range(len(point)):
        moved = point.astype(complex)
        moved[index] += 1j * _TINY
        columns.append(answers(moved).imag / _TINY)
    return np.array(columns).T


def _kept(whole: NDArray[np.float64], n: int) -> list[int]:
    """States that reach an output, in any number of samples."""
    kept = set(np.flatnonzero(whole[n:, :n].any(axis=0)).tolist())
    while more := set(np.flatnonzero(whole[sorted(kept), :n].any(axis=0)).tolist()) - kept:
        kept |= more
    return sorted(kept)
