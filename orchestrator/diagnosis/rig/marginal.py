"""Weights of residuals after roughness is marginalised and autocorrelation is corrected for."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from .misfit import variance_gain
from .study import Array

# Autocorrelation is summed up to so many of the times that the sum gives.
_WINDOW = 6.0
# The largest lag that is looked at.
_LONGEST = 200
# Directions of roughness with smaller deviations, in standard deviations of a sample, are left out.
_SPREAD = 0.1


def inflation(residuals: Iterable[Array]) -> float:
    """Factor by which squared residuals overstate their information, because neighbours are correlated.

    The integrated autocorrelation time, 1 + 2 sum rho(k), summed up to a lag of six times the sum (Sokal's
    window), each channel by itself, times the mean square where that is larger than
    one; the channels' mean, by their sums of squares. For white residuals of the specified noise it is one.

    Args:
        residuals: of the best fit, normalised, per run and channel, as `Fit.residuals`.
    """
    weighted = total = 0.0
    for r in residuals:
        square = float(r @ r)
        if len(r) < 16 or square == 0.0:
            continue
        size = 1 << (2 * len(r) - 1).bit_length()
        spectrum = np.abs(np.fft.rfft(r, size)) ** 2
        rho = np.fft.irfft(spectrum, size)[: min(_LONGEST, len(r) // 4) + 1]
        times = 2.0 * np.cumsum(rho / rho[0]) - 1.0
        enough = np.flatnonzero(np.arange(len(times)) >= _WINDOW * times)
        time = float(times[enough[0]] if enough.size else times[-1])
        weighted += square * max(time, 1.0) * max(square / len(r), 1.0)
        total += square
    return weighted / total if total > 0.0 else 1.0


class Marginal:
    """Noise and roughness, by which residuals are weighed.

    Residuals are normalised, by run and channel; stacked, all of them in a row.

    Args:
        inflation: by which squared residuals are divided: autocorrelated residuals, and what no model holds,
            carry less information than their number.
        roughness: directions of stacked residuals in which every rig deviates a little, scaled to one
            standard deviation, shape (residuals, k).
        apart: how many of them, at the end, are looked at by themselves, too: see `roughness_evidence`.
    """

    def __init__(self, inflation: float = 1.0, roughness: Array | None = None, apart: int = 0) -> None:
        self.inflation = inflation
        self._shrink: tuple[Array, Array] | None = None
        self._apart: Array | None = None
        if roughness is None or not roughness.size:
            return
        # Singular vectors, by the columns' products, which are few; those of no spread change nothing.
        square, turn = np.linalg.eigh(roughness.T @ roughness / inflation)
        kept = square > _SPREAD**2
        spread = np.sqrt(square[kept])
        directions = np.ascontiguousarray(roughness @ (turn[:, kept] / (spread * math.sqrt(inflation))))
        # (1 + C C')^(-1/2) r, which is r but along the directions.
        self._shrink = directions, 1.0 / np.sqrt(1.0 + spread**2) - 1.0
        if apart:
            own = self._over(roughness[:, roughness.shape[1] - apart :] / math.sqrt(inflation))
            self._apart = own / np.linalg.norm(own, axis=0)

    def stacked(self, residuals: Iterable[Array]) -> Array:
        """Stacked residuals, normalised by noise and roughness; their square is the cost."""
        return self._over(self._row(residuals))

    def _row(self, residuals: Iterable[Array]) -> Array:
        return np.concatenate(list(residuals)) / math.sqrt(self.inflation)

    def _over(self, r: Array) -> Array:
        """Stacked residuals, or columns of such, over roughness."""
        if self._shrink is None or not np.isfinite(r).all():
            return r
        directions, shrink = self._shrink
        return r + directions @ (shrink * (directions.T @ r).T).T

    def left(self, residuals: Iterable[Array]) -> list[Array]:
        """Residuals minus the most probable roughness."""
        residuals = list(residuals)
        if self._shrink is None:
            return residuals
        directions, shrink = self._shrink
        r = np.concatenate(residuals)
        r = r - directions @ ((1.0 - (1.0 + shrink) ** 2) * (directions.T @ r))
        return np.split(r, np.cumsum([len(one) for one in residuals])[:-1])

    def products(
        self, residuals: Iterable[Array], columns: Array, rows: Array, chosen: Array, z: Array
    ) -> tuple[Array, Array]:
        """Products of columns with each other and with residuals, normalised by noise, roughness and fit.

        Args:
            residuals: where a fit ended.
            columns: of stacked residuals, those of `rows`, shape (rows, m); elsewhere they are zero.
            chosen: derivatives of the stacked residuals by what the fit chose, in deviations of its prior,
                shape (residuals, p): it may take up something of a column that would be there.
            z: what it chose, shape (p,); where it ended a little beside the best, that is made up for.
        Returns: of shapes (m, m) and (m,).
        """
        r = self._row(residuals)
        square, product = columns.T @ columns, columns.T @ r[rows]
        if self._shrink is not None:
            directions, shrink = self._shrink
            along, kept = directions[rows].T @ columns, (1.0 + shrink) ** 2 - 1.0
            square += along.T @ (kept[:, None] * along)
            product += along.T @ (kept * (directions.T @ r))
        shared = self._over(chosen)[rows].T @ columns
        taken = np.linalg.solve(chosen.T @ chosen + np.eye(chosen.shape[1]), shared)
        slope = chosen.T @ self._over(r) + z
        return square - shared.T @ taken, product - taken.T @ slope

    def roughness_evidence(self, residuals: Iterable[Array]) -> float:
        """Log likelihood that roughness is larger than usual, if it absorbs residuals [nats].

        Along each of its directions residuals have the variance that noise and roughness make together; see
        `misfit.unexplained` for the evidence of a larger mean square. Some directions count by themselves, if
        that says more: among all of them they would drown.
        """
        if self._shrink is None:
            return 0.0
        directions, shrink = self._shrink
        r = self._row(residuals)
        sizes = (1.0 + shrink) * (directions.T @ r)
        found = variance_gain(len(sizes), float(np.mean(sizes**2)))
        if self._apart is None:
            return found
        own = self._apart.T @ self._over(r)
        return max(found, variance_gain(len(own), float(np.mean(own**2))))
