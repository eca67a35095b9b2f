"""Numbers of the paper and where they stand, as (value, place): all that is not computed here.

He, Shen, Gao, Zhang, "Active Compliance Control of a Position-Controlled Industrial Robot for Simulating
Space Operations".
"""

from __future__ import annotations

from typing import NamedTuple


class Stated(NamedTuple):
    """A number of the paper."""

    value: float
    place: str

    def quoted(self, text: str = "{:g}") -> str:
        """Number and place for the page."""
        return f"{text.format(self.value)} ({self.place})"


# Section 2.4, Fig. 3: 176 N/mm, no damping, xi_n = 0.8.
VELOCITY_AFTER_FOUR_CYCLES = Stated(15.0, "2.4, Fig. 3c: almost")  # of the initial one, at 6 ms
FORCE_AFTER_FOUR_CYCLES = Stated(10.0, "2.4, Fig. 3d")  # times the first

# Section 4.1, Figs. 6 and 7.
SIMULATION_STIFFNESS = Stated(176.0, "4.1")  # N/mm

# Section 4.2, Figs. 8 to 10.
WALL_STIFFNESS = Stated(70.0, "4.2")  # N/mm
WALL_DAMPING = Stated(0.1, "4.2")  # N.s/mm
WALL_FREQUENCY = Stated(2.52, "4.2")  # Hz
WALL_AVERAGE_STIFFNESS = Stated(69.71, "4.2")  # N/mm
WALL_STIFFNESS_ERROR = Stated(0.004, "4.2")  # less than

# Section 4.3, Figs. 12 to 16. Mass [kg] -> contact frequency [Hz] of the 10 mm rod.
ROD_FREQUENCIES = {279.07: Stated(2.62, "4.3"), 404.49: Stated(2.17, "4.3"), 521.74: Stated(1.92, "4.3")}
ROD_DIAMETERS = (10.0, 15.0, 20.0)  # mm
UNCOMPENSATED_SECOND = Stated(2.5, "4.3, Fig. 15a")  # velocity over the initial one
UNCOMPENSATED_THIRD = Stated(4.5, "4.3, Fig. 15a")
