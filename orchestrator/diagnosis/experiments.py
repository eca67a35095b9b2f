"""What to run next: the experiment that is expected to tell tied candidates apart best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np

from .catalogue import catalogue
from .effect import Effect
from .finding import Augmented, Candidate, Finding
from .fit import Fitter, Replay
from .menu import MENU, Experiment
from .model import RigModel
from .rig import CHANNELS
from .software import ControllerReplay, DynamicsReplay
from .study import Array, Role, Run, Study

__all__ = ["Chain", "Posterior", "Trial", "expected_evidence", "next_experiment", "posterior"]

# Radius of gyration that the catalogue's mass-offset takes [m].
_GYRATION = 1.0
# Candidates at least this probable are rivals of the first; evidence from which two count as told apart [nats].
_RIVAL, _TOLD_APART = 0.01, 10.0
_ITERATIONS = 4
# The rig's stop [m], and the shortest run that tells anything [ticks].
_STOP, _SHORTEST = 0.08, 20
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
    def of(study: Study, runs: Sequence[Run]) -> Chain:
        """The whole rig: robot to sensor, satellite and controller software."""
        return Chain((RigModel(study, runs), DynamicsReplay(study, runs), ControllerReplay(study, runs)))

    @property
    def tolerances(self) -> Mapping[str, tuple[float, float]]:
        """See `Replay`."""
        return self.replays[0].tolerances

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`."""
        return [part for one in self.replays for part in one.residuals(calibrated, effects, theta)]


@dataclass(frozen=True)
class Posterior:
    """What the runs at hand tell of a candidate's parameters.

    Attributes:
        z: all parameters, normalised by their priors; precision: their inverse covariance.
    """

    effects: tuple[Effect, ...]
    z: Array
    precision: Array


def posterior(study: Study, model: Augmented, inflation: float = 1.0) -> Posterior:
    """Laplace's approximation at a fitted model, from the training runs."""
    fitter = Fitter(Chain.of(study, study.of(Role.TRAIN)), inflation)
    z = fitter.normalised(model.calibrated, model.effects, model.theta)
    r = np.concatenate(fitter.residuals(model.effects, z)) / sqrt(inflation)
    jacobian = fitter.jacobian(model.effects, z, r, range(len(z)))
    return Posterior(model.effects, z, jacobian.T @ jacobian + np.eye(len(z)))


class Trial:
    """An experiment's runs as one candidate predicts them, for others to replay: a `Replay`.

    Args:
        study: with at least one training run, whose digits and first mass and speed are taken.
        cause: the candidate that makes the logs, without noise.
    """

    def __init__(self, study: Study, experiment: Experiment, cause: Posterior) -> None:
        self.experiment = experiment
        first = study.of(Role.TRAIN)[0]
        stiffness = study.nominal["contact_stiffness"]
        rod = replace(
            stiffness, value=experiment.rod * stiffness.value, tolerance=experiment.rod * stiffness.tolerance
        )
        self.study = replace(study, nominal={**study.nominal, "contact_stiffness": rod})
        self._noise = (
            DynamicsReplay(study, [first]).noise[0] * first.mass,
            ControllerReplay(study, [first]).noise[0],
        )
        still = experiment.motion is not None
        mass = experiment.mass or first.mass
        speed = 0.0 if still else experiment.approach_speed or first.approach_speed
        run = Run("trial", Role.TRAIN, mass, speed, {})
        fitter = Fitter(RigModel(self.study, []))
        calibrated, theta = fitter.values(cause.effects, cause.z)
        self.runs = tuple(
            self._logged(run, lever, calibrated, cause.effects, theta) for lever in experiment.levers
        )
        self._tips = [
            self._tip(*self._replay(run, lever, calibrated, cause.effects, theta))
            for run, lever in zip(self.runs, experiment.levers, strict=True)
        ]

    @property
    def tolerances(self) -> Mapping[str, tuple[float, float]]:
        """See `Replay`."""
        return RigModel(self.study, []).tolerances

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`."""
        found = []
        for run, lever, tip in zip(self.runs, self.experiment.levers, self._tips, strict=True):
            out, acting, values = self._replay(run, lever, calibrated, effects, theta)
            noise = RigModel(self.study, []).noise
            found.append((run["encoder_position"] - out[2]) / noise[0])
            found.append((run["sensor_force"] - out[3]) / noise[1])
            if self.experiment.tracker:
                found.append((tip - self._tip(out, acting, values)) / self.experiment.tracker)
            if self.experiment.motion is None:
                for software, sigma in (
                    (DynamicsReplay(self.study, [run]), self._noise[0] / run.mass),
                    (ControllerReplay(self.study, [run]), self._noise[1]),
                ):
                    software.noise = [sigma]
                    found += software.residuals(calibrated, acting, values)
        return found

    def _acting(
        self, lever: float, effects: tuple[Effect, ...], theta: Array
    ) -> tuple[tuple[Effect, ...], Array]:
        """What acts in the experiment: the load first, then the effects, as the lever changes them."""
        load = self.experiment.load
        acting = [] if load is None else [load.effect]
        values = [] if load is None else list(load.theta)
        at = 0
        for effect in effects:
            own = theta[at : at + len(effect.parameters)].tolist()
            at += len(effect.parameters)
            if lever and effect.id == "dynamics.mass-offset":
                # The software knows of the lever, not of the offset; what it lacks is a factor of the mass.
                known, true = (1.0 + (arm / _GYRATION) ** 2 for arm in (lever, lever + own[0]))
                effect, own = catalogue()["dynamics.mass"], [known / true - 1.0]
            acting.append(effect)
            values += own
        return tuple(acting), np.array(values)

    def _replay(
        self,
        run: Run,
        lever: float,
        calibrated: Mapping[str, float],
        effects: tuple[Effect, ...],
        theta: Array,
    ) -> tuple[Array, tuple[Effect, ...], Array]:
        acting, values = self._acting(lever, effects, theta)
        return RigModel(self.study, [run]).replay(0, calibrated, acting, values), acting, values

    def _tip(self, out: Array, acting: tuple[Effect, ...], values: Array) -> Array:
        """Position of the rod's tip, shape (n,) [m]."""
        tip, at = out[7].copy(), 0
        for effect in acting:
            if effect.id in _BENDS:
                tip += _BENDS[effect.id](values[at:], out[6])
            at += len(effect.parameters)
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
        # The software is told the mass that acts along the moved line.
        run = replace(run, mass=run.mass / (1.0 + (lever / _GYRATION) ** 2))
        columns = {name: np.zeros(ticks) for name in (*CHANNELS[:6], "time")} | {"time": time}
        if self.experiment.motion is not None:
            position = self.experiment.motion(time)
            columns["desired_position"] = position
            columns["desired_velocity"] = np.gradient(position, tick)
            out, _, _ = self._replay(replace(run, columns=columns), lever, calibrated, effects, theta)
            columns["encoder_position"], columns["sensor_force"] = out[2], out[3]
            return replace(run, columns=columns)
        acting, values = self._acting(lever, effects, theta)
        out = RigModel(self.study, [replace(run, columns=columns)]).closed_loop(0, calibrated, acting, values)
        beyond = np.flatnonzero(~(np.abs(out[0]) < _STOP))
        end = int(beyond[0]) if beyond.size else ticks
        columns = dict(zip(CHANNELS, out[:6, :end], strict=False)) | {"time": time[:end]}
        return replace(run, columns=columns)


def expected_evidence(
    study: Study,
    experiment: Experiment,
    cause: Posterior,
    rival: Posterior,
    inflation: float = 1.0,
    iterations: int = 1,
) -> float:
    """Evidence that an experiment is expected to give a candidate over a rival, if the candidate is right [nats].

    The rival is fitted to the logs that the candidate predicts, its calibration and parameters held by what
    the runs at hand tell of them: half of the least sum of squared residuals over the noise and of squared
    departures from there. What is left of the noise is the same for both on average.

    Args:
        inflation: by which squared residuals are divided, as in `Fitter`.
        iterations: of Gauss-Newton, damped.
    """
    trial = Trial(study, experiment, cause)
    if min(len(run) for run in trial.runs) < _SHORTEST:
        return 0.0
    fitter = Fitter(trial, inflation)

    def stacked(z: Array) -> Array:
        return np.concatenate(fitter.residuals(rival.effects, z)) / sqrt(inflation)

    def cost_of(r: Array, z: Array) -> float:
        step = z - rival.z
        cost = float(r @ r + step @ rival.precision @ step)
        return cost if np.isfinite(cost) else np.inf

    z = rival.z
    r = stacked(z)
    cost = cost_of(r, z)
    if not np.isfinite(cost):
        return 0.0
    for _ in range(iterations):
        jacobian = fitter.jacobian(rival.effects, z, r, range(len(z)))
        hessian = jacobian.T @ jacobian + rival.precision
        slope = jacobian.T @ r + rival.precision @ (z - rival.z)
        step, before = np.linalg.solve(hessian, slope), cost
        for share in (1.0, 0.3, 0.1):
            r_ahead = stacked(z - share * step)
            cost_ahead = cost_of(r_ahead, z - share * step)
            if cost_ahead < cost:
                z, r, cost = z - share * step, r_ahead, cost_ahead
                break
        if before - cost < 0.01 * cost + 0.1:
            break
    return 0.5 * cost


def next_experiment(
    study: Study, finding: Finding, menu: Sequence[Experiment] = MENU
) -> dict[str, Any] | None:
    """The experiment with the largest expected evidence between the first candidate and its closest rival.

    Rivals are its ties, and other candidates of at least 1 % probability.

    Args:
        menu: to choose from; the user's own experiments are added to it.
    Returns: name, description, expected_evidence [nats] over the rival that is told apart least, between
        (the tied effects, the first candidate's first), evidence by rival, `menu` with the number of each
        experiment, and `then`, the best one for what the first one leaves tied, "" if there is none. None
        where no candidate has a rival that the rig's model holds.
    Raises: ValueError if the menu is empty.
    """
    if not menu:
        raise ValueError("no experiment to choose from")
    inflation = max([1.0, *finding.misfit.values()])
    tied = _tied(study, finding)
    if len(tied) < 2:
        return None
    cause, *rivals = (posterior(study, model, inflation) for model in tied.values())
    names = list(tied)[1:]
    expected = {
        one.name: np.array([expected_evidence(study, one, cause, rival, inflation) for rival in rivals])
        for one in menu
    }
    best = max(menu, key=lambda one: expected[one.name].min())
    # What the linearised fit promises is checked by fitting on, and the next best taken where it was wrong.
    for _ in range(3):
        refined = [expected_evidence(study, best, cause, rival, inflation, _ITERATIONS) for rival in rivals]
        expected[best.name] = np.array(refined)
        better = max(menu, key=lambda one: expected[one.name].min())
        if better is best:
            break
        best = better
    left = np.flatnonzero(expected[best.name] < _TOLD_APART)
    then = max(menu, key=lambda one: expected[one.name][left].min()) if left.size else None
    return {
        "name": best.name,
        "description": best.description,
        "expected_evidence": float(expected[best.name].min()),
        "between": [next(iter(tied)), *names],
        "evidence": dict(zip(names, expected[best.name].tolist(), strict=True)),
        "menu": {name: float(values.min()) for name, values in expected.items()},
        "then": then.name if then is not None and then is not best else "",
    }


def _tied(study: Study, finding: Finding) -> dict[str, Augmented]:
    """The first candidate that the model holds, its ties and other probable ones, by their effects."""
    modelled = [one for one in finding.candidates if one.model is not None and _replayable(one)]
    if not modelled:
        return {}
    first = modelled[0]
    found = {_named(first.effects): first.model or finding.recalibrated}
    alone = {one.effects[0]: one for one in modelled if len(one.effects) == 1}
    for tie in first.ties:
        if tie in alone:
            found[tie] = alone[tie].model or finding.recalibrated
        elif tie in catalogue() and not catalogue()[tie].statistic:
            found[tie] = _fitted(study, catalogue()[tie])
    for one in modelled[1:]:
        if one.probability >= _RIVAL and one.model is not None:
            found.setdefault(_named(one.effects), one.model)
    return found


def _named(effects: tuple[str, ...]) -> str:
    return " + ".join(effects) or "none"


def _replayable(candidate: Candidate) -> bool:
    """Whether all effects act in the model; those known by statistics alone do not."""
    return candidate.model is not None and not any(one.statistic for one in candidate.model.effects)


def _fitted(study: Study, effect: Effect) -> Augmented:
    """A tie that no candidate was fitted for."""
    fitter = Fitter(Chain.of(study, study.of(Role.TRAIN)))
    nominal = fitter.base((), np.zeros(len(fitter.replay.tolerances)))
    _, base, start = fitter.screen(effect, [nominal])
    fit = fitter.fit((effect,), base.z, start, base.jacobian)
    return Augmented(fit.calibrated, fit.effects, fit.theta)
