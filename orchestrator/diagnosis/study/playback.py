"""A logged signal in place of a connection's own."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ...effects import Effect
from ...effects.base import Array, Numbers
from .study import Array as Samples


class Playback(Effect):
    """y(t) is the sample at t of a table, whatever x is; beyond its ends the first or last one.

    Where it is `ahead`, instants that are accepted get the sample of one step later: what is fed over the
    step that begins there is the log as it ends. Nothing is accepted at initialisation: it is that of then.

    An effect, so that masters, loops and what is remembered treat logged signals like all others.
    """

    jittable: ClassVar[bool] = True

    table: Any = None

    @staticmethod
    def of(start: float, step: float, samples: Samples, ahead: bool = False) -> Playback:
        """The table of samples `step` apart [s], the first at `start` [s]."""
        return Playback.model_construct(table=np.concatenate([[start, step, float(ahead)], samples]))

    def numbers(self) -> Any:
        """See Effect.numbers: start and step [s], whether it is ahead; then the samples."""
        return self.table

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        place = 3 + int((time - options[0]) / options[1] + 0.5)
        if commit and options[2] > 0.0:
            place += 1
        if place < 3:
            place = 3
        if place >= len(options):
            place = len(options) - 1
        return options[place]
