"""Instances with a step of their own: which masters and options they go with."""

from __future__ import annotations

from ..base.errors import Problem
from ..config import Places
from ..system.system import System


def slow(system: System, what: str, places: Places | None) -> list[Problem]:
    """Problems of instances whose step is longer than the communication step, for a master that `what`."""
    places = places or Places("system")
    return [
        Problem(
            places.text(("instances", one.name, "step_size")),
            f"{one.name} steps once in {one.ratio} communication steps",
            f"the master {what}",
            "Give it the communication step or a part of it, or take the master jacobi or gauss-seidel.",
        )
        for one in system.instances
        if one.ratio > 1
    ]


def slow_with_extrapolation(system: System, order: int, places: Places | None) -> list[Problem]:
    """Problems of slow instances under a master that extrapolates inputs over one communication step."""
    return slow(system, "extrapolates inputs over one communication step", places) if order else []
