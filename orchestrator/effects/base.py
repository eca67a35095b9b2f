"""The base class of effects: a subclass writes `kernel`, and `room` if it has memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self

from pydantic import BaseModel, ConfigDict

from ..base.arrays import Array
from ..base.errors import Problem
from ..base.quantities import Measure
from ..base.units import Unit

# The native loop gives arrays, the Python loop lists but for the memory: kernels take single numbers of them.
Numbers = Array | list[float]
Kernel = Callable[[float, Numbers, Numbers, Array, bool], float]


class Pure(NamedTuple):
    """Marks an option with a unit of its own, which is given by name: Annotated[float, Pure("s")]."""

    unit: str


class OfSignal(NamedTuple):
    """Marks an option in the unit of the signal, or that per another: Annotated[float, OfSignal("s")].

    Attributes:
        per: the unit that the signal's unit is divided by; empty if there is none.
        difference: whether the option is a difference of two values, such as a width or an offset: 1 degC
            is then 1 K.
    """

    per: str = ""
    difference: bool = False


class Effect(BaseModel):
    """Base of the effects: the fields of a subclass are its options, checked when it is made.

    Options that are marked by `Pure` or `OfSignal` are given with units and arrive as numbers; others arrive
    as the config has them.

    Attributes:
        main: the option that the short form gives, as in {delay: 1 ms}; empty if there is none.
        reads: names of further signals that it reads; a config names the output for each,
            {effect: ..., read: {velocity: robot.velocity}}.
        jittable: whether numba can compile the kernel; otherwise the run is left to the Python loop.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)

    main: ClassVar[str] = ""
    reads: ClassVar[tuple[str, ...]] = ()
    jittable: ClassVar[bool] = False

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """The effect's value at an instant.

        It takes single numbers of x, options and memory; where it is `jittable`, it uses nothing else but
        floats, whole numbers and the functions of `math`.

        Args:
            time: the instant [s].
            x: the signal at that instant, and those in `reads`, shape (1 + len(reads),).
            options: what `numbers` gave.
            memory: what `room` made, as the last accepted instant left it; zeros before the first.
            commit: whether the instant is accepted: only then memory may be written, and is to be.
        """
        raise NotImplementedError

    def numbers(self) -> list[float]:
        """The options as the kernel takes them: by default all, in their order."""
        return [float(getattr(self, name)) for name in type(self).model_fields]

    def room(self, step_size: float | None) -> int:
        """Length of the memory, for instants that are `step_size` apart [s]; None: not known."""
        return 0

    def grown(self, memory: Array) -> Array:
        """The memory, made longer where the next instant might not find room."""
        return memory

    def enlarged(self, memory: Array) -> Array:
        """The memory in more room; only asked where `room` depends on the step size."""
        raise NotImplementedError

    def passes_at_once(self, step_size: float | None) -> bool:
        """Whether its value at a communication point depends on the signal's value at the same point.

        Args:
            step_size: the communication step [s]; None where it is not known.
        """
        return True

    def smooth(self) -> bool:
        """Whether a smooth signal stays one that may be extrapolated."""
        return True

    def outgoing(self, measure: Measure) -> Measure | str:
        """What the value is measured in, if the signal is in `measure`; or why it cannot be."""
        return measure

    def nominal(self, nominal: float) -> float:
        """The usual magnitude of the value, if that of the signal is `nominal`."""
        return nominal

    def for_element(self, element: int) -> Self:
        """The effect for one element of an array, counted from 0."""
        return self

    @classmethod
    def prepare(cls, options: dict[str, Any], measure: Measure, place: Callable[[str], str]) -> list[Problem]:
        """Convert options that need more than their marks; returns their problems."""
        return []


def per_unit(measure: Measure, below: str, divisor: Unit) -> Measure:
    """The unit of `measure` over another."""
    if measure.unit is None:
        return Measure(f"{measure.name}/{below}" if measure.name else "", None)
    exponents = tuple(a - b for a, b in zip(measure.unit.exponents, divisor.exponents, strict=True))
    name = f"{measure.name or '1'}/{below}"
    return Measure(name, Unit(name, exponents, measure.unit.factor / divisor.factor))


def times_unit(measure: Measure, factor: Unit) -> Measure:
    """The unit of `measure` times another."""
    assert measure.unit is not None
    exponents = tuple(a + b for a, b in zip(measure.unit.exponents, factor.exponents, strict=True))
    name = factor.name if measure.name in ("", "1") else f"{measure.name} times {factor.name}"
    return Measure(name, Unit(name, exponents, measure.unit.factor * factor.factor))
