"""Which laws of friction may act at a component."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...effects.offset import Offset
from ...system.connection import Port
from ...system.system import Instance
from ..effect import Effect, Parameter
from ..families import Kin
from . import laws
from .conjugate import conjugates
from .effect import PortEffect, Sizes, unit_at
from .study import PortStudy

__all__ = ["friction"]

# Units of velocities, and those of the ways that go with them.
_WAYS = {"m/s": "m", "rad/s": "rad"}
_DRY = {"coulomb", "stribeck", "dahl", "lugre", "maxwell-slip", "presliding", "play", "presliding-backlash"}
_WITH_SPEED = {"viscous", "one-sided", "drag"}


def friction(study: PortStudy, instance: Instance, sizes: Sizes) -> list[Effect]:
    """Laws of friction of a component that is fed a force and gives a velocity, or the other way round.

    What is fed forces and gives some is a sensor or a controller, and rubs nowhere.
    """
    among = conjugates(instance)
    found: list[Effect] = []
    for sign in (-1, 1):
        own = [(one.velocity, one.force) for one in among if one.fed is (sign < 0)]
        at = [pair for pair in own if all(sizes.spread.get(one, 0.0) > 0.0 for one in pair)]
        ports = [port for _, port in at]
        for read, port in at:
            prefix = instance.name if len(own) == 1 else str(port)
            if ports.count(port) > 1:
                prefix = f"{port}-{read.variable}"
            found += _laws(study, port, read, sign, sizes, prefix)
        for port in dict.fromkeys(ports):
            if (
                sign < 0 and port not in sizes.rate
            ):  # nothing is fed there, so that it has no effects of connections
                force = sizes.spread[port]
                bias = Parameter("offset", unit_at(study, port), 0.5 * force, starts=(0.025 * force,))
                found.append(PortEffect(f"{port}.offset", "F = offset", "", (bias,), port=port,
                                        make=lambda p: Offset(value=p[0])))  # fmt: skip
    return found


def _laws(study: PortStudy, port: Port, read: Port, sign: int, sizes: Sizes, prefix: str) -> list[Effect]:
    """Laws at a force, added, and where a component gives it, softening what it has."""
    force_unit, speed_unit = unit_at(study, port), study.unit(read)
    way_unit = _WAYS[speed_unit]
    speed = sizes.spread[read]
    force, way = sizes.spread[port], sizes.way[read]
    level = Parameter("level", force_unit, force, 0.0, np.inf, (0.05 * force, 0.4 * force))
    excess = Parameter("excess", "1", 0.7, 0.0, 2.0, (0.3,), shape=True)
    corner = Parameter("width", speed_unit, 1.5, 1e-4 * speed, 0.05 * speed, (1e-2 * speed,), shape=True)
    slow = Parameter("speed", speed_unit, 1.0, 1e-3 * speed, 3 * speed, (0.2 * speed,), shape=True)
    build = Parameter("distance", way_unit, 1.5, 1e-6 * way, 3 * way, (0.003 * way, 0.05 * way), shape=True)
    soft = Parameter("distance", way_unit, 0.3 * way, 0.0, 3 * way, (0.015 * way, 0.15 * way))

    def law(
        name: str, equation: str, source: str, parameters: tuple[Parameter, ...], make: Callable
    ) -> PortEffect:
        return PortEffect(
            f"{prefix}.{name}",
            equation,
            source,
            parameters,
            port=port,
            make=make,
            reads=(read,),
            family=f"{port}: dry friction" if name in _DRY and (sign < 0 or name != "stribeck") else "",
            kin=_kin(name, prefix, sign),
        )

    def per(unit: str, scale: float, name: str) -> tuple[Parameter, ...]:
        return (Parameter(name, f"{force_unit}.s/{way_unit}" if unit == "v" else f"{force_unit}/{way_unit}",
                          scale, starts=(0.05 * scale,)),)  # fmt: skip

    found: list[Effect] = [
        law("coulomb", "F = level sgn(v), its corner rounded over width", "Coulomb (1785)", (level, corner),
            lambda p: laws.Coulomb(sign=sign, level=p[0], width=p[1])),
        law("stribeck", "F = level (1 + excess exp(-(v/speed)^2)) sgn(v)", "Stribeck (1902)",
            (level, excess, slow, corner),
            lambda p: laws.Stribeck(sign=sign, level=p[0], excess=p[1], speed=p[2], width=p[3])),
        law("viscous", "F = damping v", "", per("v", 0.5 * force / speed, "damping"),
            lambda p: laws.Viscous(sign=sign, damping=p[0])),
        law("one-sided", "F = damping |v|", "", per("v", 0.5 * force / speed, "damping"),
            lambda p: laws.OneSided(sign=sign, damping=p[0])),
        law("drag", "F = drag v |v|", "", (Parameter("drag", f"{force_unit}.s2/{way_unit}2",
            0.5 * force / speed**2, starts=(0.025 * force / speed**2,)),),
            lambda p: laws.Drag(sign=sign, drag=p[0])),
        law("dahl", "dF/dx = (level sgn(v) - F)/distance", "Dahl (1968)", (level, build),
            lambda p: laws.Dahl(sign=sign, level=p[0], distance=p[1])),
        law("lugre", "Dahl's law with a Stribeck curve", "Canudas de Wit et al. (1995)",
            (level, excess, slow, build),
            lambda p: laws.LuGre(sign=sign, level=p[0], excess=p[1], speed=p[2], distance=p[3])),
        law("maxwell-slip", "four springs in parallel that slip", "Iwan (1966)", (level, build),
            lambda p: laws.MaxwellSlip(sign=sign, level=p[0], distance=p[1])),
    ]  # fmt: skip
    if sign < 0:
        return found
    # What the component gives already is Coulomb's: further levels of it are its parameter's business.
    found = [one for one in found if one.id.rpartition(".")[2] in ("viscous", "one-sided", "drag")]
    return [
        *found,
        law("parallel-spring", "F = stiffness x", "", per("x", force / way, "stiffness"),
            lambda p: laws.Spring(sign=sign, stiffness=p[0])),
        law("stribeck", "F grows by excess exp(-(v/speed)^2)", "Stribeck (1902)",
            (Parameter("excess", "1", 0.5, -0.9, 5.0, (0.05,)), slow),
            lambda p: laws.StribeckShare(excess=p[0], speed=p[1])),
        law("dahl", "dF/dx = (F_c sgn(v) - F)/distance", "Dahl (1968)", (soft,),
            lambda p: laws.SofteningDahl(distance=p[0])),
        law("maxwell-slip", "four springs in parallel that slip", "Iwan (1966)", (soft,),
            lambda p: laws.SofteningMaxwellSlip(distance=p[0])),
        law("presliding", "a spring of distance up to slip", "Prandtl (1928)", (soft,),
            lambda p: laws.ElasticSlip(distance=p[0], play=0.0)),
        law("play", "no force within the play after a reversal", "",
            (Parameter("play", way_unit, 0.3 * way, 0.0, 3 * way, (0.03 * way, 0.3 * way)),),
            lambda p: laws.ElasticSlip(distance=0.0, play=p[0])),
        law("presliding-backlash", "a spring of distance up to slip, with play before it bears", "Prandtl "
            "(1928)", (Parameter("play", way_unit, 0.3 * way, 0.0, 3 * way, (0.03 * way, 0.3 * way)), soft),
            lambda p: laws.ElasticSlip(distance=p[1], play=p[0])),
    ]  # fmt: skip


def _kin(name: str, place: str, sign: int) -> Kin | None:
    """What a law is reported together with: one that is nested in another hardly differs from it."""
    if name in _DRY:
        return Kin("dry friction" if sign < 0 else "another form of dry friction", place)
    return Kin("friction that grows with speed", place) if name in _WITH_SPEED else None
