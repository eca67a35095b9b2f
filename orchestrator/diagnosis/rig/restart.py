"""The rig's model in closed loop, started from a measured state of a run."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .components import correct
from .finding import Augmented
from .model import Laws, RigModel, begin_state
from .motion import Contact
from .rig import CHANNELS, HISTORY, SUBSTEPS, Inject, State, run_rig
from .software import ControllerReplay, DynamicsReplay
from .study import Array, Run, Study

_OF_ROBOT = [State.POSITION, State.VELOCITY, State.FILTERED_FORCE]


class Restart:
    """Closed-loop runs of a model, each started from the logged state at a tick out of contact.

    The satellite's motion there is what was logged; servo, controller and the effects' memories are those
    of their replays from the logged inputs until then.
    """

    def __init__(self, study: Study, run: Run, model: Augmented, substeps: int = SUBSTEPS) -> None:
        self.study, self.run, self.model = study, run, model
        self._rig = RigModel(study, [run], substeps)
        # Where the model's robot errs, its contact before the tick is none that the run had.
        correct(self._rig, model)
        self._controller, self._dynamics = ControllerReplay(study, [run]), DynamicsReplay(study, [run])
        self._laws = Laws.of(model.effects)
        self._p = self._rig.parameters(0, model.calibrated, model.effects, model.theta)
        self._state = lru_cache(maxsize=None)(self._state_at)

    def _state_at(self, begin: int) -> tuple[Array, Array]:
        """State and memories at a tick."""
        memory, theta = self._laws.room(self.model.theta)
        state = begin_state(self.study, self.run)
        inject = np.zeros((4, begin + 1))
        inject[Inject.POSITION] = self._rig.correction[0][: begin + 1]
        run_rig(
            self._p, False, self._rig.commands[0][: HISTORY + begin], state, self._laws.table, memory, theta,
            inject, 0, np.zeros((len(CHANNELS), begin)), self._rig.substeps,
        )  # fmt: skip
        self._dynamics.force(0, self.model.effects, memory, theta, begin)
        _, known = self._controller.replay(0, self.model.effects, self.model.theta, begin)
        known[_OF_ROBOT] = state[_OF_ROBOT]
        known[State.DESIRED_POSITION] = self.run["desired_position"][begin]
        known[State.DESIRED_VELOCITY] = self.run["desired_velocity"][begin]
        return known, memory

    def ahead(self, begin: int, ticks: int, inject: Array | None = None) -> Array:
        """Run from a tick onwards.

        Args:
            inject: residuals by `Inject` that are added to the components' outputs, shape (4, ticks + 1).
        Returns: channels by `CHANNELS`, shape (8, ticks).
        """
        known, kept = self._state(begin)
        state, memory = known.copy(), kept.copy()
        commands = np.zeros(HISTORY + ticks)
        commands[:HISTORY] = self._rig.commands[0][begin : begin + HISTORY]
        out = np.zeros((len(CHANNELS), ticks))
        _, theta = self._laws.room(self.model.theta)
        run_rig(
            self._p, True, commands, state, self._laws.table, memory, theta,
            np.zeros((4, ticks + 1)) if inject is None else np.ascontiguousarray(inject), begin, out,
            self._rig.substeps,
        )  # fmt: skip
        return out


def contact_error(run: Run, one: Contact, out: Array) -> Array:
    """Error of a model over a contact: force relative to its peak, velocity relative to that before.

    Args:
        out: channels from `Restart.ahead` over the contact's window.
    Returns: shape (2, ticks) [1].
    """
    force, velocity = (run[name][one.begin : one.end] for name in ("sensor_force", "desired_velocity"))
    return np.stack([(out[3] - force) / np.abs(force).max(), (out[1] - velocity) / abs(velocity[0])])
