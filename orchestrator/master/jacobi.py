"""Jacobi: all instances step from the same instant."""

from __future__ import annotations

from ..fmi import Point, StepStatus
from ..system.signal_vector import Signals
from ..system.system import System
from .base import DONE, StepInfo, failure
from .extrapolation import Extrapolating, Extrapolation
from .running_instances import Instances


class Jacobi(Extrapolating):
    """Every input holds its source's value from the beginning of the step, or follows its extrapolation.

    Without extrapolation a signal that passes through n instances of direct feedthrough is n steps late: the
    step size acts as delay. The result does not depend on the instances' order.
    """

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
