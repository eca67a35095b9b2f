"""Where the gap of any system lies, what its step adds, which effects tie, and what to run next."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from ports_bench import friction, study, system

from orchestrator.__main__ import main
from orchestrator.diagnosis.answers import Answer
from orchestrator.diagnosis.finding import NOMINAL, Augmented, Candidate, Finding
from orchestrator.diagnosis.outlook import laplace
from orchestrator.diagnosis.ports.apart import Apart, closed, components, estimates
from orchestrator.diagnosis.ports.candidates import candidates
from orchestrator.diagnosis.ports.energy import energy, pairs, unclear
from orchestrator.diagnosis.ports.experiments import (
    _expected,
    next_experiment,
    no_experiment,
    predicted,
    sensors,
)
from orchestrator.diagnosis.ports.motion import PHASES, phases
from orchestrator.diagnosis.ports.numerics import doubts, numerics
from orchestrator.diagnosis.ports.practice import (
    Case,
    Practise,
    _Answer,
    coverage,
    learn,
    parts_of,
    practise,
)
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay, Weighted, measure
from orchestrator.diagnosis.ports.simulated import simulated
from orchestrator.diagnosis.ports.steps import with_steps
from orchestrator.diagnosis.ports.study import Role
from orchestrator.diagnosis.ports.tempering import Tempering, read_practice, sealed
from orchestrator.diagnosis.ports.ties import alike
from orchestrator.diagnosis.ports.where import lasting, ledger, no_shares, shapley_shares, where
from orchestrator.diagnosis.study import Nominal
from orchestrator.errors import ConfigError, OrchestratorError
from orchestrator.run import prepare
from orchestrator.system import Port

POSITION, VELOCITY = Port("drive", "position"), Port("drive", "velocity")
VOLTAGE = Port("controller", "voltage")
# Each law is compiled when it is first used, so that fewer of them are quicker.
FEW = {"only": ["drive.coulomb", "drive.viscous", "drive.voltage.gain", "drive.force_per_voltage"],
       "parameters": {"drive.force_per_voltage": "5 N/V"}}  # fmt: skip
COULOMB = friction("Coulomb", level="12 N", width="1 mm/s")
EXPERIMENTS = [
    {"name": "the same again", "set": ["run.stop_time=2 s", "path.stroke=0.2 m", "path.frequency=0.5 Hz"]},
    {"name": "slow", "description": "a slow motion",
     "set": ["run.stop_time=2 s", "path.stroke=10 mm", "path.frequency=0.5 Hz"]},
]  # fmt: skip


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    """A study with hidden friction."""
    path = study(tmp_path_factory.mktemp("rubbing"), [COULOMB], candidates=FEW, experiments=EXPERIMENTS)
    return load_port_study(path)


@pytest.fixture(scope="module")
def effects(rubbing):
    """Its candidates, by id."""
    return {one.id: one for one in candidates(rubbing, measure(rubbing, rubbing.runs[0]))}


def answer(effects, name, *theta, ties=()):
    """A finding that names one effect."""
    model = Augmented({}, (effects[name],), np.array(theta))
    one = Candidate((name,), 1.0, {}, ties, 100.0, model)
    return Finding((one,), (name,), (name.partition(".")[0],), "", (name,), NOMINAL)


def weighted(found):
    """A fitter of the train runs of a study, as if residuals were white."""
    from orchestrator.diagnosis.fit import Fitter

    replay = PortReplay(found, found.of(Role.TRAIN))
    return Fitter(Weighted(replay, [1.0] * len(replay.compared(replay.runs[0]))))


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
    with several velocities is told, not counted."""
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


def test_a_gain_and_the_parameter_that_it_equals_are_tied(tmp_path):
    path = study(tmp_path, candidates={"only": FEW["only"], "parameters": FEW["parameters"]})
    text = (path / "study.yaml").read_text().replace(
        "- run.step_size=2 ms", "- run.step_size=2 ms\n- drive.force_per_voltage=32.5 N/V"
    )  # fmt: skip
    (path / "study.yaml").write_text(text)
    found = load_port_study(path)
    known = {one.id: one for one in candidates(found, measure(found, found.runs[0]))}
    fitter = weighted(found)
    fit = fitter.fit((known["drive.voltage.gain"],), None, np.array([0.2]))
    ties = alike(fitter, Answer(("drive.voltage.gain",), 100.0, 0.0, fit), list(known.values()))
    # Another mass and damping can stand for it, too; dry friction is no gain, however large.
    aliens = [name for one in ties for name in one.alien]
    assert "drive.force_per_voltage" in aliens and "drive.coulomb" not in aliens
    # Mass and damping take their part of it, by how far their priors let them.
    (same,) = (one.fit for one in ties if one.alien == ("drive.force_per_voltage",))
    # The hidden 8 % lie in a valley as wide as this.
    assert 0.03 < fit.theta[0] < 0.13 and 0.03 < same.theta[0] / 32.5 < 0.13
    # Beside another effect, too, which keeps its own size.
    rubbing = known["drive.coulomb"]
    fit = fitter.fit(
        (rubbing, known["drive.voltage.gain"]), fit.z[: len(fitter.nominal)], np.array([0.1, 0.0, 0.2])
    )
    ties = alike(
        fitter, Answer(("drive.coulomb", "drive.voltage.gain"), 100.0, 0.0, fit), list(known.values())
    )
    (same,) = (one.fit for one in ties if one.alien == ("drive.force_per_voltage",))
    assert same.theta[0] == pytest.approx(fit.theta[0], abs=0.2 * rubbing.parameters[0].scale)


def test_the_next_experiment_is_told_with_its_evidence(rubbing, effects):
    """Coulomb against viscous friction: at another speed they differ, as before they do not."""
    one = answer(effects, "drive.coulomb", 12.0, 1e-3, ties=("drive.viscous",))
    weights = {POSITION: 0.02, VOLTAGE: 0.02}
    told = next_experiment(rubbing, one, weights, tuple(effects.values()))
    assert told["between"] == ["drive.coulomb", "drive.viscous"]
    assert set(told["menu"]) == {"the same again", "slow", "log drive.velocity"}
    assert told["name"] == max(told["menu"], key=told["menu"].get)
    assert told["expected_evidence"] == told["menu"][told["name"]] > 0.0
    # No rival, no experiment.
    assert next_experiment(rubbing, answer(effects, "drive.coulomb", 12.0, 1e-3), weights, ()) is None


def test_ties_of_one_effect_among_several_need_an_experiment(rubbing, effects):
    fitter = weighted(rubbing)
    gain, equal = ("drive.coulomb", "drive.voltage.gain"), ("drive.coulomb", "drive.force_per_voltage")
    fits = [fitter.fit(tuple(effects[name] for name in names)) for names in (gain, equal)]
    models = [Augmented(fit.calibrated, fit.effects, fit.theta) for fit in fits]
    ties = ("drive.force_per_voltage",)
    finding = Finding(
        (Candidate(gain, 1.0, {}, ties, 100.0, models[0]),), gain, ("drive",), "", gain, NOMINAL
    )
    answers = [Answer(gain, 100.0, 0.0, fits[0], ties), Answer(equal, 99.0, 0.0, fits[1])]
    weights = {POSITION: 0.02, VOLTAGE: 0.02}
    told = next_experiment(rubbing, finding, weights, tuple(effects.values()), answers)
    assert told["between"] == [
        "drive.coulomb + drive.voltage.gain",
        "drive.coulomb + drive.force_per_voltage",
    ]


def test_an_output_that_was_not_logged_is_proposed(rubbing, effects):
    """A speed tells dry friction from an inertia that positions cannot; a study need not name experiments."""
    own = replace(rubbing, trials=())
    one = answer(effects, "drive.coulomb", 12.0, 1e-3, ties=("drive.viscous",))
    weights = {POSITION: 0.02, VOLTAGE: 0.02}
    told = next_experiment(own, one, weights, tuple(effects.values()))
    assert told["name"] == "log drive.velocity" and set(told["menu"]) == {told["name"]}
    assert told["description"].startswith("run-0 again, with drive.velocity logged, too, by a sensor with a ")
    models = [Augmented({}, (effects[name],), np.array(theta)) for name, *theta in
              (("drive.coulomb", 12.0, 1e-3), ("drive.viscous", 50.0))]  # fmt: skip
    (planned,) = sensors(own, models).values()
    noise = planned.study.columns[VELOCITY].noise
    run = predicted(planned.study, models[0], planned.like)
    assert noise == pytest.approx(1e-3 * np.std(run.logs[VELOCITY]), rel=0.1)
    # What it is expected to tell comes from the speed: with a sensor as noisy as the signal it is lost.
    dull = planned.study.columns[VELOCITY].model_copy(update={"noise": 1e3 * noise})
    deaf = replace(planned, study=replace(planned.study, columns={**planned.study.columns, VELOCITY: dull}))
    candidates_ = [laplace(weighted(own), one) for one in models]
    heard, lost = (_expected(each, *candidates_, {**weights, VELOCITY: 1.0}) for each in (planned, deaf))
    assert heard > lost + 100.0
    assert no_experiment(own, one) == ""
    everything = replace(own, columns={**own.columns, VELOCITY: dull})
    assert "all outputs are logged" in no_experiment(everything, one)
    assert next_experiment(everything, one, weights, tuple(effects.values())) is None


def test_wrong_settings_are_told_at_once(rubbing, tmp_path):
    path = study(
        tmp_path,
        motion={"port": "controller.voltage"},
        experiments=[{"name": "a", "set": ["path.strok=1 m"]}, {"name": "b", "set": ["run.step_size=1 ms"]}],
        practice="none.json",
    )
    with pytest.raises(ConfigError) as caught:
        load_port_study(path)
    told = str(caught.value)
    for words in (
        "motion.port: controller.voltage is no position",
        "experiments[0]",
        "strok",
        "experiments[1].set: changes the communication step",
        "practice: no file none.json",
    ):
        assert words in told


def test_simulated_cases_hide_what_they_say(rubbing, effects):
    seen = set()
    for number in range(8):
        made, truth, evidence = simulated(rubbing, list(effects.values()), np.random.default_rng(number))
        assert {run.role for run in made.runs} == {Role.TRAIN, Role.VALIDATION}
        seen.add(len(truth) if truth != ("outside",) else "outside")
        assert (evidence >= 10.0) is bool(truth)
        if truth == ("outside",):
            assert len(made.without) > len(rubbing.without)
        log = made.runs[0].logs[POSITION]
        # Noise is there, of the size that was specified.
        rough = np.diff(log, 3) / np.sqrt(20.0)
        assert np.std(rough) == pytest.approx(2e-6, rel=0.5)
    assert len(seen) > 1


def test_no_simulated_system_swings_up(rubbing, effects):
    gain = effects["drive.voltage.gain"]
    # A controller whose volts do that little gives ten times as many.
    weak = replace(gain, parameters=(replace(gain.parameters[0], low=-0.97, high=-0.9),))
    for seed in range(12):
        made, _, _ = simulated(rubbing, [weak], np.random.default_rng(seed))
        for run, measured in zip(made.runs, rubbing.of(Role.TRAIN, Role.VALIDATION), strict=True):
            for port in (POSITION, VOLTAGE):
                assert np.abs(run.logs[port]).max() < 4.0 * np.abs(measured.logs[port]).max()


def test_where_every_simulated_system_swings_up_practice_tells_so(rubbing, monkeypatch):
    monkeypatch.setattr("orchestrator.diagnosis.ports.simulated._WILD", 0.0)
    with pytest.raises(OrchestratorError, match=r"100 times in a row(.|\n)*start values"):
        simulated(rubbing, [], np.random.default_rng(1))


def test_what_the_calibration_may_be_astray_is_nothing_hidden(rubbing, effects):
    """With mass and friction, a gain scales what the drive does: within their tolerances it is no effect."""
    gain = [effects["drive.voltage.gain"]]
    exact = {name: Nominal(one.value, 1e-6 * one.value) for name, one in rubbing.nominal.items()}
    unsure = {name: Nominal(one.value, 0.2 * one.value) for name, one in rubbing.nominal.items()}

    def told(nominal):
        study = replace(rubbing, nominal=nominal)
        return [simulated(study, gain, np.random.default_rng(seed))[1] for seed in range(6)]

    assert any(told(exact)) and not any(told(unsure))


def case(truth, gains, share=0.0):
    """A case with an answer per gain, named a, b, ..."""
    names = [(), *[(chr(97 + place),) for place in range(len(gains) - 1)]]
    made = tuple(_Answer(name, gain, ()) for name, gain in zip(names, gains, strict=True))
    return Case(truth, 10.0, made, 20, share)


def test_what_practice_teaches_covers_what_it_did_not_see():
    """Evidence that overstates itself ten times: as shipped it is trusted too much, as learned it is not."""
    draw = np.random.default_rng(5)

    def drawn():
        # Truth is a; b is likelier by chance as often as ten-fold overstated evidence of unit spread says.
        evidence = 10.0 * draw.standard_normal()
        return case(("a",), [0.0, 60.0 + evidence, 60.0 - evidence])

    cases = [drawn() for _ in range(60)]
    learned = learn(cases, Tempering())
    unseen = [drawn() for _ in range(200)]
    before, after = (coverage([(one, by) for one in unseen]) for by in (Tempering(), learned))
    assert learned.temperature > Tempering().temperature
    assert before["covered"] < 0.7 < after["covered"]
    assert abs(after["claimed"] - after["right"]) < abs(before["claimed"] - before["right"])


def test_practice_of_other_candidates_is_refused(tmp_path):
    path, parts = tmp_path / "practice.json", {"config": "c", "FMUs": "f"}
    data = {
        "format": "port-practice/3",
        "tempering": Tempering(temperature=3.0).data(),
        "effects": ["a", "b"],
        "system": parts,
    }
    path.write_text(json.dumps(sealed(data)))
    assert read_practice(path, ["b", "a"], parts)[0].temperature == 3.0
    again = "\n  Practise again: `orchestrator diagnose STUDY --practice N --out DIR`."
    with pytest.raises(ConfigError, match=r"other candidates: b, c\n  Practise again"):
        read_practice(path, ["a", "c"], parts)
    with pytest.raises(ConfigError) as caught:
        read_practice(path, ["a", "b"], {"config": "d", "FMUs": "f"})
    assert str(caught.value) == f"{path}: was practised on another system, which differs in: config{again}"
    path.write_text(path.read_text().replace("3.0", "2.0"))
    with pytest.raises(ConfigError, match=r"was changed after it was written\n  Practise again"):
        read_practice(path, ["a", "b"], parts)
    path.write_text(json.dumps(data | {"format": "port-practice/1"}))
    with pytest.raises(ConfigError, match=r"got 'port-practice/1'\n  port-practice/3. Practise again"):
        read_practice(path, ["a", "b"], parts)
    path.write_text("{}")
    with pytest.raises(ConfigError, match="is no result of practice"):
        read_practice(path, ["a"], parts)


def test_what_practice_is_of_does_not_depend_on_logs_or_folders(rubbing):
    parts = parts_of(rubbing)
    other = replace(rubbing, runs=rubbing.runs[:1], practice=Path("practice.json"))
    assert parts_of(other) == parts
    nominal = {**rubbing.nominal, "drive.mass": Nominal(60.0, 2.0)}
    loaded, columns = prepare(rubbing.prepared.config, ["drive.load=1 N"]), dict(rubbing.columns)
    columns[POSITION] = columns[POSITION].model_copy(update={"noise": 3e-6})
    for name, changed in (
        ("calibrated", replace(rubbing, nominal=nominal)),
        ("config", replace(rubbing, prepared=loaded)),
        ("columns", replace(rubbing, columns=columns)),
        ("priors", replace(rubbing, priors={"drive.force_per_voltage": 1.0})),
    ):
        found = parts_of(changed)
        assert [one for one in parts if found[one] != parts[one]] == [name]
    fmu = rubbing.prepared.system.instances[0].fmu

    class Rebuilt:
        description, path = fmu.description, fmu.path

        def checksum(self):
            return "sha256:other"

    first, *rest = rubbing.prepared.system.instances
    rebuilt = replace(rubbing.prepared.system, instances=(replace(first, fmu=Rebuilt()), *rest))
    found = parts_of(replace(rubbing, prepared=replace(rubbing.prepared, system=rebuilt)))
    assert [one for one in parts if found[one] != parts[one]] == ["FMUs"]


def test_practice_on_the_command_line(tmp_path, capsys):
    """Ten cases teach little, but are told with how often they were covered, and can be used again."""
    few = {"only": ["drive.viscous", "drive.voltage.gain", "drive.voltage.offset"]}
    # The study names already what practice is yet to write.
    path = study(tmp_path / "case", candidates=few, practice="../out/practice.json")
    out = tmp_path / "out"
    told = ["diagnose", str(path), "--out", str(out), "--no-report", "--quiet"]
    assert main([*told, "--practice", "4"]) == 2
    assert "got 4 cases" in capsys.readouterr().err
    assert main([*told, "--practice", "10"]) == 0
    practice = json.loads((out / "practice.json").read_text())
    assert practice["format"] == "port-practice/3" and len(practice["cases"]) == 10
    assert practice["coverage"]["as learned, on unseen cases"]["cases"] == 10
    assert set(practice["effects"]) == set(few["only"])
    first = json.loads((out / "diagnosis.json").read_text())
    assert main(["diagnose", str(path), "--out", str(tmp_path / "again"), "--quiet"]) == 0
    again = json.loads((tmp_path / "again" / "diagnosis.json").read_text())
    assert again["which"] == first["which"]
    assert "were calibrated on 10 simulated cases" in (tmp_path / "again" / "report.html").read_text()
    data = yaml.safe_load((path / "study.yaml").read_text())
    data["set"].append("drive.mass=60 kg")
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    capsys.readouterr()
    assert main(["diagnose", str(path), "--out", str(tmp_path / "other"), "--quiet"]) == 2
    assert "on another system, which differs in: config, calibrated\n" in capsys.readouterr().err


def test_an_interrupted_practice_goes_on(tmp_path):
    """What was weighed is not weighed again; the result is that of a practice in one go, on any processes."""
    path = study(tmp_path / "case", candidates={"only": ["drive.viscous", "drive.voltage.gain"]})
    kept, told = tmp_path / "kept.jsonl", []

    def stop(done: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        practise(path, Practise(10, jobs=1, kept=kept, progress=stop))
    with kept.open("a") as file:
        file.write('{"key": "broken o')
    whole = practise(path, Practise(10, jobs=2, kept=kept, progress=told.append))
    assert told[0] == 3 and told[-1] == 10
    assert whole["cases"] == practise(path, Practise(10, jobs=1))["cases"]
    practise(path, Practise(10, kept=kept, progress=told.append))
    assert told[8:] == [10]
    # Other draws are other cases.
    practise(path, Practise(10, seed=2, kept=kept, progress=told.append))
    assert told[9] == 0
