"""The linear system of a config, that knows its config: for charts over values of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..simulation.run import prepare
from .chart import config_chart
from .chart_report import Chart
from .from_system import Linearised, linearise
from .over_parameter import parameter_range
from .trim import trim


@dataclass(frozen=True, repr=False)
class LinearConfig(Linearised):
    """A linearised system with its config.

    Attributes:
        config: what it was made of, as for `prepare`.
        at_time: the point of a run that it is linear around [s]; None: none.
        fixed: states that were fixed, where it is linear around a steady state; None: it is not.
    """

    config: Any = None
    at_time: float | None = None
    fixed: tuple[str, ...] | None = None

    def chart(self, x: str, y: str, points: int | None = None) -> Chart:
        """Where the system is stable over two values of its config, at its operating point.

        Args:
            x, y: ranges as `orchestrator stability --over` takes them, "robot.tau_m=1..8 ms"; also
                run.step_size.
            points: along either axis; None: 200, and 50 with the communication step.
        """
        ranges = parameter_range(x), parameter_range(y)
        return config_chart(self.config, *ranges, at_time=self.at_time, trimmed=self.fixed, points=points)


def linear_config(config: Any, at_time: float | None, trimmed: Sequence[str] | None) -> LinearConfig:
    """Linearise a config, around the steady state with these states fixed if `trimmed` is not None."""
    prepared = prepare(config)
    if trimmed is not None:
        prepared = trim(prepared, trimmed).prepared
    fixed = None if trimmed is None else tuple(trimmed)
    found = linearise(prepared, at_time=at_time)
    return LinearConfig(**vars(found), config=config, at_time=at_time, fixed=fixed)
