"""Systems of two values, interpolated between a few that are linearised.

The matrices are taken at Chebyshev points and interpolated between them, to 1e-5 of their size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..base.arrays import Array
from ..base.errors import ConfigError, Problem
from .delay_equation import Link
from .delay_system import DelaySystem

# Points of the interpolation along either axis, and how far it may be off, relative to the largest value.
_NODES = (2, 3, 5, 9, 16)
_INTERPOLATED = 1e-5


class Family:
    """Systems of two values, interpolated between a few."""

    def __init__(
        self, make: Callable[[float, float], DelaySystem], spans: Sequence[tuple[float, float]]
    ) -> None:
        self.make, self.made = make, 0
        self._known: dict[tuple[float, float], DelaySystem] = {}
        self.logs, self.spans, counts = [False, False], list(spans), [2, 2]
        # Each axis takes as many points as a line along it needs, over the value or its logarithm.
        for axis, span in enumerate(spans):
            choices = [(count, log) for count in _NODES for log in (False, True) if not log or span[0] > 0.0]
            for count, log in choices:
                self.logs[axis], self.spans[axis] = log, self._inner(span, log)
                counts[axis] = count
                if self._fits(axis, count):
                    break
            else:
                what = "the linear system does not depend smoothly on the parameters"
                raise ConfigError([Problem("--over", what, "", "Take smaller ranges, or one parameter.")])
        self.nodes = [_nodes(count) for count in counts]
        places = [[self._outer(place, axis) for place in self.nodes[axis]] for axis in (0, 1)]
        values = np.array([[self._values(a, b) for b in places[1]] for a in places[0]])
        self.weights = [_weights(count) for count in counts]
        # What is the same everywhere stays so to the last bit.
        self.varies = np.flatnonzero(np.ptp(values.reshape(-1, values.shape[-1]), axis=0) > 0.0)
        self.fixed, self.values = values[0, 0], values[:, :, self.varies]
        middle = [self._outer(0.123, 0), self._outer(-0.37, 1)]
        self._check(self._interpolated(*middle), self._values(*middle), "between its points")

    @staticmethod
    def _inner(span: tuple[float, float], log: bool) -> tuple[float, float]:
        return (np.log(span[0]), np.log(span[1])) if log else span

    def _outer(self, place: float, axis: int) -> float:
        """From [-1, 1] to a value."""
        low, high = self.spans[axis]
        value = low + 0.5 * (place + 1.0) * (high - low)
        return float(np.exp(value)) if self.logs[axis] else float(value)

    def _place(self, value: float, axis: int) -> float:
        low, high = self.spans[axis]
        return 2.0 * ((np.log(value) if self.logs[axis] else value) - low) / (high - low) - 1.0

    def _values(self, a: float, b: float) -> Array:
        if (a, b) not in self._known:
            self._known[a, b] = self.make(a, b)
            self.made += 1
        one = self._known[a, b]
        links = np.array([(link.gain, link.delay) for link in one.links]).reshape(-1, 2)
        if not hasattr(self, "system"):
            self.system = one
        same = self.system
        shape = (one.states, one.inputs, one.outputs, [link[:3] for link in one.links])
        if shape != (same.states, same.inputs, same.outputs, [link[:3] for link in same.links]):
            what = (
                "the parameters change what the linear system consists of: a delay or a filter comes or goes"
            )
            raise ConfigError(
                [Problem("--over", what, "", "Take ranges within which nothing comes or goes.")]
            )
        return np.concatenate([one.a.ravel(), one.b.ravel(), one.c.ravel(), one.d.ravel(), links.ravel()])

    def _fits(self, axis: int, count: int) -> bool:
        """Whether so many points along an axis, through the middle of the other, give what lies between."""
        other = self._outer(0.0, 1 - axis)

        def at(place: float) -> Array:
            value = self._outer(place, axis)
            return self._values(value, other) if axis == 0 else self._values(other, value)

        nodes = _nodes(count)
        values = np.array([at(place) for place in nodes])
        size = self._size(values)
        for place in (-0.83, 0.31):
            made = _share(place, nodes, _weights(count)) @ values
            if np.max(abs(made - at(place)) - _INTERPOLATED * size) > 0.0:
                return False
        return True

    def _size(self, values: Array) -> Array:
        """What errors are checked by: each number's size, or a share of its matrix's largest."""
        size = np.max(abs(values), axis=0)
        edges = np.cumsum(
            [matrix.size for matrix in (self.system.a, self.system.b, self.system.c, self.system.d)]
        )
        least = [np.full(len(part), 1e-4 * np.max(part, initial=0.0)) for part in np.split(size, edges)]
        return np.maximum(size, np.concatenate(least))

    def _check(self, made: Array, wanted: Array, where: str) -> None:
        if np.max(abs(made - wanted) - 10.0 * _INTERPOLATED * self._size(np.array([made, wanted]))) > 0.0:
            what = f"the linear system does not depend smoothly on the parameters {where}"
            raise ConfigError([Problem("--over", what, "", "Take smaller ranges.")])

    def _interpolated(self, a: float, b: float) -> Array:
        along = [
            _share(self._place(value, axis), self.nodes[axis], self.weights[axis])
            for axis, value in enumerate((a, b))
        ]
        values = self.fixed.copy()
        values[self.varies] = np.einsum("i,j,ijk->k", *along, self.values)
        return values

    def __call__(self, a: float, b: float) -> DelaySystem:
        """The system of two values."""
        values, one, low = self._interpolated(a, b), self.system, 0
        made = []
        for matrix in (one.a, one.b, one.c, one.d):
            made.append(values[low : low + matrix.size].reshape(matrix.shape))
            low += matrix.size
        rest = values[low:].reshape(-1, 2)
        links = tuple(
            Link(*link[:3], float(gain), max(float(delay), 0.0))
            for link, (gain, delay) in zip(one.links, rest, strict=True)
        )
        return replace(one, a=made[0], b=made[1], c=made[2], d=made[3], links=links)


def _nodes(count: int) -> Array:
    return np.cos(np.pi * (np.arange(count) + 0.5) / count)


def _weights(count: int) -> Array:
    return (-1.0) ** np.arange(count, dtype=np.float64) * np.sin(np.pi * (np.arange(count) + 0.5) / count)


def _share(place: float, nodes: Array, weights: Array) -> Array:
    """Shares of the points in the interpolated value: the barycentric formula."""
    apart = place - nodes
    near = int(np.argmin(abs(apart)))
    if abs(apart[near]) < 1e-14:
        return np.eye(len(nodes))[near]
    share = weights / apart
    return share / share.sum()
