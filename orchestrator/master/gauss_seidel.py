"""Gauss-Seidel: instances step one after the other, each with the latest outputs of those before it."""

from __future__ import annotations

from typing import ClassVar

from ..fmi import Point, StepStatus
from ..instances import Instances
from ..signals import Signals
from ..system import System
from .base import DONE, StepInfo, failure

__all__ = ["GaussSeidel"]


class GaussSeidel:
    """Inputs hold the source's value from the end of the step if it has stepped already, else from the begin.

    Instances step in the order of direct feedthrough (System.order), so that a signal passes through any
    number of instances without delay; where feedthrough leaves it open, the config's order decides, and with
    it which connections carry the old value.
    """

    order: ClassVar[int] = 1

    def step(
        self, system: System, instances: Instances, point: Point, signals: Signals
    ) -> tuple[Signals, StepInfo]:
        """See MasterAlgorithm.step."""
        instances.load(signals)
        for index in system.order:
            instances.transfer(index)
            status = instances.advance(index, point)
            if status > StepStatus.WARNING:
                return signals, failure(instances, index, status)
        return instances.signals(point.time + point.step_size), DONE
