"""Clocks of logs that are late or early: distinguished from effects that delay."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import correlate
from threadpoolctl import threadpool_limits

from ...base.errors import Problem
from ...system.connection import Port
from ..descent import cost_of
from ..effect import Effect
from ..fit import Base, Fit
from ..search import HOPELESS, each
from ..study import Array
from ..verdict import Warned
from .replay import PortReplay, candidates_of
from .study import PortRun, PortStudy, Role
from .wary import WaryFitter

__all__ = ["wrong_clocks"]

# Mean square of what the model misses at a port, in squares of its noise, from which on it misses something;
# the share of that excess which another clock may leave; and what is looked at more closely than by itself.
_MISSED, _MENDED, _NEAR = 4.0, 0.1, 0.3
# Part of the shortest run by which a clock may be off; and how many of the best groups are looked at.
_LONGEST, _KEPT = 0.25, 3
# An effect does not explain what a clock does if it leaves so many times more, and that share of the excess
# or squares that many times larger at some port. Where the clock leaves so many times more, and than a
# little, it is the effect. So many of the most promising effects are fitted.
_TIMES, _UNEXPLAINED, _CLEAR, _LITTLE, _FITTED = 3.0, 0.2, 100.0, 0.01, 3


@dataclass(frozen=True)
class _Clock:
    """Columns of compared outputs that are late by some samples, or early, against all others.

    Attributes:
        left: share of the excess that is left without that; missed: the largest mean square at a port then.
    """

    ports: frozenset[Port]
    late: int
    left: float = 1.0
    missed: float = 0.0


def wrong_clocks(
    study: PortStudy, given: Mapping[str, Mapping[Port, Array]]
) -> tuple[list[Problem], list[Warned]]:
    """Columns whose clock is off, where that alone explains what the model misses, whatever its calibration.

    A delay of the plant shows in the same way, if it lies beyond all that the logs tell of: before what alone
    drives the system, or at an output that nothing reads. No delay is negative, and a delay within a loop
    changes the loop. So all single candidates are tried in the clock's place, struck ones, too: where none
    comes near, the logs are refused; where one explains about as much, both are reported.

    Args:
        given: what the model as configured gives, by run.
    """
    if not all(np.isfinite(one).all() for signals in given.values() for one in signals.values()):
        return [], []
    before = {port: _square(study, given, port) for port in study.compared}
    if not max(before.values()) > _MISSED:
        return [], []
    with threadpool_limits(limits=1, user_api="blas"):
        clock = _best(study, given, before)
        if clock is None:
            return [], []
        rival, by, missed = _rival(study, clock)
    worst = max(before, key=lambda port: before[port])
    place, told = _told(study, clock)
    what = f"the model misses {worst} by {before[worst] ** 0.5:.3g} times its noise"
    clear = by > _UNEXPLAINED or missed > _CLEAR * max(clock.missed, 1.0)
    if clear and by > _TIMES * clock.left:
        return [Problem(place, what, remedy=f"All fits if {told}.")], []
    if clock.left > _TIMES * max(by, _LITTLE):
        return [], []
    what += f"; another clock explains that about as well as {rival}"
    return [], [Warned(place=place, what=what, remedy=f"Rule out that {told}.")]


def _square(study: PortStudy, given: Mapping[str, Mapping[Port, Array]], port: Port) -> float:
    """Mean square of what is missed at a port in all runs, in squares of its noise."""
    parts = [
        run.logs[port][study.settled :] - given[run.name][port][study.settled :]
        for run in study.runs
        if port in run.logs
    ]
    return float(np.mean(np.concatenate(parts) ** 2)) / _noise(study, port) ** 2 if parts else 0.0


def _noise(study: PortStudy, port: Port) -> float:
    return float(study.columns[port].noise or 1.0)


def _groups(study: PortStudy) -> Iterator[frozenset[Port]]:
    """Compared columns that may come from one device, or be all but those of one.

    Alone, all of a component, all whose columns are called alike up to a dot, a slash or an underscore, and
    all that are compared. Fed ones among them are looked at where all fed ones are.
    """
    columns = {port: one.column for port, one in study.columns.items()}
    devices: dict[object, set[Port]] = {"compared": set(study.compared)}
    for port, name in columns.items():
        devices[port] = {port}
        devices.setdefault(("of", port.instance), set()).add(port)
        for mark in "./_":
            head = name.strip("/").partition(mark)
            if head[1]:
                devices.setdefault((mark, head[0]), set()).add(port)
    alone = set(study.compared) - set(study.fed)
    sets = [frozenset(one) for own in devices.values() for one in (own, set(columns) - own)]
    yield from dict.fromkeys(one for one in sets if one and one <= alone)


def _best(
    study: PortStudy, given: Mapping[str, Mapping[Port, Array]], before: Mapping[Port, float]
) -> _Clock | None:
    """The clock that mends most; None if none mends enough, and all that is missed."""
    whole = sum(_excess(one) for one in before.values())
    longest = int(_LONGEST * (min(map(len, study.runs)) - study.settled))
    curves = {port: _shifted(study, given, port, longest) for port in study.compared}
    near = []
    for ports in _groups(study):
        curve = sum(np.maximum(curves[port] - 1.0, 0.0) for port in ports)
        late = int(np.argmin(curve)) - longest
        rest = sum(_excess(before[port]) for port in study.compared if port not in ports)
        if late and curve[late + longest] + rest < _NEAR * whole:
            near.append((float(curve[late + longest] + rest), _Clock(ports, late)))
    if not near:
        return None
    near.sort(key=lambda one: one[0])
    plain, found = _calibrated(study), []
    for _, clock in near[:_KEPT]:
        after = _calibrated(_mended(study, clock))
        share = _ratio(after, plain)
        if share < _MENDED and all(
            after[port] <= max(_MISSED, _MENDED * plain[port]) for port in after if plain[port] > _MISSED
        ):
            found.append(replace(clock, left=share, missed=max(after.values())))
    return min(found, key=lambda one: (one.left, len(one.ports)), default=None)


def _excess(square: float) -> float:
    return max(square - 1.0, 0.0)


def _ratio(after: Mapping[Port, float], before: Mapping[Port, float]) -> float:
    """Share of the excess that is left, or that came up besides; ports count by the logarithm of theirs."""
    total = whole = 0.0
    for port in after:
        left, most = _excess(after[port]), max(_excess(after[port]), _excess(before[port]))
        total += np.log1p(most) * left / max(most, _MISSED)
        whole += np.log1p(most)
    return float(total / whole) if whole > 0.0 else 1.0


def _shifted(study: PortStudy, given: Mapping[str, Mapping[Port, Array]], port: Port, longest: int) -> Array:
    """Mean square of what is missed at a port, over its noise's, if its log is late by -longest to longest
    samples; shape (2 longest + 1,).
    """
    total, count = np.zeros(2 * longest + 1), np.zeros(2 * longest + 1)
    for run in study.runs:
        if port not in run.logs:
            continue
        middle = float(run.logs[port].mean())
        log, model = run.logs[port] - middle, given[run.name][port][study.settled :] - middle
        n, m = len(log), len(model)
        # The model's sample k stands at settled + k of the run, and so does the log's once it is moved.
        late = np.arange(-longest, longest + 1) + study.settled
        first, last = np.maximum(late, 0), np.minimum(late + m, n)
        together = correlate(log, model, method="fft")[late + m - 1]
        ends = np.concatenate([[0.0], np.cumsum(log**2)]), np.concatenate([[0.0], np.cumsum(model**2)])
        total += ends[0][last] - ends[0][first] + ends[1][last - late] - ends[1][first - late]
        total -= 2.0 * together
        count += last - first
    return total / np.maximum(count, 1.0) / _noise(study, port) ** 2


def _mended(study: PortStudy, clock: _Clock) -> PortStudy:
    """The study, with the logs of some columns moved against the others."""
    late, by = max(clock.late, 0), abs(clock.late)

    def moved(run: PortRun) -> PortRun:
        def part(port: Port, log: Array) -> Array:
            first = late if port in clock.ports else late - clock.late
            return log[first : len(log) - by + first]

        return replace(run, logs={port: part(port, log) for port, log in run.logs.items()})

    return replace(study, runs=tuple(map(moved, study.runs)))


def _calibrated(study: PortStudy) -> dict[Port, float]:
    """What the model misses at each port, however it is calibrated: see `_squares`."""
    replay = PortReplay(study, study.runs)
    fitter = WaryFitter(replay)
    return _squares(replay, _less(fitter.base((), fitter.nominal)))


def _less(base: Base) -> Array:
    """Residuals less what calibration takes up, as its derivatives tell."""
    j = base.jacobian
    left: Array = base.r - j @ np.linalg.solve(j.T @ j + np.eye(j.shape[1]), j.T @ base.r)
    return left


def _squares(replay: PortReplay, stacked: Array) -> dict[Port, float]:
    """Mean square of normalised residuals at each port, over all runs."""
    parts: dict[Port, list[Array]] = {}
    ends = np.cumsum([len(run) - replay.study.settled for run, _ in replay.channels])[:-1]
    for (_, port), r in zip(replay.channels, np.split(stacked, ends), strict=True):
        parts.setdefault(port, []).append(r)
    return {port: float(np.mean(np.concatenate(own) ** 2)) for port, own in parts.items()}


def _rival(study: PortStudy, clock: _Clock) -> tuple[str, float, float]:
    """The single effect that explains most in a clock's place, the share of the excess that it leaves, and
    the largest mean square that it leaves at a port.
    """
    effects = candidates_of(replace(study, only=(), without=()))
    replay = PortReplay(study, study.of(Role.TRAIN))
    fitter = WaryFitter(replay)
    base = fitter.base((), fitter.nominal)
    delay = abs(clock.late) * study.interval
    workers = 2 if replay.player.parallel else 1

    def promised(effect: Effect) -> tuple[float, Effect, Array]:
        cost, _, start = fitter.screen(effect, [base])
        first = effect.parameters[0]
        if first.unit == "s" and len(effect.parameters) == 1:
            own = np.array([delay / first.scale])
            z = np.concatenate([base.z, own])
            # As it is: about a long delay no derivative tells.
            at = cost_of(fitter.stacked((effect,), z), z)
            if at < cost:
                return at, effect, own
        return cost, effect, start

    made = sorted(each(promised, effects, workers), key=lambda one: one[0])[:_FITTED]
    fits = each(lambda one: _fitted(fitter, base, one), made, workers)
    best = min((fit for fit in fits if fit is not None), key=lambda fit: fit.cost, default=None)
    if best is None or not np.isfinite(best.cost):
        return "none", 1.0, np.inf
    left = _squares(replay, np.concatenate(best.residuals))
    return best.effects[0].id, _ratio(left, _squares(replay, _less(base))), max(left.values())


def _fitted(fitter: WaryFitter, base: Base, one: tuple[float, Effect, Array]) -> Fit | None:
    cost, effect, start = one
    try:
        return fitter.fit((effect,), base.z, start, aim=cost + HOPELESS)
    except np.linalg.LinAlgError:
        return None


def _told(study: PortStudy, clock: _Clock) -> tuple[str, str]:
    """Where a clock is wrong, and how it is corrected, in words."""
    ports = [port for port in study.columns if port in clock.ports]
    shift = clock.late * study.interval
    way = f"{'late' if shift > 0.0 else 'early'} by {abs(shift):.6g} s"
    one = len(ports) == 1
    said = "column" if one else "columns"
    names = ", ".join(study.columns[port].column for port in ports)
    clocks = {port: study.columns[port].clock + shift for port in ports}
    if len(set(clocks.values())) == 1:
        give = f"give {'it' if one else 'each'} `clock: {clocks[ports[0]]:.6g} s`"
    else:
        give = "give " + ", ".join(f"{port} `clock: {value:.6g} s`" for port, value in clocks.items())
    told = f"the clock of {said} {names} is {way}: {give}"
    others = [port for port in study.columns if port not in clock.ports]
    if others and set(others) <= set(study.fed):
        fed = ", ".join(study.columns[port].column for port in others)
        back = {port: study.columns[port].clock - shift for port in others}
        same = len(set(back.values())) == 1
        give = f"`clock: {back[others[0]]:.6g} s`" if same else "each a `clock` that is as much less"
        other = "early" if shift > 0.0 else "late"
        told += f"; or, if that of {fed} is {other} by as much, {give} there"
    return ", ".join(map(str, ports)), told
