"""Fits reach what the true parameters allow; bounds and the inflation of evidence."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.effect import Effect, Parameter
from orchestrator.diagnosis.rig.effects.robot_command_quantisation import propose as propose_steps
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.marginal import inflation
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.random_arrivals import random_arrival
from orchestrator.diagnosis.rig.rig import HISTORY
from orchestrator.diagnosis.rig.search import roughness, search
from orchestrator.diagnosis.rig.software import DynamicsReplay
from tests.diagnosis.labs import lab
from tests.diagnosis.rigs import NOMINAL


class Line:
    """A replay whose residuals are linear in its calibrated numbers, and draw them to `target`."""

    def __init__(self, target):
        self.target = target

    @property
    def tolerances(self):
        return {"stiffness": (100.0, 5.0), "bias": (0.0, 1.0)}

    def residuals(self, calibrated, effects, theta):
        return [np.array([calibrated["stiffness"] - self.target, calibrated["bias"] - self.target])]


def test_a_calibrated_number_keeps_its_sign_and_one_about_zero_may_take_either():
    fit = Fitter(Line(-1e4)).fit(())
    assert fit.calibrated["stiffness"] == pytest.approx(5.0)
    assert fit.calibrated["bias"] == pytest.approx(-5e3)


class Curve:
    """A replay of friction of 60 N at any speed by a curve that falls from low speeds to high ones."""

    @property
    def tolerances(self):
        return {"bias": (0.0, 1.0)}

    def residuals(self, calibrated, effects, theta):
        level, excess, speed = theta
        ratio = np.linspace(0.0, 0.3, 50) / speed
        return [10.0 * (level * (1.0 + excess * np.exp(-(ratio**2))) - 60.0)]


@pytest.mark.parametrize(("level", "begun"), [(6.0, 0.3), (20.0, 0.3), (48.0, 0.7)])
def test_beside_a_number_at_its_bound_others_are_moved_right(level, begun):
    size = Parameter("level", "N", 120.0, 0.0, np.inf, (6.0,))
    excess = Parameter("excess", "1", 0.7, 0.0, 2.0, (0.3,), shape=True)
    speed = Parameter("speed", "m/s", 1.0, 1e-3, 0.7, (0.045,), shape=True)
    effect = Effect("law", "F", "", (size, excess, speed), changes={"force": "level"})
    fit = Fitter(Curve()).fit((effect,), None, np.array([level / 120.0, 0.0, np.log(begun / 0.045)]))
    # A constant force wants as flat a curve as the bound of the speed allows.
    assert fit.chi2 < 100.0


class Slope:
    """A replay whose residuals are linear in an effect's number."""

    @property
    def tolerances(self):
        return {}

    def residuals(self, calibrated, effects, theta):
        return [10.0 * (theta - 2.0)]


@pytest.mark.parametrize("z", [0.0, 0.5, 0.97, 0.999, 1.0])
def test_derivatives_near_a_bound_are_those_of_the_step_that_was_taken(z):
    effect = Effect("law", "F", "", (Parameter("p", "1", 1.0, 0.0, 1.0, (0.5,)),), changes={"force": "p"})
    fitter, at = Fitter(Slope()), np.array([z])
    assert fitter.jacobian((effect,), at, fitter.stacked((effect,), at), [0]) == pytest.approx(10.0)


@pytest.mark.parametrize(("target", "promised"), [(8.0, 32.0), (-8.0, 0.0)])
def test_an_effect_promises_no_more_than_it_can_keep(target, promised):
    """A size that would have to take the other sign, as a negative delay, explains nothing."""
    size = Parameter("size", "s", 1.0, 0.0, np.inf, (0.5,))
    effect = Effect("a.x", "a", "", (size,), changes={"x": "size"})
    fitter = Fitter(Sum((target, 0.0, 0.0)))
    none = fitter.fit(())
    cost, _, _ = fitter.screen(effect, [fitter.base((), none.z)])
    # Half of the square goes to the prior.
    assert none.cost - cost == pytest.approx(promised, abs=1e-6)


class Sum:
    """A replay of three numbers, each moved by one effect; `target` is what was measured, over the noise."""

    names, tolerances = ("a.x", "a.y", "a.z"), {"bias": (0.0, 1.0)}

    def __init__(self, target):
        self.target = target

    def residuals(self, calibrated, effects, theta):
        made = dict(zip((one.id for one in effects), theta, strict=True))
        return [np.array([made.get(name, 0.0) for name in self.names]) - self.target]


@pytest.mark.parametrize(
    ("target", "named"),
    [
        ((30.0, 4.0, 0.1), {"a.x", "a.y"}),  # 8 nats of the second, of which the prior takes some
        ((30.0, 1.5, 0.1), {"a.x"}),
        ((30.0, 20.0, 4.0), {"a.x", "a.y"}),  # a third one has to promise more
        ((30.0, 20.0, 8.0), {"a.x", "a.y", "a.z"}),
    ],
)
def test_a_faint_effect_is_sought_beside_one_that_is_seen(target, named):
    size = Parameter("size", "1", 20.0)
    effects = [Effect(one, "y + size", "-", (size,), changes={"bias": "size"}) for one in Sum.names]
    found = search(Fitter(Sum(np.array(target))), effects)
    assert {one.id for one in found.best.effects} == named


def searched(own, name, model=None):
    """The fit of an effect from where a search begins it, and one from its true parameters."""
    effect = catalogue()[name]
    if model is None:
        model = RigModel(own, own.runs)
        others = [one for one in catalogue().values() if one.place not in ("dynamics", "controller")]
        fitter = Fitter(model, 1.0, roughness(Fitter(model), others))
    else:
        fitter = Fitter(model)
    count = len(fitter.replay.tolerances)
    none = fitter.fit(())
    bases = [fitter.base((), np.zeros(count)), fitter.base((), none.z)]
    _, base, start = fitter.screen(effect, bases)
    return fitter, none, fitter.fit((effect,), base.z, start, base.jacobian)


@pytest.mark.parametrize(
    ("name", "theta"),
    [
        ("structure.offset", (3e-4,)),
        ("structure.kinematic-scale", (-0.0122,)),
        ("contact.wall-offset", (-1.9e-4,)),
        ("robot.resonance", (0.3, 224.0)),
        ("robot.resonance", (0.1, 116.0)),
        ("robot.command-quantisation", (3.006e-5, -0.009)),
        ("robot.command-quantisation", (4.4e-6, 0.0)),
    ],
)
def test_a_fit_finds_what_the_true_parameters_allow(name, theta):
    own = lab([name], theta)
    fitter, none, fit = searched(own, name)
    true = fitter.fit((catalogue()[name],), None, fitter.normalised({}, fit.effects, theta)[-len(theta) :])
    assert fit.cost < true.cost + 2.0
    assert fit.cost < none.cost - 40.0


def test_an_effect_takes_over_what_a_calibrated_number_strays_by():
    """Both do the same, so that derivatives about where the number deviates promise next to nothing."""
    own = lab(["contact.wall-offset", "contact.viscoelastic"], (1.2e-4, 0.2, 0.007))
    model, (offset, relaxing) = (
        RigModel(own, own.runs),
        map(catalogue().get, ("contact.wall-offset", "contact.viscoelastic")),
    )
    fitter = Fitter(model)
    begun = fitter.starts(relaxing)[0]
    without = fitter.fit((relaxing,), start=begun)
    strayed = without.deviation["front_wall"]
    assert abs(strayed) > 5.0
    cost, base, start = fitter.screen(offset, [fitter.base((relaxing,), without.z)])
    assert cost < without.cost - 0.8 * strayed**2
    fit = fitter.fit((relaxing, offset), base.z[: len(fitter.nominal)], np.append(base.z[-2:], start))
    assert fit.theta[-1] == pytest.approx(1.2e-4, rel=0.1) and fit.cost < without.cost - 20.0


@pytest.mark.parametrize("frequency", [13.05, 28.6, 50.1])
def test_an_appendage_is_found_at_any_frequency(frequency):
    own = lab(["dynamics.appendage"], (0.08, frequency))
    _, none, fit = searched(own, "dynamics.appendage", DynamicsReplay(own, own.runs))
    assert fit.theta == pytest.approx((0.08, frequency), rel=1e-4)
    assert fit.cost < 1e-6 * none.cost


def test_a_step_is_read_from_the_runs():
    own = lab(["robot.command-quantisation"], (2.3456e-5, 0.1))
    model = RigModel(own, own.runs)
    step, phase = propose_steps(model.seen({}, (), np.zeros(0)))[0]
    assert step == pytest.approx(2.3456e-5, rel=2e-4)
    assert phase == pytest.approx(0.1, abs=0.02)


def test_inflation_is_the_time_over_which_residuals_resemble_each_other():
    rng = np.random.default_rng(5)
    white = rng.standard_normal((4, 3000))
    assert inflation(white) == pytest.approx(1.0, abs=0.15)
    for keep in (0.5, 0.9):
        coloured = np.zeros_like(white)
        for n in range(1, white.shape[1]):
            coloured[:, n] = keep * coloured[:, n - 1] + np.sqrt(1 - keep**2) * white[:, n]
        assert inflation(coloured) == pytest.approx((1 + keep) / (1 - keep), rel=0.3)
    assert inflation(2.0 * white) == pytest.approx(4.0, rel=0.15)
    assert inflation([np.zeros(100)]) == 1.0


def delayed_at_random(own, model, amount, kind):
    """How the robot deviates if each command is late by up to `amount` [s], or lost as often as that."""
    rng = np.random.default_rng(11)
    strayed = []
    omega, xi = NOMINAL["natural_frequency"].value, NOMINAL["damping_ratio"].value
    for run, commands in zip(own.runs, model.commands, strict=True):
        fine = 20
        dt = own.tick / fine
        n = len(run)
        late = np.where(kind == "jitter", amount * (rng.random(n) - 0.5), 0.0)  # its mean would be fitted
        held = np.arange(n)
        for i in range(1, n):
            if kind == "loss" and rng.random() < amount:
                held[i] = held[i - 1]
        arrives = np.maximum(np.round((np.arange(n) * own.tick + late) / dt), 0).astype(int)
        sent = np.full(n * fine, commands[HISTORY - 1])
        for i in range(n):
            sent[arrives[i] :] = commands[HISTORY + held[i]]
        plain = np.repeat(commands[HISTORY:], fine)
        x = v = 0.0
        out = np.zeros(n)
        for i, error in enumerate(sent - plain[: len(sent)]):
            if i % fine == 0:
                out[i // fine] = x
            v += dt * (omega**2 * (error - x) - 2.0 * xi * omega * v)
            x += dt * v
        delay = round(NOMINAL["response_delay"].value / own.tick)
        out = np.concatenate([np.zeros(delay), out[:-delay]])
        strayed.append(out - out[200:].mean())
    return strayed


@pytest.mark.parametrize(
    ("kind", "amount"), [("jitter", 5e-4), ("loss", 0.03), ("none", 0.0), ("wave", 1e-6)]
)
def test_commands_that_arrive_at_random_are_reported_from_slow_errors(kind, amount):
    own = lab(ticks=2000)
    model = RigModel(own, own.runs[:2])
    own = replace(own, runs=own.runs[:2])
    fit = Fitter(model).fit(())
    rng = np.random.default_rng(2)
    if kind == "wave":
        strayed = [amount * np.sin(np.arange(len(run)) * 0.06) for run in own.runs]
    else:
        strayed = delayed_at_random(own, model, amount, kind)
    left = [one / model.noise[0] + rng.standard_normal(len(one)) for one in strayed]
    evidence, deviation = random_arrival(model, fit, left)
    if kind in ("none", "wave"):
        assert evidence < 3.0
    else:
        expected = amount / np.sqrt(12.0) if kind == "jitter" else np.sqrt(amount) / (1 - amount) * own.tick
        assert evidence > 10.0
        assert deviation == pytest.approx(expected, rel=0.4)


def test_a_model_that_runs_away_warns_nobody():
    study = lab(ticks=400)
    model = RigModel(study, study.runs[:1])
    model.noise = 1e-10, 0.5  # finer than any encoder: what is left over it overflows
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        encoder, _ = model.residuals({}, (catalogue()["robot.damping"],), np.array([-3.7]))
    assert not np.isfinite(encoder).all()
