"""The signal plus a constant."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Effect, Numbers, OfSignal


class Offset(Effect):
    """y = x + value. Zero size: 0."""

    main: ClassVar[str] = "value"
    jittable: ClassVar[bool] = True

    value: Annotated[float, OfSignal(difference=True)] = Field(
        description="What is added.", allow_inf_nan=False
    )

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        if options[0] == 0.0:
            return x[0]  # -0.0 + 0.0 is +0.0
        return x[0] + options[0]
