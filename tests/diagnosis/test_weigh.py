"""Which effect causes the gap: on runs of our own model, and on a few labelled cases."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from orchestrator.diagnosis.rig.answers import Answer, Group, weigh_software
from orchestrator.diagnosis.rig.calibration import Calibration, calibration
from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.challenge.draw import Plan
from orchestrator.diagnosis.rig.challenge.hidden import HIDDEN
from orchestrator.diagnosis.rig.coloured_noise import WHITE, coloured, small_colour, whitened
from orchestrator.diagnosis.rig.hardware import weigh_rig
from orchestrator.diagnosis.rig.misfit import narrow_band_line, unexplained
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.stochastic import sensor_noise
from orchestrator.diagnosis.rig.study import Study, load_study
from orchestrator.diagnosis.rig.weigh import conclude, weigh
from tests.benchmarks.rig_calibration.learning import WeighedCase, learn, loss
from tests.benchmarks.rig_calibration.simulated_cases import simulated_study
from tests.diagnosis.rigs import study

GAP = Path(__file__).parents[3] / "shared" / "gap"
needs_gap = pytest.mark.skipif(not GAP.is_dir(), reason="the labelled cases are not beside the checkout")


def with_columns(own: Study, change) -> Study:
    """The study with columns of its runs changed by `change(run, rng) -> columns`."""
    runs = []
    for number, run in enumerate(own.runs):
        columns = dict(run.columns) | change(run, np.random.default_rng(number))
        runs.append(replace(run, columns=columns))
    return replace(own, runs=tuple(runs))


def noisy(run, rng) -> dict:
    """Noise and rounding as the lab specifies them."""
    n = len(run)
    return {
        "encoder_position": np.round(run["encoder_position"] + 2e-6 * rng.standard_normal(n), 6),
        "sensor_force": np.round(run["sensor_force"] + 0.5 * rng.standard_normal(n), 1),
    }


def own_study(effects=(), theta=()) -> Study:
    return with_columns(study([catalogue()[one] for one in effects], theta), noisy)


def named(own: Study):
    """What the rig's hardware alone is found to hide."""
    return conclude([weigh_rig(own)], calibration())


def test_a_rig_as_its_lab_believes_hides_nothing():
    found = named(own_study())
    assert found.effects == () and found.places == () and not found.doubtful_tolerances
    assert sum(one.probability for one in found.candidates) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("effect", "theta"),
    [("contact.hertz", [0.4, 5e-4]), ("robot.backlash", [2.5e-4]), ("sensor.bias", [2.0])],
)
def test_an_effect_is_named(effect, theta):
    found = named(own_study([effect], theta))
    assert found.effects == (effect,) and found.places == (effect.partition(".")[0],)
    parameter = catalogue()[effect].parameters[0].name
    assert found.candidates[0].parameters[f"{effect}.{parameter}"] == pytest.approx(theta[0], rel=0.25)


def test_two_effects_are_named():
    found = named(own_study(["contact.hertz", "robot.delay"], [0.4, 5e-4, 0.003]))
    assert set(found.effects) == {"contact.hertz", "robot.delay"}


def test_effects_that_cannot_be_distinguished_are_ties():
    found = named(own_study(["sensor.gain"], [0.2]))
    first = found.candidates[0]
    assert {"sensor.gain", "contact.stiffness"} <= {*first.effects, *first.ties}


def test_effects_that_explain_less_than_none_are_no_ties_of_a_faint_one():
    seen = [
        one for one in weigh_rig(own_study(["sensor.gain"], [0.03])).answers if one.seen and not one.unseen
    ]
    assert [one.effects for one in seen] == [("sensor.gain",)]
    assert 0.0 < seen[0].gain < 1.0 and seen[0].ties == ()


def lose_samples(run, rng) -> dict:
    force = noisy(run, rng)["sensor_force"].copy()
    for n in range(1, len(force)):
        if rng.random() < 0.15:
            force[n] = force[n - 1]
    return noisy(run, rng) | {"sensor_force": force}


def colour(run, rng) -> dict:
    columns = noisy(run, rng)
    n = np.zeros(len(run))
    for i in range(1, len(n)):
        n[i] = 0.95 * n[i - 1] + 2.0 * np.sqrt(1 - 0.95**2) * rng.standard_normal()
    return columns | {"sensor_force": np.round(columns["sensor_force"] + n, 1)}


def coarsen(run, rng) -> dict:
    columns = noisy(run, rng)
    return columns | {"sensor_force": 1.5 * np.round(columns["sensor_force"] / 1.5)}


@pytest.mark.parametrize(
    ("change", "effect"),
    [
        (lose_samples, "sensor.dropout"),
        (colour, "sensor.coloured-noise"),
        (coarsen, "sensor.quantisation"),
    ],
)
def test_a_stochastic_effect_of_the_sensor_is_named(change, effect):
    assert named(with_columns(study(), change)).effects == (effect,)


def test_coloured_noise_is_named_beside_a_coarse_resolution():
    def both(run, rng) -> dict:
        columns = colour(run, rng)
        return columns | {"sensor_force": 1.5 * np.round(columns["sensor_force"] / 1.5)}

    found = named(with_columns(study(), both))
    assert set(found.effects) == {"sensor.coloured-noise", "sensor.quantisation"}


def test_what_roughness_explains_is_no_evidence_of_coloured_noise():
    def stain(run, rng) -> dict:
        fresh = np.sqrt(1.0 - 0.9**2) * 0.25 * rng.standard_normal(len(run))
        columns = noisy(run, rng)
        return columns | {"sensor_force": columns["sensor_force"] + lfilter([1.0], [1.0, -0.9], fresh)}

    own = with_columns(study(), stain)
    model = RigModel(own, own.runs)
    left = model.residuals({}, (), np.zeros(0))[1::2]
    apart = [np.zeros(len(run), bool) for run in own.runs]
    (noise,) = sensor_noise(model, left, apart).noises
    parts = [model.noise[1] * r[20:] for r in left]
    evidence, deviation, _ = coloured(parts, model.noise[1])
    assert noise.id == "sensor.coloured-noise" and deviation == pytest.approx(0.25, rel=0.3)
    assert 0.0 < noise.log_evidence < 0.5 * evidence


def test_lost_commands_are_named():
    own = study()

    def lose(run, rng) -> dict:
        sent = run["desired_position"].copy()
        for n in range(1, len(sent)):
            if rng.random() < 0.1:
                sent[n] = sent[n - 1]
        seen = replace(run, columns=dict(run.columns) | {"desired_position": sent})
        out = RigModel(replace(own, runs=(seen,)), [seen]).replay(0, {})
        return noisy(
            replace(run, columns=dict(run.columns) | {"encoder_position": out[2], "sensor_force": out[3]}),
            rng,
        )

    assert named(with_columns(own, lose)).effects == ("link.packet-loss",)


def test_hum_is_outside_the_catalogue():
    def humming(run, rng) -> dict:
        columns = noisy(run, rng)
        wave = 4.0 * np.sin(2 * np.pi * 50.0 * run["time"] + 0.3)
        return columns | {"sensor_force": np.round(columns["sensor_force"] + wave, 1)}

    found = named(with_columns(study(), humming))
    assert found.effects == ("outside",) and found.outside_place == "sensor"


def test_what_comes_back_along_the_way_is_the_robots_though_it_comes_back_in_time():
    def cogging(run, rng) -> dict:
        columns = noisy(run, rng)
        wave = 3e-5 * np.sin(2 * np.pi * run["encoder_position"] / 1.3e-3)
        return columns | {"encoder_position": np.round(columns["encoder_position"] + wave, 6)}

    found = named(with_columns(study(), cogging))
    assert found.effects == ("outside",) and found.outside_place == "robot"


def strayed(own: Study) -> Study:
    """The study with three numbers of different kinds off by three tolerances."""
    strays = {"front_wall": 3.2, "natural_frequency": 3.0, "force_bias": 3.0}
    return replace(
        own,
        nominal={
            name: replace(one, value=one.value + strays.get(name, 0.0) * one.tolerance)
            for name, one in own.nominal.items()
        },
    )


def test_tolerances_too_tight_are_doubted_and_no_effect_is_named():
    found = named(strayed(with_columns(study(), noisy)))
    assert found.doubtful_tolerances and found.effects == ()


@pytest.mark.parametrize(("effect", "size"), [("robot.backlash", 1e-4), ("contact.cubic", 0.1)])
def test_tolerances_too_tight_are_doubted_beside_an_effect(effect, size):
    """Instead of a second effect, which wider tolerances would do as well as."""
    own = own_study([effect], [size])
    found = named(strayed(own))
    assert found.effects == (effect,) and found.doubtful_tolerances
    assert found.candidates[0].probability > 0.75
    sound = named(own)
    assert sound.effects == (effect,) and not sound.doubtful_tolerances


def test_tolerances_are_doubted_beside_an_effect_of_the_software():
    found = strayed(with_columns(study(), noisy))
    nothing = weigh_rig(found)
    fit = nothing.none
    mass = Group((Answer((), 0.0, 0.0, fit), Answer(("dynamics.mass",), 1e5, 0.0, fit)), 0.0, "dynamics", fit)
    concluded = conclude([mass, nothing], calibration())
    assert concluded.effects == ("dynamics.mass",) and concluded.doubtful_tolerances


def test_software_that_replays_exactly_hides_nothing():
    own = study()
    for place in ("dynamics", "controller"):
        group = weigh_software(own, place)
        assert [one.effects for one in group.answers] == [()] and group.outside == 0.0


def test_software_effects_are_found_exactly_with_their_ties():
    def rounded(run, rng) -> dict:
        digits = {"desired_position": 9, "desired_velocity": 9, "compensated_force": 4}
        return {name: np.round(run[name], places) for name, places in digits.items()}

    group = weigh_software(with_columns(study([catalogue()["dynamics.mass"]], [-0.04]), rounded), "dynamics")
    best = group.answers[1]
    assert {*best.effects, *best.ties} == {"dynamics.mass", "dynamics.mass-offset"}


def test_weighing_is_deterministic():
    own = own_study(["contact.friction"], [0.05, 1e-3])
    one, other = named(own), named(own)
    assert [(c.effects, c.probability) for c in one.candidates] == [
        (c.effects, c.probability) for c in other.candidates
    ]


def test_misfit_ignores_white_noise_and_sees_structure():
    white = np.random.default_rng(1).standard_normal(6000)
    slow = 0.5 * np.sin(np.arange(6000) / 80.0)
    assert unexplained([white]) < 8.0
    assert unexplained([white + slow]) > 100.0
    humming = white + np.sin(2 * np.pi * 0.05 * np.arange(6000))
    line, frequency = narrow_band_line([humming], [[slice(0, 3000), slice(3000, 6000)]])
    assert line > 500.0 and frequency == pytest.approx(0.05, abs=1e-3)
    assert narrow_band_line([white], [[slice(0, 6000)]])[0] < 5.0
    # Samples that say nothing, as lost ones, are left out: they neither make nor hide a line.
    gone = np.random.default_rng(2).random(len(white)) < 0.3
    shifted = np.where(gone, 0.0, humming + 2.0)
    assert narrow_band_line([shifted], [[slice(0, 3000), slice(3000, 6000)]])[0] == pytest.approx(
        0.7 * line, rel=0.15
    )
    assert narrow_band_line([np.zeros(6000)], [[slice(0, 6000)]]) == (0.0, 0.0)


def test_a_faint_line_that_keeps_its_phase_is_found_through_short_windows():
    rng = np.random.default_rng(4)
    runs = [rng.standard_normal(3000) for _ in range(3)]
    windows = [[slice(a, a + 250) for a in range(0, 3000, 300)]] * 3
    assert narrow_band_line(runs, windows)[0] < 5.0
    line = [0.25 * np.sin(2 * np.pi * 0.05 * np.arange(3000) + phase) for phase in (0.2, 1.9, 4.0)]
    found, frequency = narrow_band_line([r + one for r, one in zip(runs, line, strict=True)], windows)
    assert found > 20.0 and frequency == pytest.approx(0.05, abs=2e-4)
    slow = np.repeat([1.0, -1.0] * 5, 300)
    assert narrow_band_line([r + slow for r in runs], windows)[0] < 5.0


def test_a_little_coloured_noise_is_no_misfit_and_hides_none():
    rng = np.random.default_rng(2)
    white = rng.standard_normal(9000)
    assert small_colour([white]) == WHITE
    fresh = np.sqrt(1.0 - 0.92**2) * 0.25 * rng.standard_normal(9000)
    noise = white + lfilter([1.0], [1.0, -0.92], fresh)
    colour = small_colour([noise[:5000], noise[5000:]])
    assert colour.log_likelihood > 20.0
    assert colour.deviation == pytest.approx(0.25, abs=0.06) and 0.86 < colour.keep < 0.96
    assert unexplained([noise]) > 20.0
    assert unexplained(whitened([noise], colour)) < 5.0
    bump = np.where((np.arange(9000) // 150) % 3 == 0, 0.6, 0.0)
    assert unexplained(whitened([noise + bump], colour)) > 50.0


def test_probabilities_add_up_and_grow_with_evidence():
    learned = calibration()
    before = -1.0
    for gain in (0.0, 5.0, 10.0, 40.0):
        answers = [Answer((), 0.0, 0.0), Answer(("contact.hertz",), gain, 0.0)]
        p = learned.probabilities(answers, 0.0)
        assert p.sum() == pytest.approx(1.0) and p[1] > before
        before = p[1]
    assert before > 0.9
    calm, odd = (
        learned.probabilities([Answer((), 0.0, left), Answer(("contact.hertz",), 40.0, left)], 0.0)[-1]
        for left in (0.0, 1e5)
    )
    assert odd > calm


def test_learning_makes_the_truth_more_probable():
    rng = np.random.default_rng(3)
    cases = []
    for number in range(60):
        strong = 30.0 * rng.random() if number % 2 else 0.0
        # Evidence that overstates itself threefold.
        answers = (Answer((), 0.0, 0.0), Answer(("a.b",), 3.0 * strong + 9.0 * rng.standard_normal(), 0.0))
        cases.append(WeighedCase(("a.b",) if number % 2 else (), strong, answers, 0.0))
    assert loss(learn(cases), cases) < loss(Calibration(), cases) - 0.05


@needs_gap
@pytest.mark.parametrize("case", ["case-057", "case-062", "case-009", "case-016", "case-008", "case-056"])
def test_labelled_cases(case):
    truth = json.loads((GAP / "cases" / "truth.json").read_text())[case]
    found = weigh(load_study(GAP / "cases" / case))
    right = tuple(truth["effects"]) or (("outside",) if truth["outside"] else ())
    assert found.effects == right or set(right) <= set(found.candidates[0].ties)
    assert set(found.places) == set(truth["places"])


@pytest.mark.parametrize("size", [0.1, 0.17])
def test_a_search_that_began_astray_comes_to_the_pair_and_its_like(size):
    plan = Plan("pair", (HIDDEN["dynamics.drag"], HIDDEN["dynamics.mass"]), size)
    own, _ = simulated_study(61, 4, plan=plan)
    best = weigh_software(own, "dynamics").answers[1]
    # A flexible appendage looked best alone; beside drag and mass it has nothing to do.
    assert sorted(best.effects) == ["dynamics.drag", "dynamics.mass"]
    assert "dynamics.mass-offset" in best.ties
