"""Gauss-Seidel: instances step one after the other, each with the latest outputs of those before it."""

from __future__ import annotations

from ..fmi import Point, StepStatus
from ..system.signal_vector import Signals
from ..system.system import System
from .base import DONE, StepInfo, failure
from .extrapolation import Extrapolating, Extrapolation
from .running_instances import Instances


class GaussSeidel(Extrapolating):
    """Inputs hold the source's value from the end of the step if it has stepped already, else from the start.

    Instances step in the order of direct feedthrough (System.order), so that a signal passes through any
    number of instances without delay; where feedthrough leaves it open, the config's order decides, and with
    it which connections carry the old value. With extrapolation these follow a polynomial through the latest
    points, and the others one that ends in the value that is known.
    """

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
