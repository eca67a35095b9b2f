"""The bundled docking lab is the rig that a diagnosis replays, with and without effects."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import yaml
from rigs import study as own_study

from orchestrator.config import load_config
from orchestrator.diagnosis.rig.augmented import augmented_config
from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.finding import Augmented, Candidate, Finding
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.simulation.run import prepare, run

# The robot's delay holds the first command before the start, where the rig's robot is moving already.
SETTLED, TICKS = 50, 700
SIGNALS = (
    "satellite.position",
    "satellite.velocity",
    "robot.position",
    "sensor.measured_force",
    "controller.force",
    "controller.stiffness_estimate",
)
NONE = Augmented({}, (), np.zeros(0))


def ticked(result, name, step):
    return result.results[name][:: round(1e-3 / step)][:TICKS]


def of_rig(model=NONE, substeps=200):
    """The rig's channels, shape (8, TICKS)."""
    rig = RigModel(own_study(runs=((279.07, 0.02),), ticks=TICKS), own_study(ticks=TICKS).runs[:1], substeps)
    return rig.closed_loop(0, model.calibrated, model.effects, model.theta)


@pytest.fixture(scope="module")
def nominal():
    return of_rig()


def distance(result, rig, step):
    """Largest differences after SETTLED ticks, relative to the largest size of each signal, by signal."""
    found = {}
    for name, channel in zip(SIGNALS, rig, strict=False):
        size = np.abs(channel).max()
        found[name] = float(np.abs(ticked(result, name, step) - channel)[SETTLED:].max() / size)
    return found


def lab(step, *overrides):
    """Run docking-lab; the sensor's delay makes up for half a step of hold."""
    reported = [
        f"run.step_size={step!r} s",
        f"run.stop_time={TICKS} ms",
        f"sensor.tau_s={1e-3 + step / 2!r} s",
    ]
    return run("docking-lab", overrides=[*reported, *overrides], halving=False)


def test_the_co_simulation_converges_to_the_rig(nominal):
    errors = [distance(lab(step), nominal, step) for step in (5e-4, 2.5e-4, 1e-4)]
    assert np.abs(nominal[3]).max() > 100.0, "a contact is in it"
    for coarse, fine in pairwise(errors):
        assert coarse["satellite.position"] > 3.0 * fine["satellite.position"], "second order"
        assert coarse["robot.position"] > 3.0 * fine["robot.position"], "second order"
    assert errors[-1]["satellite.position"] < 2e-5
    # The damping's jump at the onset falls anywhere in a step.
    assert max(errors[-1].values()) < 1e-3


def finding(model, ids, parameters=None):
    candidate = Candidate(tuple(ids), 1.0, parameters or {}, (), 50.0, model)
    return Finding((candidate,), tuple(ids), (), "", tuple(ids), NONE)


def test_several_effects_and_calibrated_numbers(tmp_path):
    names = ("sensor.bias", "sensor.gain", "dynamics.mass", "contact.hertz")
    effects = tuple(catalogue()[name] for name in names)
    theta = np.concatenate(
        [[1.5], [0.1], [0.1], [one.starts[0] if one.starts else 0.1 for one in effects[3].parameters]]
    )
    numbers = {"natural_frequency": 480.0, "damping_ratio": 0.75, "force_bias": 0.25}
    model = Augmented(numbers, effects, theta)
    made = augmented_config(own_study(ticks=TICKS), finding(model, names))
    assert made.left_out == {}
    data = loaded(made.text, tmp_path)
    assert data["instances"]["robot"]["start"]["omega_n"] == "480.0 rad/s"
    assert data["instances"]["satellite"]["start"]["mass"] == f"{279.07 * 1.1!r} kg"
    assert data["instances"]["contact"]["fmu"] == "LabContact"
    assert data["instances"]["contact"]["start"]["hertz_exponent"] == 0.2
    assert "natural frequency: 480 instead of 471.239 rad/s" in made.changed
    assert "damping ratio: 0.75 instead of 0.8" in made.changed
    assert "contact: hertz_exponent 0.2, hertz_depth 0.0005 m" in made.changed
    (reading,) = [one for one in data["connections"] if "sensor.measured_force" in str(one)]
    assert reading["through"] == [{"offset": "1.75 N"}, {"gain": 1.1}], "the bias first, as in the rig"


def loaded(text, folder):
    """The config, whose system loads without problems."""
    path = folder / "augmented.yaml"
    path.write_text(text)
    config = load_config(path)
    assert len(prepare(config).system.instances) == 5
    return config.model.to_data()


def test_an_fmu_that_only_gives_more_is_reported(tmp_path):
    inertia = catalogue()["sensor.tool-inertia"]
    made = augmented_config(
        own_study(ticks=TICKS), finding(Augmented({}, (inertia,), np.array([0.4])), (inertia.id,))
    )
    assert loaded(made.text, tmp_path)["instances"]["robot"]["fmu"] == "LabRobot"
    assert "robot: LabRobot, which gives what the effects read" in made.changed


def test_what_statistics_know_and_what_nobody_knows(tmp_path):
    study = own_study(ticks=TICKS)
    made = augmented_config(study, finding(None, ("sensor.quantisation",), {"sensor.quantisation.step": 2.0}))
    assert {"from": "sensor.measured_force", "to": "controller.measured_force",
            "through": [{"quantise": "2.0 N"}]} in yaml.safe_load(made.text)["connections"]  # fmt: skip
    loaded(made.text, tmp_path)
    made = augmented_config(study, replace(finding(None, ("outside",)), outside_place="robot"))
    assert made.left_out == {"outside": "the catalogue has no law for it"}
    made = augmented_config(study, finding(None, ("sensor.dropout",)))
    assert made.left_out == {"sensor.dropout": "no parameters of it were fitted"}
    assert re.search(r"^extends: docking-lab$", made.text, re.M)


def test_a_number_that_no_fmu_takes_is_reported(tmp_path):
    model = Augmented({}, (catalogue()["contact.damping"],), np.array([-130.0]))
    made = augmented_config(own_study(ticks=TICKS), finding(model, ("contact.damping",)))
    assert made.left_out == {"contact_damping": "-30 was found, and the FMUs take none below 0; 0 is written"}
    loaded(made.text, tmp_path)
