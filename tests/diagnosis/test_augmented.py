"""Every effect of the catalogue, written as a config and co-simulated, is that of the rig's model."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rigs import study as own_study

from orchestrator.diagnosis.rig.augmented import augmented_config
from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.config_changes import SEED
from orchestrator.diagnosis.rig.effect import Context, Effect, Site, law
from orchestrator.diagnosis.rig.finding import Augmented, Candidate, Finding
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.effects.draws import normal, uniform
from orchestrator.simulation.run import run

TICKS, STEPS = 600, 5
# RobotResponse's delay holds the first command before the start, where the rig's robot is moving already.
SETTLED = 50
SIGNALS = ("satellite.position", "robot.position", "controller.force")
CHANNELS = (0, 2, 4)
NONE = Augmented({}, (), np.zeros(0))
# A size that shows, by id.
SIZES = {
    "contact.adhesion": (3.0, 4e-5),
    "contact.asymmetry": (0.1,),
    "contact.cubic": (0.3,),
    "contact.damping": (150.0,),
    "contact.friction": (0.06, 6e-4),
    "contact.hertz": (0.3, 5e-4),
    "contact.hunt-crossley": (1.5e5,),
    "contact.plasticity": (0.08,),
    "contact.second-contact": (0.5, 4e-4),
    "contact.softening": (0.1,),
    "contact.stiffness": (-0.2,),
    "contact.viscoelastic": (0.3, 0.02),
    "contact.wall-offset": (2e-4,),
    "controller.lead": (1e-3,),
    "controller.stiffness-gain": (0.2,),
    "dynamics.appendage": (0.1, 25.0),
    "dynamics.cable": (500.0,),
    "dynamics.drag": (60.0,),
    "dynamics.mass": (0.1,),
    "dynamics.mass-offset": (0.4,),
    "dynamics.residual-gravity": (5e-3,),
    "dynamics.slosh": (0.1, 6.0),
    "link.clock-skew": (1e-3,),
    "link.jitter": (8e-4,),
    "link.packet-loss": (0.1,),
    "link.sample-and-hold": (4.0,),
    "robot.acceleration-limit": (0.3,),
    "robot.backlash": (2e-4,),
    "robot.bandwidth": (-0.3,),
    "robot.command-quantisation": (5e-5, 0.3),
    "robot.damping": (0.3,),
    "robot.delay": (1.3e-3,),
    "robot.friction": (1.0, 0.5),
    "robot.load-sensitivity": (0.02,),
    "robot.rate-limit": (0.015,),
    "robot.resonance": (0.3, 100.0),
    "sensor.bias": (1.5,),
    "sensor.coloured-noise": (2.0,),
    "sensor.delay": (5e-4,),
    "sensor.drift": (2.0,),
    "sensor.dropout": (0.15,),
    "sensor.gain": (0.1,),
    "sensor.low-pass": (1e-3,),
    "sensor.quantisation": (2.0,),
    "sensor.tool-inertia": (6.0,),
    "structure.compliance": (1e-6,),
    "structure.kinematic-scale": (0.02,),
    "structure.offset": (2e-4,),
}
_TICK = int(Context.TICK)


# Relative errors beyond those of the step: one step of rounding more or less, as it goes around the loop.
ROUNDED = {"sensor.quantisation": (1e-3, 1e-3, 0.03), "robot.command-quantisation": (1e-4, 5e-3, 0.01)}


# Laws of the effects that draw, for draws that are known: those of the config. theta holds one for each tick.


@law
def _added(time, step, value, context, memory, theta):
    return value + theta[int(context[_TICK])]


@law
def _rounded(time, step, value, context, memory, theta):
    return theta[0] * math.floor(value / theta[0] + 0.5)


@law
def _lost(time, step, value, context, memory, theta):
    tick = int(context[_TICK])
    if tick < 0 or theta[tick] == 0.0:
        memory[0] = value
    return memory[0]


@law
def _late(time, step, value, context, memory, theta):
    return value + theta[max(math.floor((time - 0.5 * step - value) / 1e-3), 0)]


def drawn(name, size):
    """The effect that a seed makes of one that draws, and its numbers; None for others."""
    ticks = range(TICKS)
    draws = np.array([uniform(float(SEED), 0.0, 0.0, tick) for tick in ticks])
    if name == "sensor.quantisation":
        site, apply, theta = Site.SAMPLE, _rounded, np.array([size])
    elif name == "sensor.dropout":
        site, apply, theta = Site.SAMPLE, _lost, (draws < size).astype(float)
        theta[0] = 0.0
    elif name == "link.packet-loss":
        site, apply, theta = Site.COMMAND, _lost, (draws < size).astype(float)
    elif name == "link.jitter":
        site, apply, theta = Site.DELAY, _late, size * draws
    elif name == "sensor.coloured-noise":
        site, apply, theta = Site.SAMPLE, _added, np.zeros(TICKS)
        for tick in ticks:
            fresh, kept = normal(float(SEED), 0.0, 0.0, tick), theta[tick - 1] if tick else 0.0
            theta[tick] = fresh if tick == 0 else 0.9 * kept + math.sqrt(1.0 - 0.9**2) * fresh
        theta *= size
        theta[0] = 0.0  # the controller's first sample is that of the first tick's end
    else:
        return None
    return Augmented({}, (Effect("test." + name, "", "", (), site, apply, 1),), theta)


def of_rig(model):
    """The rig's channels, shape (3, TICKS), in sub-steps of 5 us."""
    study = own_study(runs=((279.07, 0.02),), ticks=TICKS)
    rig = RigModel(study, study.runs, 200)
    out = rig.closed_loop(0, model.calibrated, model.effects, model.theta)
    return out[list(CHANNELS)]


@pytest.fixture(scope="module")
def nominal():
    return of_rig(NONE)


def co_simulated(names, steps, folder):
    """The same signals of the config with some effects, at so many communication steps per tick."""
    effects, sizes = tuple(catalogue()[name] for name in names), [SIZES[name] for name in names]
    reported = {
        f"{effect.id}.{one.name}": value
        for effect, own in zip(effects, sizes, strict=True)
        for one, value in zip(effect.parameters, own, strict=True)
    }
    drawn = any(effect.statistic for effect in effects)
    model = None if drawn else Augmented({}, effects, np.concatenate(sizes))
    found = Finding((Candidate(names, 1.0, reported, (), 50.0, model),), names, (), "", names, NONE)
    made = augmented_config(own_study(runs=((279.07, 0.02),), ticks=TICKS), found, steps)
    assert made.left_out == {} and made.run == "train-1" and made.changed
    path = folder / f"augmented-{steps}.yaml"
    path.write_text(made.text)
    results = run(path, halving=False).results
    return np.array([results[signal][::steps][:TICKS] for signal in SIGNALS])


def test_every_effect_is_tried():
    assert set(SIZES) == set(catalogue())
    for one in catalogue().values():
        assert (one.written is None) == bool(one.changes), "told in one place"


@pytest.mark.parametrize("name", SIZES)
def test_the_config_converges_to_the_rig(name, nominal, tmp_path):
    rig = of_rig(drawn(name, SIZES[name][0]) or Augmented({}, (catalogue()[name],), np.array(SIZES[name])))
    coarse, fine = (co_simulated((name,), steps, tmp_path) for steps in (STEPS, 2 * STEPS))
    size = np.abs(rig).max(axis=1)
    moved, error, change = (
        np.abs(one)[:, SETTLED:].max(axis=1) / size for one in (rig - nominal, fine - rig, coarse - fine)
    )
    # Of first order at least: what is left is what halving the step changed. The damping's jump at the onset
    # falls anywhere in a step, of either.
    floor = np.array([5e-5, 5e-5, 1.5e-3]) + ROUNDED.get(name, (0.0, 0.0, 0.0))
    assert (error < 2.0 * change + floor).all(), (error, change)
    assert (error < 0.25 * moved).any() and moved.max() > 1e-3, "the effect shows, and is met"


def test_laws_of_a_contact_act_on_each_other_in_the_config_as_in_the_rig(tmp_path):
    """Each by itself would be right in many ways: friction of a mount's force is that of all springs."""
    names = ("contact.asymmetry", "contact.friction", "contact.plasticity", "structure.compliance")
    effects = tuple(catalogue()[name] for name in names)
    sizes = [SIZES[name] for name in names]
    rig = of_rig(Augmented({}, effects, np.concatenate(sizes)))
    alone = sum(
        of_rig(Augmented({}, (effect,), np.array(own))) - of_rig(NONE)
        for effect, own in zip(effects, sizes, strict=True)
    )
    coarse, fine = (co_simulated(names, steps, tmp_path) for steps in (STEPS, 2 * STEPS))
    size = np.abs(rig).max(axis=1)
    error, change, together = (
        np.abs(one)[:, SETTLED:].max(axis=1) / size
        for one in (fine - rig, coarse - fine, rig - of_rig(NONE) - alone)
    )
    assert (error < 2.0 * change + [5e-5, 5e-5, 1.5e-3]).all(), (error, change)
    assert (together > 3.0 * error).any(), (together, error)
