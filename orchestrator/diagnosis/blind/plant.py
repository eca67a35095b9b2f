"""The copy of a system that hides laws, integrated by SciPy with an adaptive step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from ...base.arrays import Array
from .draw import Drawing

# Relative tolerance of the solver; absolute ones are this share of each state's size.
_RELATIVE = 1e-8
# Evaluations of the plant after which a simulation is given up.
_EVALUATIONS = 400_000


class Lost(Exception):
    """A simulation that runs away or takes too long."""


@dataclass(frozen=True)
class Acting:
    """A law at work.

    Attributes:
        name, family: of it. place: name of the input, output or "der(state)". kind: "input", "rate" or
            "output".
        index: among inputs, states or outputs. signal, reads: name and index among [x, u, y].
        numbers: by name. value: w of (t, s, z), s being all signals that it reads. states: of its own, with
            their derivatives `rate`. delay: in place of `value` [s].
        outside: whether no law of a library can hold it. follows: whether its state begins at its signal.
    """

    name: str
    family: str
    place: str
    kind: str
    index: int
    signal: str
    reads: tuple[int, ...]
    numbers: Mapping[str, float]
    value: Callable[[float, Sequence[float], Sequence[float]], float]
    states: int = 0
    rate: Callable[[float, Sequence[float], Sequence[float]], Sequence[float]] | None = None
    delay: float = 0.0
    outside: bool = False
    follows: bool = False


@dataclass(frozen=True)
class Drive:
    """What drives a run: external signals, shape (samples, inputs), a sample every `interval` seconds.

    Held signals stay between samples; others go in straight lines.
    """

    values: Array
    held: bool
    interval: float


class Plant(Protocol):
    """A system that hides laws; vectors as in `Acting`.

    Attributes:
        states: names; of a system that gives no access to its states, outputs that answer no input at once.
        parameters: names of those that can change, with their `nominal` values.
        external, compared: names of inputs that are driven and of outputs that are logged.
        begun: names of compared outputs whose first sample is their start value.
        varied: names, among `external`, of parameters and start values that stay constant in a run.
    """

    states: list[str]
    inputs: list[str]
    outputs: list[str]
    parameters: list[str]
    external: list[str]
    compared: list[str]
    begun: list[str]
    varied: list[str]
    units: dict[str, str]
    start: Array
    nominal: Array
    legs: dict[str, list[tuple[str, float]]]

    def simulate(
        self, drive: Drive, parameters: Array, start: Array, laws: Sequence[Acting], size: Array
    ) -> Array:
        """All signals [x, u, y] at the samples, shape (samples, signals).

        Args:
            size: of each state, for the solver's absolute tolerance.
        Raises: Lost if the simulation runs away.
        """
        ...

    def at_rest(self, mean: Array, push: Acting | None = None) -> tuple[list[float], list[float]]:
        """Derivatives of states, and all signals, at the mean of the signals and with a constant law."""
        ...


class Integrated(ABC):
    """A plant whose derivatives SciPy integrates with an adaptive step."""

    states: list[str]
    inputs: list[str]
    outputs: list[str]
    external: list[str]
    begun: list[str]
    varied: list[str]
    nominal: Array

    @abstractmethod
    def evaluate(
        self, t: float, x: Sequence[float], e: Sequence[float], p: Sequence[float],
        laws: Sequence[Acting], z: Sequence[float],
    ) -> tuple[list[float], list[float], list[float]]:  # fmt: skip
        """Derivatives of states and of the laws' states, and all signals [x, u, y]."""

    def simulate(
        self, drive: Drive, parameters: Array, start: Array, laws: Sequence[Acting], size: Array
    ) -> Array:
        """See `Plant`."""
        return _integrated(self, drive, parameters, start, laws, size)

    def at_rest(self, mean: Array, push: Acting | None = None) -> tuple[list[float], list[float]]:
        """See `Plant`."""
        names = [*self.states, *self.inputs, *self.outputs]
        e = [float(mean[names.index(one)]) for one in self.external]
        x, laws = mean[: len(self.states)].tolist(), [] if push is None else [push]
        rate, _, signals = self.evaluate(0.0, x, e, self.nominal.tolist(), laws, [])
        return rate, signals


@dataclass
class Drawn(Integrated):
    """A random system with its equations as written in `parts`."""

    drawing: Drawing
    units: dict[str, str] = field(default_factory=dict)
    legs: dict[str, list[tuple[str, float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        made = self.drawing
        self.states, self.inputs, self.outputs = list[str](), list[str](), list[str]()
        self.parameters, starts, numbers = list[str](), list[float](), list[float]()
        self._parts: list[Any] = []
        for name, part in made.parts.items():
            at = [len(self.states), len(self.inputs), len(self.outputs), len(self.parameters)]
            sizes = [len(part.states), len(part.inputs), len(part.outputs), len(part.parameters)]
            self._parts.append((part, [slice(a, a + n) for a, n in zip(at, sizes, strict=True)]))
            for names, group in (
                (self.states, part.states), (self.inputs, part.inputs), (self.outputs, part.outputs),
                (self.parameters, part.parameters),
            ):  # fmt: skip
                names += [f"{name}.{one}" for one in group]
                self.units |= {f"{name}.{one}": unit for one, unit in group.items()}
            starts += [made.starts.get(f"{name}.{one}", part.starts.get(one, 0.0)) for one in part.states]
            numbers += made.numbers[name]
        self.start, self.nominal = np.array(starts), np.array(numbers)
        self.begun, self.varied = [], []
        self.external, self.compared = list(made.driven), list(made.compared)
        for target, found in made.wires.items():
            self.legs[target] = [(f"{instance}.{port}", gain) for instance, port, gain in found]
        self._wires = [
            ([(self.outputs.index(a), g) for a, g in self.legs.get(one, [])],
             self.external.index(one) if one in self.external else -1)
            for one in self.inputs
        ]  # fmt: skip
        self._order = self._sorted()

    def _sorted(self) -> list[int]:
        """Parts in the order in which their outputs can be computed."""
        left = [k for k, (part, _) in enumerate(self._parts) if part.through]
        order = [k for k in range(len(self._parts)) if k not in left]
        while left:
            ready = {o for k in order for o in _range(self._parts[k][1][2])}
            free = [
                k for k in left
                if all(o in ready for i in _range(self._parts[k][1][1]) for o, _ in self._wires[i][0])
            ]  # fmt: skip
            if not free:
                raise ValueError("the drawn system has an algebraic loop")
            order += free
            left = [k for k in left if k not in free]
        return order

    def evaluate(
        self, t: float, x: Sequence[float], e: Sequence[float], p: Sequence[float],
        laws: Sequence[Acting], z: Sequence[float],
    ) -> tuple[list[float], list[float], list[float]]:  # fmt: skip
        """See `Integrated`."""
        nx, nu = len(self.states), len(self.inputs)
        s = [*x, *([0.0] * (nu + len(self.outputs)))]
        rate, extra = [0.0] * nx, [0.0] * len(z)
        first, bent = nx + nu, self._acting(laws, "output")
        # Outputs of states come first, so that a law at one of them may read inputs that others give.
        for part, (xs, _, ys, ps) in self._parts:
            if not part.through:
                s[first + ys.start : first + ys.stop] = part.output(s[xs], (), p[ps])
        for part, (xs, us, ys, ps) in (self._parts[k] for k in self._order):
            mine = [one for one in bent if ys.start <= one[0].index < ys.stop]
            if part.through or mine:
                self._gather(t, us, s, e, laws, z, extra)
            if part.through:
                made = part.output(s[xs], s[nx + us.start : nx + us.stop], p[ps])
                s[first + ys.start : first + ys.stop] = made
            for law, at in mine:
                s[first + law.index] += _w(law, t, s, z, at, extra)
        for part, (xs, us, _, ps) in self._parts:
            if part.states:
                if not part.through:
                    self._gather(t, us, s, e, laws, z, extra)
                rate[xs] = part.rate(s[xs], s[nx + us.start : nx + us.stop], p[ps])
        for law, at in self._acting(laws, "rate"):
            rate[law.index] += _w(law, t, s, z, at, extra)
        return rate, extra, s

    @staticmethod
    def _acting(laws: Sequence[Acting], kind: str) -> list[tuple[Acting, int]]:
        found, at = [], 0
        for one in laws:
            if one.kind == kind and not one.delay:
                found.append((one, at))
            at += one.states
        return found

    def _gather(
        self, t: float, us: slice, s: list[float], e: Any, laws: Any, z: Any, extra: list[float]
    ) -> None:
        nx = len(self.states)
        first = nx + len(self.inputs)
        for i in range(us.start, us.stop):
            legs, external = self._wires[i]
            value = e[external] if external >= 0 else 0.0
            for o, gain in legs:
                value += gain * s[first + o]
            s[nx + i] = value
        for law, at in self._acting(laws, "input"):
            if us.start <= law.index < us.stop:
                s[nx + law.index] += _w(law, t, s, z, at, extra)


def _range(part: slice) -> range:
    return range(part.start, part.stop)


def _w(law: Acting, t: float, s: Sequence[float], z: Sequence[float], at: int, extra: list[float]) -> float:
    read = [s[k] for k in law.reads]
    own = z[at : at + law.states]
    if law.rate is not None:
        extra[at : at + law.states] = law.rate(t, read, own)
    return law.value(t, read, own)


def _integrated(
    plant: Integrated, drive: Drive, parameters: Array, start: Array, laws: Sequence[Acting], size: Array
) -> Array:
    count, h = len(drive.values), drive.interval
    times = np.arange(count) * h
    columns = [np.ascontiguousarray(one).tolist() for one in drive.values.T]
    late = [0.0] * len(columns)
    for law in laws:
        if law.delay and law.kind == "input":
            late[plant.external.index(law.place)] = law.delay
    p = parameters.tolist()
    nx, hidden = len(plant.states), sum(one.states for one in laws)
    calls = 0

    def driven(t: float) -> list[float]:
        found = []
        for values, delay in zip(columns, late, strict=True):
            at = max((t - delay) / h, 0.0)
            k = min(int(at), count - 1)
            after = values[min(k + 1, count - 1)]
            found.append(values[k] if drive.held else values[k] + (at - k) * (after - values[k]))
        return found

    def rate(t: float, xz: Array, middle: float | None = None) -> list[float]:
        nonlocal calls
        calls += 1
        if calls > _EVALUATIONS:
            raise Lost("the solver takes too many steps")
        both = xz.tolist()
        made, extra, _ = plant.evaluate(t, both[:nx], driven(t), p, laws, both[nx:])
        return made + extra

    ends = {0.0, float(times[-1])}
    if drive.held:
        jumps = np.flatnonzero(np.any(np.diff(drive.values, axis=0) != 0.0, axis=1)) + 1
        ends |= {float(k * h + one) for k in jumps for one in {*late, 0.0} if k * h + one < times[-1]}
    bounds = sorted(ends)
    # Just inside a piece, a held signal has the value of the piece: k * h / h may be less than k.
    shift = 1e-9 * h if drive.held else 0.0
    rest = plant.evaluate(0.0, start.tolist(), driven(0.0), p, [], [])[2]
    begun = [rest[law.reads[0]] if law.follows else 0.0 for law in laws for _ in range(law.states)]
    now = np.r_[start, begun]
    found = np.full((count, len(now)), np.nan)
    found[0] = now
    tolerance = np.r_[_RELATIVE * size, np.full(hidden, 1e-8)]
    for begin, end in pairwise(bounds):
        if end - begin < 1e-9 * h:
            continue
        inside = (times > begin + 1e-9 * h) & (times <= end + 1e-9 * h)
        at = np.minimum(times[inside], end)
        made = solve_ivp(
            lambda t, xz, end=end: rate(min(t + shift, end - shift), xz), (begin, end), now,
            method="RK45", t_eval=at if len(at) and at[-1] >= end else np.r_[at, end], rtol=_RELATIVE,
            atol=tolerance, max_step=4.0 * h if drive.held else h,
        )  # fmt: skip
        if (
            not made.success
            or not np.isfinite(made.y).all()
            or np.abs(made.y[:nx] / size[:, None]).max() > 1e6
        ):
            raise Lost("the simulation runs away")
        found[inside] = made.y.T[: len(at)]
        now = made.y[:, -1]
    signals = np.array(
        [plant.evaluate(t, xz[:nx], driven(t + shift), p, laws, xz[nx:])[2]
         for t, xz in zip(times.tolist(), found.tolist(), strict=True)]
    )  # fmt: skip
    for law in laws:
        if law.delay and law.kind == "output":
            column = nx + len(plant.inputs) + law.index
            late_times = np.maximum(times - law.delay, 0.0)
            signals[:, column] = CubicSpline(times, signals[:, column])(late_times)
    return signals
