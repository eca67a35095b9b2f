"""Checks of logs before a diagnosis: mistakes in the data as against faults of the model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...base.errors import Problem, SimulationEnded, StepError
from ...base.parallel import in_time
from ...system.connection import Port
from .channels import clipped, frozen, is_stairs
from .clocks import wrong_clocks
from .mistakes import Mistake, Warned, WarnedOfMaster, merged_problems, plural, wrong_factors, wrong_scales
from .repeats import unlike
from .replay import Replay, with_steps
from .study import Array, PortRun, PortStudy, Role
from .tolerances import wide

Signals = Mapping[Port, Array]

# Misfit of a port, over the variance of its log, above which a mistake is sought. What the misfit may be
# after the correction, and which share of the misfit before.
_WRONG, _FITS, _ENOUGH = 0.25, 0.25, 0.1
# Misfit that counts as none, and share of its misfit that a corrected log may keep.
_SMALL, _HALF = 0.01, 0.5

# Shares of a run, from its begin, that show in turn whether a mistake can explain it, and fewest samples.
_BEGINS, _FEWEST = (0.005, 0.02, 0.1, 0.4), 10
# Seconds that these begins may take.
_LONGEST = 10.0
# A model that moves by no more times the noise is at rest.
_REST = 3.0
# A model runs away whose signal is so many times as large as anything in the log.
_AWAY = 1e6
# A model loses a log that it misses by more than so many variances. It is unstable where a change of the fed
# logs by this share of their spread moves a signal by its own spread.
_LOST, _SLIGHT = 25.0, 1e-3
# Noise that is fed is worth a word where it makes so much of a compared signal's own.
_DRIVEN = 0.3


def check_logs(study: PortStudy) -> tuple[list[Problem], list[Warned]]:
    """Check the logs of a study, and the tolerances that they are held against.

    Returns: problems that forbid a diagnosis, and what a reader should be warned of. Problems are a wrong
        sign or unit, exchanged columns or a wrong clock that explain nearly all that the model misses; logs
        that open a loop which the model needs; runs in which the model runs away, fails or ends.
    """
    stops: dict[str, list[StepError]] = {run.name: [] for run in study.runs}
    replay = Replay(study)
    given = {run.name: replay.signals(run, stops=stops[run.name]) for run in study.runs}
    found = [_mistake(replay, run, given[run.name]) for run in study.runs]
    mistakes = [one for one in found if one is not None]
    refused = merged_problems(mistakes, "the same in {} more run{s}")
    # A mistake of a log that is fed opens no loop.
    unstable, drifting = _opened(replay, given) if not refused else ([], [])
    refused += unstable or _diverging(study, given, stops)
    # Beside a mistake of another kind nothing says about clocks.
    late, doubtful = wrong_clocks(replay, given) if not refused else ([], [])
    return [*refused, *late], [
        *_stuck(study, given),
        *wide(study),
        *doubtful,
        *drifting,
        *_unasked(study),
        *_unlike(study),
        *_driven_by_noise(replay, given),
        *_long_step(study, given),
        *_stairs(study),
        *_unused(study),
    ]


def _compared(study: PortStudy, run: PortRun) -> list[Port]:
    return [port for port in study.compared if port in run.logs]


def _opened(replay: Replay, signals: Mapping[str, Signals]) -> tuple[list[Problem], list[Warned]]:
    """Fed logs with which the model loses the machine, since they open a loop, and without which it follows.

    Returns: a problem where the model is unstable then, which no simulation follows; otherwise a warning. A
        system that only drifts away, as an integrator does, hardly answers to a slight change of the logs.
    """
    study = replay.study
    run = study.of(Role.TRAIN)[0]
    loop = [port for port in study.computed if port in run.logs]
    before = _misfits(study, run, signals[run.name])
    lost = [port for port, misfit in before.items() if misfit > _LOST]
    if not loop or not lost:
        return [], []
    closed = replace(study, fed=tuple(port for port in study.fed if port not in loop))
    after = _misfits(study, run, Replay(closed).signals(run))
    if not max(after.values()) < _LOST:
        return [], []
    draw = np.random.default_rng(0)
    slight = {
        port: run.logs[port] + _SLIGHT * np.std(run.logs[port]) * draw.standard_normal(len(run))
        for port in loop
    }
    other = replay.signals(_with(run, slight))
    with np.errstate(invalid="ignore", over="ignore"):
        moved = [np.std((other[port] - signals[run.name][port])[study.settled :]) for port in lost]
        spread = [np.std(run.logs[port][study.settled :]) for port in lost]
    drifts = all(by < own for by, own in zip(moved, spread, strict=True))
    worst = max(lost, key=lambda one: before[one])
    fed = "their logs are fed, which opens" if len(loop) > 1 else "its log is fed, which opens"
    what = (
        f"{fed} a loop that keeps the model near the logs: it misses {worst} by {before[worst] ** 0.5:.3g} "
    )
    what += f"times the spread of its log, and with the loop closed by {after[worst] ** 0.5:.2g} times"
    remedy = "Leave inputs out of `columns`, and give outputs `feed: false`."
    place = f"{run.name}: {_named(loop)}"
    if drifts:
        return [], [Warned(place=place, what=what, remedy=f"If the answer is implausible: {remedy}")]
    return [Problem(place, what, "logs that the model can follow", remedy)], []


def _diverging(
    study: PortStudy, signals: Mapping[str, Signals], stops: Mapping[str, list[StepError]]
) -> list[Problem]:
    """Runs in which the configured model runs away, fails or ends: the logs do not show then what it lacks.

    Args:
        stops: by run, what ended it, if anything did.
    """
    runaways: list[tuple[str, str]] = []
    found: list[Problem] = []
    for run in study.runs:
        given = signals[run.name]
        begun: dict[Port, int] = {}
        for port in _compared(study, run):
            most = max(float(np.abs(run.logs[port]).max()), float(study.columns[port].noise or 0.0))
            away = np.flatnonzero(~(np.abs(given[port]) <= _AWAY * most))  # what is no number, too
            if away.size:
                begun[port] = int(away[0])
        if not begun:
            continue
        port = min(begun, key=lambda one: begun[one])
        stop = next((one for one in stops[run.name] if one.status != "not finite"), None)
        if stop is not None and np.isnan(given[port][begun[port]]):
            found.append(_stopped(study, run, stop, begun[port] - 1))
        else:
            runaways.append((run.name, f"{port} from {begun[port] * study.interval:.4g} s on"))
    if not runaways:
        return found
    (name, what), *more = runaways
    what += f"; it does in {len(more)} more run{plural(more)}" if more else ""
    allowed = f"within {_AWAY:g} times what was measured, driven by the same inputs"
    remedy = "Check its parameters and what is fed. If a communication step below "
    remedy += f"{float(study.prepared.grid.step_size):.4g} s keeps it bounded, the coupling causes it."
    return [*found, Problem(name, f"the model as configured runs away: {what}", allowed, remedy)]


def _stopped(study: PortStudy, run: PortRun, stop: StepError, last: int) -> Problem:
    """A run that an FMU ended before the log ends.

    Args:
        last: index of the last sample that the model gave; -1: none.
    """
    ended = isinstance(stop, SimulationEnded)
    what = (
        f"the model as configured {'ends' if ended else 'fails'} before the log: {stop.instance} {stop.what}"
    )
    what += f" at {stop.time or 0.0:.6g} s of {(len(run) - 1) * study.interval:.6g} s"
    # With shorter steps it ends up to a step earlier: the sample before is there with all.
    cut = f"Cut the run before it (`to`, {last * study.interval:.6g} s after its first sample), or check "
    remedy = (cut if last > 2 else "Check ") + "what makes it do so: parameters, start values, what is fed."
    return Problem(run.name, what, "a model that runs as long as the log", remedy)


def _unlike(study: PortStudy) -> list[Warned]:
    """Runs that are said to repeat others, but were driven otherwise."""
    found = []
    for run in study.runs:
        of = next((one for one in study.runs if one.name == run.repeats), None)
        for port, differ, spread in () if of is None else unlike(study, run, of):
            what = f"{port} differs from that of {run.repeats}, which it is said to repeat, by {differ:.3g} "
            what += f"{study.unit(port)}, which spreads by {spread:.3g}"
            if run.role is Role.REPEAT:
                what += "; the noise is estimated without this run"
            remedy = "Correct `repeats`: runs with equal inputs show what does not repeat."
            found.append(Warned(place=run.name, what=what, remedy=remedy))
    return found


def _driven_by_noise(replay: Replay, signals: Mapping[str, Signals]) -> list[Warned]:
    """Fed logs whose noise drives the model so that it shows: effects may imitate what it makes."""
    found: list[Warned] = []
    study = replay.study
    run = study.of(Role.TRAIN)[0]
    given = signals[run.name]
    for number, port in enumerate(study.fed):
        noise = study.columns[port].noise
        if not noise or port not in run.logs:
            continue
        more = noise * np.random.default_rng(number).standard_normal(len(run))
        noisier = replay.signals(_with(run, {port: run.logs[port] + more}))
        moved = {
            one: float(np.std((noisier[one] - given[one])[study.settled :]))
            / float(study.columns[one].noise or 1)
            for one in _compared(study, run)
            if one != port
        }
        moved = {one: by for one, by in moved.items() if np.isfinite(by)}
        worst = max(moved, key=lambda one: moved[one], default=None)
        if worst is not None and moved[worst] > _DRIVEN:
            what = "the log is fed, and so is its noise, which moves "
            what += f"{worst} by {moved[worst]:.2g} times its own"
            remedy = (
                "Right where the machine was given this very log, noise and all. Elsewhere effects may "
                "imitate what that makes: leave `feed` out where the model computes the signal itself; where "
                "one reader alone was given the log, as a controller is, map that input instead."
            )
            found.append(Warned(place=str(port), what=what, remedy=remedy))
    return found


def _moved(study: PortStudy, run: PortRun, given: Signals, other: Signals) -> tuple[Port | None, float]:
    """The compared signal that differs most between two simulations, and by how many times its noise."""
    with np.errstate(invalid="ignore", over="ignore"):
        moved = {
            port: float(np.sqrt(np.mean((other[port] - given[port])[study.settled :] ** 2)))
            / float(study.columns[port].noise or 1)
            for port in _compared(study, run)
        }
    worst = max(moved, key=lambda one: moved[one], default=None)
    return worst, moved[worst] if worst is not None and np.isfinite(moved[worst]) else 0.0


def _long_step(study: PortStudy, signals: Mapping[str, Signals]) -> list[Warned]:
    """Compared signals that half the communication step changes by more than their noise."""
    run = study.of(Role.TRAIN)[0]
    halved = with_steps(study, 2)
    if halved is None or not _compared(study, run):
        return []
    worst, size = _moved(study, run, signals[run.name], Replay(halved).signals(run))
    if size <= 1.0:
        return []
    step = f"{float(study.prepared.grid.step_size):.4g} s"
    what = f"half the communication step of {step} changes {worst} by {size:.2g} times its noise"
    remedy = "Set a shorter run.step_size, or `hold` for signals of a digital device. "
    remedy += "Laws may imitate this error."
    return [WarnedOfMaster(place=run.name, what=what, remedy=remedy)]


def _stairs(study: PortStudy) -> list[Warned]:
    """Fed logs that jump and rest in between, but are read as lines between samples, where that shows."""
    run = study.of(Role.TRAIN)[0]
    stairs = [
        port for port in study.fed
        if port in run.logs and port not in study.held and is_stairs(run.logs[port])
    ]  # fmt: skip
    if not stairs:
        return []
    # Over one communication step an FMU holds its inputs anyway.
    study = (with_steps(study, 2) if study.parts == 1 else None) or study
    given = Replay(study).signals(run)
    found = []
    for port in stairs:
        columns = {**study.columns, port: study.columns[port].model_copy(update={"hold": True})}
        held = Replay(replace(study, columns=columns)).signals(run)
        worst, size = _moved(study, run, given, held)
        if size > 1.0:
            what = "the log jumps and rests in between, but is read as a line from sample to sample; held "
            what += f"between samples it changes {worst} by {size:.2g} times its noise"
            remedy = (
                "Set `hold: true` if the signal jumps at its samples, as the command of a digital device. "
            )
            remedy += "Laws may imitate this error."
            found.append(Warned(place=str(port), what=what, remedy=remedy))
    return found


def _unused(study: PortStudy) -> list[Warned]:
    """Keys of the study that an earlier search took."""
    remedy = {"candidates": " List a parameter that may differ under `calibrated`, with a wide tolerance."}
    return [
        Warned(
            place=study.place(key),
            what="has no effect any more: the search needs no list of effects",
            remedy=f"Leave it out.{remedy.get(key, '')}",
        )
        for key in study.unused
    ]


def _unasked(study: PortStudy) -> list[Warned]:
    """Outputs that are fed because they have no noise, which may have been forgotten."""
    what = "is fed, not compared, since it has no `noise`"
    remedy = "Give `noise` to compare it, `feed: true` if it is meant so."
    return [Warned(place=str(port), what=what, remedy=remedy) for port in study.unasked]


def _stuck(study: PortStudy, signals: Mapping[str, Signals]) -> list[Warned]:
    """Channels that are constant, clipped, or frozen for a while in which the model moves on."""
    found = []
    for run in study.runs:
        given = signals[run.name]
        for port, values in run.logs.items():
            place = f"{run.name}: {port}"
            if np.ptp(values) == 0.0:
                what = f"the log is constant, {values[0]:g} {study.unit(port)}"
                found.append(Warned(place=place, what=what, remedy="Check the column."))
                continue
            for one in [*clipped(values), *frozen(values)] if port in study.compared else []:
                # The encoder of an axis at rest stands still, too.
                moved = float(np.ptp(given[port][one.first : one.end]))
                if not moved <= _REST * float(study.columns[port].noise or 0.0):
                    found.append(Warned(place=place, what=one.what, remedy=one.remedy))
    return found


def _mistake(replay: Replay, run: PortRun, given: Signals) -> Mistake | None:
    """The single mistake without which the model misses hardly anything, if there is one.

    Args:
        given: what the model as configured gives.
    """
    study = replay.study
    before = _misfits(study, run, given)
    wrong = [port for port, misfit in before.items() if misfit > _WRONG]
    if not wrong:
        return None
    found = []
    for port, remedy, other in (*_factors(study, run), *_exchanged(study, run)):
        drives = _drives(study, run, other)
        if drives and _hopeless(replay, other, wrong, _ENOUGH * sum(before[one] for one in wrong)):
            continue
        after = _misfits(study, other, replay.signals(other) if drives else given)
        share = sum(after.get(one, np.inf) for one in wrong) / sum(before[one] for one in wrong)
        # A drive at its limit acts as if command and position were exchanged, but the position still misses.
        most = {
            one: left * (1.0 if other.logs[one] is run.logs[one] else _HALF) for one, left in before.items()
        }
        fits = all(
            misfit < _FITS and misfit <= max(most.get(one, _FITS), _SMALL) for one, misfit in after.items()
        )
        if share < _ENOUGH and fits:
            found.append((share, port, remedy))
    if not found:
        return None
    _, port, remedy = min(found, key=lambda one: one[0])
    worst = max(before, key=lambda one: before[one])
    what = f"the model misses {worst} by {before[worst] ** 0.5:.3g} times the spread of its log"
    return Mistake(f"{run.name}: {port}", what, remedy=remedy)


def _hopeless(replay: Replay, run: PortRun, wrong: list[Port], most: float) -> bool:
    """Whether a begin of a run alone leaves more than its misfits may be together, or takes too long.

    A mistake that makes the model run away, as an inverted pendulum that falls or a reaction that heats
    itself, costs the integrators many steps.
    """
    settled = replay.study.settled

    def left(end: int) -> float:
        given = replay.signals(replace(run, logs={port: log[:end] for port, log in run.logs.items()}))
        found = 0.0
        for port in wrong:
            log = run.logs[port][settled:]
            with np.errstate(invalid="ignore", over="ignore"):
                missed = float(np.sum((log[: end - settled] - given[port][settled:]) ** 2))
                found += missed / (len(log) * max(float(np.var(log)), 1e-300))
        return found

    def lost() -> bool:
        return any(not left(settled + max(_FEWEST, int(share * len(run)))) < most for share in _BEGINS)

    return in_time(lost, _LONGEST) is not False


def _drives(study: PortStudy, run: PortRun, other: PortRun) -> bool:
    """Whether two runs may be replayed differently: other logs are fed, or begun from."""
    return any(
        other.logs[port] is not log and (port in study.fed or study.columns[port].start)
        for port, log in run.logs.items()
    )


def _misfits(study: PortStudy, run: PortRun, given: Signals) -> dict[Port, float]:
    """Mean square of what a model misses at each compared port, over the variance of its log."""
    found = {}
    for port in _compared(study, run):
        log = run.logs[port][study.settled :]
        if np.ptp(log) == 0.0:
            continue
        with np.errstate(invalid="ignore", over="ignore"):
            misfit = float(np.mean((log - given[port][study.settled :]) ** 2) / np.var(log))
        found[port] = misfit if np.isfinite(misfit) else np.inf
    return found


def _factors(study: PortStudy, run: PortRun) -> Iterator[tuple[str, str, PortRun]]:
    """What a column is called, the mistake in it as a remedy, and the run without it.

    At each port, since the study may be mistaken there, and at all ports together that the column is of.
    """
    shared = [ports for ports in _columns(study, run) if len(ports) > 1]
    for ports in (*((port,) for port in run.logs), *shared):
        named = _named(ports)
        columns = [study.columns[port] for port in ports]
        factors = (wrong_factors(one.sign, one.unit, study.unit(ports[0])) for one in columns)
        for same in zip(*factors, strict=True):
            logs = {port: run.logs[port] / factor for port, (factor, _) in zip(ports, same, strict=True)}
            yield named, same[0][1], _with(run, logs)
        if len({one.unit for one in columns}) > 1:
            continue  # each is said to be on a scale of its own
        scales = (wrong_scales(study.unit(port), one.unit) for port, one in zip(ports, columns, strict=True))
        for alike in zip(*scales, strict=True):
            logs = {
                port: gain * run.logs[port] + offset
                for port, (gain, offset, _) in zip(ports, alike, strict=True)
            }
            yield named, alike[0][2], _with(run, logs)


def _exchanged(study: PortStudy, run: PortRun) -> Iterator[tuple[str, str, PortRun]]:
    remedy = "All fits if the two are exchanged. Exchange their columns."
    sets = dict.fromkeys((*((port,) for port in run.logs), *_columns(study, run)))
    for ports, others in combinations(sets, 2):
        if not set(ports) & set(others):
            logs = dict.fromkeys(ports, run.logs[others[0]]) | dict.fromkeys(others, run.logs[ports[0]])
            yield f"{_named(ports)}, {_named(others)}", remedy, _with(run, logs)


def _named(ports: Iterable[Port]) -> str:
    return " and ".join(map(str, ports))


def _columns(study: PortStudy, run: PortRun) -> list[tuple[Port, ...]]:
    """The ports of each column of a run's log."""
    found: dict[str, list[Port]] = {}
    for port in run.logs:
        found.setdefault(study.columns[port].column, []).append(port)
    return [tuple(ports) for ports in found.values()]


def _with(run: PortRun, logs: Mapping[Port, np.ndarray]) -> PortRun:
    return replace(run, logs={**run.logs, **logs})
