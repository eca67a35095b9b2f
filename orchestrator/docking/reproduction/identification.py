"""Section 4.3, Figs. 12 to 14: stiffness and damping of three rods at three masses."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..theory import contact_frequency
from . import drawing, paper, rig
from .experiment import Case, Quantity, Recorded, above, below, native, near

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "Section 4.3: docking mechanisms, identification"
ABOUT = rig.ABOUT
FIGURES = {
    "fig12": "Stiffness and damping estimates for the 10 mm rod, first eight contacts",
    "fig13": "Average identified stiffness by rod diameter; bars: lowest and highest of the three masses",
    "fig14": "Identified stiffness by contact frequency, and deviation; bars: standard deviation",
}
SEEDS = (1, 2, 3)
_CONTACTS = 8
_ALIKE = "almost the same (4.3)"


def cases() -> tuple[Case, ...]:
    """Every rod at every mass; the delay is that of the rig."""
    made = []
    for diameter in paper.ROD_DIAMETERS:
        for mass, seed in zip(rig.MASSES, SEEDS, strict=True):
            overrides = (*rig.mechanism(diameter, mass), rig.delay(), rig.noise(seed), "run.stop_time=8 s")
            made.append(Case(rig.case_name(diameter, mass), rig.CONTROLLED, native(*overrides)))
    return tuple(made)


def quantities(runs: Mapping[str, Recorded]) -> list[Quantity]:
    """Frequencies, stiffness and damping by mass and diameter."""
    return [*_of_masses(runs), *_of_rods(runs)]


def _of_masses(runs: Mapping[str, Recorded]) -> list[Quantity]:
    """Those of the first rod, which Fig. 12 shows."""
    found = []
    rod = paper.ROD_DIAMETERS[0]
    for mass, stated in paper.ROD_FREQUENCIES.items():
        estimate = _average(runs[rig.case_name(rod, mass)], "stiffness")
        found += [
            Quantity(
                f"stiffness_{mass:g}kg",
                "fig12",
                f"average stiffness estimate, 10 mm rod, {mass:g} kg",
                "N/mm",
                f"{rig.derived_stiffness()[mass] * 1e-3:.1f} (derived from {stated.quoted('{:g} Hz')})",
                estimate * 1e-3,
                near(rig.stiffness(rod) * 1e-3, 0.01, f"the rig model's {rig.stiffness(rod) * 1e-3:.2f}"),
                source=False,
            ),
            Quantity(
                f"frequency_{mass:g}kg",
                "fig12",
                f"contact frequency from that average, Eq. (31), {mass:g} kg",
                "Hz",
                stated.quoted(),
                contact_frequency(estimate, mass),
                near(stated.value, 0.005),
            ),
        ]
    damping = [_average(runs[rig.case_name(rod, mass)], "damping") * 1e-3 for mass in rig.MASSES]
    found += [
        Quantity(
            f"damping_{mass:g}kg",
            "fig12",
            f"average damping estimate, 10 mm rod, {mass:g} kg",
            "N.s/mm",
            "",
            value,
            near(rig.DAMPING, 0.1, f"the rig model's {rig.DAMPING:g}"),
        )
        for mass, value in zip(rig.MASSES, damping, strict=True)
    ]
    found.append(
        Quantity(
            "damping_alike",
            "fig12",
            "highest over lowest damping of the three masses, less one",
            "%",
            _ALIKE,
            (max(damping) / min(damping) - 1.0) * 100.0,
            below(10.0),
        )
    )
    return found


def _of_rods(runs: Mapping[str, Recorded]) -> list[Quantity]:
    """Stiffness by the rods' diameters, from all masses."""
    found = []
    averages = {}
    for diameter in paper.ROD_DIAMETERS:
        by_mass = [_average(runs[rig.case_name(diameter, mass)], "stiffness") for mass in rig.MASSES]
        averages[diameter] = float(np.mean(by_mass))
        found.append(
            Quantity(
                f"stiffness_alike_{diameter:g}mm",
                "fig14",
                f"highest over lowest stiffness of the three masses, less one, {diameter:g} mm",
                "%",
                _ALIKE,
                (max(by_mass) / min(by_mass) - 1.0) * 100.0,
                below(1.0),
            )
        )
        found.append(
            Quantity(
                f"stiffness_{diameter:g}mm",
                "fig13",
                f"average stiffness of the three masses, {diameter:g} mm",
                "N/mm",
                "",
                averages[diameter] * 1e-3,
                near(
                    rig.stiffness(diameter) * 1e-3,
                    0.01,
                    f"the rig model's {rig.stiffness(diameter) * 1e-3:.2f}",
                ),
            )
        )
    for low, high in pairwise(paper.ROD_DIAMETERS):
        found.append(
            Quantity(
                f"stiffness_growth_{high:g}mm",
                "fig13",
                f"stiffness at {high:g} mm over that at {low:g} mm",
                "1",
                "increases with the diameter (4.3)",
                averages[high] / averages[low],
                above(1.0),
                "The rig model makes it so; what is shown is that the identification finds it.",
            )
        )
    return found


def _average(run: Recorded, name: str) -> float:
    return float(run.estimate(name).mean())


def draw(figure: str, runs: Mapping[str, Recorded]) -> Figure:
    """Estimates over time in contact (fig12), by diameter (fig13), by frequency (fig14)."""
    if figure == "fig12":
        return _draw_estimates(runs)
    if figure == "fig13":
        return _draw_diameters(runs)
    return _draw_frequencies(runs)


def _draw_estimates(runs: Mapping[str, Recorded]) -> Figure:
    rod = paper.ROD_DIAMETERS[0]
    sheet, upper, lower = drawing.stacked("stiffness [N/mm]", "damping [N.s/mm]")
    for axes, name, truth in (
        (upper, "stiffness", rig.stiffness(rod) * 1e-3),
        (lower, "damping", rig.DAMPING),
    ):
        lines = {}
        for mass, stated in paper.ROD_FREQUENCIES.items():
            run = runs[rig.case_name(rod, mass)]
            lines[f"{stated.value:g} Hz"] = (run, run.results[f"controller.{name}_estimate"] * 1e-3)
        axes.axhline(truth, linestyle="--", color="#666666", label="rig model")
        drawing.over_contact_time(axes, lines, _CONTACTS)
    return sheet


def _draw_diameters(runs: Mapping[str, Recorded]) -> Figure:
    sheet, axes = drawing.sheet("rod diameter [mm]", "identified stiffness [N/mm]")
    values = np.array(
        [
            [_average(runs[rig.case_name(diameter, mass)], "stiffness") * 1e-3 for mass in rig.MASSES]
            for diameter in paper.ROD_DIAMETERS
        ]
    )
    mean = values.mean(axis=1)
    bars = np.stack([mean - values.min(axis=1), values.max(axis=1) - mean])
    axes.errorbar(
        paper.ROD_DIAMETERS, mean, yerr=bars, marker="o", capsize=4, color="#0072B2", label="identified"
    )
    model = [rig.stiffness(diameter) * 1e-3 for diameter in paper.ROD_DIAMETERS]
    axes.plot(paper.ROD_DIAMETERS, model, "x", color="#666666", markersize=9, label="rig model")
    axes.set_ylim(bottom=0.0)
    axes.legend()
    return sheet


def _draw_frequencies(runs: Mapping[str, Recorded]) -> Figure:
    sheet, upper, lower = drawing.stacked(
        "identified stiffness [N/mm]", "deviation from the rod's average [%]"
    )
    for diameter, color in zip(paper.ROD_DIAMETERS, ("#0072B2", "#D55E00", "#009E73"), strict=True):
        found = [runs[rig.case_name(diameter, mass)].estimate("stiffness") * 1e-3 for mass in rig.MASSES]
        mean = np.array([one.mean() for one in found])
        at = [contact_frequency(k * 1e3, mass) for k, mass in zip(mean, rig.MASSES, strict=True)]
        style = {"marker": "o", "color": color, "label": f"{diameter:g} mm"}
        upper.plot(at, mean, **style)
        percent = 100.0 / mean.mean()
        spread = [one.std() * percent for one in found]
        lower.errorbar(at, mean * percent - 100.0, yerr=spread, capsize=4, **style)
    upper.set_ylim(bottom=0.0)
    upper.legend()
    lower.set_xlabel("contact frequency [Hz]")
    return sheet
