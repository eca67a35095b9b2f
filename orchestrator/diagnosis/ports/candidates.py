"""What may make a system differ from its logs: parameters, effects at ports, laws of friction."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import product

import numpy as np

from ...effects import Effect as ConnectionEffect
from ...effects.backlash import Backlash
from ...effects.dead_band import DeadBand
from ...effects.delay import Delay
from ...effects.gain import Gain
from ...effects.low_pass import LowPass
from ...effects.offset import Offset
from ...effects.quantise import Quantise
from ...effects.rate_limit import RateLimit
from ...effects.sample_and_hold import SampleAndHold
from ...effects.saturate import Saturate
from ...errors import ConfigError, Problem, listed, nearest
from ...fmi import Causality, Kind
from ...system import Instance, Port
from ..effect import Effect, Parameter
from ..study import Array
from . import laws
from .comb import Comb
from .player import Inserted
from .study import PortStudy

__all__ = ["FORCES", "PortEffect", "Sizes", "candidates"]

_VELOCITIES = {"m/s": "m", "rad/s": "rad"}
_DRY = {"coulomb", "stribeck", "dahl", "lugre", "maxwell-slip", "presliding", "play", "presliding-backlash"}
# Levels between zero and a signal's peak, of the finest resolution that is looked for; and by how much of a
# level, or of a period, what is farthest from the begin may be astray.
_FINEST, _NEAR = 60, 0.25
FORCES = {"m/s": "N", "rad/s": "N.m"}


@dataclass(frozen=True, eq=False)
class PortEffect(Effect):
    """A candidate cause in a system of FMUs: see `Effect`.

    Attributes:
        port: where it is inserted; None where it changes a parameter.
        make: the effect on connections that it is, of its parameters.
        reads: ports that the effect reads.
        family: effects of one family are forms of one cause, and are not combined; "" for none.
        comb: where to look for its one parameter, if runs tell it only from very near.
    """

    port: Port | None = None
    make: Callable[[Array], ConnectionEffect] | None = None
    reads: tuple[Port, ...] = ()
    family: str = ""
    comb: Comb | None = None

    def __post_init__(self) -> None:
        if (self.port is None) != (self.make is None) or (self.port is None and not self.changes):
            raise ValueError(f"effect {self.id}: needs a port and what acts there, or a parameter to change")

    def inserted(self, theta: Array) -> Inserted | None:
        """What is put into the system; nothing where a parameter is changed."""
        if self.port is None or self.make is None:
            return None
        return Inserted(self.make(theta), self.port, self.reads)


@dataclass(frozen=True)
class Sizes:
    """How large signals are, from which priors are made.

    Attributes:
        spread: standard deviation of each port's signal, in its unit. Of forces on free inputs, the constant
            force that moves some compared output by its spread.
        peak: largest magnitude; rate: largest change per time, per second.
        way: standard deviation of the integral over time, of velocities.
    """

    spread: Mapping[Port, float]
    peak: Mapping[Port, float]
    rate: Mapping[Port, float]
    way: Mapping[Port, float]


def candidates(study: PortStudy, sizes: Sizes) -> tuple[Effect, ...]:
    """All candidates of a study, less those that its patterns strike.

    Raises: ConfigError for patterns that fit none, or leave none.
    """
    found: list[Effect] = []
    for name, prior in study.priors.items():
        unit = study.prepared.system.variable(Port.of(name)).unit_name or "1"
        found.append(
            PortEffect(
                name,
                "another value than configured",
                "config",
                (Parameter("change", unit, prior, starts=(0.1 * prior,)),),
                changes={name: "change"},
            )
        )
    for instance in study.prepared.system.instances:
        found += _friction(study, instance, sizes)
    for port in _ports(study):
        found += _effects(study, port, sizes)
    found = _apart(found)
    problems = []
    names = [one.id for one in found]
    for key, patterns in (("only", study.only), ("without", study.without)):
        for number, pattern in enumerate(patterns):
            if not _fit(names, (pattern,)):
                place = study.place("candidates", key, number)
                what = f"{pattern} fits no candidate"
                problems.append(Problem(place, what, listed(names, 30), nearest(pattern, names)))
    kept = set(_fit(names, study.only or ("*",))) - set(_fit(names, study.without))
    if found and not kept and not problems:
        what = "`only` and `without` leave no candidate"
        remedy = "Strike fewer of them: where nothing can be blamed there is nothing to tell."
        problems.append(Problem(study.place("candidates"), what, f"some of {listed(names, 30)}", remedy))
    if problems:
        raise ConfigError(problems)
    return tuple(one for one in found if one.id in kept)


def _fit(names: Sequence[str], patterns: Sequence[str]) -> list[str]:
    """Names that one of the patterns fits."""
    return [name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns)]


def _apart(effects: Sequence[Effect]) -> list[Effect]:
    """Effects, of which those whose ids others have before are called otherwise, as where a parameter is
    called as a law is."""
    found: dict[str, Effect] = {}
    for one in effects:
        name = one.id
        while name in found:
            name += "-law"
        found[name] = one if name == one.id else replace(one, id=name)
    return list(found.values())


def _ports(study: PortStudy) -> list[Port]:
    """Ports at which effects differ: inputs that something feeds, outputs that others or logs see.

    An output that feeds one input and no log is left to that input; one that only feeds what logs replace is
    left out.
    """
    system = study.prepared.system
    found: dict[Port, None] = {}
    for connection in system.connections:
        if system.variable(connection.target).kind is Kind.REAL:
            found[connection.target] = None
    for port in study.fed:
        if system.variable(port).causality is Causality.INPUT:
            found[port] = None
    for port in study.compared:
        found[port] = None
    for port in system.recorded:
        taken = [one for one in system.connections if port in one.sources]
        if port not in study.fed and len(taken) > 1 and system.variable(port).kind is Kind.REAL:
            found[port] = None
    return list(found)


def _unit(study: PortStudy, port: Port) -> str:
    """Unit of the signal that an effect at a port works on: that of the source, where an input converts."""
    for one in study.prepared.system.connections:
        if one.target == port and (one.gain, one.offset) != (1.0, 0.0):
            return study.unit(one.source)
    return study.unit(port)


def _effects(study: PortStudy, port: Port, sizes: Sizes) -> list[Effect]:
    """Effects of connections at a port."""
    unit, step = _unit(study, port), float(study.prepared.grid.step_size)
    if not sizes.spread.get(port, 0.0) > 0.0 or not sizes.rate.get(port, 0.0) > 0.0:
        return []
    spread, peak, rate = sizes.spread[port], sizes.peak[port], sizes.rate[port]

    def size(name: str, unit: str, scale: float, *starts: float, high: float = np.inf) -> Parameter:
        return Parameter(name, unit, scale, 0.0, high, tuple(share * scale for share in starts))

    def jagged(name: str, unit: str, scale: float, *starts: float) -> Parameter:
        return replace(size(name, unit, scale, *starts), jagged=True)

    def signed(name: str, unit: str, scale: float) -> Parameter:
        return Parameter(name, unit, scale, starts=(0.05 * scale,))

    cut = size("cut", "1", 0.3, 0.3, 1.5, high=0.99)
    made: dict[str, tuple[Parameter, Callable[[Array], ConnectionEffect], str]] = {
        "gain": (signed("relative", "1", 0.2), lambda p: Gain(factor=1.0 + p[0]), "y = (1 + relative) x"),
        "offset": (signed("offset", unit, 0.3 * spread), lambda p: Offset(value=p[0]), "y = x + offset"),
        "delay": (size("delay", "s", 20 * step, 0.1, 0.5), lambda p: Delay(time=p[0]), "y = x(t - delay)"),
        "low-pass": (
            size("time_constant", "s", 50 * step, 0.04, 0.4),
            lambda p: LowPass(time_constant=p[0]),
            "T y' + y = x",
        ),
        "sample-and-hold": (
            jagged("period", "s", 20 * step, 0.15, 0.5),
            lambda p: SampleAndHold(period=p[0]),
            "x at the latest sample",
        ),
        "saturate": (
            cut,
            lambda p: Saturate(low=-peak * (1.0 - p[0]), high=peak * (1.0 - p[0])),
            "|y| at most (1 - cut) of the peak",
        ),
        "quantise": (
            jagged("resolution", unit, 0.1 * spread, 0.3, 1.0),
            lambda p: Quantise(resolution=p[0]),
            "the nearest multiple",
        ),
        "rate-limit": (
            cut,
            lambda p: RateLimit(rate=rate * (1.0 - p[0])),
            "|y'| at most (1 - cut) of the largest",
        ),
        "dead-band": (
            size("threshold", unit, 0.2 * spread, 0.1, 1.0),
            lambda p: DeadBand(threshold=p[0]),
            "nothing below the threshold",
        ),
        "backlash": (
            size("width", unit, 0.2 * spread, 0.1, 1.0),
            lambda p: Backlash(width=p[0]),
            "what is carried along where the play is used up",
        ),
    }
    combs = {"quantise": _resolutions(peak), "sample-and-hold": _periods(step)}
    return [
        PortEffect(
            f"{port}.{name}", equation, "docs/effects.md", (one,), port=port, make=make, comb=combs.get(name)
        )
        for name, (one, make, equation) in made.items()
    ]


def _resolutions(peak: float) -> Comb:
    """Of a signal with that peak: so near that its largest values fall on the right step."""
    levels = _NEAR * np.arange(1, round(_FINEST / _NEAR) + 1)
    return Comb(tuple((peak / levels).tolist()), lambda value, time: _NEAR * value**2 / peak)


def _periods(step: float) -> Comb:
    """So near that the last sample of a run is taken when it should be.

    At other periods samples are late by half of it on average, at random: one of three quarters does best.
    """
    coarse = tuple((step * np.geomspace(0.3, 60.0, 60)).tolist())
    return Comb(coarse, lambda value, time: _NEAR * value**2 / time, reach=1.6)


def _friction(study: PortStudy, instance: Instance, sizes: Sizes) -> list[Effect]:
    """Laws of friction of a component that is fed a force and gives a velocity, or the other way round.

    What is fed forces and gives some is a sensor or a controller, and rubs nowhere.
    """
    variables = [one for one in instance.fmu.description.variables.values() if one.kind is Kind.REAL]
    inputs = [
        (one.name, one.unit_name) for one in variables if one.causality is Causality.INPUT and not one.shape
    ]
    outputs = [
        (one.name, one.unit_name) for one in variables if one.causality is Causality.OUTPUT and not one.shape
    ]
    ways = [(_pairs(outputs, inputs), -1)]
    if not any(unit in FORCES.values() for _, unit in inputs):
        ways.append((_pairs(inputs, outputs), 1))
    found: list[Effect] = []
    for pairs, sign in ways:
        at = [(Port(instance.name, velocity), Port(instance.name, force)) for velocity, force in pairs]
        at = [pair for pair in at if all(sizes.spread.get(one, 0.0) > 0.0 for one in pair)]
        ports = [port for _, port in at]
        for read, port in at:
            prefix = instance.name if len(pairs) == 1 else str(port)
            if ports.count(port) > 1:
                prefix = f"{port}-{read.variable}"
            found += _laws(study, port, read, sign, sizes, prefix)
        for port in dict.fromkeys(ports):
            if (
                sign < 0 and port not in sizes.rate
            ):  # nothing is fed there, so that it has no effects of connections
                force = sizes.spread[port]
                bias = Parameter("offset", _unit(study, port), 0.5 * force, starts=(0.025 * force,))
                found.append(PortEffect(f"{port}.offset", "F = offset", "", (bias,), port=port,
                                        make=lambda p: Offset(value=p[0])))  # fmt: skip
    return found


def _pairs(velocities: Sequence[tuple[str, str]], forces: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Velocities and the forces that friction may exert against them, names of each.

    Elements of vectors go with those of the same index. As many forces as velocities go with them in their
    order, as a component's axes do; else each may go with each.

    Args:
        velocities, forces: names and units.
    """
    found: list[tuple[str, str]] = []
    for unit, own in FORCES.items():
        moving, pushing = _by_index(velocities, unit), _by_index(forces, own)
        for index, names in moving.items():
            others = pushing.get(index, [])
            found += zip(names, others, strict=True) if len(names) == len(others) else product(names, others)
    return found


def _by_index(variables: Sequence[tuple[str, str]], unit: str) -> dict[str, list[str]]:
    """Names of variables of a unit by what stands in their brackets; scalars by ""."""
    found: dict[str, list[str]] = {}
    for name, own in variables:
        if own == unit:
            found.setdefault(name.partition("[")[2], []).append(name)
    return found


def _laws(study: PortStudy, port: Port, read: Port, sign: int, sizes: Sizes, prefix: str) -> list[Effect]:
    """Laws at a force, added, and where a component gives it, softening what it has."""
    force_unit, speed_unit = _unit(study, port), study.unit(read)
    way_unit = _VELOCITIES[speed_unit]
    speed = sizes.spread[read]
    force, way = sizes.spread[port], sizes.way[read]
    level = Parameter("level", force_unit, force, 0.0, np.inf, (0.05 * force, 0.4 * force))
    excess = Parameter("excess", "1", 0.7, 0.0, 2.0, (0.3,), shape=True)
    corner = Parameter("width", speed_unit, 1.5, 1e-4 * speed, 0.3 * speed, (1e-2 * speed,), shape=True)
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
        )

    def per(unit: str, scale: float, name: str) -> tuple[Parameter, ...]:
        return (Parameter(name, f"{force_unit}.s/{way_unit}" if unit == "v" else f"{force_unit}/{way_unit}",
                          scale, starts=(0.05 * scale,)),)  # fmt: skip

    found = [
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
