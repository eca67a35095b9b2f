"""Simulated cases of a study's own system.

The system, its feeding and its runs are the study's; what is hidden is drawn: nothing, one candidate or two,
from strong to nearly none, or a candidate that is struck from the list, which then is outside of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...base.errors import OrchestratorError
from ...system.connection import Port
from ..effect import Effect
from ..fit import Fitter
from ..study import Array
from .effect import PortEffect
from .repeats import apart
from .replay import PortReplay, Weighted
from .seek import carries
from .study import PortRun, PortStudy, Role
from .wary import WaryFitter

__all__ = ["simulated"]

# Kinds of cases and their shares.
_KINDS = {"none": 0.25, "one": 0.45, "two": 0.15, "outside": 0.15}
# Sizes of effects are drawn from so many decades below their prior.
_DECADES = 2.5
# An effect of which logs say less is none [nats].
_SEEN = 10.0
# Signals this many times as large as the logs' are those of no rig that would have been left running.
_WILD = 3.0
# What may be drawn one after the other until some system stays tame.
_DRAWS = 100


def simulated(
    study: PortStudy, effects: Sequence[Effect], rng: np.random.Generator
) -> tuple[PortStudy, tuple[str, ...], float]:
    """The study with logs of its own system, in which something is hidden.

    Calibrated numbers are drawn by their tolerances. Noise is what does not repeat, from a random place on,
    where runs have repeats, else white as specified. Where what is drawn makes a loop swing up or run away,
    all is drawn anew: such logs nobody hands over.

    Args:
        effects: to draw from.
    Returns: the study, train and validation runs only; what is hidden, as far as logs can tell; and how much
        they say about it, see `_told` [nats].
    Raises: OrchestratorError if whatever is drawn makes a loop swing up.
    """
    for _ in range(_DRAWS):
        kind, truth = _hidden(study, effects, rng)
        made = _made(study, truth, rng)
        if made is not None:
            break
    else:
        raise OrchestratorError(
            f"practice: whatever was hidden, {_DRAWS} times in a row, signals came to more than "
            f"{_WILD:g} times those of the logs and of the system as configured\n"
            "  Check which columns are fed, and the start values."
        )
    runs, bare, noises = made
    weights = {
        port: 1.0 / math.sqrt(carries(np.concatenate(parts) / float(study.columns[port].noise or 1.0)))
        for port, parts in noises.items()
    }
    told, evidence = _told(WaryFitter(Weighted.of(PortReplay(study, bare), weights)), truth)
    struck = study.without
    names = tuple(sorted(one.id for one in told))
    if kind == "outside" and told:
        # Its whole family is struck: another form of the same cause would be right.
        pool = [one for one in effects if isinstance(one, PortEffect)]
        family = told[0].family
        gone = [one.id for one in pool if one.id == told[0].id or (family and one.family == family)]
        struck, names = (*struck, *gone), ("outside",)
    return replace(study, runs=tuple(runs), without=struck), names, evidence


@dataclass(frozen=True)
class _Hidden:
    """What makes the logs of a simulated case."""

    calibrated: Mapping[str, float]
    effects: tuple[PortEffect, ...]
    theta: Array


def _hidden(study: PortStudy, effects: Sequence[Effect], rng: np.random.Generator) -> tuple[str, _Hidden]:
    """What kind of case, and what makes its logs."""
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    pool = [one for one in effects if isinstance(one, PortEffect)]
    hidden: list[PortEffect] = []
    for one in (pool[place] for place in rng.permutation(len(pool))):
        if len(hidden) == {"none": 0, "two": 2}.get(kind, 1):
            break
        if all(not one.family or one.family != other.family for other in hidden):
            hidden.append(one)
    theta = np.concatenate([_drawn(one, rng) for one in hidden]) if hidden else np.zeros(0)
    calibrated = {
        name: one.value + one.tolerance * float(np.clip(rng.standard_normal(), -2.5, 2.5))
        for name, one in study.nominal.items()
    }
    return kind, _Hidden(calibrated, tuple(hidden), theta)


def _made(
    study: PortStudy, hidden: _Hidden, rng: np.random.Generator
) -> tuple[list[PortRun], list[PortRun], dict[Port, list[Array]]] | None:
    """Runs with what is hidden, the same without noise, and the noise; None where the system swings up."""
    open_study = replace(study, fed=study.given)
    readers = [(port, link) for port in study.fed if (link := study.reading(port)) is not None]
    runs, bare = [], []
    noises: dict[Port, list[Array]] = {}
    for run in study.of(Role.TRAIN, Role.VALIDATION):
        replay = PortReplay(open_study, [run])
        signals = replay.signals(run, hidden.calibrated, hidden.effects, hidden.theta)
        plain = replay.signals(run, {}, (), np.zeros(0))
        logs, without = dict(run.logs), dict(run.logs)
        for port in replay.compared(run):
            usual = max(float(np.abs(one).max()) for one in (run.logs[port], plain[port]))
            # NaN, of a system that runs away, is not below anything.
            if not np.abs(signals[port]).max() <= _WILD * usual:
                return None
            noise = _noise(study, port, len(run), float(study.columns[port].noise or 0.0), rng)
            noises.setdefault(port, []).append(noise)
            logs[port], without[port] = signals[port] + noise, signals[port]
        for port, link in readers:
            for some in (logs, without):
                some[port] = link.gain * some[link.source] + link.offset
        runs.append(replace(run, logs=logs))
        bare.append(replace(run, logs=without))
    return runs, bare, noises


def _told(fitter: Fitter, hidden: _Hidden) -> tuple[tuple[PortEffect, ...], float]:
    """The hidden effects that logs without noise tell, and log evidence for all of them over none [nats].

    What the calibration may explain within its tolerances, and what the other hidden effect explains in
    another size or shape, does not count. Of two that each explain what the other does one remains.
    The evidence is Laplace's, as that of answers: a number that must be known to many digits costs as many.

    Args:
        fitter: of these logs, weighed as their noise lets them count.
    """
    z = fitter.normalised(hidden.calibrated, hidden.effects, hidden.theta)
    count = len(hidden.calibrated)
    effects = list(hidden.effects)
    parts = np.split(z[count:], np.cumsum([len(one.parameters) for one in effects])[:-1]) if effects else []

    def evidence(kept: Sequence[int]) -> float:
        start = np.concatenate([parts[place] for place in kept]) if kept else None
        return fitter.fit(tuple(effects[place] for place in kept), z[:count], start).log_evidence

    kept = list(range(len(effects)))
    whole = own = evidence(kept)
    while kept:
        others = [[other for other in kept if other != place] for place in kept]
        most, fewer = max((evidence(some), some) for some in others)
        if own - most >= _SEEN:
            break
        own, kept = most, fewer
    return tuple(effects[place] for place in kept), whole - evidence([])


def _drawn(effect: Effect, rng: np.random.Generator) -> Array:
    """Parameters of an effect: its size log-uniform below the prior's, its shape from the prior."""
    values = []
    for place, one in enumerate(effect.parameters):
        if one.shape or place > 0:
            centre = one.starts[len(one.starts) // 2] if one.starts else one.scale
            value = centre * float(np.exp(0.7 * np.clip(rng.standard_normal(), -2.0, 2.0)))
        else:
            value = one.scale * float(10.0 ** -rng.uniform(0.0, _DECADES))
            value *= -1.0 if one.low < 0.0 and rng.random() < 0.5 else 1.0
        values.append(min(max(value, one.low), one.high))
    return np.array(values)


def _noise(study: PortStudy, port: Port, n: int, specified: float, rng: np.random.Generator) -> Array:
    """Noise of a port's log, shape (n,)."""
    found = [one for run in study.runs for one in apart(study, run, port)]
    if not found:
        return specified * rng.standard_normal(n)
    one = found[int(rng.integers(len(found)))]
    begin = int(rng.integers(len(one)))
    return float(rng.choice([-1.0, 1.0])) * np.resize(np.roll(one, -begin), n)
