"""Shapes that laws outside the catalogue may have in the sensor's force and in the encoder, over a run."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import cont2discrete, lfilter

from .misfit import near_contact, stretches
from .rig import Calibrated
from .study import Array

# Families whose shapes are those of each contact or flight of each run; of others runs have them in common.
ONE_BY_ONE = frozenset(("loads", "contacts", "flights"))
# Memories of the rod, of what warms up, and of what leaks [s], and share of the fastest rate at which a force
# turns.
_SHORT, _LONG, _LEAK, _TURNS = (0.005, 0.03), (0.2, 1.0), 8.0, 0.1
# Gaps before a frame over which something may reach the rod [m].
_GAPS = (1e-4, 4e-4)
# Share of the largest force from which the rod counts as touching. Shorter flights say nothing of an offset
# of their own.
_TOUCHES, _FLIGHT = 0.03, 40


def force_shapes(p: Array, replay: Array, tick: float) -> dict[str, Array]:
    """Shapes over a run, by tick, by family, each of shape (shapes, n).

    Laws of depth, rate, side, time and memory; edges, what is there as a contact begins and ends; drifts,
    what contacts leave behind. And of each contact the force and an offset, of each flight an offset.

    Args:
        p: parameters of the rig; replay: its channels in the run, see `RigModel.replay`.
        tick: of the software [s].
    """
    at = replay[7]
    gaps = p[Calibrated.FRONT_WALL] - at, at - p[Calibrated.REAR_WALL]
    rate = np.gradient(at, tick)
    deepest = max(float(max((-one).max() for one in gaps)), 1e-12)
    fastest = max(float(np.abs(rate).max()), 1e-12)
    depths = [np.maximum(-one, 0.0) / deepest for one in gaps]
    load, turns = depths[0] + depths[1], depths[0] - depths[1]
    touches = load > 0.0
    rates = rate / fastest, -rate / fastest
    memories = _faded(turns, tick, _LEAK), np.cumsum(turns) / max(float(np.abs(turns).sum()), 1e-12)
    warm = [_faded(load, tick, memory) for memory in _LONG]
    kept = [*warm, *(_faded(turns, tick, memory) for memory in _LONG), last := _last(turns), last == 0.0]
    law = np.array([one for u, w in zip(depths, rates, strict=True) for one in _laws(u, w, tick, warm)])
    edges = np.array(
        [one for u, w, gap in zip(depths, rates, gaps, strict=True) for one in _edges(u, w, gap, tick)]
    )
    within = near_contact(touches)
    law = _sensed(law, p, tick)
    law[:, ~within] = 0.0
    drifts = _sensed(np.array([touches * one for one in memories]), p, tick)
    loads, contacts = (_sensed(_apart(one, stretches(touches)), p, tick) for one in (load, 1.0 * touches))
    flights = [one for one in stretches(~within) if one.stop - one.start >= _FLIGHT]
    return {
        "law": np.concatenate([law, np.array(kept)]),
        "edges": _sensed(edges, p, tick),
        "drifts": np.concatenate([drifts, np.array(memories)]),
        "loads": loads,
        "contacts": contacts,
        "flights": _apart(np.ones(len(at)), flights),
    }


def motion_shapes(p: Array, replay: Array, tick: float) -> dict[str, Array]:
    """Shapes of the encoder's position over a run, by tick, by family, each of shape (shapes, n).

    What the servo makes of accelerations by laws of speed, position, force and time, and of what is there as
    contacts begin and end; and what shows without the servo, by position, force and side.

    Args:
        p: parameters of the rig; replay: its channels in the run, see `RigModel.replay`.
        tick: of the software [s].
    """
    x, force = replay[2], replay[3]
    v = np.gradient(x, tick)
    x, v, force = (one / max(float(np.abs(one).max()), 1e-12) for one in (x, v, force))
    touches, time = np.abs(force) > _TOUCHES, np.arange(len(x)) / len(x)
    found = [np.tanh(v / _TURNS), v * np.abs(v), np.abs(v), v**3, v * x, v * time, x, x**2, x**3]
    found += [force, force * np.abs(force), np.abs(force), force * v, np.tanh(v / _TURNS) * np.abs(force)]
    found += [_faded(one, tick, memory) for one in (v, force) for memory in _LONG]
    edges = [touches * np.exp(-_since(touches, tick) / memory) * np.sign(force) for memory in _SHORT]
    edges += [
        ~touches * np.exp(-_since(~touches, tick) / memory) * _last(force * touches) for memory in _SHORT
    ]
    direct = [x**2, x**3, force, np.abs(force), _last(force * touches), np.cumsum(force * touches)]
    omega, xi = p[Calibrated.NATURAL_FREQUENCY], p[Calibrated.DAMPING_RATIO]
    above, below, *_ = cont2discrete(([1.0], [1.0, 2.0 * xi * omega, omega**2]), tick)
    return {
        "servo": lfilter(above.ravel(), below, np.array([*found, *edges]), axis=1),
        "encoder": np.array(direct),
    }


def _laws(u: Array, w: Array, tick: float, warm: Sequence[Array]) -> list[Array]:
    """Shapes of a frame's force, by depth and rate as shares of the largest."""
    touches, time = u > 0.0, np.arange(len(u)) / len(u)
    found = [u**1.5, u**2, u**3, u * w, touches * w * np.abs(w), u * np.tanh(w / _TURNS), u * time]
    found += [touches * _deepest_yet(u), *(touches * _faded(u, tick, memory) for memory in _SHORT)]
    return found + [u * one for one in warm]


def _edges(u: Array, w: Array, gap: Array, tick: float) -> list[Array]:
    """Shapes at the start and end of contacts with a frame, and shortly before and after [gap in m]."""
    touches = u > 0.0
    since, until = _since(touches, tick), _since(touches[::-1], tick)[::-1]
    found = [touches * np.exp(-one / memory) for one in (since, until) for memory in _SHORT]
    found += [touches * 1.0, touches * np.arange(len(u)) / len(u)]
    for reach in _GAPS:
        near = ~touches * np.exp(-np.maximum(gap, 0.0) / reach)
        found += [near, near * w]
    return found + [~touches * _faded(u, tick, memory) for memory in _SHORT]


def _since(where: Array, tick: float) -> Array:
    """Time since a condition became true [s], from its value at each tick."""
    found = np.zeros(len(where))
    for one in stretches(where):
        found[one] = tick * np.arange(one.stop - one.start)
    return found


def _apart(shape: Array, parts: Sequence[slice]) -> Array:
    """A shape in each part of a run by itself."""
    found = np.zeros((len(parts), len(shape)))
    for row, part in zip(found, parts, strict=True):
        row[part] = shape[part]
    return found


def _faded(u: Array, tick: float, memory: float) -> Array:
    """Output of a first-order memory."""
    share = 1.0 - math.exp(-tick / memory)
    return lfilter([share], [1.0, share - 1.0], u)


def _deepest_yet(u: Array) -> Array:
    """The largest value since the contact began."""
    found = np.zeros(len(u))
    for contact in stretches(u > 0.0):
        found[contact] = np.maximum.accumulate(u[contact])
    return found


def _last(turns: Array) -> Array:
    """The side of the last contact, -1 or 1; 0 before the first."""
    touched = np.where(turns != 0.0, np.arange(len(turns)), -1)
    last = np.maximum.accumulate(touched)
    return np.where(last >= 0, np.sign(turns[last]), 0.0)


def _sensed(shapes: Array, p: Array, tick: float) -> Array:
    """Shapes behind the sensor's delay and filter."""
    n = shapes.shape[1]
    if not len(shapes):
        return shapes
    since = np.arange(n) - max(float(p[Calibrated.SENSOR_DELAY]), 0.0) / tick
    behind = np.array([np.interp(since, np.arange(n), one) for one in shapes])
    if p[Calibrated.SENSOR_CUTOFF] > 0.0:
        share = 1.0 - math.exp(-tick * p[Calibrated.SENSOR_CUTOFF])
        behind = lfilter([share], [1.0, share - 1.0], behind, axis=1)
    return behind
