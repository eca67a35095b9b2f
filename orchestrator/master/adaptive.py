"""Adaptive: each communication step is divided as finely as an estimate of the error demands."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..config import Places
from ..errors import Problem, StepError
from ..fmi import Array, Point, StepStatus
from ..instances import Instances
from ..signals import Signals
from ..system import System
from .base import Master, MasterAlgorithm, StepInfo, need_rollback
from .gauss_seidel import GaussSeidel
from .jacobi import Jacobi
from .rates import slow

__all__ = ["Adaptive"]

# A division is undone where the error of the doubled part, four times as large for a method of first order,
# is still expected to keep clear of the tolerance.
_CLEAR = 0.2


class Adaptive(Master):
    """Communication steps are halved until the estimated error is within the tolerance, and doubled again.

    The step size of the config is the largest step, and the distance of what is recorded: every part is it
    over a power of two, so that all its points are met exactly. A part whose error is too large is stepped
    back. The finest division carries over to the next step.

    Estimates, both per part and per signal, relative to max(|value|, nominal), the largest counts:
        doubling: the part as one step against the same part as two, of which the two are kept. It tells the
            error of the base to leading order, at half as many steps again.
        inputs: what the inputs were supposed to be, held from the beginning, against what their sources are
            at the end. It costs no step, and is larger than the error that it stands for.

    With jacobi as the base, what passes through an instance at once is a part late, which counts as an error
    of first order and makes for small steps.
    """

    solves_loops: ClassVar[bool] = False

    tolerance: float = Field(gt=0, description="Of the estimate, relative to max(|value|, nominal).")
    estimate: Literal["doubling", "inputs"] = Field("doubling", description="How errors are estimated.")
    base: Literal["gauss-seidel", "jacobi"] = Field(
        "gauss-seidel", description="The master that takes the single steps."
    )
    max_halvings: int = Field(
        20, ge=0, le=40, strict=True, description="How often the step may be halved before the run fails."
    )

    @property
    def order(self) -> int:
        """See MasterAlgorithm.order."""
        return 1

    def check(self, system: System, places: Places | None = None) -> list[Problem]:
        """See MasterAlgorithm.check."""
        problems = super().check(system, places)
        everyone = range(len(system.instances))
        why = "which it does where the error of a step is too large"
        problems += need_rollback(system, everyone, "adaptive", why, places)
        for one in system.instances:
            if not one.fmu.description.capabilities.variable_step_size:
                problems.append(
                    Problem(
                        (places or Places("system")).text(("instances", one.name)),
                        f"master adaptive cannot vary the step of {one.name}",
                        f"FMU {one.fmu.description.name} does not declare "
                        "canHandleVariableCommunicationStepSize",
                        "Take an FMU that does, or the master gauss-seidel.",
                    )
                )
        return problems + slow(system, "varies the communication step", places)

    def step(
        self, system: System, instances: Instances, point: Point, signals: Signals
    ) -> tuple[Signals, StepInfo]:
        """See MasterAlgorithm.step."""
        if "halvings" not in instances.memory:
            instances.memory["halvings"] = 0
        base: MasterAlgorithm = Jacobi() if self.base == "jacobi" else GaussSeidel()
        taking = _Part(self, base, system, instances, point)
        halvings, done, parts, worst = instances.memory["halvings"], 0, 0, 0.0
        whole: Signals | None = None
        while done < 2**halvings:
            with instances.checkpoint(range(len(instances))) as back:
                attempt = taking.attempt(signals, done, halvings, back, whole)
                if attempt.info.status > StepStatus.WARNING:
                    return signals, attempt.info
                if attempt.error > self.tolerance:
                    if halvings == self.max_halvings:
                        raise taking.failed(attempt, halvings, done)
                    back()
            if attempt.error > self.tolerance:
                halvings, done, whole = halvings + 1, 2 * done, attempt.half
                continue
            signals, whole = attempt.signals, None
            done, parts, worst = done + 1, parts + 1, max(worst, attempt.error)
            if halvings and done % 2 == 0 and 4.0 * attempt.error < _CLEAR * self.tolerance:
                halvings, done = halvings - 1, done // 2
        instances.memory["halvings"] = halvings
        return signals, StepInfo(iterations=parts, residual=worst)


class _Attempt:
    """A part that was stepped, and what it would have to keep to."""

    def __init__(self, signals: Signals, info: StepInfo, half: Signals | None, errors: Array) -> None:
        self.signals, self.info, self.half, self.errors = signals, info, half, errors
        self.error = float(errors.max(initial=0.0))


class _Part:
    """Takes parts of one communication step and estimates their errors."""

    def __init__(
        self, master: Adaptive, base: MasterAlgorithm, system: System, instances: Instances, point: Point
    ) -> None:
        self._master, self._base, self._system, self._instances = master, base, system, instances
        self._point = point
        self._smooth, self._nominal = instances.layout.smooth, instances.layout.nominal
        fed = np.zeros(instances.layout.size, np.bool_)
        for inputs in instances.layout.inputs:
            fed[inputs.source] = True
        self._fed = fed & self._smooth

    def _stepped(self, signals: Signals, number: int, halvings: int) -> tuple[Signals, StepInfo]:
        """Step the `number`-th of 2**halvings parts."""
        begin, size = self._point.time, self._point.step_size
        # Exact but for one product and one sum: powers of two divide without rounding.
        part = Point(number, begin + size * (number / 2**halvings), size / 2**halvings)
        return self._base.step(self._system, self._instances, part, signals)

    def attempt(
        self, signals: Signals, number: int, halvings: int, back: object, whole: Signals | None
    ) -> _Attempt:
        """Step a part. `whole`: what one step gives, where it is known from the attempt at a larger part."""
        assert callable(back)
        none = np.zeros(0)
        if self._master.estimate == "inputs":
            after, info = self._stepped(signals, number, halvings)
            return _Attempt(after, info, None, self._errors(after, signals, self._fed))
        if whole is None:
            whole, info = self._stepped(signals, number, halvings)
            if info.status > StepStatus.WARNING:
                return _Attempt(signals, info, None, none)
            back()
        half, info = self._stepped(signals, 2 * number, halvings + 1)
        if info.status > StepStatus.WARNING:
            return _Attempt(signals, info, None, none)
        after, info = self._stepped(half, 2 * number + 1, halvings + 1)
        return _Attempt(after, info, half, self._errors(after, whole, self._smooth))

    def _errors(self, after: Signals, other: Signals, counted: NDArray[np.bool_]) -> Array:
        apart = np.abs(after.values - other.values)
        return np.where(counted, apart / np.maximum(np.abs(after.values), self._nominal), 0.0)

    def failed(self, attempt: _Attempt, halvings: int, number: int) -> StepError:
        """The error for a part that is as small as it may be."""
        worst = int(np.argmax(attempt.errors))
        layout = self._instances.layout
        size = self._point.step_size / 2**halvings
        return StepError(
            f"master adaptive: a step of {size:g} s, halved {halvings} times, still has an estimated error "
            f"of {attempt.error:.3g} in {layout.told(worst)}; tolerance {self._master.tolerance:g}",
            instance=layout.owners[worst].instance,
            time=self._point.time + self._point.step_size * (number / 2**halvings),
            status="not converged",
            remedy="A jump cannot be resolved by small steps: take a larger tolerance, or a fixed step.",
        )
