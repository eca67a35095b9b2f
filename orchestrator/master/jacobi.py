"""Jacobi: all instances step from the same instant."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ..config import Places
from ..errors import Problem
from ..fmi import Point, StepStatus
from ..instances import Instances
from ..signals import Signals
from ..system import System
from .base import DONE, Master, StepInfo, failure
from .extrapolation import Extrapolation
from .rates import slow_with_extrapolation

__all__ = ["Jacobi"]


class Jacobi(Master):
    """Every input holds its source's value from the beginning of the step, or follows its extrapolation.

    Without extrapolation a signal that passes through n instances of direct feedthrough is n steps late: the
    step size acts as delay. The result does not depend on the instances' order.
    """

    extrapolation: Literal[0, 1, 2] = Field(
        0, description="Order of the polynomial through the latest points that inputs follow; 0 holds them."
    )

    @property
    def order(self) -> int:
        """See MasterAlgorithm.order; FMUs that hold their inputs are of second order at best."""
        return min(self.extrapolation + 1, 2)

    def check(self, system: System, places: Places | None = None) -> list[Problem]:
        """See MasterAlgorithm.check."""
        return super().check(system, places) + slow_with_extrapolation(system, self.extrapolation, places)

    def step(
        self, system: System, instances: Instances, point: Point, signals: Signals
    ) -> tuple[Signals, StepInfo]:
        """See MasterAlgorithm.step."""
        instances.load(signals)
        curve = None
        if self.extrapolation:
            curve = Extrapolation(instances, point, signals.values, self.extrapolation).curve
        indices = range(len(instances))
        for index in indices:
            if instances.begins(index, point):
                instances.transfer(index, curve)
        for index in indices:
            if not instances.ends(index, point):
                continue
            status = instances.advance(index, point)
            if status > StepStatus.WARNING:
                return signals, failure(instances, index, status)
        return instances.signals(point.time + point.step_size), DONE
