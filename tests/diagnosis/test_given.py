"""What a lab hands over: what is wrong with it is reported before anything is blamed on the rig."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import pytest
import yaml
from logged import logged_study, with_column, write_case

from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.diagnosis.rig.challenge.verdict import read_verdict
from orchestrator.diagnosis.rig.checks import check_logs
from orchestrator.diagnosis.rig.effect import Parameter
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.servo import pulse_response
from orchestrator.diagnosis.rig.study import Role, load_study
from orchestrator.diagnosis.study.mapping import Column
from tests.diagnosis.rigs import NOMINAL


@pytest.fixture(scope="module")
def logged():
    return logged_study(ticks=1200)


@pytest.fixture
def case(logged, tmp_path):
    """A case folder, and its content to be changed; `said` gives what is refused."""
    folder = write_case(logged, tmp_path / "case")
    path = folder / "case.yaml"

    class Case:
        data = yaml.safe_load(path.read_text())

        def said(self) -> str:
            path.write_text(yaml.safe_dump(self.data))
            with pytest.raises(ConfigError) as caught:
                load_study(folder)
            return str(caught.value)

    found = Case()
    found.folder = folder
    return found


def test_all_mistakes_of_a_case_are_reported_at_once(case):
    data = case.data
    data["experimentss"] = []
    data["nominal"]["front_wall"] |= {"value": -0.01}
    data["nominal"]["natural_frequency"] |= {"value": 0.0}
    data["nominal"]["response_delay"] |= {"value": -0.002}
    data["nominal"]["sensor_delay"] |= {"tolerance": -1e-5}
    data["nominal"]["contact_damping"] |= {"tolerence": 5}
    data["nominal"]["contact_stiffness"] |= {"unit": "furlong"}
    data["nominal"]["force_bias"] |= {"value": float("nan")}
    data["nominal"]["damping_ratio"] = 0.8
    data["nominal"]["encoder_noise"] |= {"value": 0.0}
    data["nominal"]["encoder_resolution"] |= {"value": 0.0}
    data["runs"][0]["speed"] = data["runs"][0].pop("approach_speed")
    data["runs"][1]["approach_speed"] = 0.0
    data["runs"][2]["role"] = "held-out"
    data["runs"][3]["mass"] = "404,49"
    said = case.said()
    for part in (
        "case.yaml:1: experimentss: unknown",
        "Did you mean experiments?",
        "front_wall at -0.01 m is not before rear_wall",
        "nominal.natural_frequency.value: got 0.0",
        "nominal.response_delay.value: got -0.002",
        "nominal.sensor_delay.tolerance: got -1e-05",
        "nominal.contact_damping.tolerence: unknown",
        "Did you mean tolerance?",
        "nominal.contact_stiffness.unit",
        "nominal.force_bias: got",
        "nominal.damping_ratio: got 0.8",
        "encoder_noise and encoder_resolution are 0",
        "runs[0].speed: unknown",
        "runs[0]: approach_speed is missing",
        "runs[1].approach_speed: got 0.0",
        "runs[2].role: got 'held-out'",
        "runs[3].mass: got '404,49'",
    ):
        assert part in said, part


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"nominal": [1, 2]}, "nominal: got [1, 2]"),
        ({"runs": 3}, "runs: got 3"),
        ({"runs": [1]}, "runs[0]: got 1"),
        ({"tick": "1 ms"}, "tick: got '1 ms'"),
        ({"format": "gap-case/9"}, "port-study/1"),
    ],
    ids=str,
)
def test_what_has_another_form_is_reported_as_such(case, change, said):
    case.data |= change
    assert said in case.said()


def test_a_log_is_no_study(case):
    with pytest.raises(ConfigError, match="is no text"):
        load_study(case.folder / "train-1.csv.gz")


def test_runs_of_one_name_are_refused(case):
    (case.folder / "train-1.x.csv.gz").write_bytes((case.folder / "train-1.csv.gz").read_bytes())
    case.data["runs"].append(case.data["runs"][0] | {"file": "train-1.x.csv.gz"})
    assert "another run is called train-1, too" in case.said()


def test_logs_stand_where_a_lab_keeps_them(case):
    """In folders by day, elsewhere, or as links, as data versioning leaves them."""
    runs = case.data["runs"]
    apart = case.folder.parent / "archive"
    for where in (case.folder / "monday", case.folder / "tuesday", apart):
        where.mkdir()
    files = [case.folder / one["file"] for one in runs[:3]]
    files[0].rename(case.folder / "monday" / "run.csv.gz")
    files[1].rename(case.folder / "tuesday" / "run.csv.gz")
    files[2].rename(apart / "run.csv.gz")
    (case.folder / "linked.csv.gz").symlink_to(apart / "run.csv.gz")
    for one, file in zip(runs, ("monday/run.csv.gz", "tuesday/run.csv.gz", "linked.csv.gz"), strict=False):
        one["file"] = file
    (case.folder / "case.yaml").write_text(yaml.safe_dump(case.data))
    names = [one.name for one in load_study(case.folder).runs]
    assert names[:3] == ["monday/run", "tuesday/run", "linked"]
    runs[2]["file"] = "../archive/run.csv.gz"
    (case.folder / "case.yaml").write_text(yaml.safe_dump(case.data))
    assert load_study(case.folder).runs[2].name == "../archive/run"
    runs[0]["file"] = "monday/rnu.csv.gz"
    assert "runs[0].file: no file rnu.csv.gz in " in case.said()
    assert "Did you mean run.csv.gz?" in case.said()


def test_logs_without_rows_words_and_other_separators(case):
    path = case.folder / "train-1.csv.gz"
    text = gzip.decompress(path.read_bytes()).decode()
    header, first, *rest = text.splitlines()
    path.write_bytes(gzip.compress(text.replace(",", ";").encode()))
    assert len(load_study(case.folder).runs[0]) == 1200
    path.write_bytes(gzip.compress((header + "\n").encode()))
    assert "train-1.csv.gz: holds a header, and no rows below it" in case.said()
    cells = rest[5].split(",")
    rest[5] = ",".join([*cells[:4], "lost", *cells[5:]])
    path.write_bytes(gzip.compress("\n".join([header, first, *rest]).encode()))
    said = case.said()
    assert "train-1.csv.gz:8: sensor_force: row 6 of column sensor_force holds 'lost'" in said
    assert "a number; 1 such in all. Correct the log there.\n" in said + "\n" and "no column" not in said
    path.write_bytes(gzip.compress(text.replace("sensor_force [N]", "sensor_force").encode()))
    assert "Write `sensor_force [N]` in its header" in case.said()


def test_the_same_log_in_two_roles_is_refused(logged):
    copied = replace(logged.runs[2], columns=logged.runs[0].columns, mass=279.07, approach_speed=0.02)
    refused, _ = check_logs(replace(logged, runs=(*logged.runs[:2], copied)))
    assert [one.place for one in refused] == ["runs"]
    assert refused[0].what.startswith("train-1 and heldout-1 hold the same log")


def test_a_run_with_another_mass_than_stated_is_reported():
    own = logged_study(ticks=1200)
    more = [replace(run, name=f"{run.name}-again") for run in logged_study(ticks=1200, seed=2).runs[:2]]
    runs = [*own.runs, *more]
    assert check_logs(replace(own, runs=tuple(runs)))[0] == []
    runs[1] = replace(runs[1], mass=440.49)
    refused, _ = check_logs(replace(own, runs=tuple(runs)))
    assert [one.place for one in refused] == ["train-2: mass"]
    assert "moves as with 404.49 kg" in refused[0].what
    # What is off in all runs is for effects to tell.
    heavier = tuple(replace(run, mass=1.1 * run.mass) for run in (*own.runs, *more))
    assert check_logs(replace(own, runs=heavier))[0] == []


def test_a_wrong_number_of_the_study_is_not_blamed_on_the_log(logged):
    stiff = replace(logged.nominal["contact_stiffness"], value=1.76e8)
    (refused,), _ = check_logs(replace(logged, nominal=logged.nominal | {"contact_stiffness": stiff}))
    assert refused.place == "train-1: nominal.contact_stiffness" and "3 more runs" in refused.what
    assert "176000 N/m" in refused.remedy
    fast = replace(logged.runs[0], approach_speed=20.0)
    (refused,), _ = check_logs(replace(logged, runs=(fast, *logged.runs[1:])))
    assert refused.place == "train-1: approach_speed" and "0.02 m/s" in refused.remedy
    (refused,), _ = check_logs(with_column(logged, "sensor_force", np.negative))
    assert "sign: -1" in refused.remedy and "header" not in refused.remedy


def test_a_sign_or_unit_that_a_rig_study_gives_is_to_be_corrected_there(logged):
    turned = with_column(logged, "sensor_force", np.negative)
    given = {"sensor_force": Column(column="fx", sign=-1)}
    (refused,), _ = check_logs(replace(turned, mapping=given))
    assert refused.remedy.endswith("The study file says `sign: -1`: take that out.")
    large = with_column(logged, "sensor_force", lambda force: 1e3 * force)
    given = {"sensor_force": Column(column="fx", unit="kN")}
    (refused,), _ = check_logs(replace(large, mapping=given))
    assert refused.remedy.endswith("The study file says `unit: kN`: correct that.")


def test_one_case_that_trips_does_not_stop_the_others(logged, tmp_path, monkeypatch, capsys):
    from orchestrator.diagnosis.rig import diagnose as module

    seen = []

    def diagnose(case, *arguments, **options):
        seen.append(case.name)
        raise RuntimeError("a defect")

    monkeypatch.setattr(module, "diagnose", diagnose)
    cases = [str(write_case(logged, tmp_path / name)) for name in ("one", "two")]
    assert main(["diagnose", *cases, "--quiet"]) == 1
    assert seen == ["one", "two"] and "one: RuntimeError: a defect" in capsys.readouterr().err


def test_a_fit_that_runs_away_says_so_and_starts_are_counted(logged):
    model = RigModel(logged, logged.of(Role.TRAIN))

    class Diverges:
        tolerances = model.tolerances

        def residuals(self, calibrated, effects, theta):
            return [np.full(len(one), np.inf) for one in model.residuals(calibrated, effects, theta)]

        seen = model.seen

    fit = Fitter(Diverges()).fit(())
    assert fit.cost == np.inf and fit.log_evidence == -np.inf and not fit.z.any()
    with pytest.raises(ValueError, match="1 parameters to begin from, 0 to fit"):
        Fitter(model).fit((), start=np.zeros(1))


def test_parameters_of_effects_are_checked():
    with pytest.raises(ValueError, match="a shape needs one above 0"):
        Parameter("a", "1", 1.0, shape=True)
    with pytest.raises(ValueError, match="a whole number needs finite"):
        Parameter("a", "1", 1.0, whole=True)


@pytest.mark.parametrize("xi", [0.4, 0.8, 1.0, 1.2, 2.0, 6.0])
def test_a_servo_answers_a_pulse_whatever_its_damping(xi):
    omega, tick, ticks = NOMINAL["natural_frequency"].value, 0.001, 60
    found = pulse_response((omega, xi, 0.0), tick, ticks)
    # The same by small steps of x'' = omega^2 (u - x) - 2 xi omega x'.
    fine, x, v, seen = 4000, 0.0, 0.0, []
    step = tick / fine
    for number in range(ticks):
        for _ in range(fine):
            v += step * (omega**2 * ((number == 0) - x) - 2.0 * xi * omega * v)
            x += step * v
        seen.append(x)
    assert found == pytest.approx(seen, abs=2e-3 * max(seen))


def test_probabilities_that_are_no_numbers_are_refused(tmp_path):
    path = tmp_path / "diagnosis.json"
    path.write_text(
        '{"verdict": {"effects": [], "places": []},'
        ' "which": [{"effects": [], "probability": NaN, "ties": []}]}'
    )
    with pytest.raises(ConfigError, match="add up to nan"):
        read_verdict(path)
