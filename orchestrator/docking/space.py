"""The `docking-space` measure: contacts, energy and momentum of a docking run in six degrees of freedom."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from scipy.spatial.transform import Rotation

from .contacts import Contact, find_contacts
from .frames import Motion, attached
from .measures import KEPT, UNITS
from .theory import contact_frequency, ideal_peak_force, ideal_restitution

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.figure import Figure

    from ..results.recorders import Results

__all__ = [
    "SpaceContacts",
    "SpaceMeasure",
    "SpaceOptions",
    "effective_mass",
    "pose",
    "stacked",
    "tip_velocity",
]

Array = NDArray[np.float64]

# Of a free flight: there every remainder of the last contact has died away, and no prediction has begun.
_MIDDLE = (0.25, 0.75)
_POSE = {"position": 3, "orientation": 4, "velocity": 3, "angular_velocity": 3}
_SATELLITES = ("kinetic_energy", "linear_momentum", "angular_momentum")


class SpaceOptions(BaseModel):
    """Which instances play which part; `controller` is absent in an uncompensated loop."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    satellites: str
    robot: str
    contact: str
    controller: str | None = None

    def signals(self) -> tuple[str, ...]:
        """Names of the recorded signals that the measure reads."""
        names = [f"{self.satellites}.kinetic_energy", f"{self.contact}.stored_energy"]
        arrays = [(f"{self.satellites}.{name}", 3) for name in _SATELLITES[1:]]
        arrays += [(f"{self.contact}.force", 3)]
        for suffix in ("", "_a", "_b"):
            arrays += [(f"{self.satellites}.{name}{suffix}", size) for name, size in _POSE.items()]
        arrays += [(f"{self.robot}.{name}", size) for name, size in _POSE.items()]
        names += [f"{name}[{index}]" for name, size in arrays for index in range(1, size + 1)]
        if self.controller is not None:
            names += [f"{self.controller}.stiffness_estimate", f"{self.controller}.damping_estimate"]
        return tuple(names)


def stacked(results: Results, name: str, size: int = 3) -> Array:
    """A recorded array signal, shape (n, size)."""
    return np.column_stack([results[f"{name}[{index}]"] for index in range(1, size + 1)])


def pose(results: Results, instance: str, suffix: str = "") -> Motion:
    """Recorded pose and twist of an instance, n rows."""
    return Motion.of(*(stacked(results, f"{instance}.{name}{suffix}", size) for name, size in _POSE.items()))


def tip_velocity(results: Results, instance: str, tip: Array) -> Array:
    """Velocity of the rod tip in O_t, shape (n, 3) [m/s]; `tip` is its place in O_u, shape (3,) [m]."""
    return attached(pose(results, instance), tip, Rotation.identity()).velocity


def effective_mass(direction: Array, bodies: list[tuple[float, Array, Rotation, Array]]) -> float:
    """Mass [kg] that two free bodies show each other at a point of contact without friction.

    1/m_e = sum over the bodies of 1/m + (r x e).I^-1 (r x e), with I = R I_COG R' and r from the centre of
    mass to the point; on a line through both centres it is m_A m_B/(m_A + m_B).

    Args:
        direction: unit normal e, global, shape (3,).
        bodies: of each: mass [kg], inertia in its COG frame, shape (3, 3) [kg.m2], orientation, and r,
            global, shape (3,) [m].
    """
    inverse = 0.0
    for mass, inertia, turn, arm in bodies:
        lever = turn.inv().apply(np.cross(arm, direction))
        inverse += 1.0 / mass + float(lever @ np.linalg.solve(inertia, lever))
    return 1.0 / inverse


@dataclass(frozen=True)
class SpaceContacts:
    """Contacts of a run, seen along the surface normal.

    Attributes:
        velocity: of the satellite's rod tip along the way to the front surface, shape (n,) [m/s].
        force: contact force on the rod along the same way, shape (n,) [N]; negative at the front frame.
        found: the completed contacts. Their velocities are those of the free flights around them where the
            contact begins and ends: the target turns, so that even in free flight the velocity seen from it
            changes (by 0.5 % between the middle of a flight and its end in `docking-6d`).
    """

    velocity: Array
    force: Array
    found: list[Contact]

    @classmethod
    def of(cls, results: Results, options: SpaceOptions) -> SpaceContacts:
        """Find the contacts of a run."""
        way = -_normal(results, options)
        velocity = tip_velocity(results, options.satellites, _vector(results, options.contact, "tip")) @ way
        force = stacked(results, f"{options.contact}.force") @ way
        found = find_contacts(results.time, velocity, force, settled=math.inf)
        whole, before = [], 0
        for one in found:
            later = np.flatnonzero(force[one.last + 1 :])
            # The flight after the last contact may be cut off by the recording: its latter half counts then.
            end = one.last + 1 + int(later[0]) if later.size else 2 * len(velocity) - one.last
            speeds = (
                _in_flight(results.time, velocity, before, one.first, one.first),
                _in_flight(results.time, velocity, one.last, end, one.last),
            )
            whole.append(replace(one, velocity_before=speeds[0], velocity_after=speeds[1]))
            before = one.last
        return cls(velocity, force, whole)


class SpaceMeasure:
    """Measures of a docking run in six degrees of freedom; see `measure` for the keys."""

    options = SpaceOptions
    units: ClassVar[dict[str, str]] = UNITS

    def measure(self, results: Results, options: SpaceOptions) -> dict[str, Any]:
        """Measure every completed contact, energy and momentum.

        Velocities and forces of contacts are those along the surface normal, velocities of the rod tip.

        Returns: a dict with
            contacts: list, one entry per contact: `side`, `start_time` [s], `end_time` [s],
                `rebound_velocity_ratio` (free velocity after the contact over the first approach speed,
                signed), `cor` and `ideal_cor` (of the contact without delay), `effective_mass` [kg] of the
                satellites at the point of contact, `peak_force` [N], `peak_force_ratio` (over that of the
                ideal contact at this approach speed and mass), `kinetic_energy_ratio` (of the pair in free
                flight after the contact, over that at the start), `linear_impulse` [N.s] (of the contact
                force on the rod along the normal);
            energy: `start` [J], `largest_ratio` (largest kinetic energy in free flight over it);
            momentum: `linear_change`, `angular_change`: largest change over the run, relative to the largest
                momentum of a body [1]; the angular one is about O_g's origin;
            attitude: `largest_turn` [rad] of the rod's frame from the start, `largest_rate` [rad/s];
            ideal: of the first contact without delay: `first_peak_force` [N], `contact_frequency` [Hz];
            stiffness_estimate [N/m], damping_estimate [N.s/m]: the controller's at the end, None without one.
        """
        seen = SpaceContacts.of(results, options)
        stiffness = float(results.parameters[f"{options.contact}.stiffness"])
        damping = float(results.parameters[f"{options.contact}.damping"])
        energy = results[f"{options.satellites}.kinetic_energy"]
        speed = abs(float(seen.velocity[0]))
        contacts, masses = [], []
        for one in seen.found:
            mass = _effective_mass(results, options, one.first)
            masses.append(mass)
            rows = slice(max(one.first - 1, 0), one.last + 2)
            ideal = ideal_peak_force(stiffness, damping, mass, one.velocity_before)
            contacts.append(
                {
                    "side": one.side,
                    "start_time": one.start_time,
                    "end_time": one.end_time,
                    "rebound_velocity_ratio": one.velocity_after / speed if speed else None,
                    "cor": one.restitution,
                    "ideal_cor": ideal_restitution(stiffness, damping, mass),
                    "effective_mass": mass,
                    "peak_force": one.peak_force,
                    "peak_force_ratio": one.peak_force / ideal if ideal else None,
                    "kinetic_energy_ratio": float(energy[one.free_after] / energy[0]) if energy[0] else None,
                    "linear_impulse": float(np.trapezoid(seen.force[rows], results.time[rows])),
                }
            )
        estimates: dict[str, float | None] = {"stiffness_estimate": None, "damping_estimate": None}
        if options.controller is not None:
            estimates = {name: float(results[f"{options.controller}.{name}"][-1]) for name in estimates}
        ratios = [one["kinetic_energy_ratio"] for one in contacts if one["kinetic_energy_ratio"] is not None]
        return {
            "contacts": contacts,
            "energy": {"start": float(energy[0]), "largest_ratio": max([1.0, *ratios])},
            "momentum": _momentum(results, options),
            "attitude": _attitude(results, options),
            "ideal": {
                "first_peak_force": ideal_peak_force(stiffness, damping, masses[0], speed)
                if masses
                else None,
                "contact_frequency": contact_frequency(stiffness, masses[0]) if masses else None,
            },
            **estimates,
        }

    def headline(self, measured: dict[str, Any]) -> str:
        """What the contacts did to the energy; the speed along the normal changes with the rotation, too."""
        contacts = measured["contacts"]
        ratio = contacts[-1]["kinetic_energy_ratio"] if contacts else None
        if ratio is None:
            return (
                "No contact was completed." if not contacts else "The satellites were at rest at the start."
            )
        count = f"{len(contacts)} contact{'s' if len(contacts) > 1 else ''}"
        told = f"After {count} the satellites have {ratio:.4f} times their first kinetic energy"
        if any(one["ideal_cor"] < 1.0 for one in contacts):
            return f"{told}; the contact is damped."
        if abs(ratio - 1.0) <= 2 * KEPT:
            return f"{told}: the loop keeps the energy of the contact."
        return f"{told}: the loop {'adds' if ratio > 1.0 else 'takes'} energy at each contact."

    def scene(self, results: Results, options: SpaceOptions) -> dict[str, Any]:
        """The rod's tip between the surfaces, and both satellites."""
        from .scene import space_scene

        return space_scene(results, options)

    def figures(self, results: Results, options: SpaceOptions) -> dict[str, Figure]:
        """Figures by name: `positions`, `attitude`, `forces`, `energy`, `contacts` and, with a controller,
        `estimates`."""
        from . import space_figures as figures

        drawn = {
            "positions": figures.positions(results, options),
            "attitude": figures.attitude(results, options),
            "forces": figures.forces(results, options),
            "energy": figures.energy(results, options),
            "contacts": figures.contacts(results, options),
        }
        if options.controller is not None:
            drawn["estimates"] = figures.estimates(results, options)
        return drawn

    def comparison(self, runs: Mapping[str, tuple[Results, SpaceOptions]]) -> dict[str, Figure]:
        """Restitution, kinetic energy and peak force per contact of several runs: `comparison-space`."""
        from . import space_figures as figures

        measured = {name: self.measure(results, options) for name, (results, options) in runs.items()}
        return {"comparison-space": figures.comparison(measured)}


def _in_flight(time: Array, velocity: Array, begin: int, end: int, row: int) -> float:
    """Velocity [m/s] at a row, from a parabola through the middle of the free flight between two rows."""
    low, high = (begin + round(part * (end - begin)) for part in _MIDDLE)
    rows = slice(low, min(high, len(time) - 1) + 1)
    degree = min(2, rows.stop - rows.start - 1)
    return float(Polynomial.fit(time[rows], velocity[rows], degree)(time[row]))


def _vector(results: Results, instance: str, name: str, size: int = 3) -> Array:
    return np.array([results.parameters[f"{instance}.{name}[{index}]"] for index in range(1, size + 1)])


def _normal(results: Results, options: SpaceOptions) -> Array:
    normal = _vector(results, options.contact, "normal")
    return normal / np.linalg.norm(normal)


def _tensor(results: Results, instance: str, name: str) -> Array:
    rows = [[results.parameters[f"{instance}.{name}[{i},{j}]"] for j in (1, 2, 3)] for i in (1, 2, 3)]
    return np.array(rows, dtype=float)


def _effective_mass(results: Results, options: SpaceOptions, row: int) -> float:
    """Of the satellites at the rod tip, at one row."""
    pair = options.satellites
    mounted = Rotation.from_quat(_vector(results, pair, "assembly_orientation_b", 4), scalar_first=True)
    turns, places = [], []
    for body in "ab":
        quaternion = [results[f"{pair}.orientation_{body}[{index}]"][row] for index in (1, 2, 3, 4)]
        turns.append(Rotation.from_quat(quaternion, scalar_first=True))
        places.append(np.array([results[f"{pair}.position_{body}[{index}]"][row] for index in (1, 2, 3)]))
    inner = Rotation.from_quat(_vector(results, pair, "assembly_orientation_a", 4), scalar_first=True)
    tip = _vector(results, pair, "assembly_position_a") + inner.apply(
        _vector(results, options.contact, "tip")
    )
    point = places[0] + turns[0].apply(tip)
    direction = (turns[1] * mounted).apply(_normal(results, options))
    return effective_mass(
        direction,
        [
            (
                float(results.parameters[f"{pair}.mass_{body}"]),
                _tensor(results, pair, f"inertia_{body}"),
                turn,
                point - place,
            )
            for body, turn, place in zip("ab", turns, places, strict=True)
        ],
    )


def _momentum(results: Results, options: SpaceOptions) -> dict[str, float]:
    """Largest change of the pair's momenta, relative to the largest that one of the bodies has."""
    pair = options.satellites
    linear, angular = 0.0, 0.0
    for body in "ab":
        motion = pose(results, pair, f"_{body}")
        momentum = float(results.parameters[f"{pair}.mass_{body}"]) * motion.velocity
        inside = motion.orientation.inv().apply(motion.angular_velocity) @ _tensor(
            results, pair, f"inertia_{body}"
        )
        own = np.cross(motion.position, momentum) + motion.orientation.apply(inside)
        linear = max(linear, float(np.linalg.norm(momentum, axis=1).max()))
        angular = max(angular, float(np.linalg.norm(own, axis=1).max()))
    changes = {}
    for name, scale in (("linear", linear), ("angular", angular)):
        values = stacked(results, f"{pair}.{name}_momentum")
        change = float(np.linalg.norm(values - values[0], axis=1).max())
        changes[f"{name}_change"] = change / scale if scale > 0.0 else change
    return changes


def _attitude(results: Results, options: SpaceOptions) -> dict[str, float]:
    motion = pose(results, options.satellites)
    turned = (motion.orientation[0].inv() * motion.orientation).magnitude()
    rate = np.linalg.norm(motion.angular_velocity, axis=1)
    return {"largest_turn": float(turned.max()), "largest_rate": float(rate.max())}
