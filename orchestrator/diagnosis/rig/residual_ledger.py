"""Residual energy beyond the noise, by component, phase of motion and frequency band."""

from __future__ import annotations

from typing import Any

import numpy as np

from .components import COMPONENTS, residuals_of
from .finding import Augmented, Finding
from .motion import Phase, phases
from .study import Array, Role, Run, Study

# Edges of the frequency bands [Hz].
BANDS = (0.0, 5.0, 20.0, 80.0, np.inf)


def energies(study: Study, run: Run, model: Augmented) -> tuple[Array, Array]:
    """Residual energy of a run, and the part caused by noise; see `cells`.

    Returns: both by component, phase and band, shape (4, 4, len(BANDS) - 1) [N2.s].
    """
    residuals = residuals_of(study, run, model)
    labels, tick = phases(study, run), study.tick
    found = [cells(signal, labels, tick) for signal in residuals.force]
    noise = [white_cells(float(sigma), labels, tick) for sigma in residuals.force_noise]
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


def cells(signal: Array, labels: Array, step: float) -> Array:
    """Energy of a signal by phase of motion and frequency band.

    Each phase is cut out before its spectrum is taken: phases do not overlap, and Parseval's theorem holds in
    each, so that the cells add up to the signal's energy.

    Args:
        signal: shape (n,); labels: phase of each sample, shape (n,); step: between samples [s].
    Returns: shape (len(Phase), len(BANDS) - 1), in squares of the signal's unit times seconds.
    """
    n = len(signal)
    weight, band = _bands(n, step)
    found = np.zeros((len(Phase), len(BANDS) - 1))
    for phase in Phase:
        inside = labels == phase
        power = weight * np.abs(np.fft.rfft(np.where(inside, signal, 0.0))) ** 2 / n
        found[phase] = step * np.bincount(band, power, len(BANDS) - 1)
    return found


def white_cells(sigma: float, labels: Array, step: float) -> Array:
    """Expected energy of white noise by phase and band; see `cells`.

    Args:
        sigma: standard deviation of a sample.
    """
    weight, band = _bands(len(labels), step)
    widths = np.bincount(band, weight, len(BANDS) - 1) / weight.sum()
    counts = np.array([np.count_nonzero(labels == phase) for phase in Phase])
    return step * sigma**2 * counts[:, None] * widths


def _bands(n: int, step: float) -> tuple[Array, np.ndarray]:
    """Of each frequency of a transform of n samples: its weight, and the band that it lies in."""
    frequency = np.fft.rfftfreq(n, step)
    weight = np.full(len(frequency), 2.0)
    weight[0] = 1.0
    if n % 2 == 0:
        weight[-1] = 1.0
    return weight, np.searchsorted(BANDS, frequency, side="right") - 1
