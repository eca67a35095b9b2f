"""Zeros and minima of functions of frequency, all at once: one evaluation serves many brackets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..base.arrays import Array

_MOST = 60
# Points within a bracket of a minimum, and how often they close in.
_POINTS, _PASSES = 9, 5


def zeros(function: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """Zeros between places at which a function has opposite signs, by Ridders' method, to 1e-14 of each.

    Args:
        function: of shape (k,), values of shape (k,).
        low, high: shape (k,).
    """
    low, high = np.array(low, np.float64), np.array(high, np.float64)
    if not len(low):
        return low
    below, above = function(low), function(high)
    found = np.where(below == 0.0, low, high)
    open_ = (below != 0.0) & (above != 0.0)
    for _ in range(_MOST):
        if not open_.any():
            break
        middle = 0.5 * (low + high)
        value = function(middle)
        root = np.sqrt(np.maximum(value * value - below * above, 0.0))
        step = np.where(
            root > 0.0, (middle - low) * np.sign(below - above) * value / np.where(root, root, 1.0), 0
        )
        place = middle + step
        there = function(place)
        open_ &= (abs(place - found) > 1e-14 * abs(place)) & (there != 0.0)
        found = np.where(open_ | (there == 0.0), place, found)
        # The narrowest bracket of the four places.
        places = np.sort(np.stack([low, middle, place, high]), axis=0)
        order = np.argsort(np.stack([low, middle, place, high]), axis=0, kind="stable")
        values = np.take_along_axis(np.stack([below, value, there, above]), order, axis=0)
        change = np.argmax((values[:-1] > 0.0) != (values[1:] > 0.0), axis=0)[None]
        low, high = (np.take_along_axis(places, change + k, axis=0)[0] for k in (0, 1))
        below, above = (np.take_along_axis(values, change + k, axis=0)[0] for k in (0, 1))
    return found


def minima(function: Callable[[Array], Array], low: Array, high: Array) -> tuple[Array, Array]:
    """Where a function is least within brackets, and its values there.

    Args:
        function: of shape (k,), values of shape (k,).
        low, high: shape (k,).
    """
    low, high = np.array(low, np.float64), np.array(high, np.float64)
    if not len(low):
        return low, low
    share = np.linspace(0.0, 1.0, _POINTS)[:, None]
    row = np.arange(len(low))
    for _ in range(_PASSES):
        places = low + share * (high - low)
        values = function(places.ravel()).reshape(places.shape)
        least = np.argmin(values, axis=0)
        best = places[least, row], values[least, row]
        low, high = places[np.maximum(least - 1, 0), row], places[np.minimum(least + 1, _POINTS - 1), row]
    # The vertex of the parabola through the three lowest places.
    at, value = best
    before, after = at - low, high - at
    with np.errstate(divide="ignore", invalid="ignore"):
        falls = (value - function(low)) / before
        rises = (function(high) - value) / after
        vertex = at - 0.5 * (falls * after + rises * before) / (rises - falls)
    vertex = np.where(np.isfinite(vertex), np.clip(vertex, low, high), at)
    there = function(vertex)
    return np.where(there < value, vertex, at), np.minimum(there, value)
