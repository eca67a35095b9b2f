"""Laws of friction and stiffness."""

from __future__ import annotations

import math

from .law import Law, Number


def _coulomb(t, s, n, z, out):
    out[0] = n[0] * math.tanh(s[0] / n[1])


def _viscous(t, s, n, z, out):
    out[0] = n[0] * s[0]


def _quadratic(t, s, n, z, out):
    out[0] = n[0] * s[0] * abs(s[0])


def _power(t, s, n, z, out):
    out[0] = n[0] * math.copysign((s[0] * s[0] + 1e-12) ** (0.5 * n[1]), s[0])


def _one_sided(t, s, n, z, out):
    out[0] = n[0] * max(s[0], 0.0)


def _stribeck(t, s, n, z, out):
    out[0] = n[0] * math.tanh(s[0] / (0.1 * n[1])) * math.exp(-((s[0] / n[1]) ** 2))


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
    out[0] = n[0] * math.sin(s[0]) + n[1] * math.cos(s[0])


_LEVEL = Number("level", "w")
_CORNER = Number("corner", "s", (0.02, 0.1))

LAWS = [
    Law("coulomb", "dry friction", (_LEVEL, _CORNER), _coulomb, "rate", sentence="Dry friction of a guide."),
    Law("stribeck", "dry friction", (_LEVEL, Number("speed", "s", (0.1, 0.4))), _stribeck, "rate",
        sentence="More friction at low speed, as in lubricated bearings."),
    Law("viscous", "viscous friction", (Number("factor", "w/s"),), _viscous, "rate",
        sentence="Friction in proportion to the speed."),
    Law("quadratic drag", "drag", (Number("factor", "w/s2"),), _quadratic, "rate",
        sentence="Drag in air or water."),
    Law("power drag", "drag", (Number("factor", "w/s^n"), Number("exponent", "1", (1.4,), relative=False)),
        _power, "rate", sentence="Drag with a free exponent."),
    Law("one-sided damping", "one-sided damping", (Number("factor", "w/s"),), _one_sided, "rate",
        sentence="A damper that is stronger one way."),
    Law("cubic stiffness", "stiffness", (Number("factor", "w/s3"),), _cubic, "travel",
        sentence="A spring that grows stiffer with the square of its travel."),
    Law("progressive stiffness", "stiffness", (Number("factor", "w/s2"),), _progressive, "travel",
        sentence="A spring that grows stiffer with its travel."),
    Law("dead band", "play", (Number("stiffness", "w/s"), Number("band", "s", (0.1, 0.3, 0.8))), _dead_band,
        "travel", sentence="Play: within the band the spring is slack."),
    Law("stop", "stiffness", (Number("stiffness", "w/s"), Number("travel", "s", (1.0, 2.0))), _stop, "travel",
        sentence="An end stop."),
    Law("ripple", "ripple", (Number("sine", "w"), Number("cosine", "w", (0.0,), relative=False)), _ripple,
        "travel", sentence="Imbalance, or gravity on an axis that is not vertical."),
]  # fmt: skip
