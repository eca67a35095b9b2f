"""What a master algorithm is, and which there are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, Protocol, cast

from pydantic import BaseModel, ConfigDict, ValidationError

from ..base.errors import ConfigError, Problem, SimulationEnded, StepError, listed, nearest
from ..config import Places, validation_problems
from ..fmi import Point, StepStatus
from ..system.algebraic_loops import loop_problem
from ..system.signal_vector import Signals
from ..system.system import System
from .energy import Step
from .running_instances import Instances

_BEYOND = (
    "The model leaves the range in which it has values: look at its parameters, start values and inputs, and "
    "at the stability of the system."
)


@dataclass(frozen=True)
class StepInfo:
    """How a communication step went.

    Attributes:
        status: the worst status of the instances.
        instance: which one did not finish its step; empty if all did.
        reached: how far that one came [s]; None where it does not say.
        log: its log lines.
        iterations: how often the instances that were stepped most often were, without differences.
        residual: the largest relative residual that an iteration left, or error that was estimated.
        parts: the steps that it was divided in, in order; none where it was not.
    """

    status: StepStatus = StepStatus.OK
    instance: str = ""
    reached: float | None = None
    log: tuple[str, ...] = ()
    iterations: int = 1
    residual: float | None = None
    parts: tuple[Step, ...] = ()

    def raise_on_failure(self, point: Point) -> None:
        """Do nothing if all instances finished the step that began at `point`.

        Raises: StepError if one did not; SimulationEnded if it asked to end the simulation within the step.
        """
        if self.status <= StepStatus.WARNING:
            return
        if self.status is StepStatus.TERMINATED:
            raise ended(self.instance, point, self.reached, self.log)
        reached = f", it came to {self.reached!r} s" if self.reached is not None else ""
        raise StepError(
            f"refused a step of {point.step_size!r} s{reached}",
            instance=self.instance,
            time=point.time,
            status=self.status.name.lower(),
            log=self.log,
            remedy=_BEYOND if any("not finite" in one for one in self.log) else "Take a smaller step size.",
        )


DONE = StepInfo()


class MasterAlgorithm(Protocol):
    """Advances a system by one communication step.

    A step is a function of the signals that it is given, of the instances' states and memory, and of the
    point; the caller owns the loop, so that single steps can be taken by hand.

    Attributes:
        order: of convergence for smooth systems.
        solves_loops: whether algebraic loops at communication points are solved.
    """

    solves_loops: ClassVar[bool]

    @property
    def order(self) -> int:
        """Of convergence for smooth systems."""

    def check(self, system: System, places: Places | None = None) -> list[Problem]:
        """What of the system this master cannot run; `places` for messages."""

    def step(
        self, system: System, instances: Instances, point: Point, signals: Signals
    ) -> tuple[Signals, StepInfo]:
        """Signals at the end of the step that begins at `point`, and how it went.

        Raises: StepError if an FMU fails or gives a value that is not finite, or if an iteration does not
            converge.
        """


class Master(BaseModel):
    """Base of the masters: the fields of a subclass are its options, checked when it is made."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    solves_loops: ClassVar[bool] = False

    def check(self, system: System, places: Places | None = None) -> list[Problem]:
        """See MasterAlgorithm.check."""
        if self.solves_loops:
            return []
        place = (places or Places("system")).text(("connections",))
        sources = {one.target: one for one in system.connections}
        return [loop_problem(loop, sources, set(), place, False) for loop in system.loops]


def need_rollback(
    system: System, indices: Iterable[int], master: str, why: str, places: Places | None
) -> list[Problem]:
    """Problems of the instances that would have to go back to a saved state and cannot."""
    places = places or Places("system")
    problems = []
    for one in (system.instances[index] for index in sorted(indices)):
        if not one.fmu.description.capabilities.save_state:
            problems.append(
                Problem(
                    places.text(("instances", one.name)),
                    f"master {master} cannot step {one.name} back, {why}",
                    f"FMU {one.fmu.description.name} does not declare canGetAndSetFMUstate",
                    "Take an FMU that does, or the master gauss-seidel.",
                )
            )
    return problems


# Name in configs -> where it lives; imported when asked for.
_MASTERS = {
    "jacobi": ".jacobi:Jacobi",
    "gauss-seidel": ".gauss_seidel:GaussSeidel",
    "iterative": ".iterative:Iterative",
    "adaptive": ".adaptive:Adaptive",
}


def master_names() -> tuple[str, ...]:
    """Names of all masters."""
    return tuple(_MASTERS)


def master_class(name: str) -> type[Master]:
    """The class of a master. Raises: KeyError if there is none of that name."""
    module, _, attribute = _MASTERS[name].partition(":")
    return getattr(import_module(module, __package__), attribute)


def create_master(
    master: str | Mapping[str, Any], place: str = "", places: Places | None = None
) -> MasterAlgorithm:
    """The master of a config.

    Args:
        master: its name, or its name and options: {"name": "iterative", "tolerance": 1e-8}.
        place: where it was written, for the message.
        places: where each option was written.
    Raises: ConfigError if there is none of that name, or it does not take these options.
    """
    options = {"name": master} if isinstance(master, str) else dict(master)
    name = options.pop("name", None)
    if name not in _MASTERS:
        names = master_names()
        what = f"no master {name!r}" if name is not None else "the master has no name"
        suggestion = nearest(name, names) if isinstance(name, str) else ""
        raise ConfigError([Problem(place, what, f"masters: {listed(names)}", suggestion)])
    found = master_class(name)
    try:
        return cast(MasterAlgorithm, found.model_validate(options))
    except ValidationError as error:
        known = places or Places(place or f"master {name}")
        raise ConfigError(
            validation_problems(error, known, ("run", "master") if places else (), found)
        ) from None


def ended(instance: str, point: Point, reached: float | None, log: tuple[str, ...] = ()) -> SimulationEnded:
    """The end that an instance asked for within the step that began at `point`; it came to `reached` [s]."""
    begin, end = point.time, point.time + point.step_size
    time = begin if reached is None else min(max(begin, reached), end)
    return SimulationEnded(
        "asks to end the simulation", instance=instance, time=time, status="terminated", log=log
    )


def failure(instances: Instances, index: int, status: StepStatus) -> StepInfo:
    """What to report of an instance that did not finish its step."""
    one = instances.running[index]
    return StepInfo(status, one.name, one.last_successful_time(), one.log_lines())
