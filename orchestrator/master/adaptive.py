"""Adaptive: each communication step is divided as finely as an estimate of the error demands."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from ..base.errors import ConfigError, Problem, StepError
from ..config import Places
from ..fmi import Point, StepStatus
from ..system.signal_vector import Signals
from ..system.system import System
from .base import Master, MasterAlgorithm, StepInfo, create_master, need_rollback
from .energy import Step
from .estimates import Attempt, Estimate, create_estimate, tolerance_problems
from .rates import slow
from .running_instances import Instances

_BASES = ("gauss-seidel", "jacobi", "iterative")
# Of the proportional-integral controller (Gustafsson), each over the order of the error; how close to the
# tolerance it aims; how much a step may shrink or grow at once.
_INTEGRAL, _PROPORTIONAL = 0.3, 0.4
_AIM, _SHRINK, _GROW = 0.8, 0.1, 4.0


class Adaptive(Master):
    """Communication steps are divided into parts whose estimated error is within the tolerance.

    The step size of the config is the largest step, and the distance of what is recorded: every communication
    point is met, the parts before it being of equal size. A proportional-integral controller chooses the size
    of the next part by the errors of the latest two; a part whose error is too large is stepped back and
    taken again, smaller. The size carries over to the next communication step.

    Estimates, per part; the largest counts:
        doubling: the part as one step against the same part as two; the two are kept. It gives the
            error of the base to leading order, at half as many steps again.
        inputs: what the inputs were supposed to be against what their sources are at the end. It costs no
            step; for inputs that are held it is larger than the error that it stands for.
        power: the energy that the coupling creates at each power bond (see `master.energy`), as in
            Sadjina, Kyllingstad, Skjong and Pedersen's ECCO. It costs no step and by default never goes
            back, so that FMUs need not save their state: what an unforeseen event costs is seen by the next
            part only.

    With jacobi as the base, what passes through an instance at once is a part late, which counts as an error
    of first order and makes for small steps.
    """

    tolerance: float | str | dict[str, str] = Field(
        description="Of doubling and inputs: a number, relative to max(|value|, nominal) of every signal, or "
        "signals and how far each may be off, {contact.force: 0.1 N}; of power: the energy that a bond may "
        "create over a part, 1 uJ.",
    )
    estimate: Literal["doubling", "inputs", "power"] = Field(
        "doubling", description="How errors are estimated."
    )
    base: str | dict[str, Any] = Field(
        "gauss-seidel",
        description="The master that takes the single steps, gauss-seidel, jacobi or iterative: its name, or "
        "its name and options.",
    )
    rollback: bool | None = Field(
        None,
        description="Whether a part whose error is too large is stepped back; by default it is, except for "
        "power.",
    )
    max_halvings: int = Field(
        20,
        ge=0,
        le=40,
        strict=True,
        description="The smallest part is the step size, halved so often; if it does not do the run fails.",
    )

    @field_validator("tolerance", mode="before")
    @classmethod
    def _is_positive(cls, value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError("a number, an energy or signals with quantities are needed")
        if isinstance(value, int | float) and not value > 0:
            raise ValueError("input should be greater than 0")
        return float(value) if isinstance(value, int) else value

    @field_validator("base")
    @classmethod
    def _is_base(cls, value: Any) -> Any:
        name = value if isinstance(value, str) else value.get("name")
        if name not in _BASES:
            raise ValueError(f"{name!r} takes no single steps; bases: {', '.join(_BASES)}")
        try:
            create_master(value)
        except ConfigError as error:
            raise ValueError("; ".join(problem.what for problem in error.problems)) from None
        return value

    @model_validator(mode="after")
    def _can_go_on(self) -> Adaptive:
        if self.estimate == "doubling" and self.rollback is False:
            raise ValueError("estimate doubling takes every part twice, which needs rollback")
        return self

    @cached_property
    def _steps(self) -> MasterAlgorithm:
        return create_master(self.base)

    @property
    def solves_loops(self) -> bool:  # type: ignore[override]
        """See MasterAlgorithm.solves_loops."""
        return self._steps.solves_loops

    @property
    def order(self) -> int:
        """See MasterAlgorithm.order."""
        return self._steps.order

    @property
    def goes_back(self) -> bool:
        """Whether parts may be stepped back."""
        return self.estimate != "power" if self.rollback is None else self.rollback

    def check(self, system: System, places: Places | None = None) -> list[Problem]:
        """See MasterAlgorithm.check."""
        problems = self._steps.check(system, places)
        if self.goes_back:
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
        known = {str(one) for one in problems}
        problems += [
            one for one in slow(system, "varies the communication step", places) if str(one) not in known
        ]
        return problems + tolerance_problems(self.estimate, self.tolerance, system, places)

    def step(
        self, system: System, instances: Instances, point: Point, signals: Signals
    ) -> tuple[Signals, StepInfo]:
        """See MasterAlgorithm.step."""
        memory, base = instances.memory, self._steps
        if "estimate" not in memory:
            extrapolation = getattr(base, "extrapolation", 0)
            memory["estimate"] = create_estimate(
                self.estimate, instances, self.tolerance, base.order, extrapolation
            )
            # Who cannot go back begins carefully.
            memory["size"] = point.step_size * (1.0 if self.goes_back else 2.0 ** -min(10, self.max_halvings))
            memory["error"] = None
        estimate: Estimate = memory["estimate"]
        smallest = point.step_size / 2**self.max_halvings
        everyone = range(len(instances))

        def take(begin: Signals, time: float, size: float) -> tuple[Signals, StepInfo]:
            return base.step(system, instances, Point(point.index, time, size), begin)

        done, count, worst, rejected = 0.0, 0, 0.0, False
        parts: list[Step] = []
        while True:
            left = point.step_size - done
            number = max(1, math.ceil(left / memory["size"] * (1.0 - 1e-9)))
            size = left / number
            saving: AbstractContextManager[Any] = (
                instances.checkpoint(everyone) if self.goes_back else nullcontext()
            )
            with saving as back:
                attempt = estimate.attempt(take, signals, point.time + done, size, back)
                if attempt.info.status > StepStatus.WARNING:
                    return signals, attempt.info
                if self.goes_back and attempt.error > 1.0:
                    estimate.rejected()
                    if size <= smallest * (1.0 + 1e-9):
                        raise self._failed(attempt, point.time + done, size)
                    back()
                    factor = _AIM * attempt.error ** (-1.0 / estimate.order)
                    memory["size"] = max(size * min(max(factor, _SHRINK), 0.5), smallest)
                    rejected = True
                    continue
            signals, count, worst = attempt.signals, count + 1, max(worst, attempt.error)
            parts += attempt.steps
            wanted = self._next(size, attempt.error, memory, estimate.order, rejected)
            # A part that was cut short to meet a communication point says nothing against the size before.
            memory["size"] = min(max(wanted, memory["size"] if wanted >= size else smallest), point.step_size)
            rejected = False
            if number == 1:
                break
            done += size
            if instances.ender is not None:  # before the communication point, which no other instance reaches
                reached = point.time + done
                name = instances.running[instances.ender].name
                return signals, StepInfo(StepStatus.TERMINATED, name, reached)
        return signals, StepInfo(iterations=count, residual=worst, parts=tuple(parts))

    @staticmethod
    def _next(size: float, error: float, memory: dict[Any, Any], order: int, rejected: bool) -> float:
        """The size of the part after one that was accepted."""
        before, memory["error"] = memory["error"], max(error, 1e-10)
        factor = _AIM * memory["error"] ** (-_INTEGRAL / order)
        if before is not None:
            factor *= (before / memory["error"]) ** (_PROPORTIONAL / order)
        return size * min(max(factor, _SHRINK), 1.0 if rejected else _GROW)

    def _failed(self, attempt: Attempt, time: float, size: float) -> StepError:
        """The error for a part that is as small as it may be."""
        return StepError(
            f"master adaptive: a step of {size:.3g} s, halved {self.max_halvings} times, still has an "
            f"estimated error of {attempt.error:.3g} times the tolerance in {attempt.worst}",
            instance=attempt.instance or attempt.worst.partition(".")[0],
            time=time,
            status="not converged",
            remedy="A jump cannot be resolved by small steps: take a larger tolerance, or a fixed step.",
        )
