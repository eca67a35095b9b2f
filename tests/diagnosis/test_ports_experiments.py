"""Which effects of any system tie, and what to run next to distinguish them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ports_bench import POSITION, TIED, VELOCITY, VOLTAGE, answer, study

from orchestrator.base.errors import ConfigError
from orchestrator.diagnosis.answers import Answer
from orchestrator.diagnosis.expected_evidence import laplace
from orchestrator.diagnosis.finding import NOMINAL, Augmented, Candidate, Finding
from orchestrator.diagnosis.ports.candidates import candidates
from orchestrator.diagnosis.ports.experiments import (
    _expected,
    next_experiment,
    no_experiment,
    predicted,
    sensors,
)
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay, Weighted, measure
from orchestrator.diagnosis.ports.study import Role
from orchestrator.diagnosis.ports.ties import alike


def weighted(found):
    """A fitter of the train runs of a study, as if residuals were white."""
    from orchestrator.diagnosis.fit import Fitter

    replay = PortReplay(found, found.of(Role.TRAIN))
    return Fitter(Weighted(replay, [1.0] * len(replay.compared(replay.runs[0]))))


def test_a_gain_and_the_parameter_that_it_equals_are_tied(tmp_path):
    path = study(tmp_path, candidates={"only": TIED["only"], "parameters": TIED["parameters"]})
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
