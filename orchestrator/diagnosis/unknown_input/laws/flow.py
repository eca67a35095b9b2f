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


_LEVELS = "any"
LAWS = [
    Law("root of the signal", "root", (Number("factor", "w/s^0.5"),), _root, _LEVELS, kinds=(1, 2),
        sentence="Outflow under a level or a pressure."),
    Law("overflow", "overflow", (Number("factor", "w/s"), Number("level", "s", (2.0, 3.0))), _overflow,
        _LEVELS, kinds=(2,), sentence="What leaves above a level."),
]  # fmt: skip
