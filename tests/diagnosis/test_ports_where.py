"""Where the gap of any system lies, what its step adds, and what work it does at interfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from ports_bench import COULOMB, POSITION, VELOCITY, VOLTAGE, answer, friction, study, system

from orchestrator.diagnosis.finding import NOMINAL, Augmented, Candidate, Finding
from orchestrator.diagnosis.ports.apart import Apart, closed, components, estimates
from orchestrator.diagnosis.ports.energy import energy, pairs, unclear
from orchestrator.diagnosis.ports.motion import PHASES, phases
from orchestrator.diagnosis.ports.numerics import doubts, numerics
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay
from orchestrator.diagnosis.ports.steps import with_steps
from orchestrator.diagnosis.ports.study import Role
from orchestrator.diagnosis.ports.where import lasting, ledger, no_shares, shapley_shares, where
from orchestrator.system.system import Port


def test_halving_tells_the_error_of_the_step(rubbing):
    found = numerics(rubbing, {"nominal": NOMINAL})
    assert 0.0 < found["error"] < found["gap"] and found["fraction"] == found["error"] / found["gap"]
    quiet = {**found, "noise": found["error"]}
    assert found["fraction"] < 0.1 and doubts(quiet) == []
    assert "4 times the noise" in doubts({**found, "noise": found["error"] / 4.0})[0].what
    assert "25 % of the gap" in doubts({**quiet, "fraction": 0.25})[0].what
    # The error of this loop is of first order in the step: with half of it, half as large.
    finer = (rubbing, with_steps(rubbing, 2), with_steps(rubbing, 4))
    replays = [PortReplay(one, one.of(Role.HELDOUT)) for one in finer]
    coarse, half, quarter = (
        one.signals(one.runs[0], {}, (), np.zeros(0))[POSITION] for one in replays
    )  # fmt: skip
    ratio = np.std(coarse - half) / np.std(half - quarter)
    assert ratio == pytest.approx(2.0, rel=0.3)


@pytest.mark.parametrize(
    ("cutoff", "windows", "told"),
    [("5 Hz", 100, ""), ("0.2 Hz", 100, ""), ("0.2 Hz", 50, "remembers more than the 0.352 s")],
)
def test_what_a_component_remembers_is_not_its_fault(tmp_path, monkeypatch, cutoff, windows, told):
    """A filter without start values misses its own log in windows that are shorter than it remembers.

    Where a run has too many of them, they are not all led through from its begin.
    """
    monkeypatch.setattr("orchestrator.diagnosis.ports.where._ALL", windows)
    sensor = {"sensor": {"fmu": "ForceSensor", "start": {"cutoff": cutoff}}}
    listen = {"from": [{"port": "controller.voltage", "gain": "2 N/V"}], "to": "sensor.force"}
    logged = {"sensor.measured_force": ("N", 5e-3)}
    path = study(tmp_path, [COULOMB, listen], instances=sensor, logged=logged, window="20 ms")
    believed = system(0.2, [listen])
    believed["instances"] |= sensor
    (path / "believed.yaml").write_text(yaml.safe_dump(believed))
    data = yaml.safe_load((path / "study.yaml").read_text()) | {"system": "believed.yaml"}
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    found = load_port_study(path)
    finding = Finding((Candidate((), 1.0, {}, (), 0.0, NOMINAL),), (), (), "", (), NOMINAL)
    led, warned = lasting(found, finding)
    assert led.leads > 4 and ([one.place for one in warned] == ["sensor"]) == bool(told)
    assert all(told in one.what for one in warned)
    assert where(found, finding)["sensor"] > 0.3
    shares = where(led, finding)
    assert shares["drive"] > 0.99 and abs(shares["sensor"]) < 0.01


def test_windows_need_no_longer_lead_where_states_are_taken_up(rubbing):
    finding = Finding((Candidate((), 1.0, {}, (), 0.0, NOMINAL),), (), (), "", (), NOMINAL)
    assert lasting(rubbing, finding) == (rubbing, [])


def test_the_components_and_their_ports(rubbing):
    drive, controller = components(rubbing)
    assert drive.places == ("drive",) and set(drive.ports) == {POSITION, VELOCITY}
    assert controller.name == "controller" and controller.ports == (VOLTAGE,)
    assert no_shares(rubbing) == ""
    assert "alone" in no_shares(replace(rubbing, compared=(VOLTAGE,), fed=(*rubbing.fed, POSITION)))


def test_with_all_residuals_injected_the_loop_follows_the_log(rubbing, effects):
    (run,) = rubbing.of(Role.HELDOUT)
    found = answer(effects, "drive.coulomb", 12.0, 1e-3)
    apart = Apart(closed(rubbing), run, estimates(rubbing, run, found.answer), NOMINAL)
    window = apart.windows[7]
    residuals = apart.residuals(window)
    for injected, near in (({0, 1}, True), ({1}, False)):
        given = apart.ahead(window, residuals, injected)
        for port in (POSITION, VOLTAGE):
            log = run.logs[port][window.begin : window.end]
            assert bool(np.abs(given[port] - log).max() <= 1e-9 * np.abs(log).max()) is near


def test_the_faulty_component_has_the_gap(rubbing, effects):
    found = answer(effects, "drive.coulomb", 12.0, 1e-3)
    shares = shapley_shares(rubbing, found)
    assert shares.values.sum() == pytest.approx(shares.gap - shares.left, abs=1e-9)
    assert shares.left < 1e-12 * shares.gap and shares.windows >= 10
    told = where(rubbing, found)
    assert sum(told.values()) == pytest.approx(1.0, abs=1e-9)
    assert told["drive"] > 0.95
    rows = ledger(rubbing, found)
    assert sum(one["share"] for one in rows) == pytest.approx(1.0, abs=1e-9)
    assert sum(one["share"] for one in rows if one["component"] == "drive") > 0.95
    # Friction acts all the way, both ways.
    by_phase = {name: sum(one["share"] for one in rows if one["phase"] == name) for name in PHASES}
    assert by_phase["forth"] > 0.2 and by_phase["back"] > 0.2


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_noise_leaves_by_chance_is_not_shared_out(tmp_path, seed):
    """An excess that is none, shared out, was 200 % here and -100 % there."""
    finding = Finding((Candidate((), 1.0, {}, (), 0.0, NOMINAL),), (), (), "", (), NOMINAL)
    assert ledger(load_port_study(study(tmp_path / "none", seed=seed)), finding) == []
    little = friction("Coulomb", level="4 N", width="1 mm/s")
    assert ledger(load_port_study(study(tmp_path / "little", [little], seed=seed)), finding)


def test_phases_of_motion(rubbing):
    (run,) = rubbing.of(Role.HELDOUT)
    names, labels = phases(rubbing, run, {})
    assert names == PHASES
    # One motion to and fro in 2 s, from rest to rest.
    share = np.bincount(labels, minlength=4) / len(labels)
    assert share[0] == pytest.approx(share[1], abs=0.03) and share[0] > 0.4
    turning = np.flatnonzero(labels == PHASES.index("reversal"))
    assert np.abs(turning * 2e-3 - 1.0).max() < 0.1
    assert (labels[:5] == PHASES.index("rest")).all()
    held = replace(rubbing, motion=Port("path", "position"), rest=10.0)
    assert set(phases(held, run, {})[1]) == {PHASES.index("rest")}


def test_energy_at_a_measured_interface_adds_up(tmp_path):
    """The damper of a testing machine: what its friction takes, against what it is believed to."""
    time = np.arange(400) * 1e-3
    velocity = 0.05 * np.sin(2.0 * np.pi * 5.0 * time)
    force = 900.0 * np.tanh(velocity / 1e-3)
    rows = np.column_stack([time, velocity, force])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="time [s],v [m/s],f [N]", comments="")
    data = {
        "format": "port-study/1",
        "system": "friction-damper",
        "set": ["damper.level=1 kN", "run.stop_time=0.4 s"],
        "columns": {"time": "time", "machine.velocity": "v", "damper.force": {"column": "f", "noise": "1 N"}},
        "runs": [{"file": "a.csv", "role": "train"}],
    }
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(data))
    found = load_port_study(tmp_path)
    model = Augmented({}, (), np.zeros(0))
    told = energy(found, Finding((Candidate((), 1.0, {}, (), 0.0, model),), (), (), "", (), model))
    keys = [f"damper.force x velocity, {name}" for name in PHASES]
    assert told["interfaces"] == keys and told["unit"] == "J"
    assert told["change"]["measured"] == pytest.approx(1e-3 * float(force @ velocity), rel=1e-12)
    assert told["change"]["measured"] == pytest.approx(0.9 * told["change"]["nominal"], rel=0.03)
    for key in keys:
        assert told["excess"][key] == told["measured"][key] - told["nominal"][key]
        parts = told["parts"][key]
        assert parts["force"] + parts["velocity"] == pytest.approx(told["excess"][key], abs=1e-9)
        assert parts["velocity"] == 0.0  # it was fed
    assert sum(told["excess"].values()) == pytest.approx(told["change"]["excess"], abs=1e-9)
    # One component alone: the gap is its own.
    assert "alone" in no_shares(found)


def test_forces_do_work_along_their_own_velocities(tmp_path):
    """Vectors by their elements; what a controller is fed and gives is no interface, and a force that may go
    with several velocities is reported, not counted."""
    draw = np.random.default_rng(2)
    units = {
        "contact.force": "N",
        "robot.velocity": "m/s",
        "controller.force": "N",
        "satellites.velocity": "m/s",
    }
    names = {f"{name}[{axis}]": unit for name, unit in units.items() for axis in (1, 2, 3)}
    logs = {name: draw.standard_normal(200) for name in names}
    table = np.column_stack([5e-4 * np.arange(200.0), *logs.values()])
    header = ",".join(["time [s]", *(f"{name} [{unit}]" for name, unit in names.items())])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=header, comments="")
    seen = {name: {"column": name, "noise": f"0.1 {unit}", "feed": False} for name, unit in names.items()}
    data = {
        "format": "port-study/1",
        "system": "docking-6d",
        "set": ["run.stop_time=0.1 s"],
        "columns": {"time": "time", **seen},
        "runs": [{"file": "a.csv", "role": "train"}],
    }
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(data))
    found = load_port_study(tmp_path)
    axes = (1, 2, 3)
    assert [one.name for one in pairs(found, found.runs[0])] == [
        f"contact.force[{axis}] x velocity[{axis}]" for axis in axes
    ]
    told = energy(found, Finding((Candidate((), 1.0, {}, (), 0.0, NOMINAL),), (), (), "", (), NOMINAL))
    work = sum(float(logs[f"contact.force[{axis}]"] @ logs[f"robot.velocity[{axis}]"]) for axis in axes)
    assert told["change"]["measured"] == pytest.approx(5e-4 * work, rel=1e-9)
    forces = ", ".join(f"satellites.force[{axis}]" for axis in axes)
    assert unclear(found) == f"along which velocity the force acts is not known of {forces}"
