"""Step 0: components, or chains of them between logged ports, driven by what was measured."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...base.errors import StepError
from ...effects.offset import Offset
from ...fmi import Kind, Value
from ...system.connection import Port
from ..effect import Effect, Parameter, by_effect
from ..finding import Augmented
from ..fit import Fit
from ..study import Array
from .candidates import candidates
from .conjugate import conjugates
from .effect import FEW_LEVELS, PortEffect, Sizes
from .player import Inserted, Player
from .starts import Begun
from .study import PortRun, PortStudy, Role

__all__ = ["PortReplay", "Weighted", "candidates_of", "measure", "player_of"]

# A model that gives this many times as much as was logged has run away.
_RUNAWAY = 100.0
# Numbers that are kept of earlier replays.
_KEPT = 20_000_000


def player_of(study: PortStudy, fed: Sequence[Port], compared: Sequence[Port]) -> Player:
    """What runs the system of a study."""
    prepared, interval = study.prepared, study.prepared.grid.step_size * study.parts
    # Experiments may set other FMUs.
    instances = tuple(
        replace(one, fmu=study.natives.get(getattr(one.fmu, "path", Path()), one.fmu))
        for one in prepared.system.instances
    )
    system = replace(prepared.system, instances=instances)
    return Player(system, prepared.master, interval, fed, compared, study.parts, study.held)


class PortReplay:
    """Runs of a system with its logs played in, compared at its logged outputs: a `Replay`.

    Attributes:
        study, runs: what is replayed.
        player: runs the system.

    Args:
        seen: ports whose signals are given, in place of the compared ones.
    """

    def __init__(self, study: PortStudy, runs: Sequence[PortRun], seen: Sequence[Port] | None = None) -> None:
        self.study, self.runs = study, tuple(runs)
        # Searches come back to the same models with other weights.
        self._kept: OrderedDict[Any, list[Array]] = OrderedDict()
        self._begun: dict[int, Begun] = {}
        self._lock = threading.Lock()
        self.player = player_of(study, study.fed, study.compared if seen is None else seen)

    @property
    def channels(self) -> list[tuple[PortRun, Port]]:
        """Runs and their compared ports, in the order of the residuals."""
        return [(run, port) for run in self.runs for port in self.compared(run)]

    @property
    def tolerances(self) -> Mapping[str, tuple[float, float]]:
        """See `Replay`."""
        return {name: (one.value, one.tolerance) for name, one in self.study.nominal.items()}

    def signals(
        self,
        run: PortRun,
        calibrated: Mapping[str, float],
        effects: Sequence[Effect],
        theta: Array,
        off: Mapping[Port, float] | None = None,
        stops: list[StepError] | None = None,
    ) -> dict[Port, Array]:
        """What a model gives at the ports that are seen, in their units, each of shape (samples,).

        The error of the step is taken off, where the run tells it.

        Args:
            off: by what runs begin elsewhere than at the first samples of ports, in their units.
            stops: see `Player.run`.
        """
        start, inserted = self.made(calibrated, effects, theta)
        for port, column in self.study.columns.items():
            if column.start and port in run.logs:
                start[port] = float(run.logs[port][0]) + (off or {}).get(port, 0.0)
        return self.player.run(run.logs, len(run), start, inserted, run.errors, stops)

    def made(
        self, calibrated: Mapping[str, float], effects: Sequence[Effect], theta: Array
    ) -> tuple[dict[Port, Value], list[Inserted]]:
        """Start values and inserted effects of a model."""
        start: dict[Port, Value] = {
            Port.of(name): calibrated.get(name, one.value) for name, one in self.study.nominal.items()
        }
        inserted: list[Inserted] = []
        for effect, own in by_effect(effects, theta):
            assert isinstance(effect, PortEffect)
            put = effect.inserted(own)
            if put is not None:
                inserted.append(put)
            for name in effect.changes:
                port = Port.of(name)
                before = start[port] if port in start else self.study.prepared.system.start(port)
                start[port] = float(before) + float(own[0])
        return start, inserted

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`: per run, and in it per compared port; less what noise of the first samples makes of
        them, where runs begin at these: see `Begun`.
        """
        families = [one.family for one in effects if isinstance(one, PortEffect) and one.family]
        if len(set(families)) < len(families):
            # Two forms of one cause explain nothing together that a third form of it would not.
            return [np.full(len(run) - self.study.settled, np.nan) for run, _ in self.channels]
        key = tuple(calibrated.items()), tuple(one.id for one in effects), theta.tobytes()
        found = self._kept.get(key)
        if found is None:
            found = self._residuals(calibrated, effects, theta)
            with self._lock:
                self._kept[key] = found
                while len(self._kept) * sum(map(len, found)) > _KEPT:
                    self._kept.popitem(last=False)
        return list(found)

    def _residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        found = []
        for number, run in enumerate(self.runs):
            given = self.signals(run, calibrated, effects, theta)
            own = []
            for port in self.compared(run):
                noise, log = self.study.columns[port].noise, run.logs[port]
                assert noise is not None
                with np.errstate(invalid="ignore", over="ignore"):
                    r = (log - given[port])[self.study.settled :] / noise
                    ran_away = not np.abs(r).max() < _RUNAWAY * (np.abs(log).max() / noise + 1.0)
                # Where a model runs away, fits are to stay out, and not to compare by how far.
                own.append(np.full_like(r, np.nan) if ran_away else r)
            found += self._begin(number).less(own)
        return found

    def _begin(self, number: int) -> Begun:
        """How noise of the first samples deviates a run. About the system as believed: effects and other
        calibrations hardly change what so little makes.
        """
        if number not in self._begun:
            run = self.runs[number]
            ports = [port for port, one in self.study.columns.items() if one.start and one.noise]
            columns = []
            given = self.signals(run, {}, (), np.zeros(0)) if any(one in run.logs for one in ports) else {}
            for port in ports if given else ():
                if port not in run.logs:
                    continue
                size = float(self.study.columns[port].noise or 0.0)
                other = self.signals(run, {}, (), np.zeros(0), {port: size})
                columns.append(np.concatenate([self._moved(one, given, other) for one in self.compared(run)]))
            self._begun[number] = Begun(columns)
        return self._begun[number]

    def _moved(self, port: Port, given: Mapping[Port, Array], other: Mapping[Port, Array]) -> Array:
        with np.errstate(invalid="ignore", over="ignore"):
            moved: Array = (given[port] - other[port])[self.study.settled :] / self.study.columns[port].noise
        return moved

    def of(self, model: Fit | Augmented) -> list[Array]:
        """Residuals of a model."""
        return self.residuals(model.calibrated, model.effects, model.theta)

    def compared(self, run: PortRun) -> list[Port]:
        """The ports that a run is compared at."""
        return [port for port in self.study.compared if port in run.logs]


class Weighted:
    """A replay whose channels count as much as they carry: a `Replay`.

    Args:
        weights: of the channels, in the order of the replay's residuals.
    """

    def __init__(self, replay: PortReplay, weights: Sequence[float]) -> None:
        self.replay, self.weights = replay, tuple(weights)
        self.tolerances = replay.tolerances

    @staticmethod
    def of(replay: PortReplay, by_port: Mapping[Port, float]) -> Weighted:
        """With the weights of ports; others do not count."""
        return Weighted(replay, [by_port.get(port, 0.0) for _, port in replay.channels])

    @property
    def by_port(self) -> dict[Port, float]:
        """Weight of each port."""
        return {port: weight for (_, port), weight in zip(self.replay.channels, self.weights, strict=True)}

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`."""
        found = self.replay.residuals(calibrated, effects, theta)
        return [r * weight for r, weight in zip(found, self.weights, strict=True)]


def candidates_of(study: PortStudy) -> tuple[Effect, ...]:
    """All candidates of a study, their priors made from the signals of its train runs."""
    return candidates(study, measure(study, *study.of(Role.TRAIN)))


def measure(study: PortStudy, *runs: PortRun) -> Sizes:
    """How large the signals of all ports are in some runs, as logged, or else as the system gives them.

    Runs in which a signal is not finite do not count for it.
    """
    system = study.prepared.system
    outputs = [port for port in system.recorded if system.variable(port).kind is Kind.REAL]
    # What connections make of their sources is no source's signal.
    made = [one for one in system.connections if one.wire and system.variable(one.target).kind is Kind.REAL]
    replay = PortReplay(study, runs, seen=[*outputs, *(one.target for one in made)])
    found: dict[Port, list[_Size]] = {}
    given = []
    for run in runs:
        own = replay.signals(run, {}, (), np.zeros(0))
        logged = {port: run.logs[port] for port in (*own, *study.fed) if port in run.logs}
        known = {**own, **logged}
        fed = {one.target: known[one.source] for one in system.connections if one.source in known}
        fed |= {one.target: one.gain * own[one.target] + one.offset for one in made}
        for port, values in {**known, **fed, **logged}.items():
            found.setdefault(port, []).append(_size(study, values))
        given.append({port: own[port] for port in study.compared})
    sizes = _sizes(found)
    forces = {port: _force(PortReplay(study, runs), port, given, sizes) for port in _pushed(study, sizes)}
    return replace(sizes, spread={**sizes.spread, **forces})


class _Size(NamedTuple):
    """How large a signal is in one run: see `Sizes`. Of one that is not finite there are no samples.

    Attributes:
        levels: its values, if they are few, or one more than are.
    """

    spread: float
    peak: float
    rate: float
    way: float
    samples: int
    levels: frozenset[float] = frozenset()


def _size(study: PortStudy, values: Array) -> _Size:
    if not np.isfinite(values).all():
        return _Size(0.0, 0.0, 0.0, 0.0, 0)
    # A little more than the largest change, so that a limit of this rate is none.
    rate = float(np.abs(np.diff(values)).max()) / study.interval * (1.0 + 1e-9)
    about = values[study.settled :] - values[study.settled :].mean()
    way = float(np.cumsum(about).std()) * study.interval
    levels = frozenset(np.unique(values)[: FEW_LEVELS + 1].tolist())
    return _Size(float(about.std()), float(np.abs(values).max()), rate, way, len(about), levels)


def _sizes(found: Mapping[Port, Sequence[_Size]]) -> Sizes:
    """Sizes of ports' signals over all runs."""
    spread, peak, rate, way = {}, {}, {}, {}
    for port, runs in found.items():
        lengths = [one.samples for one in runs]
        spread[port] = _pooled([one.spread for one in runs], lengths)
        peak[port] = max(one.peak for one in runs)
        rate[port] = max(one.rate for one in runs)
        way[port] = _pooled([one.way for one in runs], lengths)
    levels = {port: len(frozenset().union(*(one.levels for one in runs))) for port, runs in found.items()}
    return Sizes(spread, peak, rate, way, levels)


def _pooled(sizes: Sequence[float], lengths: Sequence[int]) -> float:
    """One size for all runs: the root of the mean square over all their samples."""
    whole = max(sum(lengths), 1)
    return math.hypot(*(size * math.sqrt(n / whole) for size, n in zip(sizes, lengths, strict=True)))


def _pushed(study: PortStudy, sizes: Sizes) -> Iterator[Port]:
    """Inputs for the force along a velocity that their instance gives, where nothing moves them."""
    for instance in study.prepared.system.instances:
        for port in dict.fromkeys(one.force for one in conjugates(instance) if one.fed):
            if not sizes.spread.get(port, 0.0) > 0.0:
                yield port


def _force(replay: PortReplay, port: Port, given: Sequence[Mapping[Port, Array]], sizes: Sizes) -> float:
    """The constant force on an input that moves some compared output by its spread; 0 if none does.

    Args:
        given: what the system gives without it, by run.
    """
    settled = replay.study.settled
    unit = Parameter("offset", "1", 1.0)
    push = PortEffect(f"{port}.offset", "", "", (unit,), port=port, make=lambda p: Offset(value=p[0]))
    moved = [replay.signals(run, {}, (push,), np.ones(1)) for run in replay.runs]
    share = 0.0
    for out in replay.study.compared:
        differ = [(one[out] - two[out])[settled:] for one, two in zip(moved, given, strict=True)]
        finite = [values for values in differ if np.isfinite(values).all()]
        shift = [float(values.std() + abs(values.mean())) for values in finite]
        if sizes.spread[out] > 0.0:
            share = max(share, _pooled(shift, list(map(len, finite))) / sizes.spread[out])
    return 1.0 / share if share > 0.0 else 0.0
