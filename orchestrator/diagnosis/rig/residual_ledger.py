"""Residual energy beyond the noise, by component, phase of motion and frequency band."""

from __future__ import annotations

from typing import Any

import numpy as np

from .components import COMPONENTS, residuals_of
from .finding import Augmented, Finding
from .motion import Phase, phases
from .sharing import cells, white_cells
from .study import Array, Role, Run, Study

__all__ = ["BANDS", "energies", "ledger"]

# Edges of the frequency bands [Hz].
BANDS = (0.0, 5.0, 20.0, 80.0, np.inf)


def energies(study: Study, run: Run, model: Augmented) -> tuple[Array, Array]:
    """Residual energy of a run, and the part caused by noise; see `sharing.cells`.

    Returns: both by component, phase and band, shape (4, 4, len(BANDS) - 1) [N2.s].
    """
    residuals = residuals_of(study, run, model)
    labels, tick, count = phases(study, run), study.tick, len(Phase)
    found = [cells(signal, labels, count, BANDS, tick) for signal in residuals.force]
    noise = [white_cells(float(sigma), labels, count, BANDS, tick) for sigma in residuals.force_noise]
    return np.array(found), np.array(noise)


def ledger(study: Study, finding: Finding) -> list[dict[str, Any]]:
    """Excess residual energy by component, phase and band, as shares of all of it.

    All runs but repeats count. Residuals are those of the answer's calibration without its effects. Shares
    add up to 1; those of cells with less energy than noise explains are negative.

    Returns: rows with component, phase, band, share. Empty if no energy is in excess.
    """
    model = finding.faultless(study.nominal)
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
