"""Where residual energy beyond the noise lies: component by phase of motion by frequency band."""

from __future__ import annotations

from typing import Any

import numpy as np

from .components import COMPONENTS, faultless, residuals_of
from .finding import Augmented, Finding
from .motion import Phase, phases
from .study import Array, Role, Run, Study

__all__ = ["BANDS", "energies", "ledger"]

# Edges of the frequency bands [Hz].
BANDS = (0.0, 5.0, 20.0, 80.0, np.inf)


def energies(study: Study, run: Run, model: Augmented) -> tuple[Array, Array]:
    """Residual energy of a run, and what of it noise accounts for.

    Each phase is cut out before its spectrum is taken: phases do not overlap, and Parseval's theorem holds in
    each, so that the cells of a component add up to its residual's energy.

    Returns: both by component, phase and band, shape (4, 4, len(BANDS) - 1) [N2.s].
    """
    residuals = residuals_of(study, run, model)
    labels, n, tick = phases(study, run), len(run), study.tick
    frequency = np.fft.rfftfreq(n, tick)
    weight = np.full(len(frequency), 2.0)
    weight[0] = 1.0
    if n % 2 == 0:
        weight[-1] = 1.0
    band = np.searchsorted(BANDS, frequency, side="right") - 1
    widths = np.bincount(band, weight, len(BANDS) - 1) / weight.sum()
    found, noise = (np.zeros((len(COMPONENTS), len(Phase), len(BANDS) - 1)) for _ in range(2))
    for component, (signal, sigma) in enumerate(zip(residuals.force, residuals.force_noise, strict=True)):
        for phase in Phase:
            inside = labels == phase
            power = weight * np.abs(np.fft.rfft(np.where(inside, signal, 0.0))) ** 2 / n
            found[component, phase] = tick * np.bincount(band, power, len(BANDS) - 1)
            noise[component, phase] = tick * sigma**2 * np.count_nonzero(inside) * widths
    return found, noise


def ledger(study: Study, finding: Finding) -> list[dict[str, Any]]:
    """Excess residual energy of all runs by component, phase and band, as shares of all of it.

    Residuals are those of the answer's calibration without its effects. Shares add up to 1; those of cells
    with less energy than noise explains are negative.

    Returns: rows with component, phase, band, share. Empty if no energy is in excess.
    """
    model = faultless(study, finding)
    total = np.zeros((len(COMPONENTS), len(Phase), len(BANDS) - 1))
    for run in (run for run in study.runs if run.role is not Role.REPEAT):
        found, noise = energies(study, run, model)
        total += found - noise
    whole = float(total.sum())
    if not whole > 0.0:
        return []
    return [
        {"component": component, "phase": phase.name.lower(), "band": _band(band), "share": share}
        for component, phases_ in zip(COMPONENTS, (total / whole).tolist(), strict=True)
        for phase, bands in zip(Phase, phases_, strict=True)
        for band, share in enumerate(bands)
    ]


def _band(band: int) -> str:
    low, high = BANDS[band : band + 2]
    return f"{low:g}-{high:g} Hz" if np.isfinite(high) else f"over {low:g} Hz"
