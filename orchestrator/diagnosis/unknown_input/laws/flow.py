"""Flow and heat."""

from __future__ import annotations

import math

from .law import Law, Number


def _root(t, s, n, z, out):
    out[0] = n[0] * math.copysign(math.sqrt(abs(s[0])), s[0])


def _overflow(t, s, n, z, out):
    out[0] = n[0] * max(s[0] - n[1], 0.0)


def _radiation(t, s, n, z, out):
    out[0] = n[0] * 5.670374419e-8 * (s[0] ** 4 - n[1] ** 4)


def _radiation_of_celsius(t, s, n, z, out):
    out[0] = n[0] * 5.670374419e-8 * ((s[0] + 273.15) ** 4 - (n[1] + 273.15) ** 4)


def _loss(t, s, n, z, out):
    out[0] = n[0] * (s[0] - n[1])


def _laminar(t, s, n, z, out):
    out[0] = n[0] * s[0] / (s[0] * s[0] + n[1] * n[1] + 1e-300) ** 0.25


def _check_valve(t, s, n, z, out):
    out[0] = max(s[0] - abs(n[0]), 0.0) - s[0]


def _wall(t, s, n, z, out):
    out[0] = n[0] * (s[0] - z[0])
    out[1] = (s[0] - z[0]) / max(abs(n[1]), 0.1 * s[2])


def _convection(t, s, n, z, out):
    warmer = s[0] - n[1]
    out[0] = n[0] * warmer * (abs(warmer) + 1e-12) ** 0.25


def _exchange(t, s, n, z, out):
    out[0] = n[0] * (s[0] - s[1])


def _exchange_of_root(t, s, n, z, out):
    out[0] = n[0] * math.copysign(math.sqrt(abs(s[0] - s[1])), s[0] - s[1])


def _exchange_of_radiation(t, s, n, z, out):
    out[0] = n[0] * 5.670374419e-8 * (s[0] ** 4 - s[1] ** 4)


def _exchange_of_radiation_of_celsius(t, s, n, z, out):
    out[0] = n[0] * 5.670374419e-8 * ((s[0] + 273.15) ** 4 - (s[1] + 273.15) ** 4)


def _load_pressure(t, s, n, z, out):
    left = 1.0 - math.copysign(s[1], s[0] * s[1]) / (abs(n[0]) + 1e-300)
    out[0] = s[0] * (math.sqrt(max(left, 0.0)) - 1.0)


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
        (Number("factor", "w/u"), Number("level", "u", (0.4, 0.7, 0.9), "range", within=True)),
        _overflow,
        "any",
        kinds=(2,),
        at="flow",
        modelica="y = factor*max(u - level, 0);",
        sentence="What leaves above a level.",
    ),
    Law(
        "loss",
        "loss",
        (Number("factor", "w/u"), Number("surroundings", "u", (-3.0, 0.0), "range")),
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
        (Number("factor", "w.m2/W"), Number("surroundings", "u", (0.0,), "range", positive=True)),
        _radiation,
        "temperature",
        kinds=(1, 2),
        at="flow",
        modelica="y = factor*5.670374419e-8*(u^4 - surroundings^4);",
        sentence="Heat radiated by a hot body.",
        unit="K",
    ),
    Law(
        "radiation from degC",
        "radiation",
        (Number("factor", "w.m2/W"), Number("surroundings", "u", (0.0,), "range")),
        _radiation_of_celsius,
        "temperature",
        kinds=(1, 2),
        at="flow",
        modelica="y = factor*5.670374419e-8*((u + 273.15)^4 - (surroundings + 273.15)^4);",
        sentence="Heat radiated by a hot body.",
        unit="degC",
    ),
    Law(
        "root with a laminar part",
        "root",
        (Number("factor", "w/u^0.5"), Number("transition", "u", (0.3,), positive=True)),
        _laminar,
        "any",
        kinds=(1, 2),
        at="flow",
        modelica="y = factor*u/(u^2 + transition^2 + 1e-300)^0.25;",
        sentence="A flow that is laminar at small pressures and turbulent above.",
        rare=True,
    ),
    Law(
        "check valve",
        "one way",
        (Number("opening", "u", (0.02, 0.3), positive=True),),
        _check_valve,
        "own",
        kinds=(1, 3),
        at="flow",
        linear=False,
        modelica="y = max(u - opening, 0) - u;",
        sentence="A valve that opens one way, above a small pressure.",
        rare=True,
    ),
    Law(
        "heat capacity of a wall",
        "relaxation",
        (Number("factor", "w/u"), Number("time constant", "s", (0.05, 0.4), "run", positive=True)),
        _wall,
        "temperature",
        1,
        kinds=(1, 2),
        at="flow",
        settled=(0,),
        modelica="y = factor*(u - z1); der(z1) = (u - z1)/time_constant;",
        sentence="A wall or an insert that takes heat up and gives it back.",
        rare=True,
    ),
    Law(
        "boiling limit",
        "overflow",
        (Number("factor", "w/u"), Number("limit", "u", (0.75, 0.95), "range", within=True)),
        _overflow,
        "temperature",
        kinds=(2,),
        at="flow",
        modelica="y = factor*max(u - limit, 0);",
        sentence="A temperature that stays where a liquid boils.",
        rare=True,
    ),
    Law(
        "natural convection",
        "loss",
        (Number("factor", "w/u^1.25"), Number("surroundings", "u", (0.0,), "range")),
        _convection,
        "temperature",
        kinds=(1, 2),
        at="flow",
        modelica="y = factor*(u - surroundings)*(abs(u - surroundings) + 1e-12)^0.25;",
        sentence="Heat that warm air takes along by its own draught.",
        rare=True,
    ),
    Law(
        "load pressure",
        "load pressure",
        (Number("supply", "v", (1.2, 4.0), "second", positive=True),),
        _load_pressure,
        "own",
        kinds=(1, 3),
        at="flow",
        second="pressure",
        linear=False,
        modelica="y = u*(sqrt(max(1 - sign(u)*v/supply, 0)) - 1);",
        sentence="A valve's flow, which falls as the load's pressure nears the supply's.",
        rare=True,
    ),
    Law(
        "exchange",
        "exchange",
        (Number("factor", "w/u"),),
        _exchange,
        "any",
        kinds=(4,),
        second="any",
        modelica="y = factor*(u - v);",
        sentence="What passes from one part to another by their difference: leaks, heat, charge, momentum.",
    ),
    Law(
        "exchange through an orifice",
        "exchange",
        (Number("factor", "w/u^0.5"),),
        _exchange_of_root,
        "any",
        kinds=(4,),
        at="flow",
        second="any",
        modelica="y = factor*sign(u - v)*sqrt(abs(u - v));",
        sentence="A turbulent leak from one chamber to another.",
    ),
    Law(
        "exchange by radiation",
        "exchange",
        (Number("factor", "w.m2/W"),),
        _exchange_of_radiation,
        "temperature",
        kinds=(4,),
        at="flow",
        second="any",
        modelica="y = factor*5.670374419e-8*(u^4 - v^4);",
        sentence="Heat that one part radiates to another.",
        unit="K",
    ),
    Law(
        "exchange by radiation from degC",
        "exchange",
        (Number("factor", "w.m2/W"),),
        _exchange_of_radiation_of_celsius,
        "temperature",
        kinds=(4,),
        at="flow",
        second="any",
        modelica="y = factor*5.670374419e-8*((u + 273.15)^4 - (v + 273.15)^4);",
        sentence="Heat that one part radiates to another.",
        unit="degC",
    ),
]
