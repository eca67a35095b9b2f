"""Cases as files, the sealed truth, and scores on verdicts written by hand."""

from __future__ import annotations

import ast
import gzip
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import orchestrator.diagnosis
from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.diagnosis.rig.challenge.make import Order, make
from orchestrator.diagnosis.rig.challenge.score import Marked, figures, score
from orchestrator.diagnosis.rig.challenge.seal import LEDGER, SEALED, open_truth, truth_digest
from orchestrator.diagnosis.rig.challenge.verdict import Answer, Verdict, answer_set, names
from orchestrator.diagnosis.rig.study import Role, load_study

DIAGNOSIS = Path(orchestrator.diagnosis.__file__).parent
GAP = Path(__file__).parents[3] / "shared" / "gap"
needs_gap = pytest.mark.skipif(not GAP.is_dir(), reason="the labelled cases are not beside the checkout")
ORDER = Order(cases=4, seed=11, pairs=True, outside="known")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A challenge of four cases: it is read, never written to."""
    folder = tmp_path_factory.mktemp("challenge") / "cases"
    make(folder, ORDER)
    return folder


@pytest.fixture
def challenge(made, tmp_path):
    """A copy of the truth and of what names the cases."""
    folder = tmp_path / "cases"
    for path in made.glob("*/case.yaml"):
        (folder / path.parent.name).mkdir(parents=True)
        (folder / path.parent.name / "case.yaml").write_bytes(path.read_bytes())
    (folder / SEALED).write_bytes((made / SEALED).read_bytes())
    return folder


def write(folder, case, effects, probability=1.0, ties=(), places=None, closure=0.9, rest=()):
    """Write a verdict by hand."""
    which = [{"effects": list(effects), "probability": probability, "ties": list(ties), "parameters": {}}]
    which += [{"effects": list(other), "probability": p, "ties": []} for other, p in rest]
    places = sorted({one.partition(".")[0] for one in effects}) if places is None else places
    path = folder / case / "diagnosis.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "verdict": {"effects": list(effects), "places": places},
        "which": which,
        "how_far": {"closure": closure, "recalibration_only": 0.3},
    }
    path.write_text(json.dumps(content))


def write_truth(folder, challenge):
    """Verdicts that are right: a test may look where `diagnose` must not."""
    for case, truth in open_truth(challenge)["cases"].items():
        write(folder, case, truth["effects"], places=truth["places"])


def test_the_same_seed_gives_the_same_bytes(made, tmp_path):
    make(tmp_path / "again", ORDER, jobs=2)
    files = sorted(path.relative_to(made) for path in made.rglob("*") if path.is_file())
    assert len(files) == 4 * 8 + 1
    for file in files:
        assert (tmp_path / "again" / file).read_bytes() == (made / file).read_bytes(), file


def test_another_seed_gives_other_cases(made, tmp_path):
    make(tmp_path / "other", Order(cases=1, seed=12))
    log = "case-0001/train-1.csv.gz"
    assert (tmp_path / "other" / log).read_bytes() != (made / log).read_bytes()


def test_cases_are_read_as_studies(made):
    for path in made.glob("*/case.yaml"):
        study = load_study(path.parent)
        assert [len(study.of(role)) for role in (Role.TRAIN, Role.HELDOUT, Role.REPEAT)] == [3, 2, 2]
        for run in study.runs:
            # An unstable rig leaves the range, and its run is stopped.
            assert len(run) == 3000 or abs(run["desired_position"][-1]) > 0.07


@needs_gap
def test_files_have_the_form_of_the_given_cases(made):
    given = GAP / "cases" / "case-001"
    ours = made / "case-0001"
    assert {path.name for path in ours.iterdir()} == {path.name for path in given.iterdir()}
    lines = [
        gzip.decompress((one / "train-1.csv.gz").read_bytes()).decode().split("\n") for one in (given, ours)
    ]
    assert lines[0][0] == lines[1][0]
    shapes = [
        {
            re.sub(r"\d+", lambda digits: "d", cell).lstrip("-") + str(len(cell.partition(".")[2]))
            for cell in column
        }
        for text in lines
        for column in zip(*(line.split(",") for line in text[1:-1]), strict=True)
    ]
    assert shapes[:7] == shapes[7:]
    assert lines[0][-1] == lines[1][-1] == ""
    data = [yaml.safe_load((one / "case.yaml").read_text()) for one in (given, ours)]
    assert data[0].keys() == data[1].keys() and data[0]["runs"] == data[1]["runs"]
    choice = ("contact_stiffness", "contact_damping")
    for name, entry in data[0]["nominal"].items():
        other = data[1]["nominal"][name]
        assert list(entry) == list(other) and entry["unit"] == other["unit"]
        if name not in choice:
            assert entry == other


def test_a_case_tells_nothing_of_its_truth(made):
    truth = open_truth(made)
    hidden = {name for case in truth["cases"].values() for name in case["hides"]}
    assert hidden and len(truth["cases"]) == 4
    for path in made.rglob("case.yaml"):
        text = path.read_text()
        assert "seed" not in text and not any(name in text for name in hidden)
    assert not any(name.encode() in (made / SEALED).read_bytes() for name in hidden)


def test_nothing_that_diagnoses_reaches_the_truth_or_the_kinds_outside():
    """Only making and scoring import the opener; outside of `challenge`, learning alone knows of kinds."""
    users = {name: set() for name in ("seal", "outside", "outside_fresh")}
    for path in DIAGNOSIS.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            named = set()
            if isinstance(node, ast.ImportFrom):
                named = set((node.module or "").split(".")) | {one.name for one in node.names}
            elif isinstance(node, ast.Import):
                named = {part for one in node.names for part in one.name.split(".")}
            for module in users:
                if module in named and (path.parent.name == "challenge" or "challenge" in named):
                    users[module].add(path.relative_to(DIAGNOSIS).as_posix())
    own = {f"rig/challenge/{name}.py" for name in ("make", "score")}
    assert users["seal"] == own
    # The known kinds teach what evidence is worth; the fresh ones are kept for blind checks.
    assert users["outside_fresh"] == {"rig/challenge/make.py"}
    assert users["outside"] == {"rig/challenge/make.py"}
    learning = (Path(__file__).parents[1] / "benchmarks" / "rig_calibration").glob("*.py")
    assert not any("outside_fresh" in path.read_text(encoding="utf-8") for path in learning)
    for path in DIAGNOSIS.rglob("*.py"):
        if path.parent.name != "challenge":
            text = path.read_text(encoding="utf-8")
            assert SEALED not in text and "open_truth" not in text, path


def test_a_damaged_truth_is_refused(challenge):
    path = challenge / SEALED
    data = path.read_bytes()
    middle = len(data) * 3 // 4
    path.write_bytes(
        data[:middle] + (b"0" if data[middle : middle + 1] != b"0" else b"1") + data[middle + 1 :]
    )
    with pytest.raises(ConfigError) as caught:
        open_truth(challenge)
    assert str(caught.value) == f"{path}: does not fit its seal\n  Make the challenge again."


def test_scoring_waits_for_all_verdicts(challenge, tmp_path):
    out = tmp_path / "out"
    write(out, "case-0001", [])
    with pytest.raises(ConfigError) as caught:
        score(challenge, out)
    assert str(caught.value) == (
        f"{out}: 3 of 4 verdicts are missing: case-0002, case-0003, case-0004\n"
        "  the truth is opened after all verdicts are written. Run `orchestrator challenge run` first."
    )
    assert not (challenge / LEDGER).exists()


def test_bad_verdicts_are_reported_together_and_the_truth_stays_sealed(challenge, tmp_path):
    out = tmp_path / "out"
    write_truth(out, challenge)
    write(out, "case-0001", [], probability=0.6)
    (out / "case-0002" / "diagnosis.json").write_text("{")
    (out / "case-0003" / "diagnosis.json").write_text('{"verdict": {"effects": []}}')
    write(out, "case-0004", [], probability=0.3, rest=[(["sensor.bias"], 0.7)])
    with pytest.raises(ConfigError) as caught:
        score(challenge, out)
    text = str(caught.value)
    assert "which: probabilities add up to 0.6\n  1, none of them negative" in text
    assert "case-0002/diagnosis.json: is no JSON" in text
    assert "case-0003/diagnosis.json: verdict: 'places' is missing" in text
    other = json.loads((out / "case-0001" / "diagnosis.json").read_text()) | {"how_far": "far"}
    (out / "case-0001" / "diagnosis.json").write_text(json.dumps(other))
    with pytest.raises(ConfigError, match=r"case-0001/diagnosis\.json: how_far: got 'far'"):
        score(challenge, out)
    assert "case-0004/diagnosis.json: which: is not in the order of probability" in text
    assert not (challenge / LEDGER).exists()


def test_right_verdicts_score_one_and_are_in_the_ledger_before(challenge, tmp_path):
    write_truth(tmp_path / "out", challenge)
    found = score(challenge, tmp_path / "out")
    assert found["blind"] and found["truth"] == truth_digest(challenge)
    assert found["cases"] == {"none": 1, "outside": 1, "pair": 1, "single": 1}
    assert found["coverage"]["rate"] == 1.0 and found["ece"] == 0.0
    assert found["false_alarms"]["rate"] == 0.0 and found["closure_median"] == 0.9
    ledger = json.loads((challenge / LEDGER).read_text())
    assert len(ledger) == 1 and ledger[0]["truth"] == found["truth"]
    assert ledger[0]["verdicts"] == {line["case"]: line["verdict"] for line in found["each"]}


def test_verdicts_changed_after_the_opening_are_not_blind(challenge, tmp_path):
    out = tmp_path / "out"
    for number in range(1, 5):
        write(out, f"case-{number:04d}", [])
    assert score(challenge, out)["blind"]
    assert score(challenge, out)["blind"]  # the same verdicts again
    write_truth(out, challenge)
    assert not score(challenge, out)["blind"]
    assert not score(challenge, out)["blind"]
    assert len(json.loads((challenge / LEDGER).read_text())) == 2


def marked(
    kind,
    effects,
    answers,
    verdict=None,
    magnitude=1.0,
    evidence=100.0,
    closure=0.9,
    tight=1.0,
    doubtful=False,
    beyond=None,
):
    """A case with a verdict; answers are (effects, probability, ties)."""
    rows = tuple(Answer(frozenset(one), p, frozenset(ties)) for one, p, ties in answers)
    given = frozenset(answers[0][0] if verdict is None else verdict)
    places = {one.partition(".")[0] for one in effects}
    truth = {
        "kind": kind, "effects": ["outside"] if kind == "outside" else sorted(effects),
        "hides": sorted(effects), "places": sorted(places), "magnitude": magnitude, "evidence": evidence,
        "beyond": evidence if beyond is None else beyond, "tight": tight,
    }  # fmt: skip
    ties = next((row.ties for row in rows if row.effects == given), frozenset())
    found = frozenset(one.partition(".")[0] for one in given if one != "outside")
    shown = Verdict(given, found, ties, rows, closure, 0.2, doubtful, answer_set(rows), "")
    return Marked("case", truth, shown)


def test_figures_of_verdicts_made_by_hand():
    bias, drift, gain, mass = ["sensor.bias"], ["sensor.drift"], ["sensor.gain"], ["dynamics.mass"]
    stiff = ["contact.stiffness"]
    cases = [
        marked("single", bias, [(bias, 0.9, ()), (drift, 0.1, ())]),
        marked("single", bias, [(drift, 0.6, ()), (bias, 0.4, ())]),  # second; the place is right
        marked("single", gain, [(stiff, 0.5, gain), (gain, 0.5, stiff)]),  # a declared tie
        marked("single", mass, [([], 1.0, ())], magnitude=0.1),  # missed
        marked("single", mass, [([], 1.0, ())], evidence=1.0, magnitude=0.05),  # could not be reported
        marked("none", [], [([], 0.8, ()), (bias, 0.2, ())]),
        marked("none", [], [(bias, 0.6, ()), ([], 0.4, ())]),  # a false alarm
        marked("outside", ["sensor.hum"], [(["outside"], 0.7, ()), (drift, 0.3, ())]),
        marked("pair", [*bias, *drift], [([*bias, *drift], 1.0, ())]),
        marked("pair", [*bias, *mass], [(bias, 0.99, ()), (mass, 0.01, ())]),  # one of two
    ]
    found = figures(cases)
    assert found["effect_right"]["count"] == 2 and found["effect_right"]["of"] == 4
    assert found["top_two"]["count"] == 3
    assert found["place_right"]["count"] == 3
    assert found["pairs_within"]["rate"] == 1.0 and found["pairs_across"]["rate"] == 0.0
    assert found["pairs_one_named"]["rate"] == 1.0
    imitated = marked("pair", [*bias, *drift], [(gain, 1.0, ())], beyond=3.0)
    again = figures([*cases, imitated])
    assert again["pairs_within"]["rate"] == 0.5 and again["pairs_within_own"]["rate"] == 1.0
    assert again["pairs_across_own"]["of"] == 1
    assert found["false_alarms"]["rate"] == 0.5
    assert found["outside_flagged"]["rate"] == 1.0 and found["outside_false"]["rate"] == 0.0
    # Missed by their 95 % sets: both masses, and the pair of which one was named.
    assert found["coverage"]["count"] == 7 and found["coverage"]["of"] == 10
    assert found["set_size"] == pytest.approx((2 + 2 + 2 + 1 + 1 + 2 + 2 + 2 + 1 + 1) / 10)
    # Bins: 0.6-0.7 holds two wrong at 0.6; 0.7-0.8 one right at 0.7; 0.8-0.9 one right at 0.8; the last one
    # right at 0.9, 1 and 1 (the tie, together) and wrong at 1, 1 and 0.99.
    assert found["ece"] == pytest.approx((1.2 + 0.3 + 0.2 + abs(5.89 - 3)) / 10)
    # Were 0.5 exact, one case would be half wrong anyway; what is certain is never.
    tossed = figures([marked("none", [], [([], 0.5, ()), (bias, 0.5, ())])])["ece_exact"]
    assert tossed == {"mean": 0.5, "most": 0.5}
    sure = figures([marked("none", [], [([], 1.0, ())])] * 20)["ece_exact"]
    assert sure == {"mean": 0.0, "most": 0.0}
    # Of ten at 0.75 five are right: 0.25 too much, less what chance makes of the share of ten.
    half = [marked("none", [], [([], 0.75, ())])] * 5 + [marked("single", bias, [([], 0.75, ())])] * 5
    assert figures(half)["calibration_rms"] == pytest.approx(math.sqrt(0.25**2 - 0.25 / 9))
    assert figures(half[:7])["calibration_rms"] == 0.0
    # A tie is one of two at 0.5, and in its set anyway.
    assert found["ece_without_ties"] == pytest.approx((0.5 + 1.2 + 0.3 + 0.2 + abs(4.89 - 2)) / 10)
    assert found["coverage_without_ties"]["count"] == 7
    low, high = found["effect_right"]["interval"]
    assert low == pytest.approx(0.15, abs=0.01) and high == pytest.approx(0.85, abs=0.01)
    assert found["bands"]["strong"]["cases"] == 6 and found["bands"]["faint"]["clear"] == 0
    assert found["bands"]["weak"]["coverage"]["rate"] == 0.0


def test_what_the_catalogue_imitates_is_counted_apart():
    hum, bend, stiffer = ["sensor.hum"], ["structure.bend"], ["contact.asymmetry"]
    found = figures(
        [
            marked("outside", hum, [(["outside"], 0.9, ())]),
            marked("outside", hum, [(stiffer, 0.9, ())]),
            marked("outside", bend, [(stiffer, 0.9, ())], beyond=3.0),
        ]
    )
    assert (found["outside_flagged"]["count"], found["outside_flagged"]["of"]) == (1, 3)
    assert (found["outside_flagged_own"]["count"], found["outside_flagged_own"]["of"]) == (1, 2)


def test_what_is_suspected_is_counted_beside_what_is_flagged():
    hum, drift, outside = ["sensor.hum"], ["sensor.drift"], ["outside"]
    found = figures(
        [
            marked("outside", hum, [(outside, 0.9, ())]),
            marked("outside", hum, [(drift, 0.7, ()), (outside, 0.15, ()), ([*outside, *drift], 0.15, ())]),
            marked("outside", hum, [(drift, 0.9, ()), (outside, 0.1, ())]),
            marked("single", drift, [(drift, 0.7, ()), (outside, 0.3, ())]),
            marked("single", drift, [(drift, 1.0, ())]),
        ]
    )
    assert found["outside_flagged"]["count"] == 1 and found["outside_false"]["count"] == 0
    assert (found["outside_suspected"]["count"], found["outside_suspected"]["of"]) == (2, 3)
    assert (found["suspected_false"]["count"], found["suspected_false"]["of"]) == (1, 2)


def test_a_declared_set_of_answers_is_the_one_scored():
    rows = tuple(
        Answer(frozenset(one), p, frozenset()) for one, p in (((), 0.6), (("a", "b"), 0.39), (("a",), 0.01))
    )
    assert answer_set(rows) == rows[:2]
    assert answer_set(rows, ["none", "a"]) == (rows[0], rows[2])
    assert answer_set(rows, ["a + b"]) == rows[1:2]


def test_doubted_tolerances_are_counted():
    none = [([], 1.0, ())]
    found = figures(
        [marked("none", [], none, tight=2.5, doubtful=True), marked("none", [], none, tight=2.5)]
        + [marked("none", [], none), marked("none", [], none, doubtful=True)] * 2
        + [marked("none", [], none)]
    )
    assert (found["doubtful_tight"]["count"], found["doubtful_tight"]["of"]) == (1, 2)
    assert (found["doubtful_false"]["count"], found["doubtful_false"]["of"]) == (2, 5)


@pytest.mark.parametrize(
    ("answer", "ties", "truth", "right"),
    [
        ([], [], [], True),
        (["a"], [], ["a"], True),
        (["b"], ["a"], ["a"], True),
        (["b"], [], ["a"], False),
        ([], ["a"], ["a"], False),
        (["a", "b"], ["c"], ["a", "c"], True),
        (["a", "b"], [], ["a"], False),
        (["a"], ["a", "b"], ["a", "b"], False),
    ],
)
def test_ties_count_as_declared_and_no_further(answer, ties, truth, right):
    assert names(answer, ties, truth) is right


def say_none(case, out):
    """Diagnoses nothing, in every case."""
    write(out.parent, out.name, [])


def fail(case, out):
    """Fails in the second case; what it writes for the third is no verdict."""
    if case.name == "case-0002":
        raise ValueError("no contact in train-1")
    say_none(case, out)
    if case.name == "case-0003":
        (out / "diagnosis.json").write_text('{"verdict": {"effects": []}}')


def test_from_the_command_line(made, challenge, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = [str(challenge), "--verdicts", str(out)]
    own = f"{__name__}:"
    assert main(["challenge", "run", *arguments, "--jobs", "1", "--by", own + "fail"]) == 1
    reported = capsys.readouterr()
    assert "2 cases diagnosed" in reported.out
    assert "case-0002: ValueError: no contact in train-1" in reported.err
    assert "wrote no verdict, kept as refused.json" in reported.err and "'places' is missing" in reported.err
    assert (out / "case-0003" / "refused.json").is_file()
    assert main(["challenge", "score", *arguments]) == 2
    assert "2 of 4 verdicts are missing: case-0002, case-0003" in capsys.readouterr().err
    assert main(["challenge", "run", *arguments, "--jobs", "1", "--by", own + "say_none"]) == 0
    assert "2 cases diagnosed" in capsys.readouterr().out
    assert main(["challenge", "score", *arguments]) == 0
    reported = capsys.readouterr().out
    assert "false alarms (nothing hidden)       0.000 (0/1)" in reported and "NOT blind" not in reported
    found = json.loads((out / "score.json").read_text())
    assert found["blind"] and found["false_alarms"]["count"] == 0
    assert main(["challenge", "make", str(made), "--cases", "1", "--seed", "1"]) == 2
    assert f"{made}: is not empty" in capsys.readouterr().err


def test_verdicts_of_other_cases_are_refused(made, tmp_path, capsys):
    """All challenges call their cases alike; a verdict counted by its name, and as blind."""
    other, out, by = tmp_path / "other", tmp_path / "out", ["--jobs", "1", "--by", f"{__name__}:say_none"]
    make(other, Order(cases=2, seed=12))
    assert main(["challenge", "run", str(other), "--verdicts", str(out), *by]) == 0
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    capsys.readouterr()
    # What was diagnosed of the one is no verdict of the other.
    assert main(["challenge", "run", str(made), "--verdicts", str(out), *by]) == 2
    said = (
        f"{out}: holds verdicts of other cases of these names than {made} does: case-0001, case-0002\n"
        "  the cases that cases.json holds the digests of. Name another folder by --verdicts, one for each "
        "challenge.\n"
    )
    assert capsys.readouterr().err == f"orchestrator: {said}"
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    (other / "case-0002" / "train-1.csv.gz").write_bytes((made / "case-0002/train-1.csv.gz").read_bytes())
    assert main(["challenge", "score", str(other), "--verdicts", str(out)]) == 2
    assert f"than {other} does: case-0002\n" in capsys.readouterr().err
    assert not (other / LEDGER).exists()
    # A case that has no verdict is diagnosed, and is then known as what it is.
    (out / "case-0002" / "diagnosis.json").unlink()
    assert main(["challenge", "run", str(other), "--verdicts", str(out), *by]) == 0
    assert "1 case diagnosed" in capsys.readouterr().out
    assert main(["challenge", "score", str(other), "--verdicts", str(out)]) == 0
    (out / "cases.json").write_text("[1]")
    assert main(["challenge", "score", str(other), "--verdicts", str(out)]) == 2
    assert "cases.json: is no record of cases" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "reported"),
    [
        (["--cases", "0", "--seed", "1"], "--cases: got 0\n  at least 1"),
        (["--cases", "1", "--seed", "x"], "--seed: got 'x'\n  a whole number, or `secret`"),
        (["--cases", "1", "--seed", "-1"], "--seed: got -1\n  a whole number from 0, or `secret`"),
        (
            ["--cases", "1", "--seed", "1", "--magnitude", "3"],
            "--magnitude: got 3\n  above 0 (absent) up to 2",
        ),
        (
            ["--cases", "1", "--seed", "1", "--tight", "9"],
            "--tight: got 9\n  from 1 (tolerances as they are) to 5",
        ),
        (["--cases", "1", "--seed", "1", "--jobs", "0"], "--jobs: got 0\n  at least 1"),
        (
            ["--cases", "1", "--seed", "1", "--outside", "odd"],
            "--outside: got 'odd'\n  all, fresh, known",
        ),
    ],
)
def test_wrong_orders_are_refused(tmp_path, capsys, options, reported):
    assert main(["challenge", "make", str(tmp_path / "new"), *options]) == 2
    assert reported in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_small_challenge_from_end_to_end(tmp_path, capsys):
    cases, out = tmp_path / "cases", tmp_path / "out"
    make(cases, Order(cases=2, seed=5, magnitude=1.0))
    arguments = [str(cases), "--verdicts", str(out)]
    assert main(["challenge", "run", *arguments, "--jobs", "1"]) == 0, capsys.readouterr().err
    assert main(["challenge", "score", *arguments]) == 0
    found = json.loads((out / "score.json").read_text())
    assert found["blind"] and sum(found["cases"].values()) == len(found["each"]) == 2


def test_wrong_diagnosers_are_refused(challenge, tmp_path, capsys):
    arguments = [str(challenge), "--verdicts", str(tmp_path), "--by", "orchestrator.nowhere:f"]
    assert main(["challenge", "run", *arguments]) == 2
    assert "--by: orchestrator.nowhere:f: No module named" in capsys.readouterr().err
    assert main(["challenge", "run", str(tmp_path / "none"), "--verdicts", str(tmp_path)]) == 2
    assert "holds no cases\n  Make some by `orchestrator challenge make`." in capsys.readouterr().err


def test_a_secret_seed_differs_each_time(tmp_path):
    digests = {make(tmp_path / name, Order(cases=1, seed=None)) for name in ("a", "b")}
    assert len(digests) == 2
    assert open_truth(tmp_path / "a")["seed"] != open_truth(tmp_path / "b")["seed"]
    logs = [
        np.frombuffer((tmp_path / one / "case-0001/train-1.csv.gz").read_bytes(), np.uint8) for one in "ab"
    ]
    assert not np.array_equal(*logs)


def test_a_challenge_that_cannot_be_made_or_is_interrupted_says_where(tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    (tmp_path / "file").write_text("mine")
    folder = tmp_path / "file" / "q"
    assert main(["challenge", "make", str(folder), "--cases", "1", "--seed", "2"]) == 2
    assert f"cannot make the folder {folder} (" in capsys.readouterr().err
    monkeypatch.setattr("orchestrator.diagnosis.rig.challenge.make.make", interrupted)
    assert main(["challenge", "make", str(tmp_path / "q"), "--cases", "1", "--seed", "2"]) == 130
    assert f"cases made until then are in {tmp_path / 'q'}" in capsys.readouterr().err
