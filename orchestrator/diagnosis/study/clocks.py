"""Columns whose clock is late or early, fast or slow, against that of the other columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...base.errors import Problem
from ...system.connection import Port
from .mistakes import Warned
from .replay import Replay
from .study import Array, PortRun, PortStudy

# By run and port.
Signals = Mapping[str, Mapping[Port, Array]]

# Mean square residual of a port, in squares of its noise, above which something is missed; the share of
# that excess which another clock may leave, and which a shift by whole samples may leave before the fit.
_MISSED, _ENOUGH, _NEAR = 4.0, 0.1, 0.4
# Part of the shortest run by which a clock may be off; how many of the best groups of columns are fitted, by
# how many steps, and by how many samples at most in each.
_LONGEST, _KEPT, _STEPS, _FARTHEST = 0.25, 3, 6, 20.0
# A clock is certain where the largest mean square residual falls below the first, and by the second factor.
_NOISE, _CLEAR = 9.0, 100.0
# Samples beyond the model's range by this many times that range are wrong if they are at most this share of
# all: they are interpolated, so that an overflow of a converter decides nothing.
_BEYOND, _FEW = 3.0, 0.01
# Share of a tolerance by which a calibrated parameter is changed for its derivative.
_STEP = 0.1
# Samples that a clock of a wrong rate gains or loses in a run at least, and the share of the residual
# of a shift alone that it must leave at most.
_DRIFTS, _BETTER = 1.0, 0.5


@dataclass(frozen=True)
class _Clock:
    """Compared columns with a clock of their own.

    Attributes:
        shifts: samples by which their stamps are late at the begin of each run; negative: early.
        drifts: samples that their clock gains until the end of each run.
        residual: sum of squares that the fit leaves.
    """

    ports: frozenset[Port]
    shifts: Array
    drifts: Array
    residual: float = np.inf


def wrong_clocks(replay: Replay, given: Signals) -> tuple[list[Problem], list[Warned]]:
    """Columns whose clock is wrong, where that alone explains the residual, whatever the calibration.

    The shift and the rate of the clock of a group of columns, and calibrated parameters, are fitted by least
    squares to the simulated signals, their time derivatives and sensitivities. One more replay, with the
    clock corrected, confirms it.

    A delay of the machine looks the same where no compared signal outside the group depends on the group. In
    that case, and where the correction leaves more than the noise, there is a warning; else the logs are
    refused.

    Args:
        given: simulated signals of the study as configured.
    """
    study = replay.study
    if not all(np.isfinite(one).all() for signals in given.values() for one in signals.values()):
        return [], []
    logs = {run.name: _bounded(study, run, given[run.name]) for run in study.runs}
    before = _squares(study, _residuals(study, logs, given))
    if not max(before.values(), default=0.0) > _MISSED:
        return [], []
    near = _near(study, logs, given, before)
    if not near:
        return [], []
    slopes = _sensitivities(replay, given)
    fits = [_fitted(study, logs, given, slopes, clock) for clock in near]
    clock = min(fits, key=lambda one: (one.residual, len(one.ports)))
    if not (np.round(clock.shifts).any() or clock.drifts.any()):
        return [], []
    plain = _squares(study, _calibrated(_residuals(study, logs, given), slopes, study))
    moved = _moved(study, clock)
    confirming = Replay(moved)
    simulated = {run.name: confirming.signals(run) for run in moved.runs}
    corrected = {run.name: _bounded(moved, run, simulated[run.name]) for run in moved.runs}
    cut = {
        run.name: {port: _rows(clock, number, len(run))[1](one) for port, one in slopes[run.name].items()}
        for number, run in enumerate(study.runs)
    }
    after = _squares(moved, _calibrated(_residuals(moved, corrected, simulated), cut, moved))
    if not _ratio(after, plain) < _ENOUGH or any(
        after[port] > max(_MISSED, _ENOUGH * plain[port]) for port in after if plain[port] > _MISSED
    ):
        return [], []
    worst = max(before, key=lambda port: before[port])
    place, cause, remedy = _described(study, clock)
    what = f"the model misses {worst} by {before[worst] ** 0.5:.3g} times its noise"
    most = max(after.values())
    fits_all = most < _NOISE and max(plain.values()) > _CLEAR * max(most, 1.0)
    late = bool((clock.shifts > 0.0).any()) and not clock.drifts.any()
    if fits_all and (not late or _fed_back(study, clock.ports)):
        return [Problem(place, what, remedy=f"All fits if {cause}: {remedy}.")], []
    what += "; another clock explains that, and so may a delay or another dynamic effect of the machine"
    return [], [Warned(place=place, what=what, remedy=f"Rule out that {cause}: {remedy}.")]


def _bounded(study: PortStudy, run: PortRun, given: Mapping[Port, Array]) -> dict[Port, Array]:
    """Logs of the compared ports, without single samples far beyond the range of the model's signals."""
    found = {}
    for port in study.compared:
        if port in run.logs:
            low, high = float(given[port].min()), float(given[port].max())
            more = _BEYOND * max(high - low, _noise(study, port))
            log = np.clip(run.logs[port], low - more, high + more)
            right = log == run.logs[port]
            if 1.0 - _FEW <= np.mean(right) < 1.0:
                log = np.interp(np.arange(len(log)), np.flatnonzero(right), log[right])
            found[port] = log
    return found


def _noise(study: PortStudy, port: Port) -> float:
    return float(study.columns[port].noise or 1.0)


def _residuals(study: PortStudy, logs: Signals, given: Signals) -> dict[str, dict[Port, Array]]:
    """Residuals over the noise, once settled."""
    return {
        name: {
            port: (log - given[name][port])[study.settled :] / _noise(study, port)
            for port, log in own.items()
        }
        for name, own in logs.items()
    }


def _squares(study: PortStudy, residuals: Signals) -> dict[Port, float]:
    """Mean square of the residuals of each port over all runs."""
    found = {}
    for port in study.compared:
        parts = [own[port] for own in residuals.values() if port in own]
        if parts:
            found[port] = float(np.mean(np.concatenate(parts) ** 2))
    return found


def _groups(study: PortStudy) -> Iterator[frozenset[Port]]:
    """Compared columns that may come from one device, or be all but those of one.

    A column alone, all of a component, all whose names are equal up to a dot, a slash or an underscore, and
    all that are compared. Fed ones among them are examined where all fed ones are.
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


def _near(study: PortStudy, logs: Signals, given: Signals, before: Mapping[Port, float]) -> list[_Clock]:
    """Groups of columns that fit better if shifted by whole samples in each run, best first."""
    whole = sum(_excess(one) for one in before.values())
    longest = int(_LONGEST * (min(map(len, study.runs)) - study.settled))
    curves = {
        (name, port): _shifted(study, log, given[name][port], port, longest)
        for name, own in logs.items()
        for port, log in own.items()
    }
    found = []
    for ports in _groups(study):
        shifts, total = [], dict.fromkeys(ports, 0.0)
        for name, own in logs.items():
            curve = sum((curves[name, port] for port in ports if port in own), np.zeros(2 * longest + 1))
            shifts.append(int(np.argmin(curve)) - longest)
            for port in ports & set(own):
                logged = sum(port in one for one in logs.values())
                total[port] += curves[name, port][shifts[-1] + longest] / logged
        rest = sum(map(_excess, total.values()))
        rest += sum(_excess(one) for port, one in before.items() if port not in ports)
        if any(shifts) and rest < _NEAR * whole:
            found.append((rest, _Clock(ports, np.array(shifts, float), np.zeros(len(shifts)))))
    return [one for _, one in sorted(found, key=lambda each: each[0])[:_KEPT]]


def _excess(square: float) -> float:
    return max(square - 1.0, 0.0)


def _ratio(after: Mapping[Port, float], before: Mapping[Port, float]) -> float:
    """Share of the excess that remains or is new; ports count by the logarithm of theirs."""
    total = whole = 0.0
    for port in after:
        rest, most = _excess(after[port]), max(_excess(after[port]), _excess(before[port]))
        total += np.log1p(most) * rest / max(most, _MISSED)
        whole += np.log1p(most)
    return float(total / whole) if whole > 0.0 else 1.0


def _shifted(study: PortStudy, log: Array, signal: Array, port: Port, longest: int) -> Array:
    """Mean square residual over that of the noise, if a log is late by -longest to longest samples.

    Returns: shape (2 longest + 1,).
    """
    from scipy.signal import correlate  # takes a second to load, and logs are read first

    middle = float(log.mean())
    log, model = log - middle, signal[study.settled :] - middle
    n, m = len(log), len(model)
    # The model's sample k stands at settled + k of the run, and so does the log's once it is moved.
    late = np.arange(-longest, longest + 1) + study.settled
    first, last = np.maximum(late, 0), np.minimum(late + m, n)
    together = correlate(log, model, method="fft")[late + m - 1]
    ends = np.concatenate([[0.0], np.cumsum(log**2)]), np.concatenate([[0.0], np.cumsum(model**2)])
    total = ends[0][last] - ends[0][first] + ends[1][last - late] - ends[1][first - late] - 2.0 * together
    found: Array = total / np.maximum(last - first, 1.0) / _noise(study, port) ** 2
    return found


def _sensitivities(replay: Replay, given: Signals) -> dict[str, dict[Port, Array]]:
    """Derivatives of the simulated signals with respect to the calibrated parameters.

    Returns: by run and port, each of shape (samples, parameters), per tolerance.
    """
    found: dict[str, dict[Port, Array]] = {}
    for run in replay.study.runs:
        columns: dict[Port, list[Array]] = {port: [] for port in given[run.name]}
        for name, one in replay.study.nominal.items():
            other = replay.signals(run, {name: one.value + _STEP * one.tolerance})
            for port, own in columns.items():
                with np.errstate(invalid="ignore", over="ignore"):
                    slope = (other[port] - given[run.name][port]) / _STEP
                own.append(slope if np.isfinite(slope).all() else np.zeros(len(run)))
        found[run.name] = {
            port: np.column_stack(own) if own else np.zeros((len(run), 0)) for port, own in columns.items()
        }
    return found


def _calibrated(residuals: Signals, slopes: Signals, study: PortStudy) -> dict[str, dict[Port, Array]]:
    """Residuals without what calibration explains, within tolerances, by linear least squares."""
    keys = [(name, port) for name, own in residuals.items() for port in own]
    r = np.concatenate([residuals[name][port] for name, port in keys])
    a = np.vstack([slopes[name][port][study.settled :] / _noise(study, port) for name, port in keys])
    r = r - a @ np.linalg.solve(a.T @ a + np.eye(a.shape[1]), a.T @ r)
    ends = np.cumsum([len(residuals[name][port]) for name, port in keys])[:-1]
    found: dict[str, dict[Port, Array]] = {name: {} for name in residuals}
    for (name, port), part in zip(keys, np.split(r, ends), strict=True):
        found[name][port] = part
    return found


def _fitted(study: PortStudy, logs: Signals, given: Signals, slopes: Signals, clock: _Clock) -> _Clock:
    """The clock with fitted shifts; with fitted drifts, too, if these explain much more."""
    plain, drifting = (_least(study, logs, given, slopes, clock, drift) for drift in (False, True))
    if drifting.residual < _BETTER * plain.residual and np.abs(drifting.drifts).max() >= _DRIFTS:
        return drifting
    return plain


def _least(
    study: PortStudy, logs: Signals, given: Signals, slopes: Signals, clock: _Clock, drift: bool
) -> _Clock:
    """Shifts, drifts and calibrated parameters by Gauss-Newton steps from the clock's shifts on."""
    from scipy.interpolate import Akima1DInterpolator

    count = len(study.runs)
    x = np.concatenate([clock.shifts, np.zeros(count)])
    best = clock
    for _ in range(_STEPS):
        size = 2 * count + len(study.nominal)
        normal, right, square, samples = np.eye(size), np.zeros(size), 0.0, 0
        for number, run in enumerate(study.runs):
            k = np.arange(len(run), dtype=float)
            part = k / len(run)
            for port, log in logs[run.name].items():
                own = port in clock.ports
                at = k - (x[number] + x[count + number] * part) * own
                inside = (at >= study.settled) & (at <= k[-1])
                at, noise = at[inside], _noise(study, port)
                curve = Akima1DInterpolator(k, given[run.name][port])
                r = (log[inside] - curve(at)) / noise
                j = np.zeros((len(r), size))
                if own:
                    j[:, number] = curve.derivative()(at) / noise
                    j[:, count + number] = j[:, number] * part[inside] * drift
                j[:, 2 * count :] = -slopes[run.name][port][np.round(at).astype(int)] / noise
                normal += j.T @ j
                right += j.T @ r
                square += float(r @ r)
                samples += len(r)
        step = -np.linalg.solve(normal, right)
        calibration = np.where(np.arange(size) < 2 * count, 0.0, step)
        square += float(2.0 * calibration @ right + calibration @ normal @ calibration)
        if square / samples < best.residual:
            best = _Clock(clock.ports, x[:count], x[count:], square / samples)
        x = x + np.clip(step[: 2 * count], -_FARTHEST, _FARTHEST)
    return best


def _rows(
    clock: _Clock, number: int, count: int
) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """What a run's corrected rows are of its own ones, of the group's columns and of the others.

    Returns: two functions of arrays whose first axis is that of the run's samples.
    """
    shift, drift = clock.shifts[number], clock.drifts[number]
    if not drift:
        late = round(shift)
        ends = count - abs(late)
        first = max(late, 0), max(-late, 0)
        return (lambda log: log[first[0] : first[0] + ends]), (lambda log: log[first[1] : first[1] + ends])
    # The sample that belongs to time k stands at k + late(k) of the log.
    k = np.arange(count, dtype=float)
    at = (k + shift) / (1.0 - drift / count)
    first, last = int(np.argmax(at >= 0.0)), int(np.sum(at <= count - 1.0))
    return (lambda log: np.interp(at[first:last], k, log)), (lambda log: log[first:last])


def _moved(study: PortStudy, clock: _Clock) -> PortStudy:
    """The study with the clock of the columns corrected."""
    runs = []
    for number, run in enumerate(study.runs):
        own, other = _rows(clock, number, len(run))
        logs = {port: (own if port in clock.ports else other)(log) for port, log in run.logs.items()}
        runs.append(replace(run, logs=logs))
    return replace(study, runs=tuple(runs))


def _fed_back(study: PortStudy, ports: frozenset[Port]) -> bool:
    """Whether some other compared signal depends on these, so that a delay of them would change it."""
    compared, fed = set(study.compared), set(study.fed)
    asked, seen = set(ports), set(ports)
    while asked:
        port = asked.pop()
        for one in study.prepared.system.connections:
            if port not in one.sources or one.target in fed:
                continue
            name = one.target.instance
            outputs = {other for other in study.prepared.system.recorded if other.instance == name}
            asked |= outputs - seen - fed
            seen |= outputs
    return bool((seen & compared) - ports)


def _described(study: PortStudy, clock: _Clock) -> tuple[str, str, str]:
    """Where a clock is wrong, how, and what to do, in words."""
    ports = [port for port in study.columns if port in clock.ports]
    columns = "column" if len(ports) == 1 else "columns"
    names = ", ".join(study.columns[port].column for port in ports)
    place, cause = ", ".join(map(str, ports)), f"the clock of {columns} {names} is "
    late = np.round(clock.shifts) * study.interval
    if clock.drifts.any():
        each = [
            f"{'fast' if drift > 0.0 else 'slow'} by {1e6 * abs(drift) / len(run):.3g} ppm, "
            f"{_way(shift * study.interval)} at the begin of {run.name}"
            for run, shift, drift in zip(study.runs, clock.shifts, clock.drifts, strict=True)
        ]
        return place, cause + "; ".join(each), "correct the stamps of these columns, and resample them"
    if np.ptp(late) > 0.0:
        each = [f"{_way(one)} in {run.name}" for run, one in zip(study.runs, late, strict=True)]
        return place, cause + ", ".join(each), "correct the stamps of these columns in each log"
    shift = float(late[0])
    clocks = {port: study.columns[port].clock + shift for port in ports}
    if len(set(clocks.values())) == 1:
        remedy = f"give {'it' if len(ports) == 1 else 'each'} `clock: {clocks[ports[0]]:.6g} s`"
    else:
        remedy = "give " + ", ".join(f"{port} `clock: {value:.6g} s`" for port, value in clocks.items())
    others = [port for port in study.columns if port not in clock.ports]
    if others and set(others) <= set(study.fed):
        fed = ", ".join(study.columns[port].column for port in others)
        back = {port: study.columns[port].clock - shift for port in others}
        same = len(set(back.values())) == 1
        give = f"`clock: {back[others[0]]:.6g} s`" if same else "each a `clock` that is as much less"
        other = "early" if shift > 0.0 else "late"
        remedy += f"; or, if that of {fed} is {other} by as much, {give} there"
    return place, cause + _way(shift), remedy


def _way(shift: float) -> str:
    """A shift [s] in words."""
    return f"{'late' if shift >= 0.0 else 'early'} by {abs(shift):.6g} s"
