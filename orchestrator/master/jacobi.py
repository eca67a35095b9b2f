"""Jacobi: all instances step from the same instant."""

from __future__ import annotations

from typing import ClassVar

from ..fmi import Point, StepStatus
from ..instances import Instances
from ..signals import Signals
from ..system import System
from .base import DONE, StepInfo, failure

__all__ = ["Jacobi"]


class Jacobi:
    """Every input holds its source's value from the beginning of the step.

    A signal that passes through n instances of direct feedthrough is n steps late: the step size acts as
    delay. The result does not depend on the instances' order.
    """

    order: ClassVar[int] = 1

    def step(
        self, system: System, instances: Instances, point: Point, signals: Signals
    ) -> tuple[Signals, StepInfo]:
        """See MasterAlgorithm.step."""
        instances.load(signals)
        indices = range(len(instances))
        for index in indices:
            instances.transfer(index)
        for index in indices:
            status = instances.advance(index, point)
            if status > StepStatus.WARNING:
                return signals, failure(instances, index, status)
        return instances.signals(point.time + point.step_size), DONE
