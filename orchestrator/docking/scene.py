"""What moves in a docking run, for a view of the motion; signals by the names that results have them under.

A scene is plain data: `time`; `tip` with its place `offset` in the frames `commanded` (as the satellites
have it) and `actual` (the robot), each `position` and `orientation` by signal names, None for what is
always zero or does not turn; `surfaces`, planes at `distance` [m] along -`normal`; `force` on the rod;
`bodies` with `name` and `size` [m], where they are known.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..results.recorders import Results
    from .options import DockingOptions, SpaceOptions


def line_scene(results: Results, options: DockingOptions) -> dict[str, Any]:
    """Of a run in one dimension, along x."""

    def along(name: str) -> list[str | None]:
        return [name, None, None]

    return {
        "time": "time",
        "tip": {
            "offset": [0.0, 0.0, 0.0],
            "commanded": {"position": along(f"{options.satellite}.position"), "orientation": None},
            "actual": {"position": along(f"{options.robot}.position"), "orientation": None},
        },
        "normal": [-1.0, 0.0, 0.0],
        "surfaces": _surfaces(results, options.contact),
        "force": along(f"{options.contact}.force"),
        "bodies": [],
    }


def space_scene(results: Results, options: SpaceOptions) -> dict[str, Any]:
    """Of a run in six degrees of freedom, seen from the target; the satellites in the inertial frame."""

    def pose(instance: str, suffix: str = "") -> dict[str, list[str]]:
        return {
            name: [f"{instance}.{name}{suffix}[{index}]" for index in range(1, size + 1)]
            for name, size in (("position", 3), ("orientation", 4))
        }

    def vector(name: str) -> list[float]:
        return [float(results.parameters[f"{options.contact}.{name}[{index}]"]) for index in (1, 2, 3)]

    return {
        "time": "time",
        "tip": {
            "offset": vector("tip"),
            "commanded": pose(options.satellites),
            "actual": pose(options.robot),
        },
        "normal": vector("normal"),
        "surfaces": _surfaces(results, options.contact),
        "force": [f"{options.contact}.force[{index}]" for index in (1, 2, 3)],
        "bodies": [
            {
                "name": name,
                "size": _block(results, options.satellites, body),
                **pose(options.satellites, f"_{body}"),
            }
            for name, body in (("service satellite", "a"), ("target", "b"))
        ],
    }


def _surfaces(results: Results, contact: str) -> list[dict[str, Any]]:
    return [
        {"name": name, "distance": float(results.parameters[f"{contact}.{name}"])}
        for name in ("front", "rear")
    ]


def _block(results: Results, pair: str, body: str) -> list[float]:
    """Edges [m] of the uniform block with a satellite's mass and moments of inertia."""
    mass = float(results.parameters[f"{pair}.mass_{body}"])
    moments = [float(results.parameters[f"{pair}.inertia_{body}[{i},{i}]"]) for i in (1, 2, 3)]
    total = sum(moments)
    # I_x = m (b^2 + c^2)/12, so a^2 = 6 (I_y + I_z - I_x)/m.
    return [math.sqrt(max(6.0 * (total - 2.0 * one) / mass, 0.0)) for one in moments]
