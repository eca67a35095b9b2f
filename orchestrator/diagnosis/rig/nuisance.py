"""Nuisance deviations that every rig has: starts of runs, excess noise, roughness."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from .effect import Effect, Seen
from .fit import Fit, Fitter, Replay
from .misfit import wave
from .model import RigModel
from .rig import Calibrated
from .search import roughness
from .study import Array, Run

# Standard deviation of the position at which contacts begin, on every rig [m].
_SCATTER = 1e-6
# First ticks of a run that say nothing: how the robot is moving when a log begins is not known as well as
# the encoder sees it. A servo as that of the docking rig has forgotten it to a thousandth by then.
SETTLED = 20
# A wave of the encoder's scale that is no larger than this, in standard deviations of its noise, is roughness
# of every rig; its own standard deviation, and the log evidence from which it is reckoned with [nats].
WAVY, _WAVE, _WAVING = 1.0, 0.3, 10.0
# Factor on tolerances that are not trusted.
WIDER = 2.5


class Weighted:
    """A replay whose residuals have lower weights where the noise exceeds its specification.

    Args:
        weights: by channel, one per sample.
    """

    def __init__(self, replay: Replay, weights: Sequence[Array]) -> None:
        self.replay = replay
        self.weights = tuple(weights)

    @property
    def tolerances(self) -> Mapping[str, tuple[float, float]]:
        """See `Replay`."""
        return self.replay.tolerances

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`."""
        found = self.replay.residuals(calibrated, effects, theta)
        return [r * weight for r, weight in zip(found, self.weights, strict=True)]

    def seen(self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array) -> Seen:
        """See `Replay`."""
        return self.replay.seen(calibrated, effects, theta)


class Widened(Weighted):
    """A replay with wider tolerances of the calibration."""

    @property
    def tolerances(self) -> Mapping[str, tuple[float, float]]:
        """See `Replay`."""
        return {name: (centre, WIDER * width) for name, (centre, width) in self.replay.tolerances.items()}


def settling_weights(ticks: int) -> Array:
    """Weights of a run's samples: none while it settles, shape (ticks,)."""
    weight = np.ones(ticks)
    weight[:SETTLED] = 0.0
    return weight


def force_weights(runs: Sequence[Run], noise_factor: float, lost: bool) -> list[Array]:
    """Weights of samples, by run and channel, for force noise above its specification.

    Args:
        louder: by which its deviation is; lost: whether samples that repeat the one before say nothing.
    """
    weights = []
    for run in runs:
        force = settling_weights(len(run)) / noise_factor
        if lost:
            force[repeating(run["sensor_force"])] = 0.0
        weights += [settling_weights(len(run)), force]
    return weights


def repeating(samples: Array) -> Array:
    """Whether each sample equals the one before, shape (n,)."""
    return np.concatenate([[False], np.diff(samples) == 0.0])


def positions(model: RigModel, fit: Fit) -> list[Array]:
    """Positions of the robot that a fit gives at each tick, by run [m]."""
    own = fit.calibrated, fit.effects, fit.theta
    return [model.replay(index, *own)[2] for index in range(len(model.runs))]


def touching(model: RigModel, fit: Fit) -> list[Array]:
    """Whether the rod touches a frame at each tick, by run."""
    found = []
    for index in range(len(model.runs)):
        p = model.parameters(index, fit.calibrated, fit.effects, fit.theta)
        at = model.replay(index, fit.calibrated, fit.effects, fit.theta)[7]
        found.append((at > p[Calibrated.FRONT_WALL]) | (at < p[Calibrated.REAR_WALL]))
    return found


@dataclass(frozen=True)
class Weighing:
    """Data and options for weighing the effects of a rig.

    Attributes:
        effects: to weigh; roughness along them is marginalised.
        rough: see `Calibration.roughness`.
        weights: of the samples, by run and channel; a list, whose arrays are replaced as noise is found.
        about: the model beside which roughness acts; the nominal one by default.
        known: the last roughness, by what it was found with: a weighing asks for it up to four times.
    """

    model: RigModel
    effects: tuple[Effect, ...]
    rough: Mapping[str, Sequence[float]]
    weights: list[Array]
    about: Fit | None = None
    known: dict[bytes, Array] = field(default_factory=dict, compare=False, repr=False)

    @staticmethod
    def of(model: RigModel, effects: Sequence[Effect], rough: Mapping[str, Sequence[float]]) -> Weighing:
        """Equal weights for all samples, zero before a run is settled."""
        weights = [settling_weights(len(run)) for run in model.runs for _ in range(2)]
        return Weighing(model, tuple(effects), rough, weights)

    def roughness(self) -> Array:
        """See `search.roughness`."""
        key = b"".join(one.tobytes() for one in (*self.weights, *self.model.correction))
        if key not in self.known:
            self.known.clear()
            replay = Weighted(self.model, self.weights)
            self.known[key] = roughness(Fitter(replay), self.effects, self.rough, self.about)
        return self.known[key]

    def linearised_about(self, about: Fit) -> Weighing:
        """The same with roughness linearised beside a model's effects, for the same samples."""
        return replace(self, about=about, known={})

    def fitter(self, further: Array | None = None, scattered: Array | None = None) -> Fitter:
        """A fitter in which roughness along effects, and in further directions, is marginalised.

        Args:
            further: columns as those of `search.roughness`; scattered: such as are looked at by themselves,
                too, see `Marginal.roughness_evidence`.
        """
        columns = [self.roughness(), *(one for one in (further, scattered) if one is not None)]
        apart = 0 if scattered is None else scattered.shape[1]
        return Fitter(Weighted(self.model, self.weights), 1.0, np.hstack(columns), apart)


def scatter(model: RigModel, replay: Replay, fit: Fit) -> Array:
    """Derivatives of the residuals by the start time of each contact.

    Returns: one column per contact, scaled to one standard deviation, shape (residuals, contacts).
    """
    plain = replay.residuals(fit.calibrated, fit.effects, fit.theta)
    ends = np.cumsum([0, *map(len, plain)])
    columns = []
    for name in ("front_wall", "rear_wall"):
        at = fit.calibrated.get(name, model.study.nominal[name].value)
        moved = {**fit.calibrated, name: at + _SCATTER}
        found = replay.residuals(moved, fit.effects, fit.theta)
        for index, touched in enumerate(touching(model, fit)):
            channel = 2 * index + 1
            change = found[channel] - plain[channel]
            begins = np.flatnonzero(np.diff(touched.astype(int), prepend=0) == 1)
            for first, last in pairwise([*begins.tolist(), len(change)]):
                if np.abs(change[first:last]).max(initial=0.0) > 0.0:
                    column = np.zeros(ends[-1])
                    column[ends[channel] + first : ends[channel] + last] = change[first:last]
                    columns.append(column)
    return np.column_stack(columns) if columns else np.zeros((ends[-1], 0))


def along_way(model: RigModel, left: Sequence[Array]) -> float:
    """Share of the encoder residual that a wave along the robot's position explains.

    Args:
        left: normalised residuals, by run and channel.
    """
    total = sum(float(r @ r) for r in left[0::2])
    gain, _, _ = wave(left[0::2], [run["encoder_position"] for run in model.runs])
    return 2.0 * gain / total if total > 0.0 else 0.0


def waves(
    model: RigModel, left: Sequence[Array], weights: Sequence[Array], largest: float = WAVY
) -> Array | None:
    """Directions of a wave of the encoder's scale, if there is a small one, shape (residuals, 2).

    Args:
        largest: amplitude of what is small, in standard deviations of the noise.
    """
    positions = [run["encoder_position"] for run in model.runs]
    gain, pitch, amplitude = wave(left[0::2], positions)
    if gain < _WAVING or amplitude > largest:
        return None
    columns = []
    for function in (np.cos, np.sin):
        parts = []
        for index, position in enumerate(positions):
            parts.append(_WAVE * function(2.0 * math.pi / pitch * position) * weights[2 * index])
            parts.append(np.zeros(len(position)))
        columns.append(np.concatenate(parts))
    return np.column_stack(columns)
