"""The loop as a co-simulation computes it: inputs held over communication steps, a controller that samples.

Every component is discretised exactly for inputs that are held over a step, and the steps are put together
in the order in which the master takes them. What comes out is linear and periodic with the controller's
sample period, or the step where there is none; its eigenvalues z give the roots log(z)/period.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from ..base.errors import ConfigError, Problem, listed
from .connections import Feed
from .gain import growth_per_contact
from .loop import Loop, Wire
from .parts import INPUTS, made_part
from .transfer import Array

__all__ = ["SampledLoop", "sample"]

_MASTERS = ("jacobi", "gauss-seidel", "iterative")


@dataclass(frozen=True)
class SampledLoop:
    """A sampled loop in state space, opened at the satellite's force: x+ = A x + B u, back = C x.

    Attributes:
        step_size: communication step [s].
        period: after which everything repeats: sample period of the controller, or the step [s].
        a, b, c: shapes (n, n), (n,), (n,); the force is held over the period.
        ahead: whether the satellite is given the force of the step's end, since its source steps before it.
        closed: A of the closed loop, shape (n, n).
    """

    step_size: float
    period: float
    a: Array
    b: Array
    c: Array
    ahead: bool
    closed: Array

    def gain(self, omega: ArrayLike) -> NDArray[np.complex128]:
        """L(exp(j omega period)) for negative feedback.

        Args: omega: shape (n,), up to pi/period [rad/s].
        """
        z = np.exp(1j * np.atleast_1d(np.asarray(omega, np.float64)) * self.period)
        hessenberg, turn = scipy.linalg.hessenberg(self.a, calc_q=True)
        b, c, eye = turn.T @ self.b, self.c @ turn, np.eye(len(self.a))
        value = np.array([c @ np.linalg.solve(one * eye - hessenberg, b) for one in z])
        return -value * (z if self.ahead else 1.0)

    def roots(self) -> NDArray[np.complex128]:
        """log(z)/period of the closed loop's eigenvalues but those at 0, rightmost first [rad/s]."""
        z = np.linalg.eigvals(self.closed)
        z = z[np.abs(z) > 1e-9]
        s = np.log(z.astype(np.complex128)) / self.period
        return s[np.argsort(-s.real)]

    @property
    def unstable(self) -> int:
        """How many eigenvalues of the closed loop lie outside the unit circle."""
        return int(np.sum(np.abs(np.linalg.eigvals(self.closed)) > 1.0 + 1e-9))

    def growth(self) -> float:
        """exp(pi sigma/omega) of the rightmost root that oscillates, below half the sampling rate."""
        for root in self.roots():
            if 0.0 < root.imag < 0.99 * np.pi / self.period:
                return growth_per_contact(complex(root))
        return float("nan")

    def margins(self) -> tuple[float, float]:
        """Phase margin [deg] and delay margin [s] at the last crossover; NaN where |L| never is one."""
        omega = np.geomspace(1e-5, 0.999, 800) * np.pi / self.period
        value = self.gain(omega)
        crossing = np.flatnonzero((np.abs(value[:-1]) > 1.0) & (np.abs(value[1:]) <= 1.0))
        if not crossing.size:
            return float("nan"), float("nan")
        low, high = omega[crossing[-1]], omega[crossing[-1] + 1]
        for _ in range(60):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if np.abs(self.gain(middle)[0]) > 1.0 else (low, middle)
        angle = float(np.angle(-self.gain(low)[0]))
        return float(np.degrees(angle)), float(angle / low)


def sample(loop: Loop, master: str, step_size: float) -> SampledLoop:
    """A loop under a master and a communication step.

    Args:
        loop: with numbers for parameters.
        master: "jacobi" or "gauss-seidel", without extrapolation, or "iterative", without interpolation.
        step_size: [s].
    Raises: ConfigError if the master's steps are not known here, the step is not positive or no part of the
        controller's sample period, or an instance on the loop is of an unknown model.
    """
    problems = []
    if master not in _MASTERS:
        problems.append(
            Problem(loop.name, f"master {master!r} is not analysed", f"known: {listed(_MASTERS)}")
        )
    if not (np.isfinite(step_size) and step_size > 0.0):
        problems.append(Problem(loop.name, f"step size is {step_size!r} s", "allowed: finite and positive"))
    if problems:
        raise ConfigError(problems)
    loop.gain()
    count = 1
    for name in loop.named("ComplianceController"):
        ratio = float(loop.parameters[f"{name}.sample_period"]) / step_size
        count = round(ratio)
        if count < 1 or abs(ratio - count) > 1e-6:
            what = f"{name}.sample_period is {ratio:.6g} steps"
            raise ConfigError([Problem(loop.name, what, "a whole number of steps is needed")])
    return _Steps(loop, master, step_size, count).assembled()


class _Steps:
    """All parts of a loop under a master."""

    def __init__(self, loop: Loop, master: str, step_size: float, count: int) -> None:
        self.satellite, self.step_size, self.count = loop.only("SatelliteDynamics"), step_size, count
        self.sequential, self.implicit = master == "gauss-seidel", master == "iterative"
        order = [name for name in loop.order or loop.models if name in loop.models]
        self.parts = {
            name: made_part(loop.models[name], loop.parameters_of(name), step_size) for name in order
        }
        self.wires: dict[tuple[str, str], list[Wire]] = {}
        for wire in loop.wires:
            if wire.target[0] in self.parts:
                self.wires.setdefault(wire.target, []).append(wire)
        # Of instances of unknown models nothing comes: the loop does not pass them.
        self.wires = {
            target: [wire for wire in wires if wire.source[0] in self.parts]
            for target, wires in self.wires.items()
        }
        # One connection feeds an input, so that the effects of its wires are the same.
        self.feeds = {
            target: Feed(f"{loop.name}: connection to {'.'.join(target)}", wires[0].effects, step_size)
            for target, wires in self.wires.items()
            if wires
        }
        self.known = {
            target: self.implicit
            or (
                self.sequential
                and any(order.index(wire.source[0]) < order.index(target[0]) for wire in self.wires[target])
            )
            for target in self.feeds
        }
        self.ahead = self.known[self.satellite, "force"]
        self.places: dict[Any, slice | int] = {}
        size = 0
        for name, part in self.parts.items():
            self.places[name] = slice(size, size + part.size)
            size += part.size
            for output in part.outputs:
                self.places[name, output] = size
                size += 1
        self.memories: dict[tuple[str, str], slice] = {}
        for target, feed in self.feeds.items():
            self.memories[target] = slice(size, size + feed.size)
            size += feed.size
        self.size = size

    def sources(self, target: tuple[str, str], z: Array) -> Array:
        """Sum of what feeds an input, before the effects."""
        total = np.zeros(z.shape[1])
        for wire in self.wires[target]:
            total = total + wire.gain * z[self.places[wire.source]]
        return total

    def period(self, z: Array, force: Array | None) -> Array:
        """The whole state after a period, column by column; the satellite's force is given, or fed back."""
        for number in range(self.count):
            last = number == self.count - 1
            z = self.solved(z, force, last) if self.implicit else self.stepped(z, None, force, last)
        return z

    def stepped(self, begin: Array, end: Array | None, force: Array | None, last: bool) -> Array:
        """The whole state after a step.

        Args:
            begin: the state at its begin, shape (size, columns).
            end: outputs that inputs are to follow instead of those of the begin, placed as in a state; or
                None.
            force: on the satellite, shape (columns,); None: the one that is fed back.
            last: whether the controller samples at the step's end.
        """
        z = begin.copy()
        for name, part in self.parts.items():
            seen = end if end is not None else z if self.sequential else begin
            inputs = {}
            for target, feed in self.feeds.items():
                if target[0] == name:
                    x, memory = self.sources(target, seen), begin[self.memories[target]]
                    known = self.known[target]
                    inputs[target[1]] = feed.advance(memory, x)[1] if known else feed.value(memory, x)
            if name == self.satellite and force is not None:
                inputs["force"] = force
            fed = {key: inputs.get(key, np.zeros(z.shape[1])) for key in (*inputs, *INPUTS)}
            state, outputs = part.step(begin[self.places[name]], fed, last)
            z[self.places[name]] = state
            for output, value in zip(part.outputs, outputs, strict=True):
                z[self.places[name, output]] = value
        self.remember(begin, z)
        return z

    def remember(self, begin: Array, z: Array) -> None:
        """What the connections' effects remember at the step's end, into z."""
        for target, feed in self.feeds.items():
            rows = self.memories[target]
            z[rows] = feed.advance(begin[rows], self.sources(target, z))[0]

    def solved(self, begin: Array, force: Array | None, last: bool) -> Array:
        """The state after a step at whose end every input agrees with what feeds it: z = P begin + Q z."""
        places = [self.places[name, one] for name, part in self.parts.items() for one in part.outputs]
        unit = np.zeros((self.size, len(places)))
        unit[places, np.arange(len(places))] = 1.0
        still = None if force is None else np.zeros(len(places))
        answer = self.stepped(np.zeros_like(unit), unit, still, last)
        z = self.stepped(begin, np.zeros_like(begin), force, last)
        z = z + answer @ np.linalg.solve(np.eye(len(places)) - answer[places], z[places])
        self.remember(begin, z)
        return z

    def assembled(self) -> SampledLoop:
        """The open and the closed loop."""
        eye = np.eye(self.size)
        back = self.satellite, "force"
        c = self.feeds[back].value(eye[self.memories[back]], self.sources(back, eye))
        open_loop = self.period(eye, np.zeros(self.size))
        given = self.period(np.zeros((self.size, 1)), np.ones(1))[:, 0]
        period = self.count * self.step_size
        return SampledLoop(self.step_size, period, open_loop, given, c, self.ahead, self.period(eye, None))
