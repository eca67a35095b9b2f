"""Electrical circuits and motors."""

from __future__ import annotations

import math

from .law import Law, Number


def _back_emf(t, s, n, z, out):
    out[0] = n[0] * s[0]


def _diode(t, s, n, z, out):
    out[0] = max(s[0] - abs(n[0]), 0.0) - s[0]


def _brush(t, s, n, z, out):
    out[0] = n[0] * math.tanh(s[0] / (abs(n[1]) + 1e-300))


def _iron(t, s, n, z, out):
    limit = abs(n[0]) + 1e-300
    out[0] = limit * math.tanh(s[0] / limit) - s[0]


def _warm(t, s, n, z, out):
    out[0] = n[0] * s[0] * (s[1] - n[1])


def _self_heating(t, s, n, z, out):
    out[0] = n[0] * s[0] * z[0]
    out[1] = (s[0] * s[0] - z[0]) / max(abs(n[1]), 0.1 * s[2])


LAWS = [
    Law(
        "back-EMF",
        "back-EMF",
        (Number("factor", "w/u"),),
        _back_emf,
        "rate",
        at="electric",
        modelica="y = factor*u;",
        sentence="The voltage that a turning motor induces.",
        rare=True,
    ),
    Law(
        "diode",
        "one way",
        (Number("drop", "u", (0.05, 0.5), positive=True),),
        _diode,
        "own",
        kinds=(1, 3),
        at="electric",
        linear=False,
        modelica="y = max(u - drop, 0) - u;",
        sentence="A diode: one direction, less its forward voltage.",
        rare=True,
    ),
    Law(
        "brush drop",
        "voltage drop",
        (Number("drop", "w"), Number("corner", "u", (0.05,), most=0.5, positive=True)),
        _brush,
        "current",
        at="electric",
        modelica="y = drop*tanh(u/corner);",
        sentence="A voltage lost at any current, as at brushes or semiconductors.",
        rare=True,
    ),
    Law(
        "smooth saturation",
        "saturation",
        (Number("limit", "u", (0.9,), "most", positive=True),),
        _iron,
        "own",
        kinds=(1, 3),
        linear=False,
        modelica="y = limit*tanh(u/limit) - u;",
        sentence="A limit that is approached smoothly: the force of a tyre, the flux of iron.",
        rare=True,
    ),
    Law(
        "resistance with temperature",
        "gain with temperature",
        (Number("factor", "w/(u.v)"), Number("reference", "v", (0.0,), "second range")),
        _warm,
        "current",
        at="electric",
        second="temperature",
        modelica="y = factor*u*(v - reference);",
        sentence="A winding's resistance, which grows with its temperature.",
        rare=True,
    ),
    Law(
        "self-heating",
        "gain with temperature",
        (Number("factor", "w/u3"), Number("time constant", "s", (0.3,), "run", positive=True)),
        _self_heating,
        "current",
        1,
        at="electric",
        modelica="y = factor*u*z1; der(z1) = (u^2 - z1)/time_constant;",
        sentence="A resistance that grows as its own current heats it.",
        rare=True,
    ),
]
