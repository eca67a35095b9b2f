"""Charts of the loop as a master samples it, the communication step as one of the parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..base.errors import ConfigError, Problem
from .charts import Chart
from .loop import Loop
from .sampled import sample

__all__ = ["STEP", "sampled_chart"]

STEP = "run.step_size"


def sampled_chart(loop: Loop, master: str, x: tuple[str, ArrayLike], y: tuple[str, ArrayLike]) -> Chart:
    """Judge a loop under a master at every pair of values, one by one: some milliseconds a point.

    Args:
        loop: gives all other parameters.
        master: as `sample` has it.
        x, y: parameter, as "robot.tau_m", and its values, SI; one of the two is "run.step_size" [s].
    Returns: a chart without the first-order rule, which knows no steps.
    Raises: ConfigError if neither parameter is the step, or as `sample`.
    """
    (x_name, across), (y_name, up) = x, y
    across, up = np.asarray(across, np.float64), np.asarray(up, np.float64)
    if (x_name == STEP) == (y_name == STEP):
        what = f"the axes are {x_name} and {y_name}"
        raise ConfigError([Problem(loop.name, what, f"exactly one is to be {STEP}", "Without it: chart.")])
    name, values, steps = (y_name, up, across) if x_name == STEP else (x_name, across, up)
    unstable, growth = np.zeros((len(steps), len(values)), np.int64), np.zeros((len(steps), len(values)))
    for column, value in enumerate(values):
        changed = loop.with_parameters({name: float(value)})
        for row, step in enumerate(steps):
            one = sample(changed, master, float(step))
            unstable[row, column], growth[row, column] = one.unstable, one.growth()
    if x_name == STEP:
        unstable, growth = unstable.T, growth.T
    return Chart(loop, x_name, y_name, across, up, unstable, growth, None)
