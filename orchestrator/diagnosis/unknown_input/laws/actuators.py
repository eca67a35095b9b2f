"""Laws of actuators and drives, which act on the signal at the place itself."""

from __future__ import annotations

from .law import Law, Number


def _saturation(t, s, n, z, out):
    limit = abs(n[0])
    out[0] = min(max(s[0], -limit), limit) - s[0]


def _dead_zone(t, s, n, z, out):
    out[0] = -min(max(s[0], -abs(n[0])), abs(n[0]))


def _gain_curve(t, s, n, z, out):
    out[0] = n[0] * s[0] * abs(s[0])


def _lag(t, s, n, z, out):
    out[0] = z[0] - s[0]
    out[1] = (s[0] - z[0]) / max(abs(n[0]), 1e-9)


def _delay(t, s, n, z, out):
    # Pade of order 2.
    time = max(abs(n[0]), 1e-9)
    a = 12.0 / (time * time)
    b = 6.0 / time
    out[1] = z[1]
    out[2] = s[0] - a * z[0] - b * z[1]
    out[0] = -2.0 * b * z[1]


_OWN = "own"
LAWS = [
    Law(
        "saturation",
        "saturation",
        (Number("limit", "u", (1.0, 2.0), positive=True),),
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
        (Number("half width", "u", (0.05, 0.2, 0.6), positive=True),),
        _dead_zone,
        _OWN,
        kinds=(1, 3),
        linear=False,
        modelica="y = -min(max(u, -half_width), half_width);",
        sentence="A valve or drive that does not answer small commands.",
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
    ),
    Law(
        "lag",
        "lag",
        (Number("time constant", "s", (0.5, 4.0), "interval", positive=True),),
        _lag,
        _OWN,
        1,
        (1, 3),
        linear=False,
        modelica="y = z1 - u; der(z1) = (u - z1)/time_constant;",
        sentence="A first-order lag, as of a sensor or an amplifier.",
    ),
    Law(
        "delay",
        "lag",
        (Number("time", "s", (0.5, 4.0), "interval", positive=True),),
        _delay,
        _OWN,
        2,
        (1, 3),
        linear=False,
        modelica="der(z1) = z2; der(z2) = u - 12/time_^2*z1 - 6/time_*z2; y = -12/time_*z2;",
        sentence="A transport or computing delay.",
    ),
]
