"""The rig's software, replayed from its logged inputs: exact to the log's digits where nothing is hidden."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...base.compiled_functions import njit
from .effect import Context, Effect
from .model import Laws, apply_changes, begin_state, nominal_parameters
from .rig import State, control, move_body
from .study import Array, Run, Study


def resolution(values: Array) -> float:
    """The last digit that a column was logged with, in its unit."""
    finite = values[np.isfinite(values)]
    for digits in range(16):
        if np.allclose(finite, np.round(finite, digits), rtol=0.0, atol=1e-6 * 10.0**-digits):
            return 10.0**-digits
    return 1e-15


# In the satellite's sub-steps, velocity first, a tick's way follows its speed at 10/16 of the tick.
_MEAN_SPEED = 0.625


def ways(velocity: Array, tick: float) -> Array:
    """Displacement of the satellite over each tick from its logged velocity, shape (n - 1,) [m]."""
    return tick * (velocity[:-1] + _MEAN_SPEED * np.diff(velocity))


# As machine code takes them.
_AT, _SPEED, _NUMBER, _OF_MASS = map(int, (Context.POSITION, Context.VELOCITY, Context.TICK, Context.MASS))
_KNOWN = len(Context)
_DESIRED, _DESIRED_SPEED, _OUT, _ESTIMATE = map(
    int, (State.DESIRED_POSITION, State.DESIRED_VELOCITY, State.COMPENSATED_FORCE, State.STIFFNESS)
)


@njit(error_model="numpy", nogil=True)
def _bodies(force, position, velocity, mass, tick, laws, memory, theta, out):
    """Mean force on the satellite over each tick, laws included, from logged force and motion."""
    known = np.zeros(_KNOWN)
    known[_OF_MASS] = mass
    for n in range(out.shape[0]):
        known[_AT], known[_SPEED], known[_NUMBER] = position[n], velocity[n], n
        out[n] = move_body(laws, n * tick, tick, force[n], known, memory, theta)


class DynamicsReplay:
    """Satellite software: the change of the desired velocity over each tick, from the logged force.

    Attributes:
        noise: standard deviation of that change by the log's digits alone, one per run [m/s].
    """

    def __init__(self, study: Study, runs: Sequence[Run]) -> None:
        self.study = study
        self.runs = tuple(runs)
        self.noise = [
            np.hypot(
                resolution(run["desired_velocity"]) / np.sqrt(6.0),
                study.tick / run.mass * resolution(run["compensated_force"]) / np.sqrt(12.0),
            )
            for run in runs
        ]

    @property
    def tolerances(self) -> dict[str, tuple[float, float]]:
        """See `Replay`: software has no calibration."""
        return {}

    def force(
        self, index: int, effects: tuple[Effect, ...], memory: Array, theta: Array, ticks: int | None = None
    ) -> Array:
        """Mean force on the satellite over each tick, laws included, shape (ticks,) [N].

        Args:
            memory, theta: of all laws, as `Laws.room` gives them; the memory is left as it is at the end.
            ticks: how many of the run; all by default.
        """
        run, laws = self.runs[index], Laws.of(effects)
        body = run["compensated_force"][:ticks].copy()
        if len(laws.addresses):
            _bodies(
                run["compensated_force"],
                run["desired_position"],
                run["desired_velocity"],
                run.mass,
                self.study.tick,
                laws.table,
                memory,
                theta,
                body,
            )
        return body

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`."""
        found = []
        for index, (run, noise) in enumerate(zip(self.runs, self.noise, strict=True)):
            body = self.force(index, effects, *Laws.of(effects).room(theta))
            change = np.diff(run["desired_velocity"])
            found.append((change - self.study.tick / run.mass * body[:-1]) / noise)
        return found

    def position_drift(self) -> float:
        """Mean square of displacement minus integrated velocity over each tick, over the log's digits.

        Whatever pushes the satellite, it moves as fast as it is.
        """
        found = []
        for run in self.runs:
            position, velocity = run["desired_position"], run["desired_velocity"]
            noise = np.hypot(resolution(position), self.study.tick * resolution(velocity)) / np.sqrt(6.0)
            found.append((np.diff(position) - ways(velocity, self.study.tick)) / noise)
        return float(np.mean(np.concatenate(found) ** 2))


@njit(error_model="numpy", nogil=True)
def _controls(p, state, force, position, desired, rate, out):
    """Compensated force and stiffness estimate at each tick, from logged inputs."""
    for n in range(force.shape[0]):
        state[_DESIRED], state[_DESIRED_SPEED] = desired[n], rate[n]
        control(p, state, force[n], position[n])
        out[0, n], out[1, n] = state[_OUT], state[_ESTIMATE]


class ControllerReplay:
    """Compliance controller software: its output and stiffness estimate, from the logged inputs.

    Attributes:
        noise: standard deviations of both by the log's digits alone, one pair per run [N], [N/m].
    """

    def __init__(self, study: Study, runs: Sequence[Run]) -> None:
        self.study = study
        self.runs = tuple(runs)
        # Rounded inputs pass through differences, the filter and thresholds: a part of the sensor's last
        # digit remains of them, and that much of the stiffness at half a millimetre.
        floor = 0.02 * study.nominal["force_resolution"].value
        self.noise = [
            (
                float(np.hypot(3.0 * resolution(run["compensated_force"]), floor)),
                float(np.hypot(3.0 * resolution(run["stiffness_estimate"]), floor / 5e-4)),
            )
            for run in runs
        ]

    @property
    def tolerances(self) -> dict[str, tuple[float, float]]:
        """See `Replay`: software has no calibration."""
        return {}

    def replay(
        self, index: int, effects: tuple[Effect, ...], theta: Array, ticks: int | None = None
    ) -> tuple[Array, Array]:
        """Compensated force [N] and stiffness estimate [N/m] at each tick; and the state at the end.

        Args:
            ticks: how many of the run; all by default.
        """
        run = self.runs[index]
        p = nominal_parameters(self.study, run)
        apply_changes(p, effects, theta)
        state = begin_state(self.study, run)
        out = np.zeros((2, len(run) if ticks is None else ticks))
        _controls(
            p, state, run["sensor_force"][:ticks], run["encoder_position"], run["desired_position"],
            run["desired_velocity"], out,
        )  # fmt: skip
        return out, state

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`."""
        found = []
        for index, (run, noise) in enumerate(zip(self.runs, self.noise, strict=True)):
            out, _ = self.replay(index, effects, theta)
            found.append((run["compensated_force"] - out[0]) / noise[0])
            found.append((run["stiffness_estimate"] - out[1]) / noise[1])
        return found
