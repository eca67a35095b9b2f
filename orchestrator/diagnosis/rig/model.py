"""The rig's model as a diagnosis uses it: replayed open loop from logs, with effects and other parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .effect import Effect, Seen, Site, by_effect
from .rig import CHANNELS, HISTORY, SUBSTEPS, Calibrated, State, run_rig
from .study import Array, Run, Study

# Calibrated numbers of a study that the replay of robot, contact and sensor depends on.
CALIBRATED = (
    "natural_frequency",
    "damping_ratio",
    "response_delay",
    "contact_stiffness",
    "contact_damping",
    "front_wall",
    "rear_wall",
    "sensor_delay",
    "sensor_cutoff",
    "force_bias",
)

_ENCODER = CHANNELS.index("encoder_position")
# Poles of the observer that draws a servo at its limits to the encoder [rad/s]: slower than what effects do
# in a swing, faster than errors grow from one to the next.
_PULL = 2.0 * math.pi * 3.0


def nominal_parameters(study: Study, run: Run) -> Array:
    """Calibrated parameters of the rig by `Calibrated`, shape (16,)."""
    p = np.zeros(len(Calibrated))
    for name in CALIBRATED:
        p[Calibrated[name.upper()]] = study.nominal[name].value
    cutoff = study.nominal["sensor_cutoff"].value
    p[Calibrated.LEAD] = study.nominal["sensor_delay"].value + (1.0 / cutoff if cutoff > 0 else 0.0)
    p[Calibrated.TICK], p[Calibrated.MASS] = study.tick, run.mass
    p[Calibrated.NOMINAL_STIFFNESS] = study.nominal["contact_stiffness"].value
    p[Calibrated.NOMINAL_DAMPING] = study.nominal["contact_damping"].value
    return p


@dataclass(frozen=True)
class Laws:
    """The laws of some effects, laid out for the rig.

    Attributes:
        sites: first law of each site, and the end, shape (len(Site) + 1,).
        addresses: shape (l,); at: of each law's memory and parameters, shape (l, 2).
        memory: how many numbers they keep; theta: how many parameters all effects have.
    """

    sites: np.ndarray
    addresses: np.ndarray
    at: np.ndarray
    memory: int
    theta: int

    @property
    def table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Table for machine code."""
        return self.sites, self.addresses, self.at

    def room(self, theta: Array) -> tuple[Array, Array]:
        """Fresh memory, and the parameters; neither is empty, since addresses are taken of them."""
        filled = np.ascontiguousarray(theta, dtype=float) if theta.size else np.zeros(1)
        return np.zeros(max(self.memory, 1)), filled

    @staticmethod
    @lru_cache(maxsize=4096)
    def of(effects: tuple[Effect, ...]) -> Laws:
        """The layout; laws of one site act in the order of the effects."""
        order = []
        memory = theta = 0
        for effect in effects:
            if effect.site is not None:
                order.append((effect.site, effect.apply.address, memory, theta))
                memory += effect.memory
            theta += len(effect.parameters)
        order.sort(key=lambda law: law[0])
        firsts = [sum(law[0] < site for law in order) for site in range(len(Site) + 1)]
        return Laws(
            np.array(firsts, np.int64),
            np.array([law[1] for law in order], np.int64),
            np.array([law[2:] for law in order], np.int64).reshape(-1, 2),
            memory,
            theta,
        )


def apply_changes(p: Array, effects: Sequence[Effect], theta: Array) -> None:
    """Add the changes by effects to parameters."""
    for effect, own in by_effect(effects, theta):
        if not effect.changes:
            continue
        values = {one.name: value for one, value in zip(effect.parameters, own, strict=True)}
        for target, name in effect.changes.items():
            if target.startswith("*"):
                p[Calibrated[target[1:].upper()]] *= 1.0 + values[name]
            else:
                p[Calibrated[target.upper()]] += values[name]


def ramp_lag(calibrated: Mapping[str, float]) -> float:
    """Lag of the robot behind a command of constant velocity [s]."""
    servo = 2.0 * calibrated["damping_ratio"] / calibrated["natural_frequency"]
    return servo + calibrated["response_delay"]


def begin_state(study: Study, run: Run) -> Array:
    """State at the first tick: the robot already moves at the approach speed."""
    nominal = study.nominal
    state = np.zeros(len(State))
    state[State.POSITION] = -ramp_lag({name: one.value for name, one in nominal.items()}) * run.approach_speed
    state[State.VELOCITY] = run.approach_speed
    state[State.DESIRED_VELOCITY] = run.approach_speed
    state[State.LAST_POSITION] = state[State.POSITION]
    state[State.POSITION_RATE] = run.approach_speed
    state[State.STIFFNESS] = nominal["contact_stiffness"].value
    state[State.DAMPING] = nominal["contact_damping"].value
    state[State.P00] = (0.15 * nominal["contact_stiffness"].value) ** 2
    state[State.P11] = 60.0**2
    return state


class RigModel:
    """Link, robot, structure, contact and sensor of a study's runs, replayed from the logged commands.

    Channels: encoder position and sensor force of each run.

    Args:
        runs: those to replay.
        substeps: of contact and robot per tick.

    Attributes:
        commands: sent, by tick, of each run; the first HISTORY before it, shape (HISTORY + n,) [m].
        noise: standard deviations of encoder [m] and sensor force [N], rounding included.
        correction: added to the robot's position in replays, shape (n + 1,) of each run [m].
        pull: see `followed`; zero otherwise [rad/s].
    """

    def __init__(self, study: Study, runs: Sequence[Run], substeps: int = SUBSTEPS) -> None:
        self.study = study
        self.runs = tuple(runs)
        self.substeps = substeps
        self._nominal = [nominal_parameters(study, run) for run in runs]
        self.commands = [self._sent(run) for run in runs]
        self.correction = [np.zeros(len(run) + 1) for run in runs]
        self.pull = 0.0
        self.noise = study.noise("encoder"), study.noise("force")

    def with_commands(self, shorter: Sequence[Array]) -> RigModel:
        """The same of runs whose commands arrived changed, by run, as those of `Seen`, shape (n,) [m]."""
        model = RigModel(self.study, self.runs, self.substeps)
        model.pull = self.pull
        for index, change in enumerate(shorter):
            model.commands[index][HISTORY - 1 : -1] += change
        return model

    def corrected(self, by: Sequence[Array]) -> RigModel:
        """The same whose robot is moved in replays, by run, each of shape (n + 1,) [m]."""
        model = copy(self)
        model.correction = list(by)
        return model

    def followed(self) -> RigModel:
        """The same whose servo is drawn to the encoder in replays, by an observer, slowly.

        A servo at its limits forgets nothing: where it begins a little otherwise it goes far astray, and no
        fit comes near the rig. Drawn to the encoder it shows limits again at each swing.
        """
        model = copy(self)
        model.pull = _PULL
        return model

    def over(self, runs: Sequence[Run]) -> RigModel:
        """The same for other runs, with commands that arrived as sent."""
        model = RigModel(self.study, runs, self.substeps)
        model.pull = self.pull
        return model

    def finer(self) -> RigModel:
        """The same with sub-steps half as long."""
        model = copy(self)
        model.substeps = 2 * self.substeps
        return model

    @property
    def tolerances(self) -> dict[str, tuple[float, float]]:
        """See `Replay`."""
        nominal = {name: self.study.nominal[name] for name in CALIBRATED}
        return {name: (one.value, one.tolerance) for name, one in nominal.items() if one.tolerance > 0}

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`."""
        found = []
        for index, run in enumerate(self.runs):
            out = self.replay(index, calibrated, effects, theta)
            # Of a model that runs away they are infinite, or none at all; its cost then says so.
            with np.errstate(over="ignore", invalid="ignore"):
                found.append((run["encoder_position"] - out[2]) / self.noise[0])
                found.append((run["sensor_force"] - out[3]) / self.noise[1])
        return found

    def seen(self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array) -> Seen:
        """Data of the runs from which effects propose start values."""
        position = tuple(run["encoder_position"] for run in self.runs)
        position_error = tuple(
            one - self.replay(index, calibrated, effects, theta)[2] for index, one in enumerate(position)
        )
        p = self.parameters(0, calibrated, effects, theta)
        lag = p[Calibrated.NATURAL_FREQUENCY], p[Calibrated.DAMPING_RATIO], p[Calibrated.RESPONSE_DELAY]
        sent = tuple(commands[HISTORY - 1 : -1] for commands in self.commands)
        return Seen(self.study.tick, sent, position, position_error, tuple(map(float, lag)))

    def _sent(self, run: Run) -> Array:
        """Commands by tick; before the first the rod moved at the approach speed already."""
        tick = self.study.tick
        before = run.approach_speed * tick * np.arange(1 - HISTORY, 1)
        last = run["desired_position"][-1] + tick * run["desired_velocity"][-1]
        return np.concatenate([before, run["desired_position"][1:], [last]])

    def parameters(
        self, index: int, calibrated: Mapping[str, float], effects: Sequence[Effect], theta: Array
    ) -> Array:
        """Parameters of a run, shape (16,)."""
        p = self._nominal[index].copy()
        for name, value in calibrated.items():
            p[Calibrated[name.upper()]] = value
        apply_changes(p, effects, theta)
        return p

    def replay(
        self,
        index: int,
        calibrated: Mapping[str, float],
        effects: tuple[Effect, ...] = (),
        theta: Array | None = None,
    ) -> Array:
        """Replay link, robot, structure, contact and sensor from the logged commands.

        Args:
            index: of the run.
            calibrated: values that replace the nominal ones.
            effects, theta: what acts beside, and all their parameters one after the other.
        Returns: channels by `CHANNELS`, shape (8, n); those of the software are zero.
        """
        inject = np.zeros((4, len(self.runs[index]) + 1))
        inject[0] = self.correction[index]
        return self._driven(index, False, self.commands[index], inject, calibrated, effects, theta)

    def closed_loop(
        self,
        index: int,
        calibrated: Mapping[str, float],
        effects: tuple[Effect, ...] = (),
        theta: Array | None = None,
        inject: Array | None = None,
    ) -> Array:
        """Run the complete rig from its start; arguments as in `replay`.

        Args:
            inject: what is added to the components' outputs, by `Inject`, shape (4, n + 1).
        Returns: channels by `CHANNELS`, shape (8, n).
        """
        n = len(self.runs[index])
        commands = np.zeros(HISTORY + n)
        commands[:HISTORY] = self.commands[index][:HISTORY]
        inject = np.zeros((4, n + 1)) if inject is None else inject
        return self._driven(index, True, commands, inject, calibrated, effects, theta)

    def _driven(
        self,
        index: int,
        closed: bool,
        commands: Array,
        inject: Array,
        calibrated: Mapping[str, float],
        effects: tuple[Effect, ...],
        theta: Array | None,
    ) -> Array:
        """Run from the start of a run; arguments as those of `run_rig`."""
        laws = Laws.of(effects)
        theta = np.zeros(laws.theta) if theta is None else theta
        out = np.zeros((len(CHANNELS), inject.shape[1] - 1))
        p = self.parameters(index, calibrated, effects, theta)
        state = begin_state(self.study, self.runs[index])
        pull = 0.0 if closed else self.pull
        if pull > 0.0:
            out[_ENCODER] = self.runs[index]["encoder_position"]
        room = laws.room(theta)
        run_rig(p, closed, commands, state, laws.table, *room, inject, 0, out, self.substeps, pull)
        return out
