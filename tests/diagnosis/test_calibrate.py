"""What evidence is worth, learned from simulated cases."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.base.errors import OrchestratorError
from orchestrator.diagnosis.rig.answers import Answer, complete
from orchestrator.diagnosis.rig.calibration import FILE, Calibration, calibration
from orchestrator.diagnosis.rig.challenge.draw import SHARES
from orchestrator.fmi.workers import Work, pool_of
from tests.benchmarks.rig_calibration import calibrate
from tests.benchmarks.rig_calibration.calibrate import _outcomes, _written, main
from tests.benchmarks.rig_calibration.learning import WeighedCase, learn_leaves, learn_unseen


def practised(number: int) -> WeighedCase:
    """A case of three effects, of which one is always seen, one never, and one in every other case."""
    truth = ((), ("a.seen",), ("a.unseen",), ("b.both",), ("a.seen", "b.both"), ("outside",))[number % 6]
    rng = np.random.default_rng(number)
    gains = {"a.seen": 40.0, "b.both": 25.0 * (number // 6 % 2)}
    shown = [one for one in truth if gains.get(one, 0.0) > 0.0]
    answers = [Answer((), 0.0, 50.0 * (truth == ("outside",)) + 3.0 * rng.random())]
    if shown:
        answers.append(Answer(tuple(shown), sum(gains[one] for one in shown), 2.0 * rng.random()))
    return WeighedCase(truth, 0.1, tuple(complete(answers, ("a.seen", "a.unseen", "b.both"))), 0.0)


def test_what_stays_unseen_is_learned():
    cases = [practised(number) for number in range(60)]
    found = learn_unseen(cases, Calibration())
    assert sum(found.values()) == pytest.approx(1.0, abs=1e-4)
    assert found["a.seen"] < found["b.both"] < found["a.unseen"]


def test_what_effects_leave_unexplained_is_learned():
    def case(name: str, gain: float, left: float) -> WeighedCase:
        answers = (Answer((), 0.0, gain), Answer((name,), gain, left))
        return WeighedCase((name,), 1.0, answers, 0.0)

    bare = [WeighedCase((), 0.0, (Answer((), 0.0, 3.0),), 0.0)] * 20
    rough = [case("a.rough", gain, 3.0 + 0.05 * gain) for gain in (500.0, 3000.0, 9000.0)]
    clean = [case("b.clean", gain, 2.0) for gain in (500.0, 3000.0, 9000.0)]
    leaves = learn_leaves([*bare, *rough, *clean])
    assert leaves["a.rough"] == pytest.approx(0.05, rel=0.1) and leaves["b.clean"] < 2e-4
    learned = replace(calibration(), leaves=leaves)
    reported = [
        learned.probabilities(one.answers, 0.0)[-1]
        for one in (
            case("a.rough", 2000.0, 90.0),
            case("b.clean", 2000.0, 90.0),
            case("b.clean", 2000.0, 2.0),
        )
    ]
    assert reported[1] > 0.5 > 2.0 * reported[0] and reported[1] > 0.5 > 2.0 * reported[2]


def test_cases_kept_are_learned_from_again(tmp_path):
    """The loss of what is learned is that of the probabilities that diagnoses give, kinds as planned."""
    cases = {str(number): _written(practised(number)) for number in range(1, 31)}
    kept, out = tmp_path / "seen.json", tmp_path / "calibration.json"
    made_of = {"seed": 20261, "bare": 40}
    kept.write_text(json.dumps({"made_of": made_of, "roughness": {"a.seen": [0.01]}, "cases": cases}))
    main(["--cases", "30", "--forms", "0", "--kinds", "0", "--seen", str(kept), "--out", str(out)])
    data = json.loads(out.read_text())
    learned = Calibration(**{name: data[name] for name in Calibration.__dataclass_fields__})
    assert learned.roughness == {"a.seen": [0.01]} and data["provenance"]["cases"] == 30
    total, every = 0.0, [practised(number) for number in range(1, 31)]
    drawn = Counter(one.kind for one in every)
    whole = sum(SHARES[kind] for kind in drawn)
    for case in every:
        p = learned.probabilities(case.answers, case.beside)
        right = [case.truth != ("outside",) and case.right(one) for one in case.answers]
        reported = np.log(p[[*right, case.truth == ("outside",)]].sum())
        total -= SHARES[case.kind] / whole / drawn[case.kind] * reported
    assert data["provenance"]["loss"] == pytest.approx(total, abs=1e-4)


def test_cases_of_other_draws_are_not_taken_for_those_asked_for(tmp_path, capsys):
    kept = tmp_path / "seen.json"
    kept.write_text(json.dumps({"made_of": {"seed": 7, "bare": 40}, "roughness": {}}))
    with pytest.raises(SystemExit):
        main(["--seen", str(kept), "--out", str(tmp_path / "calibration.json")])
    assert "is of {'seed': 7, 'bare': 40}, not of {'seed': 20261" in capsys.readouterr().err


def test_a_simulated_case_that_fails_is_reported():
    with pytest.raises(OrchestratorError, match=r"simulated case 0: .*no case"):
        list(_outcomes(pool_of(None, 1), Work(failing), [0]))


def failing(payload: object, number: int) -> None:
    raise ValueError("no case")


def test_the_calibration_is_learned_by_its_command(tmp_path):
    seen, out = tmp_path / "seen.json", tmp_path / "calibration.json"
    options = [
        "--cases",
        "2",
        "--bare",
        "2",
        "--forms",
        "1",
        "--kinds",
        "1",
        "--seed",
        "5",
        "--seen",
        str(seen),
        "--out",
        str(out),
    ]
    command = [sys.executable, "-m", "tests.benchmarks.rig_calibration.calibrate", *options]
    subprocess.run(command, check=True, capture_output=True)
    made = json.loads(out.read_text())
    assert made["format"] == "weigh/16" and made["provenance"]["seed"] == 5
    weighed = json.loads(seen.read_text())
    assert (
        sorted(weighed["cases"]) == ["1", "2"] and len(weighed["forms"]) == made["provenance"]["forms"] == 1
    )
    assert len(weighed["odd"]) == made["provenance"]["odd"] == 3


def test_the_kinds_are_those_that_the_calibration_was_learned_from(tmp_path, monkeypatch):
    """So that it is learned alike when more kinds are known."""
    every = calibrate._chosen_kinds("all")
    path = tmp_path / FILE.name
    monkeypatch.setattr(calibrate, "FILE", path)
    path.write_text(json.dumps({"provenance": {"kinds": every[3:5]}}))
    assert calibrate._chosen_kinds(None) == every[3:5] and calibrate._chosen_kinds("2") == every[:2]
    some, all_ = calibrate._of_kinds(every[3:5]), calibrate._of_kinds(every)
    assert len(some) == 6 and len(all_) == 3 * len(every) and some.items() <= all_.items()
    path.write_text(json.dumps({"provenance": {"kinds": ["robot.gone"]}}))
    with pytest.raises(OrchestratorError, match=r"learned from robot\.gone, which the challenge does not"):
        calibrate._chosen_kinds(None)


def test_what_are_no_kinds_is_reported(capsys):
    with pytest.raises(SystemExit):
        main(["--kinds", "some"])
    assert "--kinds: 'some'; allowed: all, or 0 to " in capsys.readouterr().err
