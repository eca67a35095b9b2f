"""Limits of the signal."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from .base import Array, Effect, Numbers, OfSignal


class Saturate(Effect):
    """y = x between low and high, and the nearer of them elsewhere. Zero size: no limits."""

    jittable: ClassVar[bool] = True

    low: Annotated[float, OfSignal()] = Field(-math.inf, description="The lowest value.")
    high: Annotated[float, OfSignal()] = Field(math.inf, description="The highest value.")

    @model_validator(mode="after")
    def _is_ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low {self.low!r} is above high {self.high!r}")
        return self

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        if x[0] < options[0]:
            return options[0]
        if x[0] > options[1]:
            return options[1]
        return x[0]
