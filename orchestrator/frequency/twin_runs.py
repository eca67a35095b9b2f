"""Runs of one FMU on its own, side by side, from its start or from where a run has brought it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

from ..fmi import FmuInstance, Point, StepStatus
from ..simulation.grid import Grid
from ..simulation.run import Prepared
from ..system.system import Instance

__all__ = ["resumed", "step_all"]


def step_all(instances: Sequence[FmuInstance], point: Point) -> bool:
    """Write the bound inputs of instances and step them; whether all of them took the step."""
    status = StepStatus.OK
    for instance in instances:
        instance.write_inputs()
        status = max(status, instance.do_step(point))
    return status <= StepStatus.WARNING


class _Resumed:
    """An FMU whose instances go on from a saved state when they are initialised."""

    def __init__(self, one: Instance, state: bytes) -> None:
        self._fmu, self._start, self._state = one.fmu, one.start, state

    def __getattr__(self, name: str) -> Any:
        return getattr(self._fmu, name)

    def instantiate(self, name: str) -> FmuInstance:
        """See Fmu.instantiate."""
        instance: Any = self._fmu.instantiate(name)
        entered, initialised = instance.enter_initialisation, instance.exit_initialisation

        def enter_initialisation(begin: float, start: Any, stop: Any) -> None:
            # Values of a later time may be none that it can start from: they come with the state.
            entered(begin, self._start, stop)

        def exit_initialisation() -> None:
            initialised()
            state = instance.deserialise_state(self._state)
            instance.restore_state(state)
            instance.free_state(state)

        instance.enter_initialisation = enter_initialisation
        instance.exit_initialisation = exit_initialisation
        return instance


def resumed(one: Instance, running: Any, prepared: Prepared, time: float) -> tuple[Instance, Prepared] | None:
    """An instance and a system whose runs go on from a time of the run.

    Args:
        running: the instance as the run has brought it to this time [s].
    Returns: None if its FMU cannot save its state.
    """
    if not one.fmu.description.capabilities.serialise_state:
        return None
    state = running.save_state()
    try:
        data = running.serialise_state(state)
    finally:
        running.free_state(state)
    grid = Grid(Fraction(time), prepared.grid.step_size, prepared.grid.steps)
    return replace(one, fmu=_Resumed(one, data)), replace(prepared, grid=grid)
