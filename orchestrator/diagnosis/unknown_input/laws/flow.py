"""Laws of flow and heat."""

from __future__ import annotations

import math

from .law import Law, Number


def _root(t, s, n, z, out):
    out[0] = n[0] * math.copysign(math.sqrt(abs(s[0])), s[0])


def _overflow(t, s, n, z, out):
    out[0] = n[0] * max(s[0] - n[1], 0.0)


def _radiation(t, s, n, z, out):
    out[0] = n[0] * 5.670374419e-8 * s[0] ** 4


def _loss(t, s, n, z, out):
    out[0] = n[0] * (s[0] - n[1])


_LEVELS = (1.0, 1.5, 2.0, 3.0)
LAWS = [
    Law(
        "root of the signal",
        "root",
        (Number("factor", "w/u^0.5"),),
        _root,
        "any",
        kinds=(1, 2),
        at="flow",
        modelica="y = factor*sign(u)*sqrt(abs(u));",
        sentence="Outflow under a level or a pressure.",
    ),
    Law(
        "overflow",
        "overflow",
        (Number("factor", "w/u", (-0.3,), "rate"), Number("level", "u", _LEVELS)),
        _overflow,
        "any",
        kinds=(2,),
        at="flow",
        linear=False,
        modelica="y = factor*max(u - level, 0);",
        sentence="What leaves above a level.",
    ),
    Law(
        "loss",
        "loss",
        (Number("factor", "w/u"), Number("surroundings", "u", (0.0, 1.0))),
        _loss,
        "any",
        kinds=(1, 2),
        at="flow",
        modelica="y = factor*(u - surroundings);",
        sentence="A leak, or heat that goes to the surroundings.",
    ),
    Law(
        "radiation",
        "radiation",
        (Number("factor", "w/u4"),),
        _radiation,
        "temperature",
        kinds=(1, 2),
        at="flow",
        modelica="y = factor*5.670374419e-8*u^4;",
        sentence="Heat radiated by a hot body.",
    ),
]
