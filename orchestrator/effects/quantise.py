"""A resolution."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Effect, Numbers, OfSignal


class Quantise(Effect):
    """y = the multiple of the resolution that is nearest to x, the upper one of two. Zero size: 0."""

    main: ClassVar[str] = "resolution"
    jittable: ClassVar[bool] = True

    resolution: Annotated[float, OfSignal(difference=True)] = Field(
        ge=0, description="Distance of two values.", allow_inf_nan=False
    )

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        if options[0] == 0.0:
            return x[0]
        count = x[0] / options[0] + 0.5
        if abs(count) >= 4503599627370496.0:  # 2**52: the resolution is finer than the last bit
            return x[0]
        return options[0] * float(math.floor(count))

    def smooth(self) -> bool:
        return self.resolution == 0.0
