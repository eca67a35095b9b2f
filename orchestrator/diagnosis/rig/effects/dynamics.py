"""Effects of the satellite's dynamics in software."""

from __future__ import annotations

from ..config_changes import BODY, scaled, start, through, with_unit
from ..effect import Context, Effect, Parameter, Site, law

_MASS = int(Context.MASS)
_POSITION = int(Context.POSITION)
_VELOCITY = int(Context.VELOCITY)


@law
def _cable(time, step, value, context, memory, theta):
    return value - theta[0] * context[_POSITION]


@law
def _drag(time, step, value, context, memory, theta):
    return value - theta[0] * context[_VELOCITY]


@law
def _mass(time, step, value, context, memory, theta):
    return value / (1.0 + theta[0])


@law
def _mass_offset(time, step, value, context, memory, theta):
    return value * (1.0 + theta[0] * theta[0])


@law
def _residual_gravity(time, step, value, context, memory, theta):
    return value + context[_MASS] * theta[0]


EFFECTS = (
    Effect(
        id="dynamics.cable",
        words="A spring on the body",
        equation="F = F_0 - k x",
        source="Hooke",
        parameters=(Parameter("stiffness", "N/m", 1000.0, low=-100000.0, high=100000.0),),
        site=Site.BODY,
        apply=_cable,
        written=lambda t, rig: start("satellite", cable_stiffness=(t["stiffness"], "N/m")),
    ),
    Effect(
        id="dynamics.drag",
        words="A drag on the body",
        equation="F = F_0 - b x'",
        source="Stokes",
        parameters=(Parameter("damping", "N.s/m", 60.0, low=-10000.0, high=10000.0),),
        site=Site.BODY,
        apply=_drag,
        written=lambda t, rig: start("satellite", drag=(t["damping"], "N.s/m")),
    ),
    Effect(
        id="dynamics.mass",
        words="The satellite software runs with another mass",
        equation="m = m_0 (1 + r)",
        source="Eq. 6 of the docking source",
        parameters=(Parameter("relative", "1", 0.05, low=-0.5, high=2.0),),
        site=Site.BODY,
        apply=_mass,
        written=lambda t, rig: scaled(mass=1.0 + t["relative"]),
    ),
    Effect(
        id="dynamics.mass-offset",
        words="The contact line misses the centre of mass: the effective mass is lower",
        equation="1/m_e = (1 + (o/r)^2)/m, r = 1 m",
        source="Eqs. 6 and 7 of the docking source",
        parameters=(Parameter("offset", "m", 0.4, low=0.0, high=5.0, starts=(0.2,)),),
        site=Site.BODY,
        apply=_mass_offset,
        written=lambda t, rig: scaled(mass=1.0 / (1.0 + t["offset"] ** 2)),
    ),
    Effect(
        id="dynamics.residual-gravity",
        words="A constant acceleration on the body",
        equation="F = F_0 + m g",
        source="Newton",
        parameters=(Parameter("acceleration", "m/s2", 0.002, low=-1.0, high=1.0),),
        site=Site.BODY,
        apply=_residual_gravity,
        written=lambda t, rig: through(BODY, offset=with_unit(t["acceleration"] * rig["mass"], "N")),
    ),
)
