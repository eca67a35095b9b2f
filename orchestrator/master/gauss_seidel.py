"""Gauss-Seidel: instances step one after the other, each with the latest outputs of those before it."""

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

__all__ = ["GaussSeidel"]


class GaussSeidel(Master):
    """Inputs hold the source's value from the end of the step if it has stepped already, else from the begin.

    Instances step in the order of direct feedthrough (System.order), so that a signal passes through any
    number of instances without delay; where feedthrough leaves it open, the config's order decides, and with
    it which connections carry the old value. With extrapolation these follow a polynomial through the latest
    points, and the others one that ends in the value that is known.
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
        ahead = None
        if self.extrapolation:
            ahead = Extrapolation(instances, point, signals.values, self.extrapolation)
        for index in system.order:
            if not instances.ends(index, point):
                instances.hold(index, point)
                continue
            instances.transfer(index, ahead.curve if ahead else None)
            status = instances.advance(index, point)
            if status > StepStatus.WARNING:
                return signals, failure(instances, index, status)
            if ahead and index != system.order[-1]:  # nobody asks for the last one's any more
                ahead.stepped(index)
        return instances.signals(point.time + point.step_size), DONE
