"""Predicted runs of a future experiment by one candidate, for other candidates to replay."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .catalogue import catalogue
from .effect import Effect, by_effect
from .finding import Augmented
from .fit import Replay
from .menu import Experiment
from .model import RigModel
from .motion import stopped_at
from .rig import CHANNELS
from .software import ControllerReplay, DynamicsReplay
from .study import Array, Role, Run, Study

# Radius of gyration that the catalogue's mass-offset takes [m].
_GYRATION = 1.0
# How far the tip is moved by a compliance that the catalogue writes as a change of the force: [m] by force.
_BENDS: Mapping[str, Callable[[Array, Array], Array]] = {
    "structure.compliance": lambda theta, force: theta[0] * force,
}


@dataclass(frozen=True)
class Chain:
    """Replays whose residuals are weighed together; the first one's calibration is that of all.

    Attributes:
        replays: of the same runs.
    """

    replays: tuple[Replay, ...]

    @staticmethod
    def of(study: Study, runs: Sequence[Run], effects: Sequence[Effect]) -> Chain:
        """Robot to sensor, and the software with effects of a list; the rest has no residual."""
        replays: list[Replay] = [RigModel(study, runs)]
        places = {one.place for one in effects}
        replays += [DynamicsReplay(study, runs)] if "dynamics" in places else []
        replays += [ControllerReplay(study, runs)] if "controller" in places else []
        return Chain(tuple(replays))

    @property
    def tolerances(self) -> Mapping[str, tuple[float, float]]:
        """See `Replay`."""
        return self.replays[0].tolerances

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`."""
        return [part for one in self.replays for part in one.residuals(calibrated, effects, theta)]


class Trial:
    """An experiment's runs as one candidate predicts them, for others to replay: a `Replay`.

    Args:
        study: with at least one training run, whose digits, first mass and speed are taken.
        cause: the candidate that makes the logs, without noise.
        effects: of all candidates; where none of them is in a piece of software, that leaves no residual.
    """

    def __init__(
        self, study: Study, experiment: Experiment, cause: Augmented, effects: Sequence[Effect]
    ) -> None:
        self.experiment = experiment
        first = study.of(Role.TRAIN)[0]
        stiffness = study.nominal["contact_stiffness"]
        rod = replace(
            stiffness, value=experiment.rod * stiffness.value, tolerance=experiment.rod * stiffness.tolerance
        )
        self.study = replace(study, nominal={**study.nominal, "contact_stiffness": rod})
        rig = RigModel(self.study, [])
        self.tolerances: Mapping[str, tuple[float, float]] = rig.tolerances
        still = experiment.motion is not None
        speed = 0.0 if still else experiment.approach_speed or first.approach_speed
        run = Run("trial", Role.TRAIN, experiment.mass or first.mass, speed, {})
        calibrated, theta = dict(cause.calibrated), cause.theta
        # Another rod's stiffness is off by as many tolerances as the present one's.
        calibrated["contact_stiffness"] = experiment.rod * calibrated.get(
            "contact_stiffness", stiffness.value
        )
        self.runs = tuple(
            self._logged(run, lever, calibrated, cause.effects, theta) for lever in experiment.levers
        )
        self._rigs = [RigModel(self.study, [run]) for run in self.runs]
        self._software = [
            [] if still else list(Chain.of(self.study, [run], effects).replays[1:]) for run in self.runs
        ]
        for run, replays in zip(self.runs, self._software, strict=True):
            # Predicted logs have all digits; real ones will have those of the runs at hand.
            for one in replays:
                (noise,) = type(one)(study, [first]).noise
                one.noise = [noise * first.mass / run.mass if isinstance(one, DynamicsReplay) else noise]
        self._tips = [
            self._tip(*self._replay(rig, lever, calibrated, cause.effects, theta))
            for rig, lever in zip(self._rigs, experiment.levers, strict=True)
        ]

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`."""
        found = []
        for place, (rig, lever) in enumerate(zip(self._rigs, self.experiment.levers, strict=True)):
            out, acting, values = self._replay(rig, lever, calibrated, effects, theta)
            (run,) = rig.runs
            found.append((run["encoder_position"] - out[2]) / rig.noise[0])
            found.append((run["sensor_force"] - out[3]) / rig.noise[1])
            if self.experiment.tracker:
                tip = self._tip(out, acting, values)
                found.append((self._tips[place] - tip) / self.experiment.tracker)
            for software in self._software[place]:
                found += software.residuals(calibrated, acting, values)
        return found

    def _acting(
        self, lever: float, effects: tuple[Effect, ...], theta: Array
    ) -> tuple[tuple[Effect, ...], Array]:
        """Effects in the experiment: the load first, then the others, as the lever changes them."""
        load = self.experiment.load
        acting = [] if load is None else [load.effect]
        values = [] if load is None else list(load.theta)
        for effect, found in by_effect(effects, theta):
            own = found.tolist()
            if lever and effect.id == "dynamics.mass-offset":
                # The software knows of the lever, not of the offset; what it lacks is a factor of the mass.
                known, true = (1.0 + (arm / _GYRATION) ** 2 for arm in (lever, lever + own[0]))
                effect, own = catalogue()["dynamics.mass"], [known / true - 1.0]
            acting.append(effect)
            values += own
        return tuple(acting), np.array(values)

    def _replay(
        self,
        rig: RigModel,
        lever: float,
        calibrated: Mapping[str, float],
        effects: tuple[Effect, ...],
        theta: Array,
    ) -> tuple[Array, tuple[Effect, ...], Array]:
        acting, values = self._acting(lever, effects, theta)
        return rig.replay(0, calibrated, acting, values), acting, values

    def _tip(self, out: Array, acting: tuple[Effect, ...], values: Array) -> Array:
        """Position of the rod's tip, shape (n,) [m]."""
        tip = out[7].copy()
        for effect, own in by_effect(acting, values):
            if effect.id in _BENDS:
                tip += _BENDS[effect.id](own, out[6])
        return tip

    def _logged(
        self,
        run: Run,
        lever: float,
        calibrated: Mapping[str, float],
        effects: tuple[Effect, ...],
        theta: Array,
    ) -> Run:
        """A run's log as the cause makes it."""
        ticks, tick = self.experiment.ticks, self.study.tick
        time = np.arange(ticks) * tick
        # The software is reported the mass that acts along the moved line.
        run = replace(run, mass=run.mass / (1.0 + (lever / _GYRATION) ** 2))
        columns = {name: np.zeros(ticks) for name in (*CHANNELS[:6], "time")} | {"time": time}
        if self.experiment.motion is not None:
            position = self.experiment.motion(time)
            columns["desired_position"] = position
            columns["desired_velocity"] = np.gradient(position, tick)
            rig = RigModel(self.study, [replace(run, columns=columns)])
            out, _, _ = self._replay(rig, lever, calibrated, effects, theta)
            columns["encoder_position"], columns["sensor_force"] = out[2], out[3]
            return replace(run, columns=columns)
        acting, values = self._acting(lever, effects, theta)
        out = RigModel(self.study, [replace(run, columns=columns)]).closed_loop(0, calibrated, acting, values)
        end = stopped_at(out[0])
        columns = dict(zip(CHANNELS, out[:6, :end], strict=False)) | {"time": time[:end]}
        return replace(run, columns=columns)
