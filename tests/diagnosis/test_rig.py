"""The rig's model replays its own logs exactly, and effects of size zero change no bit of it."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.effect import Site
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.software import ControllerReplay, DynamicsReplay
from orchestrator.diagnosis.rig.study import Role, load_study
from tests.diagnosis.rigs import study

GAP = Path(__file__).parents[3] / "shared" / "gap"
needs_gap = pytest.mark.skipif(not GAP.is_dir(), reason="the labelled cases are not beside the checkout")


def test_the_model_replays_its_own_log_to_the_bit():
    own = study()
    model = RigModel(own, own.runs)
    for index, run in enumerate(own.runs):
        out = model.replay(index, {})
        assert np.array_equal(out[2], run["encoder_position"])
        assert np.array_equal(out[3], run["sensor_force"])
        assert np.abs(run["sensor_force"]).max() > 50.0


def test_software_replays_its_own_log():
    own = study()
    for replay in (DynamicsReplay(own, own.runs), ControllerReplay(own, own.runs)):
        worst = max(np.abs(part).max() for part in replay.residuals({}, (), np.zeros(0)))
        assert worst < 1.0  # of the log's last digit


LAWS = [one for one in catalogue().values() if one.site not in (None, Site.BODY)]


@pytest.mark.parametrize("effect", LAWS, ids=lambda one: one.id)
def test_an_effect_of_size_zero_changes_no_bit(effect):
    if effect.parameters[0].shape or effect.parameters[0].whole:
        pytest.skip("its first parameter is no size: it has no zero")
    own = study(ticks=600)
    model = RigModel(own, own.runs)
    theta = np.array([one.starts[0] if one.shape else 0.0 for one in effect.parameters])
    for index in range(len(own.runs)):
        assert np.array_equal(model.replay(index, {}, (effect,), theta), model.replay(index, {}))


@pytest.mark.parametrize("effect", LAWS, ids=lambda one: one.id)
def test_an_effect_of_prior_size_shows(effect):
    own = study(ticks=1500)
    model = RigModel(own, own.runs)
    fitter = Fitter(model)
    z = np.concatenate([np.zeros(len(model.tolerances)), fitter.starts(effect)[0]])
    if effect.id == "robot.rate-limit":
        assert len(fitter.starts(effect)) > 1
    shown = sum(float(part @ part) for part in fitter.residuals((effect,), z))
    assert shown > 1.0


@pytest.mark.parametrize(
    "names",
    [
        ("contact.asymmetry", "contact.plasticity"),
        ("contact.friction", "contact.hertz"),
        ("contact.softening", "structure.compliance"),
    ],
)
def test_laws_of_a_contact_act_in_their_own_order(names):
    own = study(ticks=1200)
    model = RigModel(own, own.runs)
    ahead, back = (tuple(catalogue()[name] for name in order) for order in (names, names[::-1]))
    sizes = {name: [one.starts[0] if one.starts else one.scale for one in catalogue()[name].parameters]
             for name in names}  # fmt: skip
    plain, other = (
        model.replay(0, {}, effects, np.concatenate([sizes[one.id] for one in effects]))
        for effects in (ahead, back)
    )
    assert np.array_equal(plain, other)


def test_a_softer_frame_is_softer_for_all_laws():
    own = study(ticks=1200)
    model = RigModel(own, own.runs)
    laws = catalogue()["contact.plasticity"], catalogue()["structure.compliance"]
    theta = np.array([0.08, 1e-6])
    softer = {"contact_stiffness": 0.9 * own.nominal["contact_stiffness"].value}
    front = model.replay(0, {}, (*laws, catalogue()["contact.asymmetry"]), np.append(theta, 0.1))
    both = model.replay(0, softer, laws, theta)
    first = slice(0, int(np.argmax(front[7] < own.nominal["rear_wall"].value)) or 1200)
    assert np.abs(both[6][first]).max() > 50.0
    assert front[6][first] == pytest.approx(both[6][first], rel=1e-9, abs=1e-9)


def test_adhesion_pulls_only_while_the_surfaces_part():
    own = study()
    model = RigModel(own, own.runs[:1])
    calibrated = {"contact_damping": 0.0}
    plain = model.replay(0, calibrated)
    pulled = model.replay(0, calibrated, (catalogue()["contact.adhesion"],), np.array([3.0, 4e-5]))
    touching = np.flatnonzero(np.abs(plain[7]) > 0.005)
    first = touching[: int(np.argmax(np.diff(touching) > 1)) + 1]  # at the front frame
    deepest = first[0] + int(np.argmax(plain[7][first]))
    change = (pulled - plain)[6]
    assert np.abs(change[:deepest]).max() < 1e-6
    after = slice(deepest, first[-1] + 20)
    assert change[after].max() == pytest.approx(3.0, rel=0.1)  # towards the frame
    assert abs(deepest + int(np.argmax(change[after])) - first[-1]) <= 2
    assert abs(change[first[-1] + 19]) < 0.01


@needs_gap
@pytest.mark.parametrize("case", [f"case-{number:03d}" for number in range(1, 63)])
def test_software_of_the_labelled_cases_is_exact_unless_it_is_the_cause(case):
    truth = json.loads((GAP / "cases" / "truth.json").read_text())[case]
    one = load_study(GAP / "cases" / case)
    for replay, place in ((DynamicsReplay, "dynamics"), (ControllerReplay, "controller")):
        parts = replay(one, one.of(Role.TRAIN)).residuals({}, (), np.zeros(0))
        square = np.mean([np.mean(part**2) for part in parts])
        assert (square < 3.0) == (place not in truth["places"]), (place, square)


def test_bad_cases_are_refused_with_all_their_problems(tmp_path):
    (tmp_path / "case.yaml").write_text(
        "format: gap-case/1\ntick: 0.001\nnominal: {stiffness: {value: 1, unit: N/m}}\n"
        "runs: [{file: a.csv.gz, role: train, mass: -1, approach_speed: 0.02}, {file: b.csv, role: other}]\n"
    )
    with pytest.raises(ConfigError) as caught:
        load_study(tmp_path)
    text = str(caught.value)
    assert "nominal.stiffness: unknown" in text and "contact_stiffness is missing" in text
    assert "runs[0].mass: got -1.0" in text and "runs[1]" in text


def test_a_column_in_a_wrong_unit_is_refused(tmp_path):
    header = "time [s],sensor_force [m],nonsense\n0,1,2\n"
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(header.encode()))
    (tmp_path / "case.yaml").write_text(
        "format: gap-case/1\ntick: 0.001\nnominal: {}\n"
        "runs: [{file: a.csv.gz, role: train, mass: 1, approach_speed: 0.02}]\n"
    )
    with pytest.raises(ConfigError) as caught:
        load_study(tmp_path)
    assert "cannot be converted" in str(caught.value) and "nonsense" in str(caught.value)


@pytest.mark.parametrize("name", ["sensor_delay", "response_delay"])
def test_what_is_still_to_come_acts_on_nothing(name):
    """Fits try delays below zero; they replay, open loop and closed, as none does."""
    own = study(ticks=600)
    model = RigModel(own, own.runs)
    for run in (model.replay, model.closed_loop):
        none = run(0, {name: 0.0})
        assert np.array_equal(run(0, {name: -2e-4}), none)
        assert 0.0 < np.abs(run(0, {name: 1e-6}) - none)[3].max() < 1.0  # N


def test_a_sensor_may_be_late_by_any_time():
    own = study(ticks=1500)
    model = RigModel(own, own.runs)
    at_once, late = (model.replay(0, {"sensor_delay": delay})[3] for delay in (0.0, 0.9))
    assert np.abs(at_once).max() > 50.0
    assert np.allclose(late[900:], at_once[:600]) and not late[:900].any()
