"""A system that is quick to run, and studies of it."""

from __future__ import annotations

from typing import Any

from orchestrator.campaign import Study

# 100 steps of compiled FMUs, one contact.
QUICK = {
    "run.stop_time": "0.8 s",
    "run.step_size": "8 ms",
    "run.loop": "python",
    "satellite.form": "native",
}
DERIVED = {
    "peak": "max(abs(contact.force))",
    "last": "final(satellite.velocity)",
    "stiff": "contact.stiffness / 1000",
}


def quick(**changes: Any) -> Study:
    """A study of 12 points, but for what is changed."""
    values: dict[str, Any] = {
        "system": "docking-1d-uncompensated",
        "set": QUICK,
        "design": {
            "grid": {
                "robot.tau_m": ["4 ms", "8 ms", "12 ms"],
                "contact.stiffness": {"from": "100 N/mm", "to": "176 N/mm", "count": 4},
            }
        },
        "derived": DERIVED,
    }
    return Study(values | changes)
