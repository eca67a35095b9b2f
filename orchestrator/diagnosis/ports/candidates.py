"""What may make a system differ from its logs: parameters, effects at ports, laws of friction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np

from ...base.errors import ConfigError, Problem, listed, nearest
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
from ...fmi import Causality, Kind
from ...system.connection import Port
from ..effect import Effect, Parameter
from ..families import Kin
from ..study import Array
from .comb import Comb
from .effect import FEW_LEVELS, PortEffect, Sizes, unit_at
from .friction import friction
from .study import PortStudy

__all__ = ["candidates"]

# Levels between zero and a signal's peak, of the finest resolution that is looked for; and by how much of a
# level, or of a period, what is farthest from the begin may be astray.
_FINEST, _NEAR = 60, 0.25
# Effects of connections that are reported together.
_KIN = {
    **dict.fromkeys(("delay", "low-pass", "sample-and-hold"), "a lag"),
    **dict.fromkeys(("dead-band", "backlash"), "a play or dead band"),
}


def candidates(study: PortStudy, sizes: Sizes) -> tuple[Effect, ...]:
    """All candidates of a study, less those that its patterns strike, and what its signals cannot tell.

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
        found += friction(study, instance, sizes)
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
        remedy = "Strike fewer of them: with nothing to blame there is no diagnosis."
        problems.append(Problem(study.place("candidates"), what, f"some of {listed(names, 30)}", remedy))
    told = tuple(one for one in found if one.id in kept and not _untold(one))
    if kept and not told and not problems:
        names = listed(sorted(kept), 10)
        what = f"no resolution can be identified from signals of {FEW_LEVELS} values or fewer: {names}"
        problems.append(Problem(study.place("candidates"), what, remedy="Let others in."))
    if problems:
        raise ConfigError(problems)
    return told


def _untold(effect: Effect) -> bool:
    return isinstance(effect, PortEffect) and effect.untold


def _fit(names: Sequence[str], patterns: Sequence[str]) -> list[str]:
    """Names that one of the patterns fits."""
    return [name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns)]


def _apart(effects: Sequence[Effect]) -> list[Effect]:
    """Effects, of which those whose ids others have before are called otherwise, as where a parameter is
    called as a law is.
    """
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


def _effects(study: PortStudy, port: Port, sizes: Sizes) -> list[Effect]:
    """Effects of connections at a port."""
    unit, step = unit_at(study, port), study.interval
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
            f"|y| at most (1 - cut) of the peak, {peak:.4g} {unit}",
        ),
        "quantise": (
            jagged("resolution", unit, 0.1 * spread, 0.3, 1.0),
            lambda p: Quantise(resolution=p[0]),
            "the nearest multiple",
        ),
        "rate-limit": (
            cut,
            lambda p: RateLimit(rate=rate * (1.0 - p[0])),
            f"|y'| at most (1 - cut) of the largest, {rate:.4g} {unit} per second",
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
    untold = {"quantise": 0 < sizes.levels.get(port, 0) <= FEW_LEVELS}
    return [
        PortEffect(
            f"{port}.{name}",
            equation,
            "docs/effects.md",
            (one,),
            port=port,
            make=make,
            kin=Kin(_KIN[name], str(port)) if name in _KIN else None,
            comb=combs.get(name),
            untold=untold.get(name, False),
        )
        for name, (one, make, equation) in made.items()
    ]


def _resolutions(peak: float) -> Comb:
    """Of a signal with that peak: so near that its largest values fall on the right step."""
    levels = _NEAR * np.arange(1, round(_FINEST / _NEAR) + 1)
    return Comb(tuple((peak / levels).tolist()), lambda value, time: _NEAR * value**2 / peak, chance=True)


def _periods(step: float) -> Comb:
    """So near that the last sample of a run is taken when it should be.

    At other periods samples are late by half of it on average, at random: one of three quarters does best.
    """
    coarse = tuple((step * np.geomspace(0.3, 60.0, 60)).tolist())
    return Comb(coarse, lambda value, time: _NEAR * value**2 / time, reach=1.6)
