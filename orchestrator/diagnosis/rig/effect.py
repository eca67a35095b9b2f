"""Definition of an unmodelled effect: its place, law and parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from ...base.compiled_functions import cfunc
from ...base.units import UnitError, parse_unit
from .config_changes import Writes


class Site(IntEnum):
    """Places in the chain of signals at which an effect can act, with the value that it changes.

    Attributes:
        COMMAND: command received at a tick [m].
        DELAY: delay of the command on its way to the servo [s].
        ACCELERATION: acceleration of the servo, to add disturbances to [m/s2].
        LIMIT: mean acceleration of the servo over a sub-step, to bound [m/s2].
        RATE: velocity of the servo [m/s].
        POSITION: position of the robot, seen by the encoder and by the contact [m].
        STRUCTURE: position of the contact point, not seen by the encoder [m].
        STIFFNESS: stiffness of the frame that is touched [N/m]; laws of the contact read it as it comes out.
        CONTACT: force of a frame's springs and dampers [N]; positive where they push.
        PUSH: the same as it reaches the rod, before it is kept from pulling [N].
        FORCE: force on the rod, before the sensor [N]; negative at the front frame.
        SAMPLE: force sampled at a tick [N].
        BODY: force on the satellite over a tick [N].
    """

    COMMAND = 0
    DELAY = 1
    ACCELERATION = 2
    LIMIT = 3
    RATE = 4
    POSITION = 5
    STRUCTURE = 6
    STIFFNESS = 7
    CONTACT = 8
    PUSH = 9
    FORCE = 10
    SAMPLE = 11
    BODY = 12


class Context(IntEnum):
    """Further values that a law can read; SI units.

    Attributes:
        POSITION, VELOCITY, ACCELERATION: of the robot's servo; of the satellite at BODY.
        COMMAND: that acts on the servo.
        FORCE: on the rod, at the latest instant.
        DEPTH, DEPTH_RATE: of the penetration; zero out of contact.
        SIDE: 1 at the front frame, -1 at the rear frame, 0 out of contact.
        STIFFNESS, DAMPING: of the frame that is touched; out of contact of either, as calibrated.
        TICK: number of the tick.
        MASS: of the satellite software.
    """

    POSITION = 0
    VELOCITY = 1
    ACCELERATION = 2
    COMMAND = 3
    FORCE = 4
    DEPTH = 5
    DEPTH_RATE = 6
    SIDE = 7
    STIFFNESS = 8
    DAMPING = 9
    TICK = 10
    MASS = 11


_POINTER = types.CPointer(types.float64)
_SIGNATURE = types.float64(types.float64, types.float64, types.float64, _POINTER, _POINTER, _POINTER)


def law(function: Callable[..., float]) -> Any:
    """Compile the law of an effect.

    Args:
        function: of time [s], step since the last call [s], the value at the site, and three arrays: the
            context (by `Context`), the effect's memory (zeros at the start) and its parameters.
    """
    return cfunc(_SIGNATURE)(function)


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Attributes:
        name, unit: SI.
        scale: standard deviation of its prior about zero, at which the effect is absent.
        low, high: bounds.
        starts: values that a fit begins from; the effect's size is not convex in all of them.
        shape: whether it only shapes the effect: then zero is nothing special, and `scale` is the standard
            deviation of its logarithm about the middle start.
        whole: whether it is a whole number; then all from `low` to `high` are tried.
        jagged: whether what it does is no smooth function of it, so that no derivative leads from a start to
            the best value: fits leave it where they begin.
    """

    name: str
    unit: str
    scale: float
    low: float = float("-inf")
    high: float = float("inf")
    starts: tuple[float, ...] = ()
    shape: bool = False
    whole: bool = False
    jagged: bool = False

    @property
    def smooth(self) -> bool:
        """Whether derivatives by it lead anywhere."""
        return not (self.whole or self.jagged)

    def __post_init__(self) -> None:
        try:
            parse_unit(self.unit)
        except UnitError as error:
            raise ValueError(f"parameter {self.name}: {error}") from None
        if not self.scale > 0 or not self.low < self.high:
            raise ValueError(f"parameter {self.name}: scale {self.scale} and bounds {self.low}, {self.high}")
        if self.shape and not (self.starts and min(self.starts) > 0.0):
            raise ValueError(
                f"parameter {self.name}: starts {self.starts}; a shape needs one above 0 or more"
            )
        if self.whole and not math.isfinite(self.high - self.low):
            raise ValueError(
                f"parameter {self.name}: bounds {self.low}, {self.high}; a whole number needs finite ones"
            )


@dataclass(frozen=True)
class Seen:
    """Data of runs from which effects propose start values of their fits.

    Attributes:
        tick: of the rig's software [s].
        commands: the last ones sent before each tick of a run, by run, shape (n,) [m].
        position: of the robot as measured, by run, shape (n,) [m].
        position_error: measured minus replayed position of the robot at the ticks, by run, shape (n,) [m].
        lag: of the replayed servo: natural frequency [rad/s], damping ratio [1], response delay [s].
    """

    tick: float
    commands: tuple[NDArray[np.float64], ...]
    position: tuple[NDArray[np.float64], ...]
    position_error: tuple[NDArray[np.float64], ...]
    lag: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Effect:
    """A candidate cause of the gap.

    An effect either has a law that acts at a site, or changes calibrated parameters, or, where it is
    stochastic, is known by statistics alone.

    Attributes:
        id: place and name, as in `contact.hertz`.
        words: what it is, without a full stop.
        equation: the law in plain text.
        source: where it stands in the literature.
        parameters: see `Parameter`.
        site, apply, memory: of the law; how many numbers it keeps.
        changes: calibrated parameters that it changes, by the parameter that is added to them; relative ones
            are marked by a leading "*".
        statistic: name of the statistic that detects a stochastic effect, "" for others.
        written: its form in the config of the augmented system, where `changes` do not define it.
        propose: further starts, one value per parameter, read from the runs.
    """

    id: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    site: Site | None = None
    apply: Any = None
    memory: int = 0
    changes: Mapping[str, str] = field(default_factory=dict)
    statistic: str = ""
    written: Writes | None = None
    propose: Callable[[Seen], Sequence[tuple[float, ...]]] | None = None
    words: str = ""

    def __post_init__(self) -> None:
        if (self.site is None) != (self.apply is None):
            raise ValueError(f"effect {self.id}: a law needs a site, and a site a law")
        if self.apply is None and not self.changes and not self.statistic:
            raise ValueError(f"effect {self.id} does nothing")

    @property
    def place(self) -> str:
        """The component that it belongs to."""
        return self.id.partition(".")[0]

    def size(self, theta: Sequence[float] | NDArray[np.float64]) -> float:
        """How strong it is, in standard deviations of its prior; 0 where no parameter of it is a size.

        Args:
            theta: its own parameters.
        """
        first = self.parameters[0]
        return 0.0 if first.shape or first.whole else abs(float(theta[0])) / first.scale


def by_effect(
    effects: Iterable[Effect], theta: NDArray[np.float64]
) -> Iterator[tuple[Effect, NDArray[np.float64]]]:
    """Effects with their own parameters, of all of them one after the other."""
    first = 0
    for effect in effects:
        last = first + len(effect.parameters)
        yield effect, theta[first:last]
        first = last
