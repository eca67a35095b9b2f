"""Friction and stiffness."""

from __future__ import annotations

import math

from .law import Law, Number


def _coulomb(t, s, n, z, out):
    out[0] = n[0] * math.tanh(s[0] / (abs(n[1]) + 1e-12))


def _viscous(t, s, n, z, out):
    out[0] = n[0] * s[0]


def _quadratic(t, s, n, z, out):
    out[0] = n[0] * s[0] * abs(s[0])


def _power(t, s, n, z, out):
    out[0] = n[0] * math.copysign((s[0] * s[0] + 1e-12) ** (0.5 * n[1]), s[0])


def _one_sided(t, s, n, z, out):
    out[0] = n[0] * max(s[0], 0.0)


def _other_sided(t, s, n, z, out):
    out[0] = n[0] * min(s[0], 0.0)


def _stribeck(t, s, n, z, out):
    more = n[1] * math.exp(-((s[0] / (abs(n[2]) + 1e-12)) ** 2))
    out[0] = n[0] * (1.0 + more) * math.tanh(s[0] / (abs(n[3]) + 1e-12))


def _cubic(t, s, n, z, out):
    out[0] = n[0] * s[0] ** 3


def _progressive(t, s, n, z, out):
    out[0] = n[0] * s[0] * abs(s[0])


def _dead_band(t, s, n, z, out):
    # Within the band the spring gives nothing.
    out[0] = n[0] * min(max(s[0], -abs(n[1])), abs(n[1]))


def _stop(t, s, n, z, out):
    out[0] = n[0] * (max(s[0] - abs(n[1]), 0.0) + min(s[0] + abs(n[1]), 0.0))


def _ripple(t, s, n, z, out):
    out[0] = n[0] * math.sin(s[0] + n[1])


def _eddy(t, s, n, z, out):
    out[0] = n[0] * s[0] / (1.0 + (s[0] / (abs(n[1]) + 1e-12)) ** 2)


def _asymmetric(t, s, n, z, out):
    out[0] = n[0] * s[0] * s[0]


def _imbalance(t, s, n, z, out):
    out[0] = n[0] * s[1] * s[1] * math.sin(s[0] + n[1])


def _between(t, s, n, z, out):
    out[0] = n[0] * math.tanh((s[0] - s[1]) / (abs(n[1]) + 1e-12))


def _with_position(t, s, n, z, out):
    out[0] = n[0] * s[0] * (s[1] - n[1])


_LEVEL = Number("level", "w")
_PHASE = Number("phase", "rad", (0.0, 1.5708), "one")
_CORNER = Number("corner", "u", (0.02, 0.1), most=0.5, positive=True)

LAWS = [
    Law(
        "coulomb",
        "dry friction",
        (_LEVEL, _CORNER),
        _coulomb,
        "rate",
        at="force",
        modelica="y = level*tanh(u/corner);",
        sentence="Dry friction of a guide.",
    ),
    Law(
        "stribeck",
        "dry friction",
        (
            _LEVEL,
            Number("excess", "1", (1.0,), "one"),
            Number("speed", "u", (0.1, 0.4), positive=True),
            _CORNER,
        ),
        _stribeck,
        "rate",
        at="force",
        modelica="y = level*(1 + excess*exp(-(u/speed)^2))*tanh(u/corner);",
        sentence="More friction at low speed, as in lubricated bearings.",
    ),
    Law(
        "viscous",
        "viscous friction",
        (Number("factor", "w/u"),),
        _viscous,
        "rate",
        at="force",
        modelica="y = factor*u;",
        sentence="Friction in proportion to the speed.",
    ),
    Law(
        "eddy-current brake",
        "viscous friction",
        (Number("factor", "w/u"), Number("speed", "u", (1.0, 3.0), positive=True)),
        _eddy,
        "rate",
        at="force",
        modelica="y = factor*u/(1 + (u/speed)^2);",
        sentence="A brake of eddy currents, weaker above a critical speed.",
    ),
    Law(
        "quadratic drag",
        "drag",
        (Number("factor", "w/u2"),),
        _quadratic,
        "rate",
        at="force",
        modelica="y = factor*u*abs(u);",
        sentence="Drag in air or water.",
    ),
    Law(
        "power drag",
        "drag",
        # Dampers with fluid have exponents down to 0.15; below, it is dry friction.
        (Number("factor", "w/u^n"), Number("exponent", "1", (1.4,), "one", limits=(0.15, 4.0))),
        _power,
        "rate",
        at="force",
        modelica="y = factor*sign(u)*(u^2 + 1e-12)^(exponent/2);",
        sentence="Drag with a free exponent.",
    ),
    Law(
        "one-sided damping",
        "one-sided damping",
        (Number("factor", "w/u"),),
        _one_sided,
        "rate",
        at="force",
        modelica="y = factor*max(u, 0);",
        sentence="A damper that is stronger one way.",
    ),
    Law(
        "one-sided damping, backward",
        "one-sided damping",
        (Number("factor", "w/u"),),
        _other_sided,
        "rate",
        at="force",
        modelica="y = factor*min(u, 0);",
        sentence="A damper that is stronger or weaker at negative speed.",
    ),
    Law(
        "cubic stiffness",
        "stiffness",
        (Number("factor", "w/u3"),),
        _cubic,
        "travel",
        at="force",
        modelica="y = factor*u^3;",
        sentence="A spring that grows stiffer with the square of its travel.",
    ),
    Law(
        "progressive stiffness",
        "stiffness",
        (Number("factor", "w/u2"),),
        _progressive,
        "travel",
        at="force",
        modelica="y = factor*u*abs(u);",
        sentence="A spring that grows stiffer with its travel.",
    ),
    Law(
        "dead band",
        "play",
        (Number("stiffness", "w/u"), Number("band", "u", (0.1, 0.3, 0.8), positive=True)),
        _dead_band,
        "travel",
        at="force",
        modelica="y = stiffness*min(max(u, -band), band);",
        sentence="Play: within the band the spring is slack.",
    ),
    Law(
        "stop",
        "stiffness",
        (Number("stiffness", "w/u"), Number("travel", "u", (0.5, 0.8), "most", positive=True)),
        _stop,
        "travel",
        at="force",
        modelica="y = stiffness*(max(u - travel, 0) + min(u + travel, 0));",
        sentence="An end stop.",
    ),
    Law(
        "ripple",
        "ripple",
        (_LEVEL, _PHASE),
        _ripple,
        "angle",
        at="force",
        modelica="y = level*sin(u + phase);",
        sentence="Imbalance, or gravity on an axis that is not vertical.",
        covers=2.0,
    ),
    Law(
        "preload",
        "play",
        (_LEVEL, _CORNER),
        _coulomb,
        "travel",
        at="force",
        modelica="y = level*tanh(u/corner);",
        sentence="A spring under load at its middle, which lets go only above a force.",
        rare=True,
    ),
    Law(
        "asymmetric stiffness",
        "stiffness",
        (Number("factor", "w/u2"),),
        _asymmetric,
        "travel",
        at="force",
        modelica="y = factor*u^2;",
        sentence="A spring that is stiffer one way, as of a loudspeaker.",
        rare=True,
    ),
    Law(
        "imbalance",
        "ripple",
        (Number("level", "w/v2"), _PHASE),
        _imbalance,
        "angle",
        at="force",
        second="rate",
        modelica="y = level*v^2*sin(u + phase);",
        sentence="A centrifugal force, which grows with the square of the speed.",
        covers=2.0,
        rare=True,
    ),
    Law(
        "friction with position",
        "viscous friction",
        (Number("factor", "w/(u.v)"), Number("reference", "v", (0.0,), "second range")),
        _with_position,
        "rate",
        at="force",
        second="travel",
        modelica="y = factor*u*(v - reference);",
        sentence="A guide that is tighter at one end.",
        rare=True,
    ),
    Law(
        "friction with temperature",
        "viscous friction",
        (Number("factor", "w/(u.v)"), Number("reference", "v", (0.0,), "second range")),
        _with_position,
        "rate",
        at="force",
        second="temperature",
        modelica="y = factor*u*(v - reference);",
        sentence="Oil that is thinner when warm.",
        rare=True,
    ),
    Law(
        "dry friction between two parts",
        "exchange",
        (_LEVEL, _CORNER),
        _between,
        "rate",
        kinds=(4,),
        at="force",
        second="any",
        modelica="y = level*tanh((u - v)/corner);",
        sentence="Dry friction from one moving part to another, as of a clutch.",
    ),
]
