"""Any domain."""

from __future__ import annotations

import math

from .law import Law, Number


def _offset(t, s, n, z, out):
    out[0] = n[0]


def _gain(t, s, n, z, out):
    out[0] = n[0] * s[0]


def _drift_of_gain(t, s, n, z, out):
    out[0] = n[0] * t * s[0]


def _drift(t, s, n, z, out):
    out[0] = n[0] * t


def _step(t, s, n, z, out):
    out[0] = n[0] * min(max((t - n[1]) / s[2] + 0.5, 0.0), 1.0)


def _gain_step(t, s, n, z, out):
    out[0] = n[0] * s[0] * min(max((t - n[1]) / s[2] + 0.5, 0.0), 1.0)


def _hum(t, s, n, z, out):
    out[0] = n[0] * math.sin(n[1] * t + n[2])


def _with_temperature(t, s, n, z, out):
    out[0] = n[0] * s[0] * (s[1] - n[1])


_TIME = Number("time", "s", (0.25, 0.5, 0.75), "run")
LAWS = [
    Law(
        "offset",
        "offset",
        (Number("value", "w"),),
        _offset,
        "own",
        modelica="y = value_;",
        sentence="A zero that is off.",
        unlogged=0.1,
        odds=0.3,
    ),
    Law(
        "gain",
        "gain",
        # To take a signal away is no error of a gain: it brings simulations that lose the logs near them.
        (Number("change", "1", limits=(-0.9, 10.0)),),
        _gain,
        "own",
        kinds=(1, 3),
        modelica="y = change*u;",
        sentence="A gain that is off.",
        unlogged=0.1,
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
        unlogged=0.1,
    ),
    Law(
        "drift",
        "drift",
        (Number("change per time", "w/s"),),
        _drift,
        "own",
        modelica="y = change_per_time*time;",
        sentence="A zero that moves with time.",
        unlogged=0.1,
        odds=0.3,
    ),
    Law(
        "step at a time",
        "step",
        (Number("step", "w"), _TIME),
        _step,
        "own",
        modelica="y = step*min(max((time - time_)/interval + 0.5, 0), 1);",
        sentence="A zero that jumps: something touches, slips or is switched on.",
        unlogged=0.1,
        odds=0.3,
        rare=True,
    ),
    Law(
        "gain that jumps",
        "step",
        (Number("change", "1"), _TIME),
        _gain_step,
        "own",
        kinds=(1, 3),
        modelica="y = change*u*min(max((time - time_)/interval + 0.5, 0), 1);",
        sentence="A gain that changes at once: a part breaks or a range is switched.",
        unlogged=0.1,
        odds=0.3,
        rare=True,
    ),
    Law(
        "hum",
        "periodic disturbance",
        (Number("level", "w"), Number("frequency", "rad/s", by="tone"),
         Number("phase", "rad", (0.0, 1.5708), "one")),
        _hum,
        "own",
        modelica="y = level*sin(frequency*time + phase);",
        sentence="Mains, a motor or a fan that is heard, with the same phase in all runs.",
        unlogged=0.1,
        odds=0.3,
        rare=True,
    ),
    Law(
        "gain with temperature",
        "gain with temperature",
        (Number("change", "1/v"), Number("reference", "v", (0.0,), "second range")),
        _with_temperature,
        "own",
        kinds=(1, 3),
        second="temperature",
        modelica="y = change*u*(v - reference);",
        sentence="A gain that changes with a temperature.",
        unlogged=0.1,
        rare=True,
    ),
]  # fmt: skip
