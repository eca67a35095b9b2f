"""Unknown inputs: an oscillator by an independent solver, with a law hidden in it."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import ports_bench
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import orchestrator as orc
from orchestrator.base.errors import ConfigError
from orchestrator.diagnosis.study.channels import outliers
from orchestrator.diagnosis.study.player import Player
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.study import Role
from orchestrator.diagnosis.unknown_input import effort, verdict
from orchestrator.diagnosis.unknown_input.choice import choose_answer, rivals_of, significant
from orchestrator.diagnosis.unknown_input.corrected import write_corrected
from orchestrator.diagnosis.unknown_input.diagnose import DiagnosedSystem
from orchestrator.diagnosis.unknown_input.evaluation import Inserted, Kinds, Place
from orchestrator.diagnosis.unknown_input.fits import Weighed
from orchestrator.diagnosis.unknown_input.inquiry import answer
from orchestrator.diagnosis.unknown_input.law_fit import Candidate, Fitted, readable, spread_out, starts_of
from orchestrator.diagnosis.unknown_input.laws import library
from orchestrator.diagnosis.unknown_input.model import StateModel
from orchestrator.diagnosis.unknown_input.open_run import transition
from orchestrator.diagnosis.unknown_input.places import Runs, rank
from orchestrator.diagnosis.unknown_input.played import LawEffect, PlayedModel
from orchestrator.diagnosis.unknown_input.polish import Polished, Replays, polished
from orchestrator.diagnosis.unknown_input.report import text_of
from orchestrator.diagnosis.unknown_input.response import Responses
from orchestrator.diagnosis.unknown_input.score import scored
from orchestrator.diagnosis.unknown_input.search import Search, kin_of
from orchestrator.diagnosis.unknown_input.separate import FittedAnswer, separating
from orchestrator.diagnosis.unknown_input.verdict import verdict_on
from orchestrator.effects.delay import Delay
from orchestrator.system.connection import Port

pytest.importorskip("rumoca")

MASS = """model Mass "Mass on a spring"
  parameter Real mass(unit="kg", min=0) = 2 "Mass";
  input Real force(unit="N", start=0) "Of the actuator";
  input Real spring(unit="N", start=0) "Of the spring";
  output Real position(unit="m", start=0, fixed=true) "Position";
  output Real velocity(unit="m/s", start=0, fixed=true) "Velocity";
equation
  der(position) = velocity;
  mass*der(velocity) = force + spring;
end Mass;
"""
SPRING = """model Spring "Spring and damper"
  parameter Real stiffness(unit="N/m", min=0) = 80 "Stiffness";
  parameter Real damping(unit="N.s/m", min=0) = 2 "Damping";
  input Real travel(unit="m", start=0) "Travel";
  input Real rate(unit="m/s", start=0) "Its rate";
  output Real force(unit="N") "Against the travel";
equation
  force = -stiffness*travel - damping*rate;
end Spring;
"""
SYSTEM = """title: Oscillator
run: {master: gauss-seidel, step_size: 5 ms, stop_time: 2 s}
instances:
  mass: {fmu: Mass.fmu}
  spring: {fmu: Spring.fmu}
connections:
  - mass.position -> spring.travel
  - mass.velocity -> spring.rate
  - spring.force -> mass.spring
"""
STUDY = """format: port-study/1
system: system.yaml
interval: 10 ms
columns:
  time: {column: time, unit: s}
  mass.force: {column: f, unit: N}
  mass.position: {column: x, unit: m, noise: 0.1 mm}
calibrated:
  mass.mass: {tolerance: 0.02 kg}
  spring.stiffness: {tolerance: 1 N/m}
runs:
  - {file: a.csv, role: train}
  - {file: b.csv, role: validation}
  - {file: c.csv, role: held-out}
"""


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fmus")
    for name, text in (("Mass", MASS), ("Spring", SPRING)):
        (folder / f"{name}.mo").write_text(text, encoding="utf-8")
        subprocess.run(
            [sys.executable, "-m", "orchestrator", "build", f"{name}.mo", "-o", f"{name}.fmu"],
            cwd=folder, check=True, capture_output=True,
        )  # fmt: skip
    (folder / "system.yaml").write_text(SYSTEM, encoding="utf-8")
    (folder / "study.yaml").write_text(STUDY, encoding="utf-8")
    return folder


def logged(
    folder: Path,
    hidden: Callable[[float, float], float],
    start: float = 0.0,
    gain: Callable[[float], float] = lambda t: 1.0,
    push: Callable[[float], float] = lambda t: 0.0,
    seconds: float = 8.0,
    late: float | None = None,
    held: float | None = None,
    masses: Sequence[float] = (2.0, 2.0, 2.0),
) -> Path:
    """Write three runs in which `hidden(position, velocity)` [N] acts on the mass.

    Args:
        late: delay [s] of a force that jumps four times a second. held: period [s] of samples of the force.
        masses: of each run [kg].
    """
    random = np.random.default_rng(4)
    for name, mass in zip("abc", masses, strict=True):
        time = np.arange(0.0, seconds, 0.01)
        tones, phases = random.uniform(0.5, 8.0, 6), random.uniform(0.0, 6.3, 6)
        force = 6.0 * np.sin(np.outer(time, tones) + phases).sum(axis=1) / 3.0
        if late is not None:
            force = force[np.arange(len(time)) // 25 * 25]

        def rate(t: float, x: list[float], time=time, force=force, mass=mass) -> list[float]:
            if held is not None:
                driven = float(np.interp(math.floor(t / held + 1e-9) * held, time, force))
            elif late is None:
                driven = float(np.interp(t, time, force))
            else:
                driven = float(force[max(0, math.floor((t - late) / 0.01 + 1e-9))])
            f = gain(t) * driven - 80.0 * x[0] - 2.0 * x[1] + hidden(x[0], x[1])
            f += push(t)
            return [x[1], f / mass]

        found = solve_ivp(
            rate, (0.0, seconds), [start, 0.0], t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.01
        )
        noisy = found.y[0] + 1e-4 * random.standard_normal(len(time))
        table = np.column_stack([time, force, noisy])
        header = "time [s],f [N],x [m]"
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    return folder / "study.yaml"


def test_the_true_place_wins(fmus: Path) -> None:
    study = load_port_study(logged(fmus, lambda x, v: -1.5 * np.tanh(v / 0.003)))
    with StateModel(study) as model:
        _, places = rank(Runs(model, study.of(Role.TRAIN, Role.VALIDATION)))
    # A force, a torque of the spring and its travel are one and the same here; the position is not.
    assert not any("position" in one.place.name for one in places[:4])
    assert places[0].gain > places[-1].gain + 100.0
    assert places[0].gain > 1000.0


def test_a_delay_of_a_force_that_jumps_is_exact(fmus: Path) -> None:
    """A delay of 2.37 samples, which a lag or a rational approximation of the delay does not explain."""
    path = logged(fmus, lambda x, v: 0.0, late=0.0237)
    held = path.read_text(encoding="utf-8").replace("column: f, unit: N}", "column: f, unit: N, hold: true}")
    path = path.with_name("held.yaml")
    path.write_text(held, encoding="utf-8")
    study = load_port_study(path)
    found = answer(study)
    assert found.fitted is not None and found.verdict == "law"
    assert [one.name for one in found.fitted.laws] == ["delay at mass.force of mass.force"]
    assert abs(found.fitted.numbers[0]) == pytest.approx(0.0237, rel=2e-3)
    assert found.remains < 1.1
    assert write_corrected(study, found, fmus) == []
    assert (fmus / "law_1.fmu").is_file()


def test_a_force_that_a_slower_clock_holds_is_read_with_its_period(fmus: Path, tmp_path: Path) -> None:
    study = load_port_study(logged(fmus, lambda x, v: 0.0, held=0.08))
    found = answer(study)
    assert found.fitted is not None and found.verdict == "law"
    assert [one.name for one in found.fitted.laws] == ["hold at mass.force of mass.force"]
    assert abs(found.fitted.numbers[0]) == pytest.approx(0.08, rel=5e-3)
    assert found.remains < 1.1
    assert write_corrected(study, found, tmp_path) == []
    assert (tmp_path / "law_1.fmu").is_file()


def test_a_hum_is_read_with_its_frequency(fmus: Path) -> None:
    found = answer(load_port_study(logged(fmus, lambda x, v: 0.0, push=lambda t: math.sin(23.0 * t + 1.0))))
    assert found.fitted is not None and found.verdict == "law"
    assert [one.law.name for one in found.fitted.laws] == ["hum"]
    assert found.fitted.numbers[1] == pytest.approx(23.0, rel=1e-3)
    assert found.remains < 1.1


def test_dry_friction_is_read_with_its_level(fmus: Path) -> None:
    found = answer(load_port_study(logged(fmus, lambda x, v: -1.5 * np.tanh(v / 0.003))))
    assert found.verdict == "law" and found.fitted is not None
    assert [one.law.family for one in found.fitted.laws] == ["dry friction"]
    assert found.closed > 0.9
    level = abs(found.fitted.numbers[0])
    assert 1.3 < (2.0 * level if found.fitted.laws[0].place.kind == 2 else level) < 1.7


def test_cubic_stiffness_is_read(fmus: Path) -> None:
    found = answer(load_port_study(logged(fmus, lambda x, v: -900.0 * x**3)))
    assert found.verdict == "law" and found.fitted is not None
    assert [one.law.family for one in found.fitted.laws] == ["stiffness"]
    assert found.closed > 0.9


@pytest.mark.parametrize("start", [0.0, 0.01])
def test_another_start_is_no_law(fmus: Path, start: float) -> None:
    found = answer(load_port_study(logged(fmus, lambda x, v: 0.0, start)))
    assert found.verdict == "none" and found.fitted is None


def test_without_held_out_runs_the_answer_is_said_to_be_untested(fmus: Path) -> None:
    study = load_port_study(logged(fmus, lambda x, v: 0.0))
    found = answer(replace(study, runs=study.of(Role.TRAIN, Role.VALIDATION)))
    assert found.verdict == "none" and found.probability <= 0.6 and found.held_out == []
    assert any(one.startswith("No run is held out") for one in found.remarks)
    text = text_of("one", found)
    assert "the fitted runs: the residual is" in text and "held-out runs:" not in text
    # Numbers that JSON lacks end no diagnosis.
    data = DiagnosedSystem(study, replace(found, gap=math.inf)).data
    assert data["held_out"]["gap_over_noise"] is None and json.dumps(data, allow_nan=False)


def test_a_gain_that_drifts_is_read(fmus: Path, tmp_path: Path) -> None:
    # The command writes the answer; the force's gain falls by 3 % a second.
    study = logged(fmus, lambda x, v: 0.0, gain=lambda t: 1.0 - 0.03 * t)
    command = [sys.executable, "-m", "orchestrator", "diagnose", str(study)]
    done = subprocess.run([*command, "--out", str(tmp_path)], check=True, capture_output=True, text=True)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert data["verdict"] == "law" and [one["family"] for one in data["laws"]] == ["drift"]
    assert data["laws"][0]["numbers"]["change per time"]["value"] == pytest.approx(-0.03, rel=0.1)
    assert data["held_out"]["closed"] > 0.9
    assert "gain that drifts" in done.stdout


def test_calibration_stays_within_what_the_fmu_allows(fmus: Path) -> None:
    """What drives the mass would take a negative damping, which the FMU refuses."""
    path = logged(fmus, lambda x, v: 2.5 * v)
    text = path.read_text(encoding="utf-8")
    path = path.with_name("damped.yaml")
    damping = "  spring.damping: {tolerance: 5 N.s/m}"
    path.write_text(text.replace("calibrated:", f"calibrated:\n{damping}"), encoding="utf-8")
    study = load_port_study(path)
    with StateModel(study) as model:
        found = polished(Runs(model, study.of(Role.TRAIN)), (), model.nominal)
        calibrated = dict(zip(map(str, model.parameters), found.constants.tolist(), strict=True))
    assert 0.0 <= calibrated["spring.damping"] < 0.1 and found.remains > 2.0


def test_nothing_is_missing_where_a_speed_is_defined(fmus: Path) -> None:
    with StateModel(load_port_study(logged(fmus, lambda x, v: 0.0))) as model:
        names = [one.name for one in model.places()]
    assert "der(mass.velocity)" in names and "der(mass.position)" not in names


def test_what_the_library_lacks_is_outside_and_drawn(fmus: Path, tmp_path: Path) -> None:
    # A force that knocks once in a while is no law of the signals.
    def knocks(t: float) -> float:
        return 12.0 if t % 1.7 < 0.2 else 0.0

    study = logged(fmus, lambda x, v: 0.0, push=knocks, seconds=3.0)
    command = [sys.executable, "-m", "orchestrator", "diagnose", str(study)]
    subprocess.run([*command, "--out", str(tmp_path)], check=True, capture_output=True)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert data["verdict"] == "outside" and not data["laws"] and data["probability"] >= 0.6
    assert data["places"] and "position" not in data["places"][0]["place"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "against the signals there" in page and page.count("<svg") == 2


def test_noise_that_is_larger_than_stated_is_no_law(fmus: Path) -> None:
    """No law explains a white residual, so that none is fitted."""
    path = logged(fmus, lambda x, v: 0.0)
    text = path.read_text(encoding="utf-8").replace("noise: 0.1 mm", "noise: 0.06 mm")
    path = path.with_name("noisy.yaml")
    path.write_text(text, encoding="utf-8")
    found = answer(load_port_study(path))
    assert found.verdict == "none" and found.fitted is None
    assert found.remains == pytest.approx(1.0 / 0.6, rel=0.05)


def test_outliers_of_a_log_hide_no_law_and_are_reported(fmus: Path) -> None:
    path = logged(fmus, lambda x, v: -600.0 * x**3)
    random = np.random.default_rng(9)
    for name in "abc":
        table = np.loadtxt(fmus / f"{name}.csv", delimiter=",", skiprows=1)
        rows = random.choice(np.arange(30, len(table) - 30), 8, replace=False)
        table[rows, 2] = random.choice([0.0, 2.0], 8)
        header = "time [s],f [N],x [m]"
        np.savetxt(fmus / f"{name}.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    found = answer(load_port_study(path))
    assert found.verdict == "law" and found.fitted is not None
    assert [one.law.name for one in found.fitted.laws] == ["cubic stiffness"]
    assert [one.split(" rows")[0][:2] for one in found.remarks if "outliers" in one] == ["a:", "b:", "c:"]


def test_outliers_are_no_tips_of_an_oscillation_nor_steps() -> None:
    random, time = np.random.default_rng(2), np.arange(2000)
    calm = 0.01 * random.standard_normal(2000)
    steps, tips = np.sign(np.sin(time / 150.0)), np.cos(time * 0.9) ** 5
    bursts = np.where(time % 400 < 40, tips, 0.0)
    for signal in (steps, tips, bursts):
        assert not outliers(signal + calm, 0.01).any()
    rows = np.array([100, 400, 401, 402, 1300, 1302, 1800])
    away = steps + calm
    away[rows] += 3.0
    assert np.flatnonzero(outliers(away, 0.01)).tolist() == rows.tolist()


def test_a_small_law_that_held_out_runs_contradict_is_none(fmus: Path) -> None:
    """A sensor's scale drifts by 3 % in a run, in the held-out run the other way."""
    study = logged(fmus, lambda x, v: 0.0)
    for name, change in zip("abc", (0.03, 0.03, -0.03), strict=True):
        path = fmus / f"{name}.csv"
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        table[:, 2] *= 1.0 + change * table[:, 0] / 8.0
        header = "time [s],f [N],x [m]"
        np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    found = answer(load_port_study(study))
    assert found.verdict == "none" and found.fitted is None and found.probability <= 0.6
    remarks = " ".join(found.remarks)
    assert "contradict the nearest law" in remarks and "times the noise" in remarks


@pytest.mark.parametrize(("remains", "said"), [(1.3, "none"), (30.0, "outside")])
def test_a_law_that_held_out_runs_contradict_is_none_beside_noise(remains: float, said: str) -> None:
    search: Any = SimpleNamespace(base=SimpleNamespace(remains=remains))
    best: Any = SimpleNamespace(laws=(SimpleNamespace(),))
    verdict, remarks = verdict_on(search, best, closes=0.3, share=0.01, calibrated=0.2)
    assert verdict == said and "contradict the nearest law" in remarks[0]


def test_one_law_is_tried_at_several_components(fmus: Path) -> None:
    model = StateModel(load_port_study(logged(fmus, lambda x, v: 0.0)))
    every = [one for place in model.places() for one in readable(model, place) if one.law.name == "viscous"]
    shares = sorted((replace(one, share=0.9 if one.place.component else 0.5) for one in every), key=str)
    kept = spread_out(shares, 12, 2)
    assert {one.place.component for one in kept} == {one.place.component for one in every}
    assert 2 <= len(kept) <= 3


def test_the_likeliest_of_laws_that_act_the_same_takes_the_place_of_another(fmus: Path) -> None:
    """A spring that grows stiffer, found as a curved scale of the travel by way of a pair."""
    study = load_port_study(logged(fmus, lambda x, v: -300.0 * x * abs(x)))
    with StateModel(study) as model:
        search = Search(Runs(model, study.of(Role.TRAIN, Role.VALIDATION)), lambda stage: None)
        search.scores(search.begins[0])
        place = next(one for one in search.places if one.name == "spring.travel")
        curve = next(one for one in readable(model, place) if one.law.name == "gain curve")
        start = np.r_[search.base.constants, 3.0]
        found = search.likelier([search.fit([curve], start, search.base.starts, 12, None)])
    ((laws, fit),) = [(one.laws, two) for one, two in found]
    assert [one.law.name for one in laws] == ["progressive stiffness"]
    assert fit.remains < 1.1
    assert curve.name in [one.name for one in search.twins[laws[0].name]]


def test_a_rare_law_is_compared_with_the_usual_ones_of_its_family(fmus: Path) -> None:
    """A spring that grows stiffer, whose gain curve was no candidate, since it acts like another law."""
    study = load_port_study(logged(fmus, lambda x, v: -300.0 * x * abs(x)))
    with StateModel(study) as model:
        search = Search(Runs(model, study.of(Role.TRAIN, Role.VALIDATION)), lambda stage: None)
        place = next(one for one in search.places if one.name == "spring.travel")
        rare = next(one for one in readable(model, place, rare=True) if one.law.name == "gain above a level")
        start = np.r_[search.base.constants, 0.1, 0.01]
        found = search.rivals([search.fit([rare], start, search.base.starts)])
        best = min(found, key=lambda one: one.remains)
    assert [law.name for law in best.laws] == ["gain curve at spring.travel of spring.travel"]
    assert best.remains < 1.2 < search.base.remains


@pytest.mark.parametrize("suits", [True, False])
def test_a_fit_begins_where_the_law_leaves_less(fmus: Path, suits: bool, monkeypatch: Any) -> None:
    """Calibration makes up for friction by parameters; those of its score suit the law better."""
    study = load_port_study(logged(fmus, lambda x, v: -0.8 * math.tanh(v / 2e-3), seconds=4.0))
    with StateModel(study) as model:
        search = Search(Runs(model, study.of(Role.TRAIN)), lambda _: None)
        (law, *_) = [
            one for one in search.scores(search.begins[0])[0].candidates if one.law.name == "coulomb"
        ]
        assert law.beside is not None
        constants, starts = law.beside
        if not suits:
            law = replace(law, beside=(2.0 * constants, starts))
        begun = []
        monkeypatch.setattr(search, "fit", lambda laws, constants, starts: begun.append(constants))
        search._fit_beside([law], search.begins[0])
    expected = constants if suits else search.base.constants
    np.testing.assert_allclose(begun[0], [*expected, *law.numbers])


@pytest.mark.parametrize(("corner", "finer"), [(5e-4, True), (0.3, False)])
def test_steps_are_finer_where_a_law_is_faster_than_the_model(fmus: Path, corner: float, finer: bool) -> None:
    study = load_port_study(logged(fmus, lambda x, v: -4.0 * math.tanh(v / corner), seconds=4.0))
    with StateModel(study) as model:
        search = Search(Runs(model, study.of(Role.TRAIN)), lambda _: None)
        place = next(one for one in search.places if one.name == "der(mass.velocity)")
        law = next(one for one in readable(model, place) if one.law.name == "coulomb")
        law = replace(law, numbers=(-1.9, 0.9 * corner))
        begin = np.r_[search.base.constants, law.numbers]
        brief = search.fit([law], begin, search.base.starts)
        steps = search.runs.sub_of([law.inserted])
        (best, *_) = search.finish([brief], 1)
        assert (search.runs.sub_of([law.inserted]) > steps) is finer
        assert search.runs.sub_of([]) == search.runs.sub
    assert best.remains < 1.1
    assert best.fitted.numbers[0] == pytest.approx(-2.0, rel=0.01)
    assert (brief.remains > 1.5 * best.remains) is finer


@pytest.mark.parametrize(("name", "at"), [("delay", "spring.travel"), ("lag", "mass.force")])
def test_the_best_law_is_tried_elsewhere_and_others_at_its_place(fmus: Path, name: str, at: str) -> None:
    """A delay of the force, found as one of the spring's travel, or as another law of the force."""
    study = load_port_study(logged(fmus, lambda x, v: 0.0, late=0.03))
    with StateModel(study) as model:
        search = Search(Runs(model, study.of(Role.TRAIN, Role.VALIDATION)), lambda stage: None)
        search._scores = search.scores(search.begins[0])
        place = next(one for one in search.places if one.name == at)
        law = next(one for one in readable(model, place) if one.law.name == name)
        start = np.r_[search.base.constants, 0.02]
        found = search.rivals([search.fit([law], start, search.base.starts)])
    best = min(found, key=lambda fit: fit.remains)
    assert best.laws[0].name == "delay at mass.force of mass.force" and best.remains < 1.1


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere fits run one after the other")
def test_the_effort_is_counted_alike_on_any_number_of_cores(fmus: Path) -> None:
    study = load_port_study(logged(fmus, lambda x, v: -900.0 * x**3))
    spent = []
    cores = os.sched_getaffinity(0)
    try:
        for some in (cores, set(list(cores)[:1])):
            os.sched_setaffinity(0, some)
            with StateModel(study) as model:
                search = Search(Runs(model, study.of(Role.TRAIN, Role.VALIDATION)), lambda stage: None)
                search.scores(search.begins[0])
                spent.append(model.effort.spent)
    finally:
        os.sched_setaffinity(0, cores)
    assert spent[0] == spent[1] > 4 * 3 * 800


def test_a_search_ends_at_its_limit_of_effort_and_says_so(
    fmus: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = load_port_study(logged(fmus, lambda x, v: -900.0 * x**3, push=lambda t: 4.0 * (3.0 < t < 3.1)))
    monkeypatch.setattr(effort, "_LIMIT", 1e6)
    found = answer(study)
    (remark,) = [one for one in found.remarks if "limit of work" in one]
    assert "pairs of laws" in remark
    assert found.fitted is not None and found.fitted.laws[0].law.family == "stiffness"


def test_laws_of_a_family_begin_with_the_numbers_that_they_share(fmus: Path) -> None:
    model = StateModel(load_port_study(logged(fmus, lambda x, v: 0.0)))
    runs = Runs(model, model.study.of(Role.TRAIN))
    places = model.places()
    every = [one for place in places for rare in (False, True) for one in readable(model, place, rare)]

    def begun(law: str, other: str, numbers: list[float]) -> set[tuple[float, ...]]:
        (one, *_) = [each for each in every if each.law.name == law]
        found = kin_of(runs, one, np.array(numbers))
        return {each.numbers for each in found if each.law.name == other}

    # A delay takes the time of a lag. Dry friction takes the level of one that builds up over a travel, and
    # corners of its own, since a travel is no speed.
    assert begun("lag", "delay", [0.07]) == {(0.07,)}
    corners = begun("Dahl friction", "coulomb", [1.5, 1e-8])
    assert len(corners) == 2 and all(level == 1.5 and corner > 1e-4 for level, corner in corners)


def test_the_corrected_system_runs_and_matches_the_machine(fmus: Path, tmp_path: Path) -> None:
    study = load_port_study(logged(fmus, lambda x, v: -1.5 * np.tanh(v / 0.003)))
    found = answer(study)
    assert write_corrected(study, found, tmp_path) == []
    # The third run's force drives the corrected system from a file of signals.
    config = yaml.safe_load((tmp_path / "corrected.yaml").read_text(encoding="utf-8"))
    config["instances"]["log"] = {"fmu": str(fmus / "c.csv")}
    config["connections"].remove("law_1.y -> mass.force")
    config["connections"].append({"from": ["law_1.y", "log.f"], "to": "mass.force"})
    config["run"] |= {"step_size": "0.25 ms", "stop_time": "7.9 s"}
    (tmp_path / "driven.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    made = orc.run(tmp_path / "driven.yaml")
    table = np.loadtxt(fmus / "c.csv", delimiter=",", skiprows=1)
    position = np.interp(table[:780, 0], made["mass.position"].time, made["mass.position"].values)
    left = float(np.sqrt(np.mean((position - table[:780, 2]) ** 2)))
    # 1 ms leaves 0.5 mm, four times shorter steps a quarter of that beside the noise of 0.1 mm.
    assert left < 2e-4 < 0.01 * float(np.ptp(table[:, 2]))


def test_components_without_states_are_replayed_by_the_master(tmp_path: Path) -> None:
    # A connection with a delay has no state form; friction is hidden in the drive.
    late = {"from": ["controller.voltage"], "to": "drive.voltage", "through": [{"delay": "4 ms"}]}
    study = ports_bench.study(tmp_path, [ports_bench.COULOMB, late])
    config = ports_bench.system(0.2, [late])
    (tmp_path / "late.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    data = yaml.safe_load((study / "study.yaml").read_text(encoding="utf-8"))
    data |= {"system": "late.yaml", "runs": data["runs"]}
    (study / "study.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    made = orc.diagnose(study, tmp_path / "out")
    assert isinstance(made, DiagnosedSystem) and "corrected.yaml" in made.files
    (law,) = made.data["laws"]
    assert (law["law"], law["place"], law["signal"]) == ("coulomb", "drive.load", "drive.velocity")
    assert law["numbers"]["level"]["value"] == pytest.approx(-12.0, rel=0.02)
    assert made.data["held_out"]["closed"] > 0.98 and "coulomb" in str(made)
    # The drive's load has a start value, which the law now replaces.
    corrected = orc.run(tmp_path / "out" / "corrected.yaml", halving=False)
    assert np.isfinite(corrected["drive.position"].values).all()


@pytest.mark.parametrize(("law_far", "chosen"), [(False, 1), (True, 0)])
def test_a_law_within_tolerances_comes_before_parameters_beyond_them(law_far: bool, chosen: int) -> None:
    """Where both explain the logs."""
    weighed = [fit_of((), 0.9, 0.0, far=True), fit_of(("delay",), 0.9, 50.0, far=law_far)]
    assert choose_answer(FAR_OR_NOT, weighed) == chosen


@pytest.mark.parametrize(("remains", "chosen"), [(1.5, 2), (3.0, 0)])
def test_two_laws_of_which_neither_is_an_answer_have_to_explain_the_logs(remains: float, chosen: int) -> None:
    """Two laws imitate much: what they leave shows that they are not what is missing."""
    begun = [fit_of((), 10.0, 0.0), fit_of(("saturation",), 9.0, 60.0)]
    assert choose_answer(FAR_OR_NOT, [*begun, fit_of(("saturation", "dead zone"), remains, 90.0)]) == chosen


@pytest.mark.parametrize(
    ("left", "nats", "reported"), [(6.0, 90.0, True), (8.9, 90.0, False), (6.0, 65.0, False)]
)
def test_two_laws_that_leave_less_than_the_answer_are_reported(
    left: float, nats: float, reported: bool
) -> None:
    """If held-out runs confirm it, and the evidence for the second law is clear."""
    weighed = [fit_of(("coulomb", "dead zone"), 7.0, nats), fit_of(("coulomb",), 10.0, 60.0)]

    def judged(one: Fitted) -> Any:
        return SimpleNamespace(remains=left if len(one.laws) == 2 else 10.0)

    remarks = verdict.further_law(weighed, 1, judged, 9.0)
    assert len(remarks) == reported
    if reported:
        assert "6 times the noise there instead of 9: coulomb at mass.force of" in remarks[0]


def test_an_answer_that_held_out_runs_contradict_gives_way_to_a_usual_one_about_as_likely() -> None:
    each = [("eddy-current brake", 1.7, 50.0), ("Dahl friction", 1.9, 49.0), ("coulomb", 1.9, 48.5)]
    weighed = [*(fit_of((name,), left, nats) for name, left, nats in each), fit_of((), 9.0, 0.0)]
    leaves = {"eddy-current brake": 3.3, "Dahl friction": 2.6, "coulomb": 2.8}

    def judged(one: Fitted) -> Any:
        return SimpleNamespace(remains=leaves[one.laws[0].law.name])

    for calibrated, chosen in ((6.3, 2), (20.0, 0), (3.5, 0)):
        found, replay, remarks = verdict.confirmed(FAR_OR_NOT, weighed, 0, judged, calibrated)
        assert found == chosen and len(remarks) == (chosen == 2)
        assert replay.remains == (2.8 if chosen == 2 else 3.3)


@pytest.mark.parametrize(("left", "chosen"), [(3.0, 0), (9.0, 1)])
def test_held_out_runs_decide_between_likelihood_and_tolerances(left: float, chosen: int) -> None:
    """A likelier law that needs a parameter beyond its tolerance, and one that does not."""
    weighed = [
        fit_of(("cubic stiffness",), 2.2, 90.0, True),
        fit_of(("progressive stiffness",), 3.9, 50.0),
        fit_of((), 22.0, 0.0),
    ]
    assert choose_answer(FAR_OR_NOT, weighed) == 1

    def judged(one: Fitted) -> Any:
        return SimpleNamespace(remains=left if one.laws[0].law.name == "cubic stiffness" else 14.0)

    found, _, remarks = verdict.confirmed(FAR_OR_NOT, weighed, 1, judged, 58.0)
    assert found == chosen
    assert any("leaves 14 times the noise on held-out runs" in one for one in remarks) is (chosen == 0)


@pytest.mark.parametrize(
    ("laws", "fitted", "left", "nats", "chosen"),
    [
        (("coulomb", "power curve"), 7.5, 5.5, 120.0, 0),
        (("coulomb", "power curve"), 7.5, 8.0, 120.0, 1),
        (("coulomb", "power curve"), 9.5, 5.5, 120.0, 1),
        (("coulomb", "power curve"), 7.5, 5.5, 65.0, 1),
        (("coulomb", "cogging"), 7.5, 5.5, 120.0, 1),
    ],
)
def test_two_laws_count_if_they_close_a_third_of_what_one_leaves_on_all_runs(
    laws: tuple[str, str], fitted: float, left: float, nats: float, chosen: int
) -> None:
    """On fitted and on held-out runs, with clear evidence, and without a rare law."""
    weighed = [
        fit_of(laws, fitted, nats), fit_of(("power curve",), 12.5, 60.0), fit_of((), 30.0, 0.0)
    ]  # fmt: skip

    def judged(one: Fitted) -> Any:
        return SimpleNamespace(remains=left if len(one.laws) == 2 else 10.0)

    assert choose_answer(FAR_OR_NOT, weighed) == 1
    found, _, remarks = verdict.confirmed(FAR_OR_NOT, weighed, 1, judged, 33.0)
    assert found == chosen and len(remarks) == (chosen == 0)


def test_the_simpler_law_of_a_family_is_not_a_rare_one() -> None:
    best_first = [("stribeck", 4.0, 500.0), ("Dahl friction", 4.2, 400.0), ("coulomb", 4.4, 300.0)]
    weighed = [*(fit_of((name,), left, nats) for name, left, nats in best_first), fit_of((), 10.0, 0.0)]
    assert choose_answer(FAR_OR_NOT, weighed) == 2


@pytest.mark.parametrize(("nats", "chosen"), [(113.0, 0), (100.0, 2)])
def test_the_simpler_law_of_a_family_is_no_answer_where_another_family_explains_more(
    nats: float, chosen: int
) -> None:
    """Thrust by the square of a command is no line that bends, if a dead zone suits the logs better."""
    laws = [("power curve", 11.7, 120.0), ("dead zone", 12.6, nats), ("gain curve", 15.4, 95.0)]
    weighed = [*(fit_of((name,), left, evidence) for name, left, evidence in laws), fit_of((), 27.0, 0.0)]
    assert choose_answer(FAR_OR_NOT, weighed) == chosen


@pytest.mark.parametrize(("remains", "chosen"), [(6.6, 0), (7.8, 2)])
def test_a_rare_law_in_a_pair_needs_not_halve_what_a_pair_leaves_that_is_no_answer(
    remains: float, chosen: int
) -> None:
    pairs = [
        fit_of(("coulomb", "rate limit"), remains, 120.0),
        fit_of(("coulomb", "dead zone"), 11.0, 90.0),
    ]
    weighed = [*pairs, fit_of(("quadratic drag",), 15.0, 60.0), fit_of((), 30.0, 0.0)]
    assert choose_answer(FAR_OR_NOT, weighed) == chosen


def test_any_number_of_a_law_without_an_amplitude_shows_that_it_acts() -> None:
    """The pivot of a power curve may be anything beside a free gain, but its exponent is known."""
    fitted = fit_of(("coulomb", "power curve"), 1.0, 0.0).fitted
    both, one, none = (0.1, 9.0, 9.0, 0.1), (9.0, 0.1, 0.1, 0.1), (0.1, 0.1, 9.0, 9.0)
    for sigmas, acts in ((both, True), (one, False), (none, False)):
        assert significant(replace(fitted, sigmas=np.array(sigmas))) is acts


@pytest.mark.parametrize("damping", [0.5, 300.0, 1e6])
def test_the_transition_over_a_step_is_exact_where_a_mode_is_faster(damping: float) -> None:
    """As at the corner of dry friction, against a matrix exponential of SciPy."""
    g = 0.02 * np.array([[0.0, 1.0, 0.0], [-40.0, -damping, 1e4], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(transition(g, np.eye(3)), expm(g), atol=1e-3, rtol=1e-3)


# Parameters leave their tolerances where the first one is 1.
FAR_OR_NOT: Any = SimpleNamespace(far=lambda constants: np.flatnonzero(constants[:1]).tolist(), begins=[])


def fit_of(names: tuple[str, ...], remains: float, nats: float, far: bool = False) -> Weighed:
    """Laws at one place, with what they leave over the noise, and their evidence."""
    laws = [next(one for one in library() if one.name == name) for name in names]
    place = Place("mass.force", Kinds.INPUT, 0, 0)
    each = [Candidate(one, place, one.name, Inserted(place, 0, (0,), 1), (1.0,), 1.0) for one in laws]
    count = sum(len(one.numbers) for one in laws)
    fitted = Fitted(tuple(each), np.ones(count), np.full(count, 1e-3), 0.0, ())
    return Weighed(fitted, Polished(np.full(1, float(far)), np.eye(1), [], remains, 100, 1.0), nats)


@pytest.mark.parametrize("name", ["delay", "lag", "dead zone", "saturation"])
def test_laws_as_effects_do_what_they_do_in_state_form(name: str) -> None:
    law = next(one for one in library() if one.name == name)
    times = np.arange(400) * 2e-3
    signal = np.sin(2.0 * np.pi * 3.0 * times)
    effect = LawEffect(
        address=float(law.address),
        own=True,
        states=law.states,
        values=(0.02,),
        settled=sum(1 << k for k in law.settled),
        interval=2e-3,
    )
    memory = np.zeros(effect.room(None))
    found = [
        effect.kernel(t, [x], effect.numbers(), memory, True) for t, x in zip(times, signal, strict=True)
    ]
    at = slice(100, None)  # settled
    shifted = np.sin(2.0 * np.pi * 3.0 * (times - 0.02))
    w = 2.0 * np.pi * 3.0 * 0.02
    expected = {
        "delay": shifted,
        "lag": np.sin(2.0 * np.pi * 3.0 * times - np.arctan(w)) / np.hypot(1.0, w),
        "dead zone": signal - np.clip(signal, -0.02, 0.02),
        "saturation": np.clip(signal, -0.02, 0.02),
    }[name]
    np.testing.assert_allclose(np.array(found)[at], expected[at], atol=2e-4)


def test_the_same_law_elsewhere_that_explains_the_logs_as_well_is_no_rival(fmus: Path) -> None:
    with StateModel(load_port_study(logged(fmus, lambda x, v: 0.0))) as model:
        every = [one for place in model.places() for one in readable(model, place)]
    (first, *_, second) = [one for one in every if one.law.name == "viscous"]
    other = next(one for one in every if one.law.name == "coulomb")
    wider = next(one for one in every if one.law.name == "stribeck" and one.place == other.place)
    assert first.place.component != second.place.component
    matrix = np.zeros(0), np.eye(0)
    fits = [Fitted((one,), np.ones(1), np.ones(1), 0.0, matrix) for one in (first, second, other)]
    polished = Polished(*matrix, [], 1.0, 100, 1.0)
    weighed = [Weighed(one, polished, nats) for one, nats in zip(fits, (0.0, -0.5, -0.5), strict=True)]
    search: Any = SimpleNamespace(far=lambda constants: [])

    probability, rivals, elsewhere = rivals_of(search, weighed, 0, 0.98, leaves=False)
    assert elsewhere == [fits[1]] and [one.fitted for one in rivals] == [fits[2]]
    assert probability + rivals[0].probability == pytest.approx(0.98) and probability > 0.7
    # What leaves more than noise may do so in different ways.
    less, rivals, elsewhere = rivals_of(search, weighed, 0, 0.98, leaves=True)
    assert less < probability and len(rivals) == 2 and not elsewhere
    # What holds the answer as a special case explains the logs as well.
    sizes = ((other, 2), (wider, 4))
    friction = [Fitted((one,), np.ones(n), np.ones(n), 0.0, matrix) for one, n in sizes]
    weighed = [Weighed(one, polished, 0.0) for one in friction]
    assert rivals_of(search, weighed, 0, 0.98, leaves=False)[0] > 0.85
    assert rivals_of(search, weighed, 1, 0.98, leaves=False)[0] == pytest.approx(0.49)
    # A rare law is less likely than a usual one with as many numbers.
    weighed = [fit_of(("dead zone",), 1.0, 0.0), fit_of(("backlash",), 1.0, 0.0)]
    assert [rivals_of(search, weighed, k, 0.98, leaves=False)[0] > 0.85 for k in (0, 1)] == [True, False]


@pytest.mark.parametrize("held", [False, True])
def test_what_small_laws_change_is_predicted_without_simulation(fmus: Path, held: bool) -> None:
    path = logged(fmus, lambda x, v: 0.0)
    if held:
        text = path.read_text(encoding="utf-8").replace("unit: N}", "unit: N, hold: true}")
        path = path.with_name("held.yaml")
        path.write_text(text, encoding="utf-8")
    study, differ = load_port_study(path), []
    with StateModel(study) as model:
        runs, places = Runs(model, study.of(Role.TRAIN)), model.places()
        starts = [each[3] for each in runs.data]
        responses = Responses(runs, [], model.nominal, starts, 200, places)
        every = [one for place in places for rare in (False, True) for one in readable(model, place, rare)]
        for one in [one for one in every if one.law.linear]:
            replays = Replays(runs, [one.inserted], 200, starts)
            for begin in starts_of(one, runs):
                numbers = np.array([1e-4 * runs.spread_at(one.place), *begin[1:]])
                other = np.r_[-numbers[0], numbers[1:]]
                simulated = replays.residual(np.r_[model.nominal, numbers])
                simulated = 0.5 * (simulated - replays.residual(np.r_[model.nominal, other]))
                size = float(np.linalg.norm(simulated))
                if 0.0 < size < 1e3:
                    left = float(np.linalg.norm(responses.of(one, numbers) - simulated))
                    differ.append((left / size, one.name, begin))
    assert len(differ) > 100
    # Steps, and what bends within a sample, are not resolved as a simulation does.
    assert float(np.median([one for one, *_ in differ])) < 2e-3, sorted(differ)[-20:]
    assert float(np.quantile([one for one, *_ in differ], 0.97)) < 0.1, sorted(differ)[-20:]


def test_an_experiment_separates_laws_that_agree_on_the_logs(fmus: Path) -> None:
    # Viscous friction with the same loss per cycle as dry friction, at this amplitude alone.
    study = load_port_study(logged(fmus, lambda x, v: 0.0))
    with StateModel(study) as model:
        runs = Runs(model, study.of(Role.TRAIN))
        place = next(one for one in model.places() if one.name == "mass.force")
        index = model.states.index(Port("mass", "velocity"))
        spread = float(runs.spread[index])
        made = []
        for name, numbers in (("coulomb", (-0.3, 0.01 * spread)), ("viscous", (-0.3 * 0.8 / spread,))):
            law = next(one for one in library() if one.name == name)
            put = Inserted(place, law.address, (index,), len(law.numbers), law.states)
            one = Candidate(law, place, "mass.velocity", put, numbers, 1.0)
            made.append(FittedAnswer((one,), np.r_[model.nominal, numbers], [each[3] for each in runs.data]))
        (found,) = separating(runs, made[0], made[1:])
    assert found.what.startswith("repeat the run a with") and "amplitude" in found.what
    assert found.rival == "viscous at mass.force of mass.velocity"
    assert found.difference > 2.0 * found.before


def test_a_rival_that_runs_away_needs_no_experiment(fmus: Path) -> None:
    study = load_port_study(logged(fmus, lambda x, v: 0.0))
    with StateModel(study) as model:
        runs = Runs(model, study.of(Role.TRAIN))
        place = next(one for one in model.places() if one.name == "mass.force")
        law = next(one for one in readable(model, place) if one.law.name == "viscous")
        starts = [each[3] for each in runs.data]
        answer, rival = (
            FittedAnswer((replace(law, numbers=(factor,)),), np.r_[model.nominal, factor], starts)
            for factor in (-1.0, 500.0)
        )
        assert separating(runs, answer, [rival]) == []


def with_values(path: Path, values: Sequence[dict[str, str]]) -> Path:
    """The study whose runs set these values; the mass is calibrated no more."""
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    del data["calibrated"]["mass.mass"]
    for run, own in zip(data["runs"], values, strict=True):
        run["set"] = own
    path = path.with_name("values.yaml")
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_runs_with_other_masses_and_starts_share_one_law(fmus: Path) -> None:
    path = logged(fmus, lambda x, v: -3.0 * v * abs(v), start=0.05, masses=(2.0, 5.0, 3.0))
    given = [{"mass.mass": f"{mass} kg", "mass.position": "50 mm"} for mass in (2, 5, 3)]
    study = load_port_study(with_values(path, given))
    with StateModel(study) as states, PlayedModel(study) as played:
        assert not any("mass.mass" in one.name for one in (*states.places(), *played.places()))
        for run in study.runs:
            begin = states.started(run)
            # The master simulates with a step of 5 ms, the state form without.
            one = Runs(states, [run]).simulated(*states.external(run), np.r_[begin, states.nominal])[0]
            two = Runs(played, [run]).simulated(*played.external(run), played.nominal)[0]
            assert float(np.abs(one - two).max()) < 0.03 * float(np.ptp(one))
    found = answer(study)
    assert found.verdict == "law" and found.fitted is not None
    assert [one.law.family for one in found.fitted.laws] == ["drag"]
    assert found.closed > 0.95 and found.remains < 1.2


def test_all_faults_of_what_runs_set_are_reported_at_once(fmus: Path) -> None:
    path = logged(fmus, lambda x, v: 0.0, seconds=2.0)
    first = {"mass.weight": "2 kg", "mass.mass": "2 m"}
    faults = [first, {"spring.stiffness": "70 N/m"}, {"mass.force": "1 N"}]
    with pytest.raises(ConfigError) as error:
        load_port_study(with_values(path, faults))
    text = str(error.value)
    for part in ("runs[0].set.mass.weight: no such", "mass.mass: ", "is calibrated, too", "mass.force"):
        assert part in text
    assert len(error.value.problems) == 4


def test_only_the_part_that_a_law_changes_is_simulated_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Logs feed the controller and the drive, so that neither depends on the other."""
    path = ports_bench.study(tmp_path, seed=None, logged={"drive.velocity": ("m/s", 1e-4)})
    data = yaml.safe_load((path / "study.yaml").read_text(encoding="utf-8"))
    for name in ("drive.position", "drive.velocity", "controller.voltage"):
        data["columns"][name]["feed"] = True
    (path / "study.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    study = load_port_study(path)
    calls = list[tuple[Port, ...]]()
    plain = Player.run

    def counted(self: Player, *args: Any, **more: Any) -> Any:
        calls.append(self.compared)
        return plain(self, *args, **more)

    with PlayedModel(study) as model:
        runs = Runs(model, study.of(Role.TRAIN))
        monkeypatch.setattr(Player, "run", counted)
        ext, held, logs, start = runs.data[0]
        z = np.r_[start, model.nominal]
        first = runs.simulated(ext, held, z)[0]
        assert sorted(map(len, calls)) == [1, 2]
        assert np.abs(first - logs).max() < 1e-9
        place = next(one for one in model.places() if one.name == "drive.load")
        law = next(one for one in readable(model, place) if one.law.name == "offset")
        second = runs.simulated(ext, held, np.r_[z, 5.0], [law.inserted])[0]
        moved = [model.compared[k] for k in np.flatnonzero(np.abs(second - first).max(axis=0))]
        assert set(moved) == {Port("drive", "position"), Port("drive", "velocity")} == set(calls[2])
        runs.simulated(ext, held, z)
        assert len(calls) == 3


def test_laws_that_explain_nothing_of_the_worst_run_take_one_simulation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the master simulates. Of several begins only the first one takes simulations."""
    study = load_port_study(ports_bench.study(tmp_path, [ports_bench.COULOMB]))
    calls = [0]
    plain = Player.run

    def counted(self: Player, *args: Any, **more: Any) -> Any:
        calls[0] += 1
        return plain(self, *args, **more)

    with PlayedModel(study) as model:
        runs = Runs(model, study.of(Role.TRAIN, Role.VALIDATION))
        assert len(runs.data) == 2
        places = [one for one in model.places() if one.name in ("drive.load", "drive.voltage")]
        tried = sum(len(starts_of(one, runs)) for place in places for one in readable(model, place))
        begins = [(model.nominal * factor, [run[3] for run in runs.data]) for factor in (1.0, 1.001)]
        monkeypatch.setattr(Player, "run", counted)
        monkeypatch.setattr("orchestrator.diagnosis.unknown_input.score.in_parallel", _one_by_one)
        made = []
        for some in (begins[:1], begins):
            for part in model._parts:
                part.kept.clear()
            calls[0] = 0
            made.append((scored(runs, places, [], some), calls[0]))
    (alone,), (first, second) = (scores for scores, _ in made)
    assert {one.candidates[0].law.family for one in (alone, first, second)} == {"dry friction"}
    assert made[0][1] < 1.5 * tried
    assert made[1][1] < made[0][1] + 0.5 * tried


def _one_by_one(tasks: Sequence[Callable[[], Any]]) -> list[Any]:
    return [task() for task in tasks]


def test_a_delay_beyond_a_run_needs_no_more_memory_than_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fit tries any time; the master keeps the signal of so long."""
    study = load_port_study(ports_bench.study(tmp_path, seed=None))
    rooms = []
    plain = Delay.room
    monkeypatch.setattr(Delay, "room", lambda self, step: rooms.append(plain(self, step)) or rooms[-1])
    with PlayedModel(study) as model:
        place = next(one for one in model.places() if one.name == "drive.voltage")
        law = next(one for one in readable(model, place) if one.law.name == "delay")
        ext, *_, start = Runs(model, study.of(Role.TRAIN)).data[0]
        model.simulated(ext, np.r_[start, 0.0, 0.0, model.nominal, 1e3], [law.inserted])
    assert 0 < max(rooms) < 3 * len(ext) * study.parts


@pytest.mark.parametrize(("effect", "name"), [("delay", "delay"), ("sample-and-hold", "hold")])
def test_the_master_replays_a_delay_without_approximation(tmp_path: Path, effect: str, name: str) -> None:
    late = {"from": ["controller.voltage"], "to": "drive.voltage", "through": [{effect: "6.5 ms"}]}
    study = load_port_study(ports_bench.study(tmp_path, [late], seed=None))
    with PlayedModel(study) as model:
        place = next(one for one in model.places() if one.name == "drive.voltage")
        law = next(one for one in readable(model, place) if one.law.name == name)
        ext, _, logs, start = Runs(model, study.of(Role.TRAIN)).data[0]
        z = np.r_[start, np.zeros(law.law.states), model.nominal, [0.0065, 1.0][: law.inserted.numbers]]
        found = model.simulated(ext, z, [law.inserted])[0]
        assert np.abs(found - logs).max(axis=0) == pytest.approx([0.0, 0.0], abs=1e-9)
        runs = Runs(model, study.of(Role.TRAIN))
        numbers = Replays(runs, [law.inserted]).sensitivity(z[-len(model.nominal) - law.inserted.numbers :])
        # A hold jumps with its numbers, so that no fit moves them.
        assert np.any(numbers[:, len(model.nominal) :]) == (name == "delay")
        without = model.simulated(ext, np.r_[start, model.nominal])[0]
        assert (np.abs(without - logs).max(axis=0) > 10.0 * model.noise).all()
