"""Which frequencies show all of a loop, however far its corners lie apart and however sharp they are."""

from __future__ import annotations

import numpy as np

from .quasi import characteristic
from .transfer import Array, Term, Transfer

__all__ = ["at_rest", "span"]

_PER_DECADE = 1500
# Sharper than this a resonance may hide between two neighbours of the grid.
_SHARP = 0.02
# Next to a root on the imaginary axis L has no value; roots themselves are known to rounding.
_NEAREST = 1e-12


def span(loop: Transfer) -> Array:
    """Frequencies that show all of a loop, ascending, shape (n,) [rad/s].

    From there, where every term has become a power of s and none crosses one any more, to where |L| stays
    below one, six decades at least; close together around resonances and notches.
    """
    # Each term with a delay of its own, so that none cancels another: the bound is to hold for all phases.
    apart = tuple(
        Term(term.numerator, term.factors, np.asarray(1.0 + index)) for index, term in enumerate(loop.terms)
    )
    # A loop that carries nothing has no such bound, and any frequency shows it.
    high = float(characteristic(Transfer(apart)).reach(0.0)) * 1.01 or 1.0
    corners = _corners(loop)
    low = min([1e-6 * high, *(0.01 * np.abs(corners))])
    crossing = _crossing_below(loop, low)
    low = min(low, 0.1 * crossing) if crossing < low else low
    omega = np.geomspace(low, high, round(_PER_DECADE * np.log10(high / low)) + 1)
    close = [_around(root) for root in corners if abs(root.real) < _SHARP * root.imag]
    return np.unique(np.concatenate([omega, *close])) if close else omega


def at_rest(loop: Transfer) -> float:
    """L(0); infinite where a term integrates."""
    total = 0.0
    for term in loop.terms:
        if not term.numerator.any():
            continue
        powers = [_lowest(polynomial) for polynomial in (term.numerator, *term.factors)]
        order = powers[0] - sum(powers[1:])
        if order < 0:
            return np.inf
        if order == 0:
            lowest = [
                float(one[power]) for one, power in zip((term.numerator, *term.factors), powers, strict=True)
            ]
            total += lowest[0] / float(np.prod(lowest[1:]))
    return total


def _lowest(polynomial: Array) -> int:
    return int(np.flatnonzero(polynomial)[0])


def _corners(loop: Transfer) -> np.ndarray:
    """Roots of all numerators and factors but those at zero, upper half plane [rad/s]."""
    found = [
        np.roots(polynomial[_lowest(polynomial) :][::-1])
        for term in loop.terms
        if term.numerator.any()
        for polynomial in (term.numerator, *term.factors)
    ]
    roots = np.concatenate(found) if found else np.zeros(0)
    return np.unique(roots[roots.imag >= 0.0])


def _crossing_below(loop: Transfer, low: float) -> float:
    """Where |L|, a power of the frequency from `low` down, crosses one, or `low` [rad/s]."""
    here, lower = (float(np.abs(loop(1j * w))) for w in (low, 0.1 * low))
    if not (here > 0.0 and lower > 0.0):
        return low
    order = round(np.log10(here / lower))
    return float(min(low, low * here ** (-1.0 / order))) if order else low


def _around(root: complex) -> Array:
    """Frequencies closing in on a sharp corner from the grid's distance to below its own width."""
    width = max(abs(root.real) / abs(root.imag), _NEAREST)
    away = np.geomspace(0.1 * width, 2.0 * _SHARP, 20 * int(np.ceil(np.log10(0.4 / width) + 1.0)))
    return root.imag * np.concatenate([1.0 - away, 1.0 + away])
