"""How results of `docking-6d` depend on what the paper leaves open, as a table.

    python -m tests.benchmarks.controller_choices

The paper names neither the forgetting factor of the Sage-Husa filter, nor initial covariances, nor how
control switches at contact, nor what it assumes before the first contact. Each is varied by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from orchestrator.simulation.run import run

# What is varied -> settings of the controller, beside the chosen ones.
CHANGES: dict[str, tuple[str, ...]] = {
    "as chosen": (),
    "forgetting factor 0.9": ("forgetting_factor=0.9",),
    "forgetting factor 0.995": ("forgetting_factor=0.995",),
    "stiffness sigma 10 N/mm": ("stiffness_sigma=10 N/mm",),
    "stiffness sigma 1000 N/mm": ("stiffness_sigma=1000 N/mm",),
    "damping sigma 100 N.s/m": ("damping_sigma=100 N.s/m",),
    "damping sigma 10000 N.s/m": ("damping_sigma=10000 N.s/m",),
    "force sigma 0.1 N": ("force_sigma=0.1 N",),
    "force sigma 10 N": ("force_sigma=10 N",),
    "switching at 10 N, back at 5 N": ("contact_threshold=10 N", "release_threshold=5 N"),
    "switching at 20 N, back at 10 N": ("contact_threshold=20 N", "release_threshold=10 N"),
    "silence of 3 ms": ("settling_time=3 ms",),
    "silence of 12 ms": ("settling_time=12 ms",),
    "initial stiffness 30 N/mm": ("initial_stiffness=30 N/mm",),
    "initial stiffness 300 N/mm": ("initial_stiffness=300 N/mm",),
    "missed work not restored": ("switching_compensation=false",),
    "normal not averaged": ("normal_time=0 ms",),
    "normal averaged over 20 ms": ("normal_time=20 ms",),
}
NOISE = ("noise.force_sigma=1 N", "noise.torque_sigma=0.05 N.m", "run.stop_time=2.5 s")


def measured(changes: Sequence[str], settings: Sequence[str] = NOISE) -> dict[str, float]:
    """Run `docking-6d` with settings of its controller.

    Args:
        changes: settings of the controller, such as "forgetting_factor=0.9".
        settings: of the rest.
    Returns: `contacts`; `first_cor`; `worst_cor`, of the later contacts the one furthest from 1; `energy`,
        the kinetic energy in free flight after the last contact over that at the start; `stiffness_error`,
        of the final estimate, relative [1]; `damping_estimate` [N.s/m], 0 in truth.
    Raises: ValueError if the run has fewer than two contacts.
    """
    summary = run(
        "docking-6d", overrides=[*settings, *(f"controller.{one}" for one in changes)], halving=False
    ).summary
    contacts: list[dict[str, Any]] = summary["contacts"]
    if len(contacts) < 2:
        raise ValueError(f"{len(contacts)} contacts in the run; needed: 2; let it run longer")
    truth = summary["parameters"]["contact.stiffness"]
    return {
        "contacts": float(len(contacts)),
        "first_cor": contacts[0]["cor"],
        "worst_cor": max((one["cor"] for one in contacts[1:]), key=lambda cor: abs(cor - 1.0)),
        "energy": contacts[-1]["kinetic_energy_ratio"],
        "stiffness_error": summary["stiffness_estimate"] / truth - 1.0,
        "damping_estimate": summary["damping_estimate"],
    }


def main() -> None:
    """Run all variations and print the table."""
    for name, changes in CHANGES.items():
        row = measured(changes)
        print(f"{name:34}" + "".join(f"{key} {value:<12.5g}" for key, value in row.items()))


if __name__ == "__main__":
    main()
