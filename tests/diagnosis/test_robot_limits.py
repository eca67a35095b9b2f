"""Limits of the servo, and commands that are lost one by one: found from what runs show."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from orchestrator.diagnosis.rig.calibration import calibration
from orchestrator.diagnosis.rig.catalogue import catalogue, of_hardware
from orchestrator.diagnosis.rig.challenge.draw import Plan
from orchestrator.diagnosis.rig.challenge.hidden import HIDDEN, Hidden
from orchestrator.diagnosis.rig.effects.robot_command_quantisation import propose
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.hardware import _sensed, weigh_rig
from orchestrator.diagnosis.rig.link_effects import Arrivals
from orchestrator.diagnosis.rig.lost_commands import Losses, _regular, lost_commands
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.nuisance import Weighing
from orchestrator.diagnosis.rig.random_arrivals import random_arrival
from orchestrator.diagnosis.rig.residual_evidence import ResidualEvidence, own_error
from orchestrator.diagnosis.rig.search import counted, search
from orchestrator.diagnosis.rig.study import Role
from tests.benchmarks.rig_calibration.simulated_cases import simulated_case, simulated_study
from tests.diagnosis.rigs import study

_RIVALS = ("robot.bandwidth", "robot.damping", "robot.delay", "link.clock-skew", "robot.friction")


def fitter_of(own):
    model = RigModel(own, own.of(Role.TRAIN))
    known = [catalogue()[one] for one in _RIVALS]
    return model, Weighing.of(model, known, calibration().roughness).fitter()


def hiding(name, size, seed=6, number=3):
    plan = Plan("single", (HIDDEN[name],), size)
    case = simulated_case(seed, number, plan=plan)
    return simulated_study(seed, number, plan=plan)[0], case.values


@pytest.mark.parametrize(
    ("name", "size", "number", "knob", "near"),
    [
        ("robot.rate-limit", 0.4, 4, "rate_limit", 1e-3),
        ("robot.rate-limit", 0.6, 3, "rate_limit", 1e-3),
        ("robot.rate-limit", 1.0, 3, "rate_limit", 1e-3),
        ("robot.acceleration-limit", 0.1, 5, "acceleration_limit", 0.25),
        ("robot.acceleration-limit", 0.3, 3, "acceleration_limit", 0.15),
    ],
)
def test_a_limit_is_found_wherever_it_lies(name, size, number, knob, near):
    own, values = hiding(name, size, number=number)
    _, fitter = fitter_of(own)
    found = search(fitter, [catalogue()[one] for one in (name, *_RIVALS)], longest=1)
    best = found.best
    assert [one.id for one in best.effects] == [name] and found.gain(best) > 10.0
    assert best.theta[0] == pytest.approx(values[knob], rel=near)


def test_roughness_is_larger_where_a_limit_leads_the_rig():
    """Deep in the frames the force deviates farther by a contact's roughness than without the limit."""
    own, values = hiding("robot.acceleration-limit", 0.6)
    model = RigModel(own, own.of(Role.TRAIN))
    weighing = Weighing.of(model, [catalogue()["contact.cubic"]], calibration().roughness)
    limit = (catalogue()["robot.acceleration-limit"],)
    begin = weighing.fitter().normalised({}, limit, np.array([values["acceleration_limit"]]))
    fit = weighing.fitter().fit(limit, None, begin[-1:])
    usual, there = (np.linalg.norm(one.roughness()) for one in (weighing, weighing.linearised_about(fit)))
    assert there > 3.0 * usual > 0.0


def test_what_halved_sub_steps_change_of_a_limited_servo_is_its_own_error():
    """One that runs into its limit again and again goes another way in finer steps, and none else does."""

    def reported(name, *left):
        own, _ = hiding(name, 1.0)
        model = RigModel(own, own.of(Role.TRAIN))
        weighing = Weighing.of(model, [catalogue()["contact.cubic"]], calibration().roughness)
        fitter = weighing.fitter()
        fit = search(fitter, [catalogue()[name]], longest=1).best
        return [own_error(weighing, fitter, fit, one) for one in left]

    astray, bounded = reported("robot.acceleration-limit", 1e9, 1e3)
    assert 1e4 < astray < 1e9
    assert bounded == 1e3  # no more than is left
    (followed,) = reported("robot.rate-limit", 1e9)
    assert followed < 5.0


def test_what_contacts_do_that_are_elsewhere_is_no_noise_of_the_force():
    """Of a servo at its limit the model without effects has the contacts wrong, and so what is flight."""
    pair = tuple(HIDDEN[name] for name in ("robot.backlash", "robot.rate-limit"))
    own, _ = simulated_study(6, 4, plan=Plan("pair", pair, 0.95))
    model = RigModel(own, own.of(Role.TRAIN))
    weighing = Weighing.of(model, of_hardware(), calibration().roughness)
    first = _sensed(weighing, ())
    assert first.coloured > 3.0
    group = weigh_rig(own)
    best = max(group.answers, key=lambda one: one.gain)
    assert best.effects == tuple(one.id for one in pair) and best.nonrandom == 0.0
    assert calibration().probabilities(group.answers, group.outside)[-1] < 0.3


def losses_of(name, size):
    own, values = hiding(name, size)
    return *losses_in(own), values


def losses_in(own):
    model, fitter = fitter_of(own)
    fit = fitter.fit(())
    left = fitter.marginal.left(fit.residuals)[0::2]
    return lost_commands(model, fit, left), random_arrival(model, fit, left)[0]


def test_few_lost_commands_tell_for_themselves():
    found, arrival, values = losses_of("link.packet-loss", 0.06)
    assert found.log_evidence > max(15.0, 2.0 * arrival)
    assert found.chance == pytest.approx(values["loss"], rel=0.5)


@pytest.mark.parametrize(
    ("name", "size"), [("link.jitter", 0.3), ("robot.friction", 0.3), ("robot.delay", 0.01)]
)
def test_what_else_moves_the_robot_is_no_loss(name, size):
    found, arrival, _ = losses_of(name, size)
    assert found.log_evidence < max(5.0, 1.5 * arrival)


@pytest.mark.parametrize(("share", "ticks"), [(0.005, 4), (0.02, 2), (0.08, 6)])
def test_commands_that_come_after_newer_ones_are_neither_lost_nor_late(share, ticks):
    def drawn(rng, size):
        return {"reorder": share, "reorder_ticks": float(ticks)}

    plan = Plan("single", (Hidden("link.out-of-order", drawn, chance=True),), 1.0)
    found, arrival = losses_in(simulated_study(6, 3, plan=plan)[0])
    assert Arrivals(arrival, 0.0, 0.0, [], found).regular > 20.0


def test_wrong_commands_are_neither_lost_nor_late():
    def drawn(rng, size):
        return {"corrupt": 6e-5, "corrupt_rate": 15.0}

    plan = Plan("single", (Hidden("link.wrong-commands", drawn, chance=True),), 1.0)
    found, arrival = losses_in(simulated_study(6, 3, plan=plan)[0])
    assert Arrivals(arrival, 0.0, 0.0, [], found).regular > 20.0


@pytest.mark.parametrize(
    ("name", "size"), [("link.packet-loss", 0.06), ("link.packet-loss", 0.9), ("link.jitter", 0.6)]
)
def test_what_is_lost_or_late_at_random_is_in_order(name, size):
    found, arrival, _ = losses_of(name, size)
    assert Arrivals(arrival, 0.0, 0.0, [], found).regular < 3.0


def test_a_rig_that_loses_few_commands_is_relieved_of_them():
    own, values = hiding("link.packet-loss", 0.06)
    group = weigh_rig(own)
    best = max((one for one in group.answers if not one.unseen), key=lambda one: one.gain)
    assert best.effects == ("link.packet-loss",) and best.left < 12.0
    assert best.noises[0].theta[0] == pytest.approx(values["loss"], rel=0.5)


def test_losses_that_keep_a_period_are_not_by_chance():
    rng = np.random.default_rng(1)
    everywhere, moving = np.ones(3000), (np.arange(3000) % 500 < 300).astype(float)
    even = [np.arange(first, 3000, 150) + rng.integers(0, 4, 20) for first in (20, 90, 140)]
    missed = [one[rng.random(20) < 0.6] for one in even]
    chance = [np.sort(rng.choice(3000, 40, replace=False)) for _ in range(3)]
    # Losses show while the robot moves, and it moves in turns.
    shown = [one[moving[one] > 0.0] for one in chance]
    assert _regular(even, [everywhere] * 3) > _regular(missed, [everywhere] * 3) > 30.0
    assert _regular(chance, [everywhere] * 3) < 3.0 and _regular(shown, [moving] * 3) < 3.0
    assert _regular(shown, [everywhere] * 3) > 5.0
    assert _regular([one[:2] for one in even], [everywhere] * 3) == 0.0


def test_losses_too_few_for_chance_are_reported_by_their_period():
    def reported(by_chance, period, arrivals=0.0):
        return Arrivals(arrivals, 0.0, 0.0, [], Losses(by_chance, 0.01, (), (), period)).periodic

    assert reported(12.0, 9.0) == 21.0
    assert (
        reported(30.0, 0.0)
        == reported(3.0, 9.0)
        == reported(-4.0, 0.0)
        == reported(12.0, 9.0, arrivals=6.0)
        == 0.0
    )
    assert Arrivals(0.0, 0.0, 0.0, []).periodic == 0.0


def test_a_wide_step_of_commands_is_proposed_beside_a_resonance():
    """A hundredth of it from its phase it hardly explains anything, and a fifth of it seemed likelier."""
    plan = Plan("pair", (HIDDEN["robot.command-quantisation"], HIDDEN["robot.resonance"]), 0.7)
    case = simulated_case(11, 1, plan=plan)
    own = simulated_study(11, 1, plan=plan)[0]
    model = RigModel(own, own.of(Role.TRAIN))
    fit = search(Weighing.of(model, [], {}).fitter(), [catalogue()["robot.resonance"]], longest=1).best
    (step, phase), _ = propose(model.seen(fit.calibrated, fit.effects, fit.theta))
    assert step == pytest.approx(case.values["command_step"], rel=5e-6)
    assert step * phase == pytest.approx(case.values["command_phase"], rel=0.2)


@pytest.mark.parametrize(("seed", "number"), [(6, 4), (7, 3), (7, 4)])
def test_a_servo_drawn_to_the_encoder_shows_its_limit_without_detours(seed, number):
    """Replayed from its begin alone, one at its limit goes far astray whatever the limit is taken to be."""
    own, values = hiding("robot.acceleration-limit", 1.0, seed, number)
    model, limit = RigModel(own, own.of(Role.TRAIN)), (catalogue()["robot.acceleration-limit"],)
    factors = (0.94, 0.96, 0.98, 1.0, 1.02, 1.04, 1.06)

    def strayed(by):
        tried = [np.array([values["acceleration_limit"] * one]) for one in factors]
        return [float(np.mean(np.square(by.residuals({}, limit, one)[0::2]))) for one in tried]

    free, drawn = strayed(model), strayed(model.followed())
    assert min(free) > 100.0
    assert drawn[3] == min(drawn) < 2.0
    assert drawn[:4] == sorted(drawn[:4], reverse=True) and drawn[3:] == sorted(drawn[3:])
    assert strayed(model) == free  # the model itself stays as it is


@pytest.mark.parametrize(
    ("names", "size", "seed", "number"),
    [
        (("link.sample-and-hold", "robot.acceleration-limit"), 0.6, 6, 5),
        (("robot.acceleration-limit",), 1.0, 7, 4),
    ],
)
def test_a_deep_limit_leaves_little(names, size, seed, number):
    plan = Plan("pair" if len(names) > 1 else "single", tuple(HIDDEN[one] for one in names), size)
    own, _ = simulated_study(seed, number, plan=plan)
    with threadpool_limits(limits=1, user_api="blas"):
        group = weigh_rig(own)
    probable = calibration().probabilities(group.answers, group.outside)
    best = group.answers[int(np.argmax(probable[:-1]))]
    assert tuple(sorted(best.effects)) == names and probable.max() > 0.6
    # Of runs that no fit saw it leaves more, since its limit is known only as well as the others tell.
    assert (
        ResidualEvidence(*best.parts[: len(ResidualEvidence._fields)]).total < 20.0
        and best.left < 0.01 * best.gain
    )


def test_a_whole_number_is_found_though_the_calibration_took_up_another():
    hold = catalogue()["link.sample-and-hold"]
    own = study((hold,), (6.0,))
    model = RigModel(own, own.runs)
    fitter = Fitter(model)
    astray = fitter.fit((hold,), None, np.array([2.0 / hold.parameters[0].scale]))
    assert round(astray.theta[0]) == 2 and astray.deviation["response_delay"] > 10.0
    found = counted(fitter, astray, len(model.tolerances), np.inf)
    assert round(found.theta[0]) == 6 and abs(found.deviation["response_delay"]) < 0.1
    assert counted(fitter, found, len(model.tolerances), np.inf) is found
