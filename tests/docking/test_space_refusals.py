"""What a system in six degrees of freedom refuses before it runs, as the command line tells it."""

from __future__ import annotations

import pytest

from orchestrator.cli.main import main

INITIALISATION = "    [error] ExitInitializationMode: initialisation is refused\n"


def reported(instance: str, sentence: str) -> str:
    """The whole text of a refusal at the end of initialisation."""
    return (
        f"orchestrator: {instance}: fmi2ExitInitializationMode returned error\n"
        f"  log of the FMU:\n    [error] {instance}: {sentence}\n{INITIALISATION}"
    )


MOVE = "Move target_position or rail_position"
BRANCH = f"{MOVE}, or start in another branch (present)."
REFUSALS = {
    "unreachable pose": (
        "docking-6d-arm",
        ["inverse.target_position[1]=4 m"],
        reported(
            "inverse",
            "the first command: out of reach: the wrist's centre would be 3.17415 m from A2; allowed: "
            f"0.0507002 m to 2.3507 m. {MOVE}, or let the rail carry more by rail_share.",
        ),
    ),
    "rail limit": (
        "docking-6d-arm",
        ["inverse.rail_position=1.6 m", "inverse.target_position[1]=3.28403508 m"],
        reported(
            "inverse",
            f"the first command: rail would stand at 1.6 m; allowed: -1.5 m to 1.5 m. {BRANCH}",
        ),
    ),
    "rail rate": (
        "docking-6d-arm",
        ["inverse.rail_share=100"],
        reported(
            "inverse",
            "the first command: rail would move at 2 m/s; allowed: up to 1.5 m/s. Command it slower, or keep "
            "further from singularities.",
        ),
    ),
    "singular wrist": (
        "docking-6d-arm",
        ["inverse.target_position[1]=1.8653 m", "inverse.target_position[3]=1.7665 m"],
        reported(
            "inverse",
            "the first command: wrist singularity: A4 and A6 are in line but for an angle, A5, of sine "
            "2.35634e-05; allowed: 0.05 (wrist_margin) or more. Move target_position up or down, or turn the "
            "tool.",
        ),
    ),
    "inertia not positive definite": (
        "docking-6d",
        ["satellites.inertia_a[1,1]=-1 kg.m2"],
        reported(
            "satellites",
            "inertia_a is not positive definite: diagonal -1.0, 50.0, 50.0 kg.m2, [1,2], [1,3], [2,3] "
            "0.0, 0.0, 0.0 kg.m2; its three principal moments have to be above 0 kg.m2",
        ),
    ),
    "start in penetration": (
        "docking-6d",
        ["contact.front=-7 mm"],
        "orchestrator: contact: fmi2ExitInitializationMode returned error\n  log of the FMU:\n    [error] "
        "ExitInitializationMode: assertion violated at t = 0 s: the rod tip starts inside a frame; start it "
        "between rear and front, or set start_in_contact if that is meant (PointContact.mo:70)\n",
    ),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_bad_input_is_refused_before_the_run(name, tmp_path, capsys):
    system, changes, expected = REFUSALS[name]
    settings = [part for change in changes for part in ("--set", change)]
    assert main(["run", system, *settings, "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err == expected
