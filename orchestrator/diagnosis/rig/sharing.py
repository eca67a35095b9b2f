"""Shares of a total: Shapley values of coalitions, energies by phase and band."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations
from math import factorial

import numpy as np

from .finding import Finding
from .study import Array

__all__ = ["by_place", "cells", "coalitions", "shapley_values", "white_cells"]


def coalitions(count: int) -> list[frozenset[int]]:
    """All coalitions of so many players: none first, all last."""
    return [frozenset(some) for size in range(count + 1) for some in combinations(range(count), size)]


def shapley_values(gaps: Mapping[frozenset[int], float] | Sequence[float], count: int) -> Array:
    """Shapley values of the reduction of a gap by coalitions.

    Args:
        gaps: by coalition, or in the order of `coalitions`.
    Returns: by player, shape (count,); they add up to the gap of no player less that of all.
    """
    every = coalitions(count)
    found = gaps if isinstance(gaps, Mapping) else dict(zip(every, gaps, strict=True))
    values = np.zeros(count)
    for coalition in every:
        for player in range(count):
            if player not in coalition:
                weight = factorial(len(coalition)) * factorial(count - len(coalition) - 1)
                lessened = found[coalition] - found[coalition | {player}]
                values[player] += weight / factorial(count) * lessened
    return values


def by_place(
    shares: Iterable[float],
    components: Mapping[str, Sequence[str]],
    finding: Finding,
    place_of: Callable[[str], str] = lambda effect: effect.partition(".")[0],
) -> dict[str, float]:
    """Shares of components, shared out to their places.

    Signals distinguish components; within one, its share goes to its places as probable as the candidates
    make them, or equally to all where no candidate lies in it.

    Args:
        shares: in the order of the components.
        components: the places of each.
        place_of: an effect.
    """
    probability = dict.fromkeys((place for places in components.values() for place in places), 0.0)
    for candidate in finding.candidates:
        places = [place_of(one) for one in candidate.effects if one != "outside"]
        if candidate.effects == ("outside",):
            places = finding.outside_place.split("+") if finding.outside_place else []
        for place in places:
            if place in probability:
                probability[place] += candidate.probability / len(places)
    shared: dict[str, float] = {}
    for share, places in zip(shares, components.values(), strict=True):
        mass = sum(probability[place] for place in places)
        for place in places:
            shared[place] = share * (probability[place] / mass if mass > 0.0 else 1.0 / len(places))
    return shared


def cells(signal: Array, labels: Array, phases: int, edges: Sequence[float], step: float) -> Array:
    """Energy of a signal by phase of motion and frequency band.

    Each phase is cut out before its spectrum is taken: phases do not overlap, and Parseval's theorem holds in
    each, so that the cells add up to the signal's energy.

    Args:
        signal: shape (n,); labels: phase of each sample, shape (n,); phases: how many there are.
        edges: of the bands, from 0 to beyond the largest frequency [Hz]; step: between samples [s].
    Returns: shape (phases, len(edges) - 1), in squares of the signal's unit times seconds.
    """
    n = len(signal)
    weight, band = _bands(n, edges, step)
    found = np.zeros((phases, len(edges) - 1))
    for phase in range(phases):
        inside = labels == phase
        power = weight * np.abs(np.fft.rfft(np.where(inside, signal, 0.0))) ** 2 / n
        found[phase] = step * np.bincount(band, power, len(edges) - 1)
    return found


def white_cells(sigma: float, labels: Array, phases: int, edges: Sequence[float], step: float) -> Array:
    """Expected energy of white noise by phase and band; see `cells`.

    Args:
        sigma: standard deviation of a sample.
    """
    weight, band = _bands(len(labels), edges, step)
    widths = np.bincount(band, weight, len(edges) - 1) / weight.sum()
    counts = np.array([np.count_nonzero(labels == phase) for phase in range(phases)])
    return step * sigma**2 * counts[:, None] * widths


def _bands(n: int, edges: Sequence[float], step: float) -> tuple[Array, np.ndarray]:
    """Of each frequency of a transform of n samples: its weight, and the band that it lies in."""
    frequency = np.fft.rfftfreq(n, step)
    weight = np.full(len(frequency), 2.0)
    weight[0] = 1.0
    if n % 2 == 0:
        weight[-1] = 1.0
    return weight, np.searchsorted(edges, frequency, side="right") - 1
