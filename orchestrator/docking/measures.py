"""The `docking` measure: rebound, peak force and restitution per contact; the final estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .contacts import find_contacts
from .options import DockingOptions
from .theory import contact_frequency, ideal_peak_force, ideal_restitution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..frequency.from_system import Linearised, LinearPoint
    from ..results.recorders import Results
    from ..simulation.run import Prepared

# Of the numbers of both docking measures; the others are ratios.
UNITS = {
    "start_time": "s",
    "end_time": "s",
    "peak_force": "N",
    "first_peak_force": "N",
    "contact_frequency": "Hz",
    "stiffness_estimate": "N/m",
    "damping_estimate": "N.s/m",
    "effective_mass": "kg",
    "linear_impulse": "N.s",
    "start": "J",
    "largest_turn": "rad",
    "largest_rate": "rad/s",
}
# Ratios of speeds this near to the ideal count as kept: the paper's own rebounds stay within it.
KEPT = 0.02


def _kept_speed(contacts: Sequence[Mapping[str, Any]], ideal: float) -> str:
    """What a sequence of contacts did to the speed, in a sentence.

    Args:
        contacts: each with its `rebound_velocity_ratio`.
        ideal: the size of the last ratio without delay.
    """
    if not contacts:
        return "No contact was completed."
    ratio = contacts[-1]["rebound_velocity_ratio"]
    count = f"{len(contacts)} contact{'s' if len(contacts) > 1 else ''}"
    if ratio is None:
        return (
            f"{count}; the satellite was at rest at the start, so that there is no first speed to compare to."
        )
    ratio = abs(ratio)
    sentence = f"After {count} the rod has {ratio:.4f} times its first speed (without delay {ideal:.4g})"
    if abs(ratio - ideal) <= KEPT * ideal:
        return f"{sentence}: the loop keeps the energy of the contact."
    return f"{sentence}: the loop {'adds' if ratio > ideal else 'takes'} energy at each contact."


class DockingMeasure:
    """Measures of a one-dimensional docking run; see `measure` for the keys."""

    options = DockingOptions
    units: ClassVar[dict[str, str]] = UNITS

    def measure(self, results: Results, options: DockingOptions) -> dict[str, Any]:
        """Measure every completed contact.

        Returns: a dict with
            contacts: list, one entry per contact: `side`, `start_time` [s], `end_time` [s],
                `rebound_velocity_ratio` (free velocity after the contact over the approach speed, signed),
                `ideal_velocity_ratio` (the same of the contact without delay), `peak_force` [N],
                `peak_force_ratio` (over the ideal first peak), `cor` (Eq. 32, as a ratio); the ratios to
                the approach are None where the satellite was at rest at the start;
            ideal: without delay: `cor`, `first_peak_force` [N], `contact_frequency` [Hz] (Eq. 31);
            stiffness_estimate [N/m], damping_estimate [N.s/m]: the controller's at the end, None without one.
        """
        velocity = results[f"{options.satellite}.velocity"]
        force = results[f"{options.contact}.force"]
        approach_speed = abs(float(velocity[0]))
        stiffness = results.parameters[f"{options.contact}.stiffness"]
        damping = results.parameters[f"{options.contact}.damping"]
        mass = results.parameters[f"{options.satellite}.mass"]
        restitution = ideal_restitution(stiffness, damping, mass)
        first_peak = ideal_peak_force(stiffness, damping, mass, approach_speed)
        direction = float(np.sign(velocity[0]))
        contacts = []
        for index, contact in enumerate(find_contacts(results.time, velocity, force), start=1):
            contacts.append(
                {
                    "side": contact.side,
                    "start_time": contact.start_time,
                    "end_time": contact.end_time,
                    "rebound_velocity_ratio": contact.velocity_after / approach_speed
                    if approach_speed
                    else None,
                    "ideal_velocity_ratio": direction * (-restitution) ** index if approach_speed else None,
                    "peak_force": contact.peak_force,
                    "peak_force_ratio": contact.peak_force / first_peak if first_peak else None,
                    "cor": contact.restitution,
                }
            )
        estimates: dict[str, float | None] = {"stiffness_estimate": None, "damping_estimate": None}
        if options.controller is not None:
            estimates = {name: float(results[f"{options.controller}.{name}"][-1]) for name in estimates}
        return {
            "contacts": contacts,
            "ideal": {
                "cor": restitution,
                "first_peak_force": first_peak,
                "contact_frequency": contact_frequency(stiffness, mass),
            },
            **estimates,
        }

    def linear_point(self, prepared: Prepared, options: DockingOptions) -> LinearPoint:
        """Stability is that of the contact: the rod at rest in its frame."""
        from .stability import contact_point

        return contact_point(prepared, options)

    def hold(self, prepared: Prepared, linear: Linearised, options: DockingOptions) -> dict[str, float]:
        """A push on the satellite that lets the rod rest in its frame."""
        from .stability import resting_push

        return resting_push(prepared, linear, options)

    def stability(
        self, prepared: Prepared, linear: Linearised, report: Mapping[str, Any], options: DockingOptions
    ) -> tuple[dict[str, Any], list[str]]:
        """Growth of the velocity per contact."""
        from .stability import stability_lines, stability_numbers

        numbers = stability_numbers(prepared, linear, report, options)
        return numbers, stability_lines(numbers)

    def headline(self, measured: dict[str, Any]) -> str:
        """What the contacts did to the speed."""
        contacts = measured["contacts"]
        return _kept_speed(contacts, abs(contacts[-1]["ideal_velocity_ratio"] or 0.0) if contacts else 1.0)

    def scene(self, results: Results, options: DockingOptions) -> dict[str, Any]:
        """The rod's tip between the surfaces."""
        from .scene import line_scene

        return line_scene(results, options)

    def figures(self, results: Results, options: DockingOptions) -> dict[str, Figure]:
        """Figures by name: `contacts` (velocity and force, free flight cut out), `rebounds` and,
        with a controller, `estimates`.
        """
        from . import figures

        drawn = {
            "contacts": figures.contacts(results, options),
            "rebounds": figures.rebounds(self.measure(results, options)),
        }
        if options.controller is not None:
            drawn["estimates"] = figures.estimates(results, options)
        return drawn

    def comparison(self, runs: Mapping[str, tuple[Results, DockingOptions]]) -> dict[str, Figure]:
        """Rebound velocity and peak force per contact of several runs: `comparison`."""
        from . import figures

        return {"comparison": figures.comparison(runs)}
