"""Conditions under which an FMU can be tried: a step size that it takes, and inputs that it takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from .trial import Conditions

# Where an FMU names no step size: that of control loops, then a sampled component's likely ones [s].
_STEPS = (1e-3, 5e-4, 1e-4, 1e-2, 0.1, 1.0)
# An FMU may refuse inputs far from its start values: smaller ones are tried, and at last none.
_AMPLITUDES = (1.0, 0.1, 0.01, 0.0)


class Refused(Exception):
    """An FMU does not take its steps under some conditions; the message says why."""


def usable(
    attempt: Callable[[Conditions], int], wanted: Conditions, step_size: float | None, driven: bool
) -> Conditions:
    """The first conditions under which an attempt comes through.

    Args:
        attempt: tries conditions; gives the number of steps taken, or raises Refused.
        step_size: the one that the FMU is made for or proposes [s], the only one to be tried; None: likely
            ones are.
        driven: whether there are inputs.
    Raises: Refused if there are none: the last refusal.
    """
    refusal = Refused("nothing was tried")
    # The step size is found with inputs at rest, then how large they may be.
    for step in (step_size,) if step_size else _STEPS:
        found = replace(wanted, step_size=step, amplitude=0.0)
        try:
            found = replace(found, steps=attempt(found))
        except Refused as error:
            refusal = error
            continue
        for amplitude in _AMPLITUDES if driven else ():
            larger = replace(wanted, step_size=step, amplitude=amplitude)
            try:
                return replace(larger, steps=attempt(larger))
            except Refused:
                continue
        return found
    raise refusal
