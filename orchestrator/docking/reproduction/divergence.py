"""Section 2.4, Fig. 3: without compensation the loop diverges, the more so the later the robot is."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from . import drawing, paper
from .delay import delay_for_growth, growth_of_roots
from .experiment import Case, Quantity, Recorded, above, native, near

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SYSTEM = "docking-1d-uncompensated"
FREQUENCIES = (25, 50, 75, 100)  # Hz
DELAYS = (2, 4, 6)  # ms
CONTACTS = 8

TITLE = "Section 2.4: effects of time delay"
ABOUT = (
    "The bundled system docking-1d-uncompensated: 176 N/mm, no damping, 20 mm/s, m_e = 279.07 kg, the "
    "robot as Eq. 17 with the damping term 2 xi_n omega_n s (printed as 2 xi_n s, which leaves the robot "
    "undamped). The text names the curve at 75 Hz and 6 ms only; the other response frequencies and "
    "delays are our choice.",
    "Growth per contact is the mean over the first contacts, and is held against the rightmost "
    "characteristic root of the same loop.",
)
FIGURES = {
    "fig3a": "Contact velocity for different response frequencies, xi_n = 0.8, tau_m = 2 ms",
    "fig3b": "Contact force for different response frequencies, xi_n = 0.8, tau_m = 2 ms",
    "fig3c": "Contact velocity for different time delays, xi_n = 0.8, 75 Hz",
    "fig3d": "Contact force for different time delays, xi_n = 0.8, 75 Hz",
}


def _overrides(frequency: int, delay: int) -> tuple[str, ...]:
    return (f"robot.omega_n={frequency} Hz", f"robot.tau_m={delay} ms", "run.stop_time=3.4 s")


def _points() -> dict[str, tuple[int, int]]:
    found = {f"{frequency} Hz, 2 ms": (frequency, 2) for frequency in FREQUENCIES}
    return found | {f"75 Hz, {delay} ms": (75, delay) for delay in DELAYS}


def cases() -> tuple[Case, ...]:
    """One run for every curve."""
    return tuple(
        Case(name, SYSTEM, native(*_overrides(*point), controller=False)) for name, point in _points().items()
    )


def quantities(runs: Mapping[str, Recorded]) -> list[Quantity]:
    """Growth per contact of every curve, and what the text says about the one at 6 ms."""
    found = []
    growth = {}
    for name, (frequency, delay) in _points().items():
        ratios = runs[name].ratios[:CONTACTS]
        growth[frequency, delay] = float(ratios[-1] ** (1.0 / len(ratios)))
        figure = "fig3a" if delay == 2 else "fig3c"
        theory = growth_of_roots(SYSTEM, _overrides(frequency, delay))
        text = f"growth of the velocity per contact, {name}"
        criterion = near(theory, 1e-3, f"the characteristic root's {theory:.5f}")
        found.append(
            Quantity(
                f"growth_{frequency}Hz_{delay}ms", figure, text, "1", "", growth[frequency, delay], criterion
            )
        )
    steps = [growth[low, 2] - growth[high, 2] for low, high in pairwise(FREQUENCIES)]
    claim = "a lower response frequency diverges more (2.4)"
    text = "smallest fall of the growth to the next higher frequency"
    found.append(Quantity("growth_falls_with_frequency", "fig3a", text, "1", claim, min(steps), above(0.0)))
    rises = [growth[75, high] - growth[75, low] for low, high in pairwise(DELAYS)]
    text = "smallest rise of the growth to the next longer delay"
    claim = "divergence becomes larger with the delay (2.4)"
    found.append(Quantity("growth_rises_with_delay", "fig3c", text, "1", claim, min(rises), above(0.0)))
    return found + _at_six_milliseconds(runs["75 Hz, 6 ms"])


def _at_six_milliseconds(run: Recorded) -> list[Quantity]:
    stated, force = paper.VELOCITY_AFTER_FOUR_CYCLES, paper.FORCE_AFTER_FOUR_CYCLES
    before, after = float(run.ratios[CONTACTS - 2]), float(run.ratios[CONTACTS - 1])
    peaks = run.peaks[: CONTACTS - 1] / run.ideal_peak
    matching = delay_for_growth(SYSTEM, stated.value ** (1.0 / CONTACTS), _overrides(75, 6))
    return [
        Quantity(
            "velocity_before_contact_8",
            "fig3c",
            "velocity at 6 ms before contact 8 over the initial one",
            "1",
            "",
            before,
        ),
        Quantity(
            "velocity_after_contact_8",
            "fig3c",
            "velocity at 6 ms after contact 8 (four cycles, two contacts each) over the initial one",
            "1",
            stated.quoted(),
            after,
            near(stated.value, 0.1),
            f"{stated.value:g} lies between the velocities before and after contact 8, and the text does "
            f"not say at which instant it reads the curve; with {matching * 1e3:.2f} ms of delay instead "
            "of 6, contact 8 would end there. Ours is the characteristic root's growth to the power of "
            "eight.",
        ),
        Quantity(
            "delay_for_15",
            "fig3c",
            f"delay with which contact 8 ends at {stated.value:g} times the velocity",
            "ms",
            "",
            matching * 1e3,
        ),
        Quantity(
            "peak_force_contact_7",
            "fig3d",
            "peak force of contact 7 at 6 ms over the ideal first one",
            "1",
            force.quoted(),
            float(np.max(peaks)),
            near(force.value, 0.1),
            "Contact 7 begins the fourth cycle.",
        ),
    ]


def draw(figure: str, runs: Mapping[str, Recorded]) -> Figure:
    """Velocity (a, c) or force (b, d) by frequency (a, b) or delay (c, d)."""
    if figure in ("fig3a", "fig3b"):
        chosen = {f"{frequency} Hz": runs[f"{frequency} Hz, 2 ms"] for frequency in FREQUENCIES}
        count = 6  # at 25 Hz the next ones would hide all others
    else:
        chosen = {f"{delay} ms": runs[f"75 Hz, {delay} ms"] for delay in DELAYS}
        count = CONTACTS
    make = drawing.velocities if figure in ("fig3a", "fig3c") else drawing.forces
    return make(chosen, count)
