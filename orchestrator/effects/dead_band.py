"""A range around zero in which nothing comes out."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Effect, Numbers, OfSignal


class DeadBand(Effect):
    """y = 0 where |x| <= threshold, and x less the threshold, towards zero, elsewhere. Zero size: 0."""

    main: ClassVar[str] = "threshold"
    jittable: ClassVar[bool] = True

    threshold: Annotated[float, OfSignal(difference=True)] = Field(
        ge=0, description="Half the width of the band.", allow_inf_nan=False
    )

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        if options[0] == 0.0:
            return x[0]
        if x[0] > options[0]:
            return x[0] - options[0]
        if x[0] < -options[0]:
            return x[0] + options[0]
        return 0.0
