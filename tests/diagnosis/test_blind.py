"""Blind checks of any system: the independent solver, what is hidden, scores, and the command."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from orchestrator.cli.main import main
from orchestrator.diagnosis.blind.cases import drawn, make
from orchestrator.diagnosis.blind.draw import Drawing, draw
from orchestrator.diagnosis.blind.hidden import named
from orchestrator.diagnosis.blind.parts import PARTS
from orchestrator.diagnosis.blind.plant import Drawn, Drive
from orchestrator.diagnosis.blind.run import Order, check
from orchestrator.diagnosis.blind.score import calibration_error, scored, summary, summary_text


def oscillator() -> Drawn:
    """A driven carriage of 2 kg on a strut of 80 N/m and 2 N.s/m."""
    made = Drawing("test", interval=0.01)
    made.add("carriage", "Carriage", 2.0, 0.0)
    made.add(
        "strut", "Strut", 80.0, 2.0, travel=("carriage", "position", 1.0), rate=("carriage", "velocity", 1.0)
    )
    made.add("motor", "LinearMotor", 1.0)
    made.wire("carriage.force", ("motor", "force", 1.0), ("strut", "force", -1.0))
    made.driven["motor.voltage"] = 0.0, 1.0
    made.compared.append("carriage.position")
    return Drawn(made)


def test_the_solver_agrees_with_equations_written_by_hand() -> None:
    plant, count = oscillator(), 400
    time = np.arange(count) * 0.01
    force = np.sin(5.0 * time) + 0.5 * np.sin(9.0 * time + 1.0)
    law = named(plant, "coulomb", "strut.force", "output", "strut.rate", [0.4, 0.01])
    assert law is not None
    drive = Drive(force[:, None], False, 0.01)
    found = plant.simulate(drive, plant.nominal, plant.start, [law], np.array([0.01, 0.1]))

    def rate(t: float, x: list[float]) -> list[float]:
        f = np.interp(t, time, force) - 80.0 * x[0] - 2.0 * x[1] - 0.4 * np.tanh(x[1] / 0.01)
        return [x[1], f / 2.0]

    # From sample to sample, since straight lines between them have corners there.
    x, exact = np.zeros(2), [0.0]
    for begin, end in pairwise(time):
        x = solve_ivp(rate, (begin, end), x, method="DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
        exact.append(x[0])
    assert np.abs(found[:, 0] - exact).max() < 2e-5 * np.ptp(exact)


def test_a_held_drive_has_its_new_value_from_its_own_sample_on() -> None:
    """Also where the time of a sample, over the interval, is less than its number: 31 * 4.8 / 4.8 < 31."""
    plant = oscillator()
    values = np.arange(300.0)[:, None]
    found = plant.simulate(Drive(values, True, 4.8), plant.nominal, plant.start, [], np.array([1.0, 1.0]))
    voltage = len(plant.states) + plant.inputs.index("motor.voltage")
    assert found[:, voltage].tolist() == values[:, 0].tolist()


def test_a_delay_and_a_lag_of_the_drive_shift_it() -> None:
    plant = oscillator()
    count, size = 600, np.array([0.01, 0.1])
    drive = Drive(np.sin(4.0 * np.arange(count) * 0.01)[:, None], False, 0.01)
    plain = plant.simulate(drive, plant.nominal, plant.start, [], size)
    delay = named(plant, "delay", "motor.voltage", "input", "motor.voltage", [0.05])
    lag = named(plant, "lag", "motor.voltage", "input", "motor.voltage", [0.05])
    assert delay is not None and lag is not None
    late = plant.simulate(drive, plant.nominal, plant.start, [delay], size)
    assert np.allclose(late[5:, 0], plain[:-5, 0], atol=1e-4 * np.ptp(plain[:, 0]))
    slow = plant.simulate(drive, plant.nominal, plant.start, [lag], size)
    # In the steady state a lag turns the phase by atan(omega tau) and divides by sqrt(1 + (omega tau)^2).
    end = slice(400, None)
    assert np.ptp(slow[end, 0]) == pytest.approx(np.ptp(plain[end, 0]) / np.hypot(1.0, 0.2), rel=0.02)


@pytest.mark.parametrize("seed", range(12))
def test_drawn_systems_are_of_2_to_8_parts_and_can_be_ordered(seed: int) -> None:
    made = draw(np.random.default_rng(seed))
    assert 2 <= len(made.parts) <= 8 and made.compared and made.driven
    plant = Drawn(made)
    rate, _, signals = plant.evaluate(
        0.0, plant.start.tolist(), [0.0] * len(plant.external), plant.nominal.tolist(), [], []
    )
    assert np.isfinite([*rate, *signals]).all()


def test_a_case_is_the_same_whenever_it_is_made() -> None:
    one, two = (make(6, drawn, "one") for _ in range(2))
    assert one.truth == two.truth and all(
        np.array_equal(a, b) for a, b in zip(one.logs, two.logs, strict=True)
    )
    assert one.truth["hidden"][0]["over_noise"] >= 3.0 and one.truth["clear"]
    assert make(6, drawn, "none").truth["hidden"] == []


@pytest.mark.slow
def test_modelica_texts_and_python_equations_are_one_system(tmp_path: Path) -> None:
    # The product runs the FMUs of a drawn system; the independent solver runs its own equations.
    pytest.importorskip("rumoca")
    pytest.importorskip("casadi")
    assert main(["challenge", "--random", "3", "--hide", "none", "--out", str(tmp_path), "--jobs", "1"]) == 0
    case = make(3, drawn, "none")
    plant = case.draft.plant
    logs = np.loadtxt(tmp_path / "case-3" / "c.csv", delimiter=",", skiprows=1)
    assert np.array_equal(logs[:, 1 + len(plant.external) :].shape, case.logs[-1].shape)
    truth = json.loads((tmp_path / "case-3" / "truth.json").read_text(encoding="utf-8"))
    verdict = json.loads((tmp_path / "case-3" / "verdict.json").read_text(encoding="utf-8"))
    assert truth["kind"] == "none" and verdict["verdict"] == "none"
    # With no law, what the calibrated FMUs leave on held-out runs is the noise that was added.
    assert verdict["held_out"]["remains_over_noise"] == pytest.approx(1.0, abs=0.1)
    found = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert found["counts"]["none"] == 1 and found["figures"]["false alarms"] == 0.0 and not found["wrong"]
    # A second call makes nothing anew.
    before = (tmp_path / "case-3" / "verdict.json").stat().st_mtime_ns
    assert main(["challenge", "--random", "3", "--out", str(tmp_path), "--jobs", "1"]) == 0
    assert (tmp_path / "case-3" / "verdict.json").stat().st_mtime_ns == before


def test_a_given_system_hides_a_law_of_its_own(tmp_path: Path) -> None:
    pytest.importorskip("rumoca")
    pytest.importorskip("casadi")
    from orchestrator.diagnosis.blind.given import given
    from orchestrator.translate.build import build
    from orchestrator.translate.package import this_platform

    for name in ("Carriage", "Strut", "LinearMotor"):
        (tmp_path / f"{name}.mo").write_text(PARTS[name].modelica(), encoding="utf-8")
        build(tmp_path / f"{name}.mo", tmp_path / f"{name}.fmu", platforms=(this_platform(),))
    (tmp_path / "system.yaml").write_text(
        """run: {master: gauss-seidel, step_size: 10 ms, stop_time: 4 s}
instances:
  carriage: {fmu: Carriage.fmu, start: {mass: 2 kg, friction: 0 N.s/m}}
  strut: {fmu: Strut.fmu, start: {stiffness: 80 N/m, damping: 2 N.s/m}}
  motor: {fmu: LinearMotor.fmu, start: {force_per_voltage: 1 N/V, voltage: 0 V}}
connections:
  - carriage.position -> strut.travel
  - carriage.velocity -> strut.rate
  - {from: [motor.force, {port: strut.force, gain: -1}], to: carriage.force}
""",
        encoding="utf-8",
    )
    held = given(tmp_path / "system.yaml")
    try:
        own, law = oscillator(), ("coulomb", "carriage.force", "input", "carriage.velocity", [-0.4, 0.01])
        drive = Drive(np.sin(5.0 * np.arange(200) * 0.01)[:, None], False, 0.01)
        size = np.array([0.01, 0.1])
        made = [
            one.simulate(drive, p, one.start, [named(one, *law)], size)  # type: ignore[list-item]
            for one, p in ((held, held.nominal), (own, own.nominal))
        ]
        at = [one.states.index("carriage.position") for one in (held, own)]
        assert held.external == ["motor.voltage"] and "strut.stiffness" in held.parameters
        assert np.allclose(made[0][:, at[0]], made[1][:, at[1]], atol=1e-6 * np.ptp(made[1][:, at[1]]))
    finally:
        held.close()


def verdict(law: str, family: str, place: str, signal: str, probability: float) -> dict[str, object]:
    numbers = {"factor": {"value": 1.0}}
    named_law = {"law": law, "family": family, "place": place, "acts_on": "input", "signal": signal}
    return {
        "verdict": "law", "laws": [{**named_law, "numbers": numbers}], "probability": probability,
        "held_out": {"closed": 0.9, "remains_over_noise": 1.1}, "seconds": 2.0, "processor_seconds": 1.0,
    }  # fmt: skip


def test_scores_tell_place_law_and_family_apart() -> None:
    case = make(6, drawn, "one")
    hidden = case.truth["hidden"][0]
    right = scored(
        case.truth, verdict(hidden["law"], hidden["family"], hidden["place"], hidden["signal"], 0.9), case
    )
    assert right.right and right.place and right.law and right.family and not right.spurious
    other = scored(case.truth, verdict("offset", "offset", hidden["place"], hidden["signal"], 0.9), case)
    assert other.place and not other.law and not other.family and not other.right
    away = scored(case.truth, verdict(hidden["law"], hidden["family"], "nowhere.x", "nowhere.x", 0.9), case)
    assert not away.place and not away.law and not away.right
    failed = scored(case.truth, {"error": "ConfigError: it"}, case)
    assert failed.verdict == "error" and not failed.right
    rows = [
        {"seed": 6, "title": "t", "kind": "one", "clear": True, **one.data_of()}
        for one in (right, other, failed)
    ]
    found = summary(rows)
    assert found["figures"]["law"] == pytest.approx(1 / 3, abs=1e-3) and found["counts"]["failed"] == 1
    assert len(found["wrong"]) == 2 and "offset" in summary_text(found)


def test_calibration_error_is_that_of_its_definition() -> None:
    assert calibration_error([0.95] * 20, [True] * 19 + [False]) == pytest.approx(0.0, abs=1e-12)
    assert calibration_error([0.95] * 10 + [0.55] * 10, [True] * 10 + [False] * 10) == pytest.approx(0.3)


@pytest.mark.parametrize(
    "words", [[], ["--random", "1", "system.yaml"], ["--random", "-1"], ["--random", "1", "--count", "0"]]
)
def test_wrong_commands_are_refused(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["challenge", *words, "--out", str(tmp_path)]) == 2
    assert "orchestrator: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("law", "numbers"),
    [("quadratic drag", [-0.05]), ("Dahl friction", [-0.4, 0.3]), ("stribeck", [-0.2, 1.0, 1.0, 0.1])],
)
def test_a_law_at_an_output_of_a_state_reads_inputs(law: str, numbers: list[float]) -> None:
    """As the library names it, with its numbers: the score takes a law that does the same for the same."""
    # A drag at the torque of a winding, by the speed that it is given, is one at the rotor.
    made = Drawing("test", interval=0.01)
    rotor = made.add("rotor", "Rotor", 0.02, 0.05)
    made.add("motor", "Winding", 1.0, 0.02, 0.1, speed=(rotor, "speed", 1.0))
    made.wire("rotor.torque", ("motor", "torque", 1.0))
    made.driven["motor.voltage"] = 0.0, 1.0
    plant, drive = Drawn(made), Drive(5.0 * np.sin(np.arange(200) * 0.05)[:, None], False, 0.01)
    found = [
        plant.simulate(drive, plant.nominal, plant.start, [one] if one else [], np.ones(3))[:, 1]
        for one in (
            named(plant, law, "motor.torque", "output", "motor.speed", numbers),
            named(plant, law, "rotor.torque", "input", "rotor.speed", numbers),
            None,
        )
    ]
    assert np.allclose(found[0], found[1], atol=1e-6) and np.abs(found[0] - found[2]).max() > 0.1


def test_a_lag_and_a_delay_begin_at_their_signal() -> None:
    plant = oscillator()
    drive = Drive(np.full((50, 1), 5.0), False, 0.01)
    steady = np.array([5.0 / 80.0, 0.0])
    for name, numbers in (("lag", [0.05]), ("delay", [0.03])):
        index = plant.inputs.index("motor.voltage")
        law = named(plant, name, "motor.voltage", "input", "motor.voltage", numbers)
        assert law is not None and law.index == index
        found = plant.simulate(drive, plant.nominal, steady, [law], np.array([0.01, 0.1]))
        assert np.abs(found[:, 0] - steady[0]).max() < 1e-6


@pytest.mark.parametrize(("seed", "law"), [(207, "saturation"), (227, "overflow")])
def test_laws_with_thresholds_are_found_where_signals_do_not_pass_zero(
    seed: int, law: str, tmp_path: Path
) -> None:
    """A valve's command and a tank's level, whose means are many times their spread."""
    pytest.importorskip("casadi")
    check(Order(tmp_path, [seed]), 1)
    score = json.loads((tmp_path / f"case-{seed}" / "score.json").read_text(encoding="utf-8"))
    assert [one.split(" at ")[0] for one in score["hidden"]] == [law]
    assert score["right"] and score["closed"] > 0.99, score["said"]
