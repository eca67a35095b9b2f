"""The bundled components from communication point to communication point, exact for inputs that are held."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from .plant import ACTIVE, OFF
from .transfer import Array

__all__ = ["INPUTS", "Part", "made_part"]

INPUTS = (
    "force",
    "command",
    "position",
    "velocity",
    "measured_force",
    "desired_position",
    "desired_velocity",
)


class Part(Protocol):
    """One instance over a step, on many columns at once."""

    size: int
    outputs: tuple[str, ...]

    def step(self, x: Array, u: Mapping[str, Array], last: bool) -> tuple[Array, list[Array]]:
        """State and outputs at the step's end."""


class _Held:
    """x' = A x + B u(t - delay), y = C x + D u(t - delay), with u held over each step: exact."""

    def __init__(
        self,
        matrices: tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike],
        inputs: tuple[str, ...],
        outputs: tuple[str, ...],
        step: float,
        delay: float = 0.0,
    ) -> None:
        a, b, c, d = (np.atleast_2d(np.asarray(one, np.float64)) for one in matrices)
        self.inputs, self.outputs = inputs, outputs
        n, m = len(a) if a.size else 0, len(inputs)
        whole = int(np.floor(delay / step + 1e-9))
        fraction = max(delay - whole * step, 0.0)
        self.states, self.width, self.whole = n, m, whole
        self.split = fraction > 1e-9 * step
        self.buffer = whole + (1 if self.split else 0)
        self.size = n + m * self.buffer
        self.c, self.d = (c if n else np.zeros((len(outputs), 0))), d
        old_transition, old_input = _discretised(a, b, fraction if self.split else 0.0, n, m)
        new_transition, new_input = _discretised(a, b, step - (fraction if self.split else 0.0), n, m)
        self.transition = new_transition @ old_transition
        self.from_new, self.from_old = new_input, new_transition @ old_input

    def step(self, x: Array, u: Mapping[str, Array], last: bool) -> tuple[Array, list[Array]]:
        """See Part."""
        now = np.array([u[name] for name in self.inputs])
        line = [now, *x[self.states :].reshape(self.buffer, self.width, x.shape[1])]
        new, old = line[self.whole], line[-1]
        state = self.transition @ x[: self.states] + self.from_new @ new
        if self.split:
            state = state + self.from_old @ old
        # A delay of whole steps ends where the held input jumps; the FMUs' delay gives the value after the
        # jump.
        passing = line[self.whole - 1] if self.whole and not self.split else new
        outputs = self.c @ state + self.d @ passing
        kept = np.array(line[: self.buffer]).reshape(self.buffer * self.width, x.shape[1])
        return np.concatenate([state, kept]), list(outputs)


def _discretised(a: Array, b: Array, time: float, n: int, m: int) -> tuple[Array, Array]:
    whole = np.zeros((n + m, n + m))
    if n:
        whole[:n, :n], whole[:n, n:] = a, b
    exponential = _exponential((whole * time).tobytes(), n + m)
    return exponential[:n, :n], exponential[:n, n:]


@functools.lru_cache(maxsize=4096)
def _exponential(matrix: bytes, size: int) -> Array:
    # Points of a chart share most of their matrices.
    values = np.frombuffer(matrix).reshape(size, size)
    return scipy.linalg.expm(values) if values.any() else np.eye(size)


class _Controller:
    """The compliance controller in contact: samples at the end of the last step of its period."""

    outputs = ("force", "compensated_force")
    size = 4  # reading one sample ago, filtered difference, force, compensated force

    def __init__(self, p: Mapping[str, Any]) -> None:
        period, filter_time = p["sample_period"], p["lead_filter_time"]
        self.p, self.period = p, period
        self.keep = float(np.exp(-period / filter_time)) if filter_time > 0.0 else 0.0

    def step(self, x: Array, u: Mapping[str, Array], last: bool) -> tuple[Array, list[Array]]:
        """See Part."""
        if not last:
            return x, [x[2], x[3]]
        p, reading = self.p, u["measured_force"]
        rate = self.keep * x[1] + (1.0 - self.keep) * (reading - x[0]) / self.period
        compensated = reading + p["tau_s"] * rate
        force = reading if int(p["mode"]) == OFF else compensated
        if int(p["mode"]) == ACTIVE:
            ahead = p["transfer_delay"] + (0.5 * self.period if p["hold_compensation"] else 0.0)
            stretch = u["desired_position"] + u["desired_velocity"] * ahead - u["position"]
            rate_of_it = u["desired_velocity"] - u["velocity"]
            force = force - p["stiffness_estimate"] * stretch - max(p["damping_estimate"], 0.0) * rate_of_it
        return np.array([reading, rate, force, compensated]), [force, compensated]


def made_part(model: str, p: Mapping[str, Any], step: float) -> Part:
    """An instance of a model of `plant.MODELS` with its parameters, SI, over a step [s]."""
    if model == "SatelliteDynamics":
        matrices = ([[0, 1], [0, 0]], [[0], [1 / p["mass"]]], np.eye(2), np.zeros((2, 1)))
        return _Held(matrices, ("force",), ("position", "velocity"), step)
    if model == "RobotResponse":
        w, xi = p["omega_n"], p["xi_n"]
        matrices = ([[0, 1], [-w * w, -2 * xi * w]], [[0], [w * w]], np.eye(2), np.zeros((2, 1)))
        return _Held(matrices, ("command",), ("position", "velocity"), step, p["tau_m"])
    if model == "DockingContact":
        law = [[-p["stiffness"], -p["damping"]], [1.0, 0.0]]
        empty = (np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), law)
        return _Held(empty, ("position", "velocity"), ("force", "penetration"), step)
    if model == "ForceSensor":
        cut = 2.0 * np.pi * p["cutoff"]
        static = (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]])
        lagging = ([[-cut]], [[cut]], [[1.0]], [[0.0]])
        return _Held(lagging if cut > 0 else static, ("force",), ("measured_force",), step, p["tau_s"])
    return _Controller(p)
