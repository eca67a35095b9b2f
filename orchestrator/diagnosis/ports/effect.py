"""A candidate cause in a system of FMUs, and the sizes of signals that its priors are made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ...effects import Effect as ConnectionEffect
from ...system.connection import Port
from ..effect import Effect
from ..families import Kin
from ..study import Array
from .comb import Comb
from .player import Inserted
from .study import PortStudy

__all__ = ["FEW_LEVELS", "PortEffect", "Sizes", "unit_at"]

# A resolution gives each value of a signal an error of its own: where they are no more, any law does so.
FEW_LEVELS = 8


@dataclass(frozen=True, eq=False)
class PortEffect(Effect):
    """A candidate cause in a system of FMUs: see `Effect`.

    Attributes:
        port: where it is inserted; None where it changes a parameter.
        make: the effect on connections that it is, of its parameters.
        reads: ports that the effect reads.
        family: effects of one family are forms of one cause, and are not combined; "" for none.
        kin: what it is reported together with, if anything; unlike a family's, such effects may be combined.
        comb: where to look for its one parameter, if runs tell it only from very near.
        untold: whether its signal takes so few values that any error of these could be its doing.
    """

    port: Port | None = None
    make: Callable[[Array], ConnectionEffect] | None = None
    reads: tuple[Port, ...] = ()
    family: str = ""
    kin: Kin | None = None
    comb: Comb | None = None
    untold: bool = False

    def __post_init__(self) -> None:
        if (self.port is None) != (self.make is None) or (self.port is None and not self.changes):
            raise ValueError(f"effect {self.id}: needs a port and what acts there, or a parameter to change")

    def inserted(self, theta: Array) -> Inserted | None:
        """What is put into the system; nothing where a parameter is changed."""
        if self.port is None or self.make is None:
            return None
        return Inserted(self.make(theta), self.port, self.reads)


@dataclass(frozen=True)
class Sizes:
    """How large signals are, from which priors are made.

    Attributes:
        spread: standard deviation of each port's signal, in its unit. Of forces on free inputs, the constant
            force that moves some compared output by its spread.
        peak: largest magnitude; rate: largest change per time, per second.
        way: standard deviation of the integral over time, of velocities.
        levels: how many values it takes, where these are no more than `FEW_LEVELS`; else more than that.
    """

    spread: Mapping[Port, float]
    peak: Mapping[Port, float]
    rate: Mapping[Port, float]
    way: Mapping[Port, float]
    levels: Mapping[Port, int]


def unit_at(study: PortStudy, port: Port) -> str:
    """Unit of the signal that an effect at a port works on: that of the source, where an input converts what
    comes from it as it is.
    """
    for one in study.prepared.system.connections:
        if one.target == port and one.wire is None and (one.gain, one.offset) != (1.0, 0.0):
            return study.unit(one.source)
    return study.unit(port)
