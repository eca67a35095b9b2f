"""Practice on simulated cases of any system: what they hide, what it teaches, and what it is kept for."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from ports_bench import POSITION, VOLTAGE, study

from orchestrator.base.errors import ConfigError, OrchestratorError
from orchestrator.cli.main import main
from orchestrator.diagnosis.ports.practice import (
    Case,
    Practise,
    _Answer,
    coverage,
    learn,
    parts_of,
    practise,
)
from orchestrator.diagnosis.ports.simulated import simulated
from orchestrator.diagnosis.ports.study import Role
from orchestrator.diagnosis.ports.tempering import Tempering, read_practice, sealed
from orchestrator.diagnosis.study import Nominal
from orchestrator.simulation.run import prepare


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
    """Ten cases teach little, but are reported with how often they were covered, and can be used again."""
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
    assert main(["diagnose", str(path), "--effects", "--out", str(tmp_path / "again"), "--quiet"]) == 0
    again = json.loads((tmp_path / "again" / "diagnosis.json").read_text())
    assert again["which"] == first["which"]
    assert "were calibrated on 10 simulated cases" in (tmp_path / "again" / "report.html").read_text()
    data = yaml.safe_load((path / "study.yaml").read_text())
    data["set"].append("drive.mass=60 kg")
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    capsys.readouterr()
    assert main(["diagnose", str(path), "--effects", "--out", str(tmp_path / "other"), "--quiet"]) == 2
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
