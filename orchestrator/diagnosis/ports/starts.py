"""Noise of the samples at which runs begin: distinguished from what the rest of the run tells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..study import Array

__all__ = ["Begun"]

# Beyond so many standard deviations a first sample is not noisy, but wrong, or the model is.
_MOST = 3.0
# Directions of residuals that stray by less, in standard deviations of a sample, are left out.
_SPREAD = 0.1


class Begun:
    """Residuals of a run less what the noise of its first samples makes of them.

    A run begins where its first samples say, off by their noise; what that makes of its residuals r is nearly
    linear in it, J d with d of variance one. Weighed are (1 + J J')^(-1/2) r, whose square is what the best d
    leaves and costs: neither calibration nor effects have to explain it. Bounded, or a wrong model would be
    explained by a begin that no noise makes.

    Args:
        columns: of J: what the residuals of all ports, in a row, change by where the first sample of a port
            is off by its noise.
    """

    def __init__(self, columns: Sequence[Array]) -> None:
        finite = [one for one in columns if np.isfinite(one).all()]
        self._directions, self._spread = np.zeros((0, 0)), np.zeros(0)
        if finite:
            u, spread, _ = np.linalg.svd(np.column_stack(finite), full_matrices=False)
            self._directions, self._spread = u[:, spread > _SPREAD], spread[spread > _SPREAD]

    def less(self, residuals: Sequence[Array]) -> list[Array]:
        """The residuals of all ports without it, each of shape (samples,)."""
        if not self._spread.size:
            return list(residuals)
        r = np.concatenate(list(residuals))
        if np.isfinite(r).all():
            whole = np.sqrt(1.0 + self._spread**2)
            along = self._directions.T @ r
            # As far as the begin that is most probable is one that noise makes.
            within = np.clip(along, -_MOST * whole**2 / self._spread, _MOST * whole**2 / self._spread)
            r = r - self._directions @ (within * (1.0 - 1.0 / whole))
        return np.split(r, np.cumsum([len(one) for one in residuals])[:-1])
