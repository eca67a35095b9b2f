"""The bundled systems in six degrees of freedom: conservation, energy, and the line as a special case."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from orchestrator.cli.main import main
from orchestrator.docking.contacts import find_contacts
from orchestrator.docking.space import effective_mass
from orchestrator.docking.space_figures import comparison
from orchestrator.docking.space_signals import stacked
from orchestrator.simulation.run import run

# Of the initial energy: what the active mode may gain in any free flight, over all contacts of a run.
ENERGY_BOUND = 3e-4


@pytest.mark.parametrize("system", ["docking-6d", "docking-6d-arm"])
def test_active_control_bounds_energy_and_conserves_momentum(system):
    result = run(system, halving=False)
    summary = result.summary
    assert len(summary["contacts"]) >= 6
    for contact in summary["contacts"]:
        assert contact["kinetic_energy_ratio"] == pytest.approx(1.0, abs=ENERGY_BOUND)
        # The effective mass changes while the rod slides along the surface, so that 1 is not exact.
        assert contact["cor"] == pytest.approx(contact["ideal_cor"], abs=2e-3)
        assert contact["peak_force_ratio"] == pytest.approx(1.0, abs=2e-3)
        assert 240.0 < contact["effective_mass"] < 300.0 * 4000.0 / 4300.0
    assert summary["momentum"]["linear_change"] < 1e-9 and summary["momentum"]["angular_change"] < 1e-9
    assert summary["stiffness_estimate"] == pytest.approx(176e3, rel=1e-4)
    # Contact is off the line of centres and oblique: both satellites begin to turn.
    assert summary["attitude"]["largest_turn"] > 0.03
    assert np.abs(stacked(result.results, "satellites.angular_velocity_b")).max() > 5e-4


def test_energy_grows_without_control():
    summary = run("docking-6d-uncompensated", halving=False).summary
    energies = [contact["kinetic_energy_ratio"] for contact in summary["contacts"]]
    assert len(energies) >= 4 and min(np.diff([1.0, *energies])) > 0.4
    for contact in summary["contacts"]:
        # The rig's lag alone: that of a mass as large as the effective one on a line.
        assert contact["cor"] == pytest.approx(1.25, abs=0.005)
    assert summary["momentum"]["linear_change"] < 1e-9 and summary["momentum"]["angular_change"] < 1e-9
    assert summary["stiffness_estimate"] is None


def test_the_virtual_wall_takes_its_theoretical_share():
    summary = run("docking-6d-wall", overrides=["run.stop_time=1.6 s"], halving=False).summary
    assert len(summary["contacts"]) == 2
    for contact in summary["contacts"]:
        assert contact["ideal_cor"] == pytest.approx(0.9634, abs=5e-4)
        assert contact["cor"] == pytest.approx(contact["ideal_cor"], abs=2e-3)
    assert summary["stiffness_estimate"] == pytest.approx(70e3, rel=1e-3)
    assert summary["damping_estimate"] == pytest.approx(100.0, rel=1e-2)


def on_a_line(*instances: str) -> list[str]:
    """Settings that turn the system in space into the one along x."""
    settings = ["contact.normal[2]=0", "contact.normal[3]=0", "contact.front=5 mm", "contact.rear=-5 mm"]
    settings += [
        f"{name}.tip[2]=0 m" for name in ("contact", *instances) if name in ("contact", "controller")
    ]
    for name in ("satellites", "sensor", *instances):
        settings += [f"{name}.sensor_position[1]=0 m", f"{name}.sensor_position[2]=0 m"]
        settings += [f"{name}.sensor_orientation[1]=1", f"{name}.sensor_orientation[2]=0"]
    return settings


PAIRS = {
    "satellite.position": "satellites.position[1]",
    "satellite.velocity": "satellites.velocity[1]",
    "robot.position": "robot.position[1]",
    "contact.force": "contact.force[1]",
}


@pytest.mark.parametrize(
    ("line", "space", "own", "settings"),
    [
        ("docking-1d", "docking-6d", ["controller"], []),
        ("docking-1d", "docking-6d", ["controller"], ["controller.mode=off"]),
        ("docking-1d-uncompensated", "docking-6d-uncompensated", [], ["run.step_size=0.5 ms"]),
    ],
)
def test_the_line_is_a_special_case(line, space, own, settings):
    """To the integrators' relative tolerance, 1e-9 by default: the robots are different FMUs."""
    settings = ["run.stop_time=2.5 s", *settings]
    one = run(line, overrides=settings, halving=False).results
    other = run(space, overrides=[*settings, *on_a_line(*own)], halving=False).results
    assert np.count_nonzero(np.diff((one["contact.force"] != 0.0).astype(int)) == 1) >= 3
    pairs = dict(PAIRS)
    if own:
        pairs |= {"controller.force": "controller.force[1]"}
        pairs |= {f"controller.{name}_estimate": f"controller.{name}_estimate" for name in ("stiffness",)}
    for first, second in pairs.items():
        difference = np.abs(one[first] - other[second]).max()
        assert difference < 1e-8 * np.abs(one[first]).max(), (first, difference)
    for name in ("position[2]", "position[3]", "velocity[2]", "angular_velocity[1]", "orientation[4]"):
        assert not other[f"satellites.{name}"].any()


def test_effective_mass_on_the_line_of_centres_is_the_reduced_mass_and_off_it_less():
    inertia = np.diag([50.0, 60.0, 70.0])
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5])
    way = np.array([1.0, 0.0, 0.0])

    def seen(arm: np.ndarray) -> float:
        return effective_mass(way, [(300.0, inertia, turn, arm), (4000.0, inertia, turn, np.zeros(3))])

    assert seen(np.array([0.5, 0.0, 0.0])) == pytest.approx(300.0 * 4000.0 / 4300.0, rel=1e-14)
    # A push of 1 N.s off the centre: velocity of the point along it, from momentum and spin.
    arm = np.array([0.5, 0.2, -0.1])
    spin = turn.apply(np.linalg.solve(inertia, turn.inv().apply(np.cross(arm, way))))
    velocity = 1.0 / 300.0 + np.cross(spin, arm)[0] + 1.0 / 4000.0
    assert seen(arm) == pytest.approx(1.0 / velocity, rel=1e-14)


def test_contacts_whose_velocity_changes_in_flight_are_found():
    """A velocity that drifts in free flight hides the last contact from the measure on a line alone."""
    time = np.arange(60) * 0.1
    force = np.where((time > 0.95) & (time < 2.05), -5.0, 0.0)
    velocity = np.where(time < 1.5, 1.0, -1.0) + 1e-3 * time
    assert find_contacts(time, velocity, force) == []
    (found,) = find_contacts(time, velocity, force, settled=math.inf)
    assert (found.side, found.first, found.last) == ("front", 10, 20)
    assert found.velocity_after == velocity[found.free_after]


def test_the_command_writes_measures_and_figures(tmp_path, capsys):
    out = tmp_path / "out"
    settings = ["--set", "run.stop_time=0.6 s"]
    assert main(["run", "docking-6d-uncompensated", "docking-6d", *settings, "--out", str(out)]) == 0
    reported = capsys.readouterr().out
    assert "kinetic_energy_ratio" in reported
    names = {"positions", "attitude", "forces", "energy", "contacts"}
    for system, own in (("docking-6d", {"estimates"}), ("docking-6d-uncompensated", set())):
        drawn = {path.stem for path in (out / system).glob("*.png")}
        assert drawn >= names | own | {"signals"} and ("estimates" in drawn) == bool(own)
        summary = json.loads((out / system / "summary.json").read_text())
        assert len(summary["contacts"]) == 1 and summary["numerics"]["momentum"]["linear_change"] is not None
    assert (out / "comparison-space.png").is_file()


def test_equal_runs_are_both_seen_in_their_comparison():
    contact = {"cor": 1.0, "kinetic_energy_ratio": 1.0, "peak_force": 140.0}
    drawn = comparison({name: {"contacts": [contact, contact]} for name in ("one", "two", "three", "four")})
    for axes in drawn.axes:
        sizes = [line.get_markersize() for line in axes.lines]
        assert sizes == sorted(sizes, reverse=True) and len(set(sizes[:3])) == 3
        assert all(line.get_fillstyle() == "none" for line in axes.lines)


def test_noise_reaches_the_reading_and_is_the_seeds():
    noisy = ["noise.force_sigma=1 N", "noise.torque_sigma=0.05 N.m", "run.stop_time=0.2 s"]
    first, again, other = (
        run("docking-6d", overrides=[*noisy, f"noise.seed={seed}"]).results["sensor.measured_force[2]"]
        for seed in (3, 3, 4)
    )
    assert (first == again).all() and (first != other).any()
    assert np.std(first) == pytest.approx(1.0, abs=0.15)
