"""A model of the paper's rig of Section 4.3, derived from what the text says about it.

The mechanisms themselves are not at hand: stiffness follows from contact frequency and mass, the robot's
delay from the divergence without compensation, and what the text leaves open is assumed and named.
"""

from __future__ import annotations

import math

from . import paper
from .delay import delay_for_growth

CONTROLLED, UNCOMPENSATED = "docking-1d", "docking-1d-uncompensated"
MASSES = tuple(paper.ROD_FREQUENCIES)
DAMPING = 0.1  # N.s/mm, that of the virtual walls
NOISE = "0.5 N"

ABOUT = (
    "The paper's mechanisms are real; ours are a model. Stiffness of the 10 mm rod: k = m_e (2 pi f)^2, "
    "Eq. (31), from the first of the three pairs of mass and contact frequency in the text. The rods of "
    "15 and 20 mm: k grows with the cross-section, d^2, as of a rod pressed along its axis; an "
    "assumption, since the text gives no number (bending would give d^4 and 1210 N/mm at 20 mm).",
    f"Assumed as well: damping {DAMPING:g} N.s/mm for each rod, that of the virtual walls; white noise of "
    f"{NOISE} (standard deviation, a new value every 0.5 ms) on the force reading; the robot's response of "
    "75 Hz and xi_n = 0.8, as in Fig. 3.",
    "The robot's delay is derived: it is the one with which the uncompensated loop of the 10 mm rod at "
    "279.07 kg grows as the text says, to 2.5 and 4.5 times the velocity after contacts 2 and 3 (least "
    "squares of the logarithms). Only delay plus lag, tau_m + 2 xi_n/omega_n, is determined by this.",
)


def derived_stiffness() -> dict[float, float]:
    """Stiffness of the 10 mm rod [N/m] by mass [kg], Eq. (31); they differ by the text's rounding."""
    return {
        mass: mass * (2.0 * math.pi * stated.value) ** 2 for mass, stated in paper.ROD_FREQUENCIES.items()
    }


def stiffness(diameter: float) -> float:
    """Contact stiffness of a rod [N/m] by its diameter [mm]."""
    return derived_stiffness()[MASSES[0]] * (diameter / paper.ROD_DIAMETERS[0]) ** 2


def delays() -> dict[str, float]:
    """The robot's delay [s] that explains the ratio of contact 2, of contact 3, and both at best."""
    second, third = paper.UNCOMPENSATED_SECOND.value, paper.UNCOMPENSATED_THIRD.value
    # ln(ratio after contact n) = n ln(growth), least squares over n = 2, 3.
    fitted = math.exp((2.0 * math.log(second) + 3.0 * math.log(third)) / (2.0**2 + 3.0**2))
    growths = {"contact 2": second ** (1.0 / 2.0), "contact 3": third ** (1.0 / 3.0), "both": fitted}
    contact = mechanism(paper.ROD_DIAMETERS[0], MASSES[0])
    return {name: delay_for_growth(UNCOMPENSATED, growth, contact) for name, growth in growths.items()}


def delay() -> str:
    """Override of the robot's delay, rounded to the two digits of the text."""
    return f"robot.tau_m={delays()['both'] * 1e3:.1f} ms"


def mechanism(diameter: float, mass: float) -> tuple[str, ...]:
    """Overrides for a rod of `diameter` [mm] between satellites of effective `mass` [kg]."""
    return (
        f"contact.stiffness={stiffness(diameter)!r} N/m",
        f"contact.damping={DAMPING!r} N.s/mm",
        f"satellite.mass={mass!r} kg",
    )


def noise(seed: int, size: str = NOISE) -> str:
    """Override that puts noise on the force reading."""
    return f"connections[sensor.force].through=[{{noise: {size}, period: 0.5 ms, seed: {seed}}}]"


def case_name(diameter: float, mass: float) -> str:
    """Name of the compensated run."""
    return f"{diameter:g} mm, {mass:g} kg"
