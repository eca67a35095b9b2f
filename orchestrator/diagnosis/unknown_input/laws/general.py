"""Laws of any domain."""

from __future__ import annotations

from .law import Law, Number


def _offset(t, s, n, z, out):
    out[0] = n[0]


def _gain(t, s, n, z, out):
    out[0] = n[0] * s[0]


def _drift_of_gain(t, s, n, z, out):
    out[0] = n[0] * t * s[0]


def _drift(t, s, n, z, out):
    out[0] = n[0] * t


LAWS = [
    Law(
        "offset",
        "offset",
        (Number("value", "w"),),
        _offset,
        "own",
        modelica="y = value_;",
        sentence="A zero that is off.",
        odds=0.1,
    ),
    Law(
        "gain",
        "gain",
        (Number("change", "1"),),
        _gain,
        "own",
        kinds=(1, 3),
        modelica="y = change*u;",
        sentence="A gain that is off.",
        odds=0.1,
    ),
    Law(
        "gain that drifts",
        "drift",
        (Number("change per time", "1/s"),),
        _drift_of_gain,
        "own",
        kinds=(1, 3),
        modelica="y = change_per_time*time*u;",
        sentence="A gain that changes with time, as with temperature or wear.",
    ),
    Law(
        "drift",
        "drift",
        (Number("change per time", "w/s"),),
        _drift,
        "own",
        modelica="y = change_per_time*time;",
        sentence="A zero that moves with time.",
    ),
]
