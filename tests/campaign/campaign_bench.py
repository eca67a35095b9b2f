"""A system that is quick to run, and studies of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from orchestrator.campaign import Study
from orchestrator.config import load_config
from orchestrator.fmi import bundled

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


def through(effect: str, **options: Any) -> tuple[dict[str, Any], str]:
    """The loop with an effect on the force, and the path of the effect."""
    data = load_config("docking-1d-uncompensated").model.to_data()
    data.pop("bonds", None)
    number = next(n for n, one in enumerate(data["connections"]) if str(one).endswith("-> satellite.force"))
    source, _, target = str(data["connections"][number]).partition("->")
    entry = {"from": source.strip(), "to": target.strip(), "through": [{"effect": effect, **options}]}
    data["connections"][number] = entry
    return data, f"connections[{number}].through[0].effect"


def with_mass_in(unit: str, path: Path, start: str, bounds: str = 'min="0"') -> Path:
    """The satellite as an FMU that takes its mass to be in g, K or kg."""
    # Here: processes of the tests' own import this module, without pytest's paths.
    from archives import repack

    base = {"g": '<BaseUnit kg="1" factor="0.001"/>', "K": '<BaseUnit K="1"/>', "kg": ""}[unit]
    changes = {
        '<Real start="279.06976744186045" quantity="Mass" unit="kg" min="0"/>': (
            f'<Real start="{start}" unit="{unit}" {bounds}/>'
        )
    }
    if base:
        changes['<Unit name="kg">'] = f'<Unit name="{unit}">{base}</Unit><Unit name="kg">'

    def change(name: str, data: bytes) -> tuple[str, bytes]:
        if name == "modelDescription.xml":
            for old, new in changes.items():
                assert data.count(old.encode()) == 1
                data = data.replace(old.encode(), new.encode())
        return name, data

    return repack(bundled.fmu_forms("SatelliteDynamics")["native"], path, change)


def one_body(fmu: object, **changes: Any) -> Study:
    """A study of one free body, 10 steps."""
    system = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "0.1 s"},
        "instances": {"m": {"fmu": str(fmu), "start": {"force": "0 N"}}},
    }
    values = {"system": system, "derived": {"mass": "m.mass"}, "step_halving": False}
    return Study(values | changes)
