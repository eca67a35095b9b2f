"""Tolerances of calibrated numbers that say less than their signs are known."""

from __future__ import annotations

from ...system.connection import Port
from .mistakes import Warned
from .study import PortStudy


def wide(study: PortStudy) -> list[Warned]:
    """Calibrated numbers whose tolerance is as large as their value, or larger.

    A tolerance is one standard deviation: one in six such numbers has the other sign than its value, as few
    stiffnesses or masses have, and may imitate what effects do. Of a number that is zero, as an offset is,
    any tolerance is meant so.

    Returns: a warning of each, at its line of the study.
    """
    found = []
    for name, one in study.nominal.items():
        if one.value == 0.0 or one.tolerance < abs(one.value):
            continue
        unit = study.unit(Port.of(name))
        unit = "" if unit == "1" else f" {unit}"
        got, value = f"{one.tolerance:.4g}{unit}", f"{abs(one.value):.4g}{unit}"
        share = f"{100.0 * one.tolerance / abs(one.value):.3g} %"
        found.append(
            Warned(
                place=study.place("calibrated", name, "tolerance"),
                what=f"{got} is {share} of the value and leaves its sign open; expected, as one standard "
                f"deviation: below {value}",
                remedy="Give what the calibration is known to: the search moves a number by up to three "
                "tolerances without a reason.",
            )
        )
    return found
