"""Mechanics with memory.

Hysteresis, backlash, relaxation, and masses on springs.
"""

from __future__ import annotations

import math

from .law import Law, Number


def _dahl(t, s, n, z, out):
    # A rate of no more than two slides an interval keeps short travels stable.
    rate = min(abs(s[0]) / (abs(n[1]) + 1e-300), 2.0 / s[2])
    out[0] = n[0] * z[0]
    out[1] = rate * (math.copysign(1.0, s[0]) - z[0])


def _lugre(t, s, n, z, out):
    rate = min(abs(s[0]) / (abs(n[1]) + 1e-300), 2.0 / s[2])
    level = 1.0 + 0.5 * math.exp(-((s[0] / (abs(n[2]) + 1e-300)) ** 2))
    out[0] = n[0] * z[0]
    out[1] = rate * (math.copysign(1.0, s[0]) - z[0] / level)


def _presliding(t, s, n, z, out):
    out[0] = z[0] - s[0]
    out[1] = min(abs(s[1]) / (abs(n[0]) + 1e-300), 2.0 / s[2]) * (s[0] - z[0])


def _bouc_wen(t, s, n, z, out):
    rate = min(abs(s[0]) / (abs(n[1]) + 1e-300), 2.0 / s[2])
    sign = math.copysign(1.0, s[0])
    size = (z[0] * z[0] + 1e-12) ** (0.5 * min(max(n[2], 0.2), 10.0))
    out[0] = n[0] * z[0]
    out[1] = rate * (sign - 0.5 * (sign + math.copysign(1.0, z[0])) * size)


def _hardening(t, s, n, z, out):
    rate = min(abs(s[0]) / (abs(n[1]) + 1e-300), 2.0 / s[2])
    sign = math.copysign(1.0, s[0])
    share = min(max(n[2], -2.0), 0.5)
    out[0] = n[0] * z[0]
    out[1] = rate * (sign - 0.5 * z[0] - share * sign * abs(z[0]))


def _slip(t, s, n, z, out):
    # The state is where the slider rests. It follows within half an interval, which w does not see.
    limit = abs(n[1]) + 1e-300
    spring = min(max(s[0] - z[0], -limit), limit)
    out[0] = n[0] * spring / limit
    out[1] = (s[0] - z[0] - spring) / (0.5 * s[2])


def _backlash(t, s, n, z, out):
    free = min(max(s[0] - z[0], -abs(n[0])), abs(n[0]))
    out[0] = -free
    out[1] = (s[0] - z[0] - free) / (0.5 * s[2])


def _relaxation(t, s, n, z, out):
    out[0] = n[0] * (s[0] - z[0])
    out[1] = (s[0] - z[0]) / max(abs(n[1]), 0.1 * s[2])


def _flexible(t, s, n, z, out):
    # z: travel of the mass on its spring, and its speed.
    frequency = min(abs(n[1]), 6.0 / s[2])
    pull = frequency * frequency * z[0] + 2.0 * abs(n[2]) * frequency * (z[1] - s[0])
    out[0] = n[0] * pull
    out[1] = z[1] - s[0]
    out[2] = -pull


def _added_mass(t, s, n, z, out):
    rate = (s[0] - z[0]) / (0.5 * s[2])
    out[0] = n[0] * rate
    out[1] = rate


_TRAVEL = Number("travel", "u.s", (3.0, 30.0), "step", positive=True)
_LEVEL = Number("level", "w")
_RATE = "der(z1) = min(abs(u)/travel, 2/interval)*"
LAWS = [
    Law(
        "Dahl friction",
        "dry friction",
        (_LEVEL, _TRAVEL),
        _dahl,
        "rate",
        1,
        at="force",
        modelica=f"y = level*z1; {_RATE}(sign(u) - z1);",
        sentence="Dry friction that builds up over a short travel, as in ball bearings.",
        rare=True,
    ),
    Law(
        "LuGre friction",
        "dry friction",
        (_LEVEL, Number("travel", "u.s", (5.0,), "step", positive=True),
         Number("speed", "u", (0.2,), positive=True)),
        _lugre,
        "rate",
        1,
        at="force",
        modelica=f"y = level*z1; {_RATE}(sign(u) - z1/(1 + 0.5*exp(-(u/speed)^2)));",
        sentence="Friction that builds up over a short travel and is half as large again at rest.",
        rare=True,
    ),
    Law(
        "presliding",
        "dry friction",
        (Number("travel", "v.s", (10.0, 100.0), "second step", positive=True),),
        _presliding,
        "own",
        1,
        kinds=(1, 3),
        at="force",
        second="rate",
        linear=False,
        settled=(0,),
        modelica="y = z1 - u; der(z1) = min(abs(v)/travel, 2/interval)*(u - z1);",
        sentence="The model's friction, built up over a travel after each reversal by elastic parts.",
        rare=True,
    ),
    Law(
        "Bouc-Wen hysteresis",
        "hysteresis",
        (_LEVEL, Number("travel", "u.s", (10.0, 100.0), "step", positive=True),
         Number("exponent", "1", (1.5,), "one")),
        _bouc_wen,
        "rate",
        1,
        at="force",
        modelica=(
            f"y = level*z1; {_RATE}"
            "(sign(u) - 0.5*(sign(u) + sign(z1))*(z1^2 + 1e-12)^(0.5*min(max(exponent, 0.2), 10)));"
        ),
        sentence="A force with a loop, as of wire ropes, magnetic dampers and joints of steel.",
        rare=True,
    ),
    Law(
        "hardening hysteresis",
        "hysteresis",
        (_LEVEL, _TRAVEL, Number("share", "1", (-0.5,), "one")),
        _hardening,
        "rate",
        1,
        at="force",
        modelica=f"y = level*z1; {_RATE}(sign(u) - 0.5*z1 - min(max(share, -2), 0.5)*sign(u)*abs(z1));",
        sentence="A force with a loop that does not level off, as of a Bouc-Wen model that hardens.",
        rare=True,
    ),
    Law(
        "slip of a spring",
        "hysteresis",
        (_LEVEL, Number("travel", "u", (0.1, 0.4), positive=True)),
        _slip,
        "travel",
        1,
        at="force",
        settled=(0,),
        modelica=(
            "y = level*min(max(u - z1, -travel), travel)/travel; "
            "der(z1) = (u - z1 - min(max(u - z1, -travel), travel))/(0.5*interval);"
        ),
        sentence="A spring that slips at a level of force, one element of the Maxwell slip model.",
        rare=True,
    ),
    Law(
        "backlash",
        "play",
        (Number("half width", "u", (0.01, 0.15), positive=True),),
        _backlash,
        "own",
        1,
        (1, 3),
        settled=(0,),
        linear=False,
        modelica=(
            "y = -min(max(u - z1, -half_width), half_width); "
            "der(z1) = (u - z1 - min(max(u - z1, -half_width), half_width))/(0.5*interval);"
        ),
        sentence="Play with memory: after a turn the output rests until the play is crossed.",
        rare=True,
    ),
    Law(
        "relaxation",
        "relaxation",
        (Number("stiffness", "w/u"), Number("time constant", "s", (10.0, 60.0), "interval", positive=True)),
        _relaxation,
        "travel",
        1,
        at="force",
        settled=(0,),
        modelica="y = stiffness*(u - z1); der(z1) = (u - z1)/time_constant;",
        sentence="A stiffness that yields with time, as of rubber.",
        rare=True,
    ),
    Law(
        "flexible mode",
        "resonance",
        (Number("mass", "w.s/u"), Number("frequency", "rad/s", (0.03, 0.08, 0.2, 0.5), "rate", positive=True),
         Number("damping ratio", "1", (0.03,), "one", positive=True)),
        _flexible,
        "rate",
        2,
        at="force",
        settled=(1,),
        modelica=(
            "y = mass*(frequency^2*z1 + 2*damping_ratio*frequency*(z2 - u)); der(z1) = z2 - u; "
            "der(z2) = -frequency^2*z1 - 2*damping_ratio*frequency*(z2 - u);"
        ),
        sentence="A part that swings on the body: a mast, a cable, an arm that bends.",
        rare=True,
    ),
    Law(
        "added mass",
        "added mass",
        (Number("mass", "w.s/u"),),
        _added_mass,
        "rate",
        1,
        at="force",
        settled=(0,),
        modelica="y = mass*der(z1); der(z1) = (u - z1)/(0.5*interval);",
        sentence="A mass that moves along, as water around a hull.",
        rare=True,
    ),
]  # fmt: skip
