"""What a master algorithm is, and which there are."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import ClassVar, Protocol

from ..errors import ConfigError, Problem, StepError, listed, nearest
from ..fmi import Point, StepStatus
from ..instances import Instances
from ..signals import Signals
from ..system import System

__all__ = ["DONE", "MasterAlgorithm", "StepInfo", "create_master", "master_names"]


@dataclass(frozen=True)
class StepInfo:
    """How a communication step went.

    Attributes:
        status: the worst status of the instances.
        instance: which one did not finish its step; empty if all did.
        reached: how far that one came [s]; None where it does not say.
        log: its log lines.
    """

    status: StepStatus = StepStatus.OK
    instance: str = ""
    reached: float | None = None
    log: tuple[str, ...] = ()

    def raise_on_failure(self, point: Point) -> None:
        """Raises: StepError if an instance did not finish the step that began at `point`."""
        if self.status <= StepStatus.WARNING:
            return
        if self.status is StepStatus.TERMINATED:
            what, remedy = "asks to end the simulation", ""
        else:
            reached = f", it came to {self.reached!r} s" if self.reached is not None else ""
            what = f"refused a step of {point.step_size!r} s{reached}"
            remedy = "Take a smaller step size."
        raise StepError(
            what,
            instance=self.instance,
            time=point.time,
            status=self.status.name.lower(),
            log=self.log,
            remedy=remedy,
        )


DONE = StepInfo()


class MasterAlgorithm(Protocol):
    """Advances a system by one communication step.

    A step is a function of the signals that it is given, of the instances' states and of the point; the
    caller owns the loop, so that single steps can be taken by hand.

    Attributes:
        order: of convergence for smooth systems whose signals are held over a step.
    """

    order: ClassVar[int]

    def step(
        self, system: System, instances: Instances, point: Point, signals: Signals
    ) -> tuple[Signals, StepInfo]:
        """Signals at the end of the step that begins at `point`, and how it went.

        Raises: StepError if an FMU fails or gives a value that is not finite.
        """


# Name in configs -> where it lives; imported when asked for.
_MASTERS = {
    "jacobi": ".jacobi:Jacobi",
    "gauss-seidel": ".gauss_seidel:GaussSeidel",
}


def master_names() -> tuple[str, ...]:
    """Names of all masters."""
    return tuple(_MASTERS)


def create_master(name: str, place: str = "") -> MasterAlgorithm:
    """The master of a name.

    Args:
        place: where the name was written, for the message.
    Raises: ConfigError if there is none of that name.
    """
    if name not in _MASTERS:
        names = master_names()
        raise ConfigError(
            [Problem(place, f"no master {name!r}", f"masters: {listed(names)}", nearest(name, names))]
        )
    module, _, attribute = _MASTERS[name].partition(":")
    return getattr(import_module(module, __package__), attribute)()


def failure(instances: Instances, index: int, status: StepStatus) -> StepInfo:
    """What to report of an instance that did not finish its step."""
    one = instances.running[index]
    return StepInfo(status, one.name, one.last_successful_time(), one.log_lines())
