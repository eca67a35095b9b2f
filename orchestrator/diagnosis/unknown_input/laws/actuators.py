"""Actuators and drives.

Most act on the signal at the place itself.
"""

from __future__ import annotations

import math

from .law import Law, Number


def _saturation(t, s, n, z, out):
    limit = abs(n[0])
    out[0] = min(max(s[0], -limit), limit) - s[0]


def _dead_zone(t, s, n, z, out):
    out[0] = -min(max(s[0], -abs(n[0])), abs(n[0]))


def _quantisation(t, s, n, z, out):
    step = abs(n[0]) + 1e-300
    out[0] = step * math.floor(s[0] / step + 0.5) - s[0]


def _gain_curve(t, s, n, z, out):
    out[0] = n[0] * s[0] * abs(s[0])


def _above(t, s, n, z, out):
    out[0] = n[0] * max(s[0] - n[1], 0.0)


def _below(t, s, n, z, out):
    out[0] = n[0] * min(s[0] - n[1], 0.0)


def _lag(t, s, n, z, out):
    out[0] = z[0] - s[0]
    out[1] = (s[0] - z[0]) / max(abs(n[0]), 0.1 * s[2])


def _delay(t, s, n, z, out):
    # For filters: Pade of order 2; at rest the first state is the signal.
    time = max(abs(n[0]), 0.35 * s[2])
    out[0] = -time * z[1]
    out[1] = z[1]
    out[2] = 12.0 / (time * time) * (s[0] - z[0]) - 6.0 / time * z[1]


def _hold(t, s, n, z, out):
    # For filters: the mean delay, as above.
    time = max(0.5 * abs(n[0]), 0.35 * s[2])
    out[0] = -time * z[1]
    out[1] = z[1]
    out[2] = 12.0 / (time * time) * (s[0] - z[0]) - 6.0 / time * z[1]


def _resonance(t, s, n, z, out):
    frequency = min(abs(n[0]), 6.0 / s[2])
    out[0] = z[0] - s[0]
    out[1] = z[1]
    out[2] = frequency * frequency * (s[0] - z[0]) - 2.0 * abs(n[1]) * frequency * z[1]


def _rate_limit(t, s, n, z, out):
    # Within the limit the state is half an interval behind, which w makes up for.
    step = 0.5 * s[2]
    moved = min(max(s[0] - z[0], -abs(n[0]) * step), abs(n[0]) * step)
    out[0] = z[0] + moved - s[0]
    out[1] = moved / step


def _power_limit(t, s, n, z, out):
    power = abs(s[0] * s[1])
    out[0] = s[0] * (abs(n[0]) / power - 1.0) if power > abs(n[0]) else 0.0


def _power_curve(t, s, n, z, out):
    pivot = abs(n[0]) + 1e-300
    exponent = min(max(n[1], 0.1), 5.0)
    out[0] = math.copysign(pivot * (abs(s[0]) / pivot + 1e-12) ** exponent, s[0]) - s[0]


def _cogging(t, s, n, z, out):
    out[0] = n[0] * math.sin(n[1] * s[0] + n[2])


_OWN = "own"
# Of a slower clock, in intervals of the logs. A fit stays near its begin.
_PERIODS = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
# A step is found where the number of levels, from 0 to the largest signal, is right within a quarter.
_LEVELS = tuple(4.0 / k for k in range(4, 65))
_LEVEL = Number("level", "u", (0.3, 0.5, 0.7), "range", within=True)
LAWS = [
    Law(
        "saturation",
        "saturation",
        (Number("limit", "u", (0.5, 0.7, 0.9), "most", positive=True),),
        _saturation,
        _OWN,
        kinds=(1, 3),
        linear=False,
        modelica="y = min(max(u, -limit), limit) - u;",
        sentence="A limit of force, power or voltage.",
    ),
    Law(
        "dead zone",
        "dead zone",
        (Number("half width", "u", (0.05, 0.2, 0.6), positive=True, within=True),),
        _dead_zone,
        _OWN,
        kinds=(1, 3),
        linear=False,
        modelica="y = -min(max(u, -half_width), half_width);",
        sentence="A valve or drive that does not answer small commands.",
    ),
    Law(
        "quantisation",
        "quantisation",
        (Number("step", "u", _LEVELS, "most", positive=True, scanned=0.01),),
        _quantisation,
        _OWN,
        kinds=(1, 3),
        linear=False,
        modelica="y = step*floor(u/step + 0.5) - u;",
        sentence="A converter, a stepper or a valve of few levels; up to 16 are found.",
        rare=True,
    ),
    Law(
        "gain curve",
        "gain curve",
        (Number("factor", "w/u2"),),
        _gain_curve,
        _OWN,
        kinds=(1, 3),
        modelica="y = factor*u*abs(u);",
        sentence="A gain that changes with the command.",
        odds=0.5,
    ),
    Law(
        "gain above a level",
        "gain curve",
        (Number("factor", "w/u"), _LEVEL),
        _above,
        _OWN,
        kinds=(1, 3),
        modelica="y = factor*max(u - level, 0);",
        sentence="A limit on one side, hard or soft, as of a diode or of a drive that pushes less.",
        odds=0.5,
        rare=True,
    ),
    Law(
        "gain below a level",
        "gain curve",
        (Number("factor", "w/u"), _LEVEL),
        _below,
        _OWN,
        kinds=(1, 3),
        modelica="y = factor*min(u - level, 0);",
        sentence="The same below a level; with a factor of -2 below 0, a sensor that does not see the sign.",
        odds=0.5,
        rare=True,
    ),
    Law(
        "lag",
        "lag",
        (Number("time constant", "s", (0.5, 2.0, 6.0, 16.0), "interval", positive=True),),
        _lag,
        _OWN,
        1,
        (1, 3),
        linear=False,
        settled=(0,),
        modelica="y = z1 - u; der(z1) = (u - z1)/time_constant;",
        sentence="A first-order lag, as of a sensor, an amplifier or a dead volume.",
        unlogged=0.1,
    ),
    Law(
        "delay",
        "lag",
        (Number("time", "s", (0.5, 2.0, 6.0, 16.0), "interval", positive=True),),
        _delay,
        _OWN,
        2,
        (1, 3),
        linear=False,
        settled=(0,),
        modelica="y = delay(u, time_) - u;",
        delay="fixed",
        sentence="A transport or computing delay.",
        unlogged=0.1,
    ),
    Law(
        "hold",
        "hold",
        (Number("period", "s", _PERIODS, "interval", positive=True),
         Number("share", "1", (0.0, 0.25, 0.5, 0.75), "one")),
        _hold,
        _OWN,
        2,
        (1, 3),
        linear=False,
        settled=(0,),
        modelica="when sample((share - floor(share))*period, period) then z1 = u; end when; y = z1 - u;",
        delay="held",
        sentence="A slower clock: a link or a computer that takes every n-th sample, and holds it.",
        unlogged=0.0,
        odds=0.3,
    ),
    Law(
        "resonance",
        "lag",
        (Number("frequency", "rad/s", (0.05, 0.3), "rate", positive=True),
         Number("damping ratio", "1", (0.4,), "one", positive=True)),
        _resonance,
        _OWN,
        2,
        (1, 3),
        settled=(0,),
        linear=False,
        modelica=(
            "y = z1 - u; der(z1) = z2; der(z2) = frequency^2*(u - z1) - 2*damping_ratio*frequency*z2;"
        ),
        sentence="A drive or filter of second order that swings.",
        unlogged=0.1,
        rare=True,
    ),
    Law(
        "rate limit",
        "rate limit",
        (Number("rate", "u/s", (0.5, 2.0), "slope", positive=True),),
        _rate_limit,
        _OWN,
        1,
        (1, 3),
        settled=(0,),
        linear=False,
        modelica=(
            "y = z1 + min(max(u - z1, -0.5*rate*interval), 0.5*rate*interval) - u; "
            "der(z1) = min(max(2*(u - z1)/interval, -rate), rate);"
        ),
        sentence="A valve or drive that moves no faster.",
        rare=True,
    ),
    Law(
        "power limit",
        "saturation",
        (Number("power", "u.v", (1.0, 3.0), "product", positive=True),),
        _power_limit,
        _OWN,
        kinds=(1, 3),
        at="force",
        second="rate",
        linear=False,
        modelica="y = u*(min(1, power/max(abs(u*v), 1e-12)) - 1);",
        sentence="A drive whose force falls with speed at its largest power.",
        rare=True,
    ),
    Law(
        "power curve",
        "gain curve",
        (Number("pivot", "u", (1.0,), "most", positive=True), Number("exponent", "1", (0.5, 2.0), "one")),
        _power_curve,
        _OWN,
        kinds=(1, 3),
        linear=False,
        modelica="y = sign(u)*pivot*(abs(u)/pivot + 1e-12)^min(max(exponent, 0.1), 5) - u;",
        sentence="Thrust or torque as a power of the command, as of a propeller.",
    ),
    Law(
        "cogging",
        "ripple",
        (Number("level", "w"), Number("periods a turn", "1", (2.0, 4.0, 6.0, 8.0, 12.0, 24.0), "one"),
         Number("phase", "rad", (0.0, 1.5708), "one")),
        _cogging,
        "angle",
        at="force",
        modelica="y = level*sin(periods_a_turn*u + phase);",
        sentence="A motor's magnets that pull to some angles, or a gear's teeth.",
        rare=True,
    ),
]  # fmt: skip
