"""Instances that many runs of a system take turns with."""

from __future__ import annotations

from collections import defaultdict, deque
from contextlib import suppress

from ..base.errors import OrchestratorError
from ..fmi import CompiledFmu, Fmu, FmuInstance
from .system import Instance

_OWN = "orchestrator"


def resets_well(fmu: Fmu) -> bool:
    """Whether a reset of the FMU can be trusted: whether `orchestrator build` made it."""
    return isinstance(fmu, CompiledFmu) and fmu.description.tool == _OWN


class InstancePool:
    """Instances that are reset after a run and reused by the next, instead of being loaded again.

    To load an FMU takes as long as thousands of steps. FMUs whose reset cannot be trusted are loaded for each
    run. Runs may be in several threads, each has instances of its own.
    """

    def __init__(self) -> None:
        # By what makes them: an FMU that is kept here keeps its number.
        self._idle: defaultdict[tuple[int, str], deque[FmuInstance]] = defaultdict(deque)
        self._made: dict[int, Instance] = {}

    def take(self, instance: Instance) -> FmuInstance:
        """An instance as new. Raises: FmuError if it cannot be loaded."""
        if not resets_well(instance.fmu):
            return instance.fmu.instantiate(instance.name)
        self._made.setdefault(id(instance.fmu), instance)
        try:
            return self._idle[id(instance.fmu), instance.name].pop()
        except IndexError:
            return instance.fmu.instantiate(instance.name)

    def give_back(self, instance: Instance, running: FmuInstance) -> None:
        """Keep an instance whose run is over; one that cannot be reset is freed."""
        if resets_well(instance.fmu) and getattr(running, "resettable", False):
            with suppress(OrchestratorError):
                running.reset()  # type: ignore[attr-defined]
                self._idle[id(instance.fmu), instance.name].append(running)
                return
        running.free()

    def close(self) -> None:
        """Free all instances that no run holds."""
        for idle in self._idle.values():
            while idle:
                with suppress(OrchestratorError):
                    idle.pop().free()
