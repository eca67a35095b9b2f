"""Sensors.

Offset, gain, drift, lag, delay, play and saturation act at outputs as anywhere else.
"""

from __future__ import annotations

import math

from .law import Law, Number


def _cross_talk(t, s, n, z, out):
    out[0] = n[0] * s[0]


def _curved(t, s, n, z, out):
    out[0] = n[0] * s[0] * s[0]


def _eccentric(t, s, n, z, out):
    out[0] = n[0] * math.sin(s[0] + n[1])


_SENSOR = (3,)
LAWS = [
    Law(
        "cross-talk",
        "cross-talk",
        (Number("share", "w/u"),),
        _cross_talk,
        "other",
        kinds=_SENSOR,
        modelica="y = share*u;",
        sentence="A sensor that shows a share of another signal, as if misaligned.",
        odds=0.3,
        rare=True,
    ),
    Law(
        "curved scale",
        "gain curve",
        (Number("factor", "w/u2"),),
        _curved,
        "own",
        kinds=_SENSOR,
        modelica="y = factor*u^2;",
        sentence="A sensor whose gain changes along its range.",
        rare=True,
    ),
    Law(
        "eccentric scale",
        "ripple",
        (Number("level", "w"), Number("phase", "rad", (0.0, 1.5708), "one")),
        _eccentric,
        "angle",
        kinds=_SENSOR,
        modelica="y = level*sin(u + phase);",
        sentence="An encoder whose disc is not centred.",
        covers=2.0,
        rare=True,
    ),
]
