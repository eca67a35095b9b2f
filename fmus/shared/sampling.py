"""The sample grid of a controller within communication steps of any size."""

from __future__ import annotations

import math
from typing import Any

# Of a sample period: far above the rounding of a communication point's time, far below any step.
GRID_TOLERANCE = 1e-6


def sample_due(slave: Any, current_time: float, step_size: float) -> bool:
    """Whether a sample is due at the end of the step.

    Args:
        slave: with `parameters.sample_period`, `state.start_time` and `state.samples`.
        current_time, step_size: of the step [s].
    Raises: ValueError, which the FMI layer logs and turns into a status, if the step leaves out a sample.
    """
    p, s = slave.parameters, slave.state
    end = current_time + step_size
    elapsed = end - s.start_time
    index = round(elapsed / p.sample_period)
    on_grid = abs(elapsed - index * p.sample_period) <= GRID_TOLERANCE * p.sample_period
    reached = index if on_grid else math.floor(elapsed / p.sample_period)
    if reached <= s.samples:
        return False
    if not on_grid or reached > s.samples + 1:
        due = s.start_time + (s.samples + 1) * p.sample_period
        raise ValueError(
            f"{slave.instance_name}: the step from {current_time:.9g} s to {end:.9g} s passes over the "
            f"sample at {due:.9g} s; steps have to end at every multiple of sample_period, "
            f"{p.sample_period:.9g} s: take a step size that divides it, or set sample_period to the "
            "step size"
        )
    return True


def require_finite(slave: Any, name: str, value: float, time: float) -> None:
    """Refuse an input that is not a finite number. Raises: ValueError, as above."""
    if not math.isfinite(value):
        unit = slave.type_attributes[name]["unit"]
        raise ValueError(
            f"{slave.instance_name}: input {name} is {value!r} {unit} at {time:.9g} s; a finite number "
            "is needed. Look at what is connected to it"
        )
