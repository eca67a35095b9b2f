"""Laws of friction as effects: added to a component that lacks them, or softening the one that it has.

Added to a force that is fed to a component (`sign` -1) or that it gives (1), as a function of its velocity
v: y = x + sign F(v). Those with memory follow the path dx = v dt. Softened laws take x for the force of
sliding and let it build up along the path. All can stand in a config, under `through`, as
{effect: orchestrator.diagnosis.ports.laws:Dahl, level: 20 N, ..., read: {velocity: drive.velocity}}.
"""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from pydantic import Field

from ...effects import Effect, OfSignal, Pure
from ...effects.base import Array, Numbers

__all__ = [
    "Coulomb",
    "Dahl",
    "Drag",
    "ElasticSlip",
    "LuGre",
    "MaxwellSlip",
    "OneSided",
    "SofteningDahl",
    "SofteningMaxwellSlip",
    "Spring",
    "Stribeck",
    "StribeckShare",
    "Viscous",
]

_ELEMENTS = 4


class _Law(Effect):
    reads: ClassVar[tuple[str, ...]] = ("velocity",)
    jittable: ClassVar[bool] = True


class _Added(_Law):
    sign: int = Field(-1, description="-1 where friction takes from a force that acts, 1 where it adds.")


class _OfPath(_Law):
    """Remembers whether there is an instant before, its time [s], and further numbers."""

    def room(self, step_size: float | None) -> int:
        """See Effect.room."""
        return 3 + _ELEMENTS


class Coulomb(_Added):
    """F = level v/sqrt(v^2 + width^2): Coulomb friction, its corner rounded off. Zero size: level 0."""

    level: Annotated[float, OfSignal()] = Field(ge=0, description="Force of sliding.")
    width: Annotated[float, Pure("m/s")] = Field(gt=0, description="Speed at 71 % of the level.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel."""
        return x[0] + options[0] * options[1] * x[1] / math.sqrt(x[1] * x[1] + options[2] * options[2])


class Stribeck(_Added):
    """F = level (1 + excess exp(-(v/speed)^2)) v/sqrt(v^2 + width^2). Zero size: level 0.

    Stribeck (1902), as Bo and Pavelescu (1982) write it.
    """

    level: Annotated[float, OfSignal()] = Field(ge=0, description="Force of fast sliding.")
    excess: float = Field(ge=0, description="By which share breaking away takes more.")
    speed: Annotated[float, Pure("m/s")] = Field(gt=0, description="Over which the excess goes.")
    width: Annotated[float, Pure("m/s")] = Field(gt=0, description="Speed at 71 % of the level.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel."""
        ratio = x[1] / options[3]
        size = options[1] * (1.0 + options[2] * math.exp(-ratio * ratio))
        return x[0] + options[0] * size * x[1] / math.sqrt(x[1] * x[1] + options[4] * options[4])


class Viscous(_Added):
    """F = damping v. Zero size: 0."""

    damping: Annotated[float, OfSignal("m/s")] = Field(description="Force per velocity.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel."""
        return x[0] + options[0] * options[1] * x[1]


class OneSided(_Added):
    """F = damping |v|: what viscous friction is more in one direction than in the other. Zero size: 0."""

    damping: Annotated[float, OfSignal("m/s")] = Field(description="Force per speed.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel."""
        return x[0] + options[0] * options[1] * abs(x[1])


class Drag(_Added):
    """F = drag v |v|, of a turbulent flow. Zero size: 0."""

    drag: Annotated[float, OfSignal("m2/s2")] = Field(description="Force per square of velocity.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel."""
        return x[0] + options[0] * options[1] * x[1] * abs(x[1])


class Spring(_Added, _OfPath):
    """F = stiffness times the path since the start. Zero size: 0."""

    stiffness: Annotated[float, OfSignal("m")] = Field(description="Force per path.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel."""
        path = memory[2]
        if memory[0] != 0.0:
            path += x[1] * (time - memory[1])
        if commit:
            memory[0] = 1.0
            memory[1] = time
            memory[2] = path
        return x[0] + options[0] * options[1] * path


class Dahl(_Added, _OfPath):
    """dF/dx = (level sgn(v) - F)/distance. Zero size: level 0. Dahl (1968)."""

    level: Annotated[float, OfSignal()] = Field(ge=0, description="Force of sliding.")
    distance: Annotated[float, Pure("m")] = Field(gt=0, description="Over which it builds up.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel."""
        force = memory[2]
        if memory[0] != 0.0:
            path = x[1] * (time - memory[1])
            end = math.copysign(options[1], path)
            force = end + (force - end) * math.exp(-abs(path) / options[2])
        if commit:
            memory[0] = 1.0
            memory[1] = time
            memory[2] = force
        return x[0] + options[0] * force


class LuGre(_Added, _OfPath):
    """Dahl's law with the Stribeck curve for the force of sliding. Zero size: level 0.

    Canudas de Wit, Olsson, Astrom, Lischinsky (1995), without damping of the bristles.
    """

    level: Annotated[float, OfSignal()] = Field(ge=0, description="Force of fast sliding.")
    excess: float = Field(ge=0, description="By which share breaking away takes more.")
    speed: Annotated[float, Pure("m/s")] = Field(gt=0, description="Over which the excess goes.")
    distance: Annotated[float, Pure("m")] = Field(gt=0, description="Over which the force builds up.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel."""
        force = memory[2]
        if memory[0] != 0.0:
            path = x[1] * (time - memory[1])
            ratio = x[1] / options[3]
            end = math.copysign(options[1] * (1.0 + options[2] * math.exp(-ratio * ratio)), path)
            force = end + (force - end) * math.exp(-abs(path) / options[4])
        if commit:
            memory[0] = 1.0
            memory[1] = time
            memory[2] = force
        return x[0] + options[0] * force


class _Slip(_OfPath):
    """Four springs in parallel that slip at a quarter of the level each, after 1/8, 1/4, 1/2 and 1 times the
    distance. Iwan (1966).
    """

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel.

        Args:
            options: whether x itself is the level, or else x is passed on and the springs add to it; their
                level then; the distance [m].
            memory: further the level as it was on the last part of the path, and the four bendings [m].
        """
        if options[2] == 0.0:
            return x[0]
        level, path = options[1], 0.0
        if options[0] != 0.0:
            level = memory[2]
        if memory[0] != 0.0:
            path = x[1] * (time - memory[1])
            if options[0] != 0.0:
                level = abs(x[0]) + (level - abs(x[0])) * math.exp(-abs(path) / (0.1 * options[2]))
        total, reach = 0.0, options[2] / 8.0
        for element in range(4):
            bent = min(max(memory[3 + element] + path, -reach), reach)
            total += 0.25 * bent / reach
            if commit:
                memory[3 + element] = bent
            reach *= 2.0
        if commit:
            memory[0] = 1.0
            memory[1] = time
            memory[2] = level
        if options[0] != 0.0:
            return level * total
        return x[0] + level * total


class MaxwellSlip(_Added, _Slip):
    """Four springs in parallel that slip at a quarter of the level each, after 1/8, 1/4, 1/2 and 1 times the
    distance. Zero size: level 0. Iwan (1966); Lampaert, Al-Bender, Swevers (2003).
    """

    level: Annotated[float, OfSignal()] = Field(ge=0, description="Force of sliding.")
    distance: Annotated[float, Pure("m")] = Field(gt=0, description="After which all slide.")

    def numbers(self) -> list[float]:
        """See Effect.numbers."""
        return [0.0, self.sign * self.level, self.distance]


class StribeckShare(_Law):
    """y = x (1 + excess exp(-(v/speed)^2)): more for breaking away. Zero size: 0."""

    excess: float = Field(description="Share.")
    speed: Annotated[float, Pure("m/s")] = Field(gt=0, description="Over which it goes.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel."""
        ratio = x[1] / options[1]
        return x[0] * (1.0 + options[0] * math.exp(-ratio * ratio))


class SofteningDahl(_OfPath):
    """dy/dx = (x - y)/distance along the path: sliding builds up exponentially. Zero size: 0. Dahl (1968)."""

    distance: Annotated[float, Pure("m")] = Field(ge=0, description="Over which the force builds up.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel."""
        y = x[0]
        if memory[0] != 0.0 and options[0] > 0.0:
            path = abs(x[1] * (time - memory[1]))
            y += (memory[2] - y) * math.exp(-path / options[0])
        if commit:
            memory[0] = 1.0
            memory[1] = time
            memory[2] = y
        return y


class ElasticSlip(_OfPath):
    """A spring that slips at the force x, with play before it bears. Zero size: distance and play 0.

    Bent by u, it gives the level times (|u| - play/2)/distance, at most 1, and none within the play; beyond,
    it slides. The level is |x|, as it was on the last part of the path.
    """

    distance: Annotated[float, Pure("m")] = Field(ge=0, description="Bending at which it slips.")
    play: Annotated[float, Pure("m")] = Field(ge=0, description="Way between bearing on either side.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel. Memory further: bending u [m], level."""
        half = 0.5 * options[1]
        reach = half + options[0]
        if reach == 0.0:
            return x[0]
        bent, level = memory[2], memory[3]
        if memory[0] != 0.0:
            path = x[1] * (time - memory[1])
            bent = min(max(bent + path, -reach), reach)
            level = abs(x[0]) + (level - abs(x[0])) * math.exp(-abs(path) / (0.1 * reach))
        share = 0.0
        if abs(bent) >= reach:
            share = 1.0
        elif abs(bent) > half:
            share = (abs(bent) - half) / options[0]
        if commit:
            memory[0] = 1.0
            memory[1] = time
            memory[2] = bent
            memory[3] = level
        return math.copysign(level * share, bent)


class SofteningMaxwellSlip(_Slip):
    """Four springs in parallel that slip at a quarter of x each, after 1/8, 1/4, 1/2 and 1 times the
    distance. Zero size: 0. The level is |x|, as it was on the last part of the path. Iwan (1966).
    """

    distance: Annotated[float, Pure("m")] = Field(ge=0, description="After which all slide.")

    def numbers(self) -> list[float]:
        """See Effect.numbers."""
        return [1.0, 0.0, self.distance]
