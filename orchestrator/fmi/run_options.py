"""How an FMU is to be run, where it leaves a choice."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass

# Relative, of the integration of a model-exchange FMU for which nobody names one.
DEFAULT_TOLERANCE = 1e-6


class Interface(StrEnum):
    """Of the interfaces that FMI defines, those that are run here."""

    CO_SIMULATION = "co-simulation"
    MODEL_EXCHANGE = "model-exchange"


@dataclass(frozen=True)
class RunOptions:
    """How an FMU is to be run.

    Attributes:
        any_step: whether it takes any constant step size, although it does not declare so.
        interface: None: co-simulation where the FMU offers it, else model exchange.
        tolerance: relative tolerance of the integration; None: that of the FMU's default experiment, else
            `DEFAULT_TOLERANCE`. In model exchange the absolute tolerance of a state is this times its nominal
            value. A co-simulation FMU is reported it, and does
            with it what it will; FMI 1.0 has no call for that.
        event_mode: whether an FMI 3.0 co-simulation FMU returns at its events to have them handled, instead
            of handling them within its steps.
        isolated: whether it runs in a process of its own.
        time_limit: of each call to an isolated instance [s]; None: it may take as long as it wants.
        structure: structural parameters (FMI 3.0) and their values, on which sizes of arrays depend.
    """

    any_step: bool = False
    interface: Interface | None = None
    tolerance: float | None = None
    event_mode: bool = False
    isolated: bool = False
    time_limit: float | None = None
    structure: tuple[tuple[str, int], ...] = ()
