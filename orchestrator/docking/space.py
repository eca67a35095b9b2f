"""The `docking-space` measure: contacts, energy and momentum of a docking run in six degrees of freedom."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from .measures import KEPT, UNITS
from .options import SpaceOptions
from .space_contacts import SpaceContacts, _normal, _vector
from .space_signals import Array, pose, stacked
from .theory import contact_frequency, ideal_peak_force, ideal_restitution

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.figure import Figure

    from ..frequency.from_system import LinearPoint
    from ..results.recorders import Results
    from ..simulation.run import Prepared

_SATELLITES = ("kinetic_energy", "linear_momentum", "angular_momentum")


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
        sentence = f"After {count} the satellites have {ratio:.4f} times their first kinetic energy"
        if any(one["ideal_cor"] < 1.0 for one in contacts):
            return f"{sentence}; the contact is damped."
        if abs(ratio - 1.0) <= 2 * KEPT:
            return f"{sentence}: the loop keeps the energy of the contact."
        return f"{sentence}: the loop {'adds' if ratio > 1.0 else 'takes'} energy at each contact."

    def linear_point(self, prepared: Prepared, options: SpaceOptions) -> LinearPoint:
        """Stability: equations of the satellites and the controller."""
        from .space_point import space_laws

        return space_laws(prepared, options)

    def scene(self, results: Results, options: SpaceOptions) -> dict[str, Any]:
        """The rod's tip between the surfaces, and both satellites."""
        from .scene import space_scene

        return space_scene(results, options)

    def figures(self, results: Results, options: SpaceOptions) -> dict[str, Figure]:
        """Figures by name: `positions`, `attitude`, `forces`, `energy`, `contacts` and, with a controller,
        `estimates`.
        """
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
