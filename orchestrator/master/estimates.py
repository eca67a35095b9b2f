"""How large the error of a step is, over what is allowed: for masters that choose their steps by it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..base.errors import Problem, listed, nearest
from ..base.units import ONE, UnitError, parse_quantity, parse_unit
from ..config import Places
from ..fmi import Array, Kind, StepStatus
from ..system.signal_vector import Layout, Signals
from ..system.system import System
from .base import StepInfo
from .energy import Before, Books, Step
from .extrapolation import predicted
from .running_instances import Instances

Tolerance = float | str | Mapping[str, str]
# Steps a part with the base, from signals: time, size.
Take = Callable[[Signals, float, float], tuple[Signals, StepInfo]]


@dataclass(frozen=True)
class Attempt:
    """A part of a communication step that was stepped.

    Attributes:
        signals: at its end.
        info: how the last of its steps went.
        error: over what is allowed; accepted up to 1.
        worst: whose error it is, a signal or a power bond.
        steps: that were taken and count; their inputs are noted only where somebody asks.
        instance: that the error is reported for; empty: that of the signal.
    """

    signals: Signals
    info: StepInfo
    error: float
    worst: str
    steps: tuple[Step, ...]
    instance: str = ""


class Estimate(Protocol):
    """Takes a part and estimates its error.

    Attributes:
        order: of the error in the part's size.
    """

    order: int

    def attempt(self, take: Take, signals: Signals, begin: float, size: float, back: object) -> Attempt:
        """Step a part from `begin` by `size` [s]; `back` brings the instances back to its beginning."""

    def rejected(self) -> None:
        """The latest attempt does not count."""


class _Scale:
    """What errors of signals are measured against."""

    def __init__(self, instances: Instances, tolerance: Tolerance, counted: NDArray[np.bool_]) -> None:
        layout = instances.layout
        self._names = [layout.describe(place) for place in range(layout.size)]
        self._nominal = layout.nominal
        self._relative: float | None = None
        if isinstance(tolerance, Mapping):
            self._counted = np.array([self._names.index(name) for name in tolerance], np.intp)
            self._allowed = np.array(
                [_allowed(instances.system, name, text) for name, text in tolerance.items()]
            )
        else:
            assert isinstance(tolerance, float)
            self._relative = tolerance
            self._counted = np.flatnonzero(counted)

    def measure(self, after: Array, other: Array) -> tuple[float, str]:
        """The largest difference over what is allowed, and the signal that has it."""
        if not len(self._counted):
            return 0.0, ""
        apart = np.abs(after[self._counted] - other[self._counted])
        if self._relative is not None:
            usual = np.maximum(np.abs(after[self._counted]), self._nominal[self._counted])
            apart /= self._relative * usual
        else:
            apart /= self._allowed
        worst = int(np.argmax(apart))
        return float(apart[worst]), self._names[self._counted[worst]]


class _Forgetful:
    """An estimate that keeps nothing from part to part."""

    def rejected(self) -> None:
        """See Estimate.rejected."""


class _Doubling(_Forgetful):
    """A part as one step against the same part as two; the two are kept."""

    def __init__(self, instances: Instances, tolerance: Tolerance, order: int) -> None:
        self._instances = instances
        self._scale = _Scale(instances, tolerance, instances.layout.smooth)
        self.order = order + 1

    def attempt(self, take: Take, signals: Signals, begin: float, size: float, back: object) -> Attempt:
        """See Estimate.attempt."""
        assert callable(back)
        whole, info = take(signals, begin, size)
        if info.status > StepStatus.WARNING:
            return Attempt(signals, info, 0.0, "", ())
        back()
        half, info = take(signals, begin, 0.5 * size)
        if info.status > StepStatus.WARNING:
            return Attempt(signals, info, 0.0, "", ())
        steps = (*_noted(self._instances, half, 0.5 * size),)
        after, info = take(half, begin + 0.5 * size, 0.5 * size)
        if info.status > StepStatus.WARNING:
            return Attempt(signals, info, 0.0, "", ())
        error, worst = self._scale.measure(after.values, whole.values)
        return Attempt(after, info, error, worst, (*steps, *_noted(self._instances, after, 0.5 * size)))


class _Inputs(_Forgetful):
    """What inputs were supposed to be against what their sources are at the end."""

    def __init__(self, instances: Instances, tolerance: Tolerance, extrapolation: int) -> None:
        self._instances = instances
        fed = np.zeros(instances.layout.size, np.bool_)
        for inputs in instances.layout.inputs:
            fed[inputs.source] = True
        self._scale = _Scale(instances, tolerance, fed & instances.layout.smooth)
        self.order = extrapolation + 1

    def attempt(self, take: Take, signals: Signals, begin: float, size: float, back: object) -> Attempt:
        """See Estimate.attempt."""
        after, info = take(signals, begin, size)
        if info.status > StepStatus.WARNING:
            return Attempt(signals, info, 0.0, "", ())
        supposed = predicted(self._instances)
        supposed = signals.values if supposed is None else supposed
        error, worst = self._scale.measure(after.values, supposed)
        return Attempt(after, info, error, worst, _noted(self._instances, after, size))


class _Power:
    """The energy that the coupling creates at each power bond over the part."""

    def __init__(self, instances: Instances, tolerance: Tolerance, extrapolation: int) -> None:
        self._instances = instances
        self._books = Books(instances.system, instances.layout)
        self._allowed = allowed_energy(tolerance)
        self._before: Before | None = None
        self._earlier: Before | None = None
        self.order = extrapolation + 2

    def rejected(self) -> None:
        """See Estimate.rejected."""
        self._before = self._earlier

    def attempt(self, take: Take, signals: Signals, begin: float, size: float, back: object) -> Attempt:
        """See Estimate.attempt."""
        books = self._books
        self._earlier = self._before or books.start(signals.values)
        after, info = take(signals, begin, size)
        if info.status > StepStatus.WARNING:
            return Attempt(signals, info, 0.0, "", ())
        given = self._instances.inputs_over_step(books.inputs)
        points = books.outputs(np.stack([signals.values, after.values]))
        sizes = np.array([size])
        inputs = np.broadcast_to(given, (1, 3, len(books.inputs)))
        *_, created, self._before = books.energies(sizes, points, inputs, self._earlier)
        error = np.abs(books.per_bond(created)[0]) / self._allowed
        worst = int(np.argmax(error))
        bond, steps = books.bonds[worst], _noted(self._instances, after, size)
        return Attempt(after, info, float(error[worst]), f"power bond {bond.name}", steps, bond.giver)


def create_estimate(
    name: str, instances: Instances, tolerance: Tolerance, order: int, extrapolation: int
) -> Estimate:
    """The estimate of a name.

    Args:
        tolerance: see `Adaptive.tolerance`.
        order, extrapolation: of the master that takes the steps.
    """
    if name == "power":
        return _Power(instances, tolerance, extrapolation)
    if name == "inputs":
        return _Inputs(instances, tolerance, extrapolation)
    return _Doubling(instances, tolerance, order)


def _noted(instances: Instances, after: Signals, size: float) -> tuple[Step, ...]:
    """The step that was taken, with its inputs if somebody keeps books of them."""
    places = instances.noted_inputs
    return () if places is None else (Step(size, after.values, instances.inputs_over_step(places)),)


def allowed_energy(tolerance: Tolerance) -> float:
    """An energy as it is written [J]. Raises: UnitError if it is none."""
    if not isinstance(tolerance, str):
        raise UnitError(f"{tolerance!r} is no energy; write it as in '1 uJ'")
    value = parse_quantity(tolerance).to(parse_unit("J"))
    if not value > 0.0:
        raise UnitError(f"{tolerance!r} is not above zero")
    return value


def _allowed(system: System, name: str, text: str) -> float:
    """A signal's tolerance in its unit. Raises: UnitError if it cannot be read or is not above zero."""
    port = next(port for port in Layout.of(system).index if str(port) == name)
    unit = system.variable(port).unit
    quantity = parse_quantity(text)
    if unit is not None:
        value = quantity.to(unit, difference=True)
    elif quantity.unit == ONE:
        value = float(quantity.value)
    else:
        raise UnitError(f"{name} declares no unit, so that {text!r} cannot be converted")
    if not value > 0.0:
        raise UnitError(f"{text!r} is not above zero")
    return value


def tolerance_problems(
    estimate: str, tolerance: Tolerance, system: System, places: Places | None
) -> list[Problem]:
    """What is wrong with a tolerance for a system."""
    place = (places or Places("system")).text(("run", "master", "tolerance"))
    if estimate == "power":
        problems = []
        if not system.bonds:
            what = "master adaptive cannot estimate by power: no power bond is known"
            problems.append(Problem(place, what, remedy="Declare them under bonds."))
        try:
            allowed_energy(tolerance)
        except UnitError as error:
            problems.append(Problem(place, f"estimate power: {error}"))
        return problems
    if isinstance(tolerance, str):
        what = f"{tolerance!r} says of no signal how large its error may be"
        return [
            Problem(place, what, "a number, or signals with quantities", "Estimate power takes energies.")
        ]
    if not isinstance(tolerance, Mapping):
        return []
    layout = Layout.of(system)
    known = {str(port): port for port in layout.index if system.variable(port).kind is Kind.REAL}
    if estimate == "inputs":
        fed = {port for connection in system.connections for port in connection.sources}
        known = {name: port for name, port in known.items() if port in fed}
    problems = []
    for name, text in tolerance.items():
        if name not in known:
            kind = "that feeds an input" if estimate == "inputs" else "that is recorded or feeds an input"
            what = f"no real signal {name!r} {kind}"
            problems.append(Problem(place, what, f"signals: {listed(known)}", nearest(name, known)))
            continue
        try:
            _allowed(system, name, text)
        except UnitError as error:
            problems.append(Problem(place, f"tolerance of {name}: {error}"))
    return problems
