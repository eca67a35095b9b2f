"""What makes evidence honest: settling, waves of the encoder, roughness, effects too small to be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from orchestrator.diagnosis.rig import nuisance
from orchestrator.diagnosis.rig.answers import Answer, Group, complete
from orchestrator.diagnosis.rig.calibration import Calibration, calibration
from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.challenge.draw import Plan
from orchestrator.diagnosis.rig.challenge.hidden import HIDDEN
from orchestrator.diagnosis.rig.challenge.outside import OUTSIDE
from orchestrator.diagnosis.rig.coloured_noise import coloured
from orchestrator.diagnosis.rig.dropout import in_turn, lost_in_contact, piled
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.hardware import weigh_rig
from orchestrator.diagnosis.rig.link_effects import search_behind
from orchestrator.diagnosis.rig.misfit import unexplained, wave
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.nuisance import Weighing
from orchestrator.diagnosis.rig.search import directions, roughness
from orchestrator.diagnosis.rig.stochastic import sensor_noise
from orchestrator.diagnosis.rig.study import Nominal, Role
from orchestrator.diagnosis.rig.weigh import conclude
from tests.benchmarks.rig_calibration.roughness_learning import RoughnessProblem, learn_roughness
from tests.benchmarks.rig_calibration.simulated_cases import (
    ODDITIES,
    bare_study,
    simulated_case,
    simulated_study,
)
from tests.diagnosis.rigs import study
from tests.diagnosis.test_weigh import named, noisy, own_study, with_columns

_SIMPLE = Calibration(
    temperature=1.0, growth=0.0, first=4.0, second=5.0, further=8.0, outside=12.0, slope=1.0, floor=0.001
)


def test_how_a_run_begins_is_no_effect(monkeypatch):
    """A robot that is still catching up when the log begins."""

    def late(run, rng) -> dict:
        columns = noisy(run, rng)
        caught = -8e-5 * np.exp(-run["time"] / 3e-3) * (1.0 - np.exp(-run["time"] / 3e-3))
        return columns | {"encoder_position": np.round(columns["encoder_position"] + caught, 6)}

    own = with_columns(study(), late)
    assert named(own).effects == ()
    monkeypatch.setattr(nuisance, "SETTLED", 0)
    assert named(own).effects != ()


def test_a_small_wave_of_the_encoder_is_roughness_and_a_large_one_is_not():
    def waved(size):
        def change(run, rng) -> dict:
            columns = noisy(run, rng)
            along = size * np.sin(2.0 * np.pi * run["encoder_position"] / 7e-4 + 0.4)
            return columns | {"encoder_position": np.round(columns["encoder_position"] + along, 6)}

        return with_columns(study(), change)

    small, large = (weigh_rig(waved(size), rough={}) for size in (1.5e-6, 1e-5))
    assert small.answers[0].left < 30.0 and large.answers[0].left > 1000.0
    assert max(one.gain for one in small.answers) < 5.0


def test_contacts_that_begin_a_little_early_or_late_are_roughness(monkeypatch):
    own = bare_study(11, 26)  # its frames stand up to 4 micrometres elsewhere from one contact to the next
    found = weigh_rig(own).answers[0]
    monkeypatch.setattr(nuisance, "_SCATTER", 1e-12)
    plain = weigh_rig(own).answers[0]
    assert found.left < 3.0 and plain.left > 8.0


def test_a_line_that_a_strong_effect_leaves_is_not_outside():
    none, strong = Answer((), 0.0, 5e4), Answer(("a.x",), 8e4, 20.0)
    for beside, outside in ((80.0, False), (1e6, True)):
        p = Calibration(slope=1.5, outside=5.0).probabilities([none, strong], beside)
        assert (p[-1] > 0.5) == outside


def test_one_likely_answer_that_lacks_nothing_speaks_against_outside():
    """Also where another one leads by a hair."""
    none, single, pair = (
        Answer((), 0.0, 5e3),
        Answer(("a.x",), 400.0, 2e3),
        Answer(("a.x", "b.y"), 408.0, 0.0),
    )
    alone, both = (
        Calibration().probabilities(answers, 0.0) for answers in ([none, single], [none, single, pair])
    )
    assert alone[-1] > 0.8 and both[1] > both[2] > both[-1] and both[-1] < 0.1


def test_the_evidence_of_noise_is_not_held_against_what_others_add():
    none = Answer((), 0.0, 3e3)
    noise = Answer(("a.noise",), 3000.0, 0.0, random=3000.0)
    both = Answer(("a.noise", "b.x"), 3020.0, 0.0, random=3000.0)
    p = Calibration(form=1.0).probabilities([none, both, noise], 0.0)
    assert p[1] > 0.9
    # Of a law another effect mends some of what its form lacks: there as much is nothing.
    laws = [replace(one, random=0.0, left=60.0) for one in (none, both, noise)]
    assert Calibration(form=1.0).probabilities(laws, 0.0)[1] < 0.1


def test_a_second_effect_counts_by_what_the_first_usually_leaves():
    none = Answer((), 0.0, 1e5)
    # What both leave bounds what the first one's form may lack.
    for leaves, left, believed in ((1e-5, 2.0, True), (1e-2, 400.0, False), (1e-2, 2.0, True)):
        learned = Calibration(form=1.0, leaves={"a.x": leaves})
        alone, both = Answer(("a.x",), 1e5, left + 200.0), Answer(("a.x", "b.y"), 1e5 + 200.0, left)
        p = learned.probabilities([none, alone, both], 0.0)
        assert (p[2] > 0.9) == believed and (p[1] > p[2]) != believed


def test_a_wave_is_found_by_its_pitch():
    rng = np.random.default_rng(5)
    positions = [0.006 * np.sin(np.arange(3000) / 150.0 + phase) for phase in (0.0, 1.0)]
    noise = [rng.standard_normal(3000) for _ in positions]
    assert wave(noise, positions)[0] < 6.0
    r = [one + 0.5 * np.cos(2.0 * np.pi * x / 8e-4) for one, x in zip(noise, positions, strict=True)]
    gain, pitch, amplitude = wave(r, positions)
    assert (
        gain > 200.0 and pitch == pytest.approx(8e-4, rel=0.01) and amplitude == pytest.approx(0.5, abs=0.1)
    )


def test_evidence_of_autocorrelated_residuals_is_deflated():
    own = own_study(["contact.hertz"], [0.1, 5e-4])
    model = RigModel(own, own.of(Role.TRAIN))
    hertz = catalogue()["contact.hertz"]
    cubic = {"contact.cubic": (0.01,)}
    for columns in (None, roughness(Fitter(model), [catalogue()["contact.cubic"]], cubic)):
        fitter = Fitter(model, 1.0, columns)
        none, fit = fitter.fit(()), fitter.fit((hertz,), None, fitter.starts(hertz)[0])
        ones, threes = [1.0] * len(fit.residuals), [3.0] * len(fit.residuals)
        for one in (none, fit):
            assert fitter.log_evidence(one, ones) == pytest.approx(one.log_evidence, rel=1e-9)
        plain = fit.log_evidence - none.log_evidence
        deflated = fitter.log_evidence(fit, threes) - fitter.log_evidence(none, threes)
        assert 0.2 * plain < deflated < 0.5 * plain


def contacts(lost: float, clip: float = 1e9, runs: int = 3) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Forces of runs that hit a frame five times each, and when they do."""
    rng = np.random.default_rng(5)
    forces, touching = [], []
    for _ in range(runs):
        phase = np.arange(3000) % 600
        touch = phase < 60
        force = np.where(touch, 120.0 * np.sin(np.pi * phase / 60.0), 0.0) + 0.5 * rng.standard_normal(3000)
        force = np.round(np.minimum(force, clip), 1)
        for n in range(1, 3000):
            if rng.random() < lost:
                force[n] = force[n - 1]
        forces.append(force)
        touching.append(touch)
    return forces, touching


def test_lost_samples_show_where_the_force_moves():
    none = lost_in_contact(*contacts(0.0), 0.1, 0.5)
    probability, evidence = lost_in_contact(*contacts(0.03), 0.1, 0.5)
    assert none[1] == 0.0
    assert evidence > 15.0 and probability == pytest.approx(0.03, rel=0.5)


def test_a_force_that_stays_put_in_contact_only_has_lost_nothing(monkeypatch):
    own = study(ticks=3000)
    model = RigModel(own, own.of(Role.TRAIN))
    found = {}
    for name, lost, clip in (("lost", 0.05, 1e9), ("clipped", 0.0, 60.0)):
        forces, touching = contacts(lost, clip, len(model.runs))
        runs = [
            replace(run, columns={**run.columns, "sensor_force": force})
            for run, force in zip(model.runs, forces, strict=True)
        ]
        monkeypatch.setattr(model, "runs", runs)
        left = [np.random.default_rng(1).standard_normal(3000) for _ in forces]
        found[name] = sensor_noise(model, left, touching)
    assert "sensor.dropout" in {one.id for one in found["lost"].noises} and found["lost"].held == 0.0
    assert (
        "sensor.dropout" not in {one.id for one in found["clipped"].noises} and found["clipped"].held > 50.0
    )


def test_samples_that_stand_out_of_the_force_are_no_noise(monkeypatch):
    model = RigModel(study(), study().of(Role.TRAIN))
    rng = np.random.default_rng(7)
    white = [rng.standard_normal(len(run)) for run in model.runs]
    free = [np.zeros(len(run), bool) for run in model.runs]
    # One in a hundred, of five standard deviations.
    spiked = [r + 5.0 * (rng.random(len(r)) < 0.01) * rng.choice([-1.0, 1.0], len(r)) for r in white]
    found = []
    for left in (white, spiked):
        runs = [
            replace(run, columns={**run.columns, "sensor_force": model.noise[1] * r})
            for run, r in zip(model.runs, left, strict=True)
        ]
        monkeypatch.setattr(model, "runs", runs)
        found.append(sensor_noise(model, left, free).spiky)
    assert found[0] == 0.0 and found[1] > 20.0


def test_a_force_that_waves_along_the_way_is_no_noise(monkeypatch):
    model = RigModel(study(), study().of(Role.TRAIN))
    rng = np.random.default_rng(8)
    # What wanders is no wave, whatever it takes up of one.
    wanders = [0.2 * lfilter([0.3], [1.0, -0.95], rng.standard_normal(len(run))) for run in model.runs]
    found = []
    for size in (0.0, 0.25):
        left = []
        for run, slow in zip(model.runs, wanders, strict=True):
            turns = np.sin(2.0 * np.pi * run["encoder_position"] / 1.3e-3 + 0.4)
            left.append(rng.standard_normal(len(run)) + slow + size * turns)
        runs = [
            replace(run, columns={**run.columns, "sensor_force": model.noise[1] * r})
            for run, r in zip(model.runs, left, strict=True)
        ]
        monkeypatch.setattr(model, "runs", runs)
        found.append(sensor_noise(model, left, [np.zeros(len(run), bool) for run in runs]).line)
    assert found[0] < 3.0 and found[1] > 20.0


def test_roughness_that_takes_up_too_much_is_reported():
    model = RigModel(study(), study().of(Role.TRAIN))
    plain = Fitter(model)
    r = plain.residuals((), plain.nominal)
    rng = np.random.default_rng(4)
    size = sum(map(len, r))
    columns = rng.standard_normal((size, 6)) / 4.0
    fitter = Fitter(model, 1.0, columns)
    ends = np.cumsum([len(one) for one in r])[:-1]
    white = rng.standard_normal(size)
    usual, large = (np.split(white + columns @ (by * rng.standard_normal(6)), ends) for by in (1.0, 30.0))
    assert (
        fitter.marginal.roughness_evidence(usual) < 5.0 and fitter.marginal.roughness_evidence(large) > 500.0
    )
    # Nothing of it shows in what is left.
    assert unexplained(fitter.marginal.left(large)) < 10.0
    assert plain.marginal.roughness_evidence(large) == 0.0


def test_effects_too_small_to_be_seen_are_answers():
    none, seen = Answer((), 0.0, 3.0), Answer(("a.x",), 20.0, 1.0, ties=("a.y",))
    worse = Answer(("a.x", "b.y"), 18.0, 1.0)
    found = {one.effects: one for one in complete([none, seen, worse], ["a.x", "a.y", "b.y"])}
    assert set(found) == {(), ("a.x",), ("a.y",), ("b.y",), ("a.x", "a.y"), ("a.x", "b.y")}
    assert found["a.x",] is seen and found["b.y",].gain == 0.0 and found["b.y",].unseen == ("b.y",)
    # An effect that may be as small as it likes cannot make an answer worse.
    assert found["a.x", "b.y"].gain == 20.0 and found["a.x", "b.y"].unseen == ("b.y",)
    assert found["a.x", "a.y"].ties == ("a.y",)


def test_two_unseen_effects_are_no_answer_where_one_is_clear():
    none, seen = Answer((), 0.0, 3.0), Answer(("a.x",), 200.0, 1.0)
    found = {one.effects for one in complete([none, seen], ["a.x", "a.y", "b.y"])}
    assert ("a.y", "b.y") not in found and ("a.x", "b.y") in found


def test_effects_that_often_stay_unseen_are_the_more_probable_ones_to_be_there_unseen():
    learned = replace(_SIMPLE, unseen={"a.x": 0.75, "a.y": 0.25})
    answers = complete([Answer((), 0.0, 0.0)], ["a.x", "a.y"])
    p = dict(zip([one.effects for one in answers], learned.probabilities(answers, 0.0), strict=False))
    assert p["a.x",] / p["a.y",] == pytest.approx(3.0, rel=0.03)
    assert p["a.x", "a.y"] / p["a.y",] == pytest.approx(0.75 * np.exp(-learned.beside), rel=0.1)


def test_effects_of_software_and_rig_share_one_price():
    model = RigModel(study(), study().of(Role.TRAIN))
    nothing = Fitter(model).fit(())
    software = Group((Answer((), 0.0, 0.0), Answer(("dynamics.drag",), 1e6, 0.0)), 0.0, "dynamics")
    rig = Group((Answer((), 0.0, 0.0, nothing), Answer(("sensor.bias",), 5.3, 0.0)), 0.0, "sensor", nothing)
    alone = conclude([rig], _SIMPLE)
    both = conclude([software, rig], _SIMPLE)
    assert alone.effects == ("sensor.bias",) and both.effects == ("dynamics.drag",)
    assert sum(one.probability for one in both.candidates) == pytest.approx(1.0)
    second = {one.effects: one.probability for one in both.candidates}
    ratio = second["dynamics.drag", "sensor.bias"] / second["dynamics.drag",]
    assert ratio == pytest.approx(np.exp(5.3 - _SIMPLE.second), rel=0.02)
    # Chance shows in the logs of the rig as often, whatever the software hides.
    cheap = {one.effects: one for one in conclude([software, rig], replace(_SIMPLE, second=2.0)).candidates}
    ratio = cheap["dynamics.drag", "sensor.bias"].probability / cheap["dynamics.drag",].probability
    assert ratio == pytest.approx(np.exp(5.3 - _SIMPLE.first), rel=0.02)


def test_beyond_two_an_effect_costs_as_much_unseen():
    one = _SIMPLE
    assert one.price(0, 2) == one.hidden + one.beside and one.price(1, 1) == one.first + one.beside
    assert one.price(2, 1) == one.price(3) == one.first + one.second + one.further
    assert one.price(1, 2) == one.first + one.beside + one.further
    seen, unseen = np.array([0, 2, 1]), np.array([1, 0, 1])
    assert one.price(seen, unseen).tolist() == [one.price(*each) for each in zip(seen, unseen, strict=True)]


def test_beside_a_strong_effect_another_one_seldom_stays_unseen():
    learned = replace(_SIMPLE, fainter=0.8)

    def unseen_beside(size: float) -> float:
        answers = complete([Answer((), 0.0, 0.0), Answer(("a.x",), 90.0, 0.0, size=size)], ["a.x", "a.y"])
        p = dict(zip([one.effects for one in answers], learned.probabilities(answers, 0.0), strict=False))
        return p["a.x", "a.y"] / p["a.x",]

    usual, strong, weak = (unseen_beside(size) for size in (0.2, 0.4, 0.2 / 3.0))
    assert strong == pytest.approx(usual * (5.0 / 2.0) ** -0.8, rel=0.05)
    assert weak == pytest.approx(usual * (10.0 / 9.0 / 2.0) ** -0.8, rel=0.05)
    assert unseen_beside(0.0) == usual  # whose size says nothing


def test_samples_that_pile_up_at_the_end_of_the_range_are_no_noise():
    rng = np.random.default_rng(3)
    force = 150.0 * np.sin(np.arange(3000) / 60.0) + 0.5 * rng.standard_normal(3000)
    assert piled([np.round(force, 1)], 0.1, 0.5) == 0.0
    for step in (0.02, 0.001, 1e-6):
        runs = [force + 0.5 * np.random.default_rng(seed).standard_normal(3000) for seed in range(5)]
        assert piled([np.round(one / step) * step for one in runs], step, 0.5) == 0.0
    clipped = np.clip(np.round(force, 1), None, 148.0)
    assert piled([clipped], 0.1, 0.5) > 100.0 and piled([-clipped], 0.1, 0.5) > 100.0


def test_the_size_of_an_effect_is_that_of_its_prior():
    known = catalogue()
    assert known["sensor.bias"].size([-3.0]) == pytest.approx(2.0)
    assert known["contact.adhesion"].size([1.0, 1e-5]) == pytest.approx(0.5)
    assert known["robot.rate-limit"].size([0.01]) == known["link.sample-and-hold"].size([4.0]) == 0.0


def test_the_set_holds_effects_that_the_logs_do_not_exclude():
    found = named(own_study())
    assert found.effects == ()
    assert found.answer_set[0] == "none" and "contact.adhesion" in found.answer_set
    unseen = next(one for one in found.candidates if one.effects == ("contact.adhesion",))
    assert unseen.model is None and unseen.probability < 0.1


def test_the_answer_is_what_the_logs_speak_for_most():
    """One of tied effects, though none is more probable than each; but not at little more than even odds."""
    model = RigModel(study(), study().of(Role.TRAIN))
    nothing = Fitter(model).fit(())
    names = ("sensor.bias", "sensor.drift", "sensor.gain")
    bias, drift, gain = (
        Answer((one,), 3.97 - 0.01 * place, 0.0, nothing, tuple(other for other in names if other != one))
        for place, one in enumerate(names)
    )
    rig = Group((Answer((), 0.0, 0.0, nothing), bias, drift, gain), 0.0, "sensor", nothing)
    found = conclude([rig], _SIMPLE)
    assert found.candidates[0].effects == () and found.effects == ("sensor.bias",)
    assert conclude([replace(rig, answers=rig.answers[:3])], _SIMPLE).effects == ()
    stronger = [replace(one, gain=one.gain + 0.7) for one in (bias, drift)]
    assert conclude([replace(rig, answers=(rig.answers[0], *stronger))], _SIMPLE).effects == ("sensor.bias",)
    unseen = [replace(drift, effects=(one,), gain=0.0, ties=(), unseen=(one,)) for one in ("a.x", "a.y")]
    weak = Group((rig.answers[0], replace(bias, gain=5.005, ties=()), *unseen), 0.0, "sensor", nothing)
    assert conclude([weak], _SIMPLE).effects == ()  # what is too small to be seen speaks for none


def test_roughness_is_learned_where_rigs_show_it():
    rng = np.random.default_rng(2)
    problems = []
    for _ in range(60):
        jacobian = 300.0 * rng.standard_normal((40, 3))
        sizes = np.array([0.01, 0.0, 0.0]) * rng.standard_normal(3)
        r = jacobian @ sizes + rng.standard_normal(40)
        problems.append(
            RoughnessProblem(("a", "b", "c"), jacobian.T @ jacobian, -jacobian.T @ r, np.zeros(0))
        )
    learned = learn_roughness(problems)
    assert learned["a"] == (pytest.approx(0.01, rel=0.3),)
    # The least that is reckoned with moves residuals by one standard deviation.
    least = pytest.approx(1.0 / (300.0 * np.sqrt(40.0)), rel=0.1)
    assert learned["b"] == learned["c"] == (least,)


def test_roughness_has_a_size_along_each_start_of_a_shape():
    model = RigModel(study(), study().of(Role.TRAIN))
    fitter, resonance = Fitter(model), catalogue()["robot.resonance"]
    plain = [one.column for one in directions(fitter, [resonance])]
    sizes = tuple(0.001 * (1 + place) for place in range(len(plain)))
    columns = roughness(fitter, [resonance], {resonance.id: sizes})
    np.testing.assert_allclose(columns, np.column_stack(plain) * sizes)
    # Learned of other starts: as rough on the whole.
    columns = roughness(fitter, [resonance], {resonance.id: (0.003, 0.004)})
    np.testing.assert_allclose(columns, np.column_stack(plain) * 0.005 / np.sqrt(len(plain)))


def test_oddities_to_practise_on_are_none_of_the_challenges():
    assert not {one.id for one in ODDITIES} & set(OUTSIDE)
    numbers = (number for number in range(1, 60) if simulated_study(3, number)[1].kind == "outside")
    number = next(numbers)
    odd, plan = simulated_study(3, number)
    plain, _ = simulated_study(3, number, plan=replace(plan, kind="none", effects=()))
    assert plan.effects[0] in ODDITIES
    changed = [
        not np.array_equal(one[name], other[name])
        for one, other in zip(odd.runs, plain.runs, strict=True)
        for name in ("encoder_position", "sensor_force")
    ]
    assert any(changed)
    again, _ = simulated_study(3, number)
    assert all(
        np.array_equal(one[name], other[name])
        for one, other in zip(odd.runs, again.runs, strict=True)
        for name in one.columns
    )


def test_a_sensor_with_no_noise_but_its_rounding():
    def rounded(run, rng) -> dict:
        return noisy(run, rng) | {"sensor_force": np.round(run["sensor_force"], 1)}

    own = with_columns(study(), rounded)
    nominal = {**own.nominal, "force_noise": Nominal(0.0, 0.0)}
    found = weigh_rig(replace(own, nominal=nominal), rough={})
    assert found.answers[0].effects == () and max(one.gain for one in found.answers) < 5.0


def test_looking_behind_a_random_link_leaves_the_rest_as_it_was():
    """What is weighed without the link's randomness is so by the model and the weights that it had."""
    own = simulated_study(3, 5, plan=Plan("single", (HIDDEN["link.jitter"],), 0.5))[0]
    weighing = Weighing.of(RigModel(own, own.of(Role.TRAIN)), (), {})
    weights, correction = [
        [one.copy() for one in some] for some in (weighing.weights, weighing.model.correction)
    ]
    behind, _ = search_behind(weighing, (catalogue()["link.jitter"],), weighing.fitter().fit(()))
    for before, now, beyond in (
        (weights, weighing.weights, behind.weights),
        (correction, weighing.model.correction, behind.model.correction),
    ):
        assert all(map(np.array_equal, before, now)) and not any(map(np.array_equal, before, beyond))


def test_a_clear_effect_is_found_in_its_size_beside_a_random_link():
    """What it explains of the encoder is not the link's randomness, beside which it is sought."""
    plan = Plan("pair", (HIDDEN["link.jitter"], HIDDEN["link.clock-skew"]), 1.0)
    own, rig = simulated_study(77, 2, plan=plan)[0], simulated_case(77, 2, plan=plan)
    found = weigh_rig(own)
    best = max(found.answers, key=lambda one: one.gain)
    assert best.effects == ("link.clock-skew", "link.jitter")
    skew = dict(zip([one.id for one in best.fit.effects], best.fit.theta, strict=True))["link.clock-skew"]
    assert skew == pytest.approx(rig.hidden["link.clock-skew"]["skew"], rel=0.1)


def test_a_force_without_any_noise_has_none_of_a_colour():
    """As of a sensor that tells none below a threshold."""
    _, deviation, keep = coloured([np.zeros(196), np.zeros(429)], 0.5)
    assert 0.0 <= deviation < 1e-6 and 0.0 <= keep <= 1.0


def test_samples_that_are_lost_in_turn_are_not_lost_by_chance():
    rng = np.random.default_rng(5)
    sizes = (900, 700, 60, 1200)
    chance = [rng.random(n) < 0.25 for n in sizes]
    bursts = [np.repeat(rng.random(n // 6) < 0.25, 6) for n in sizes]
    assert in_turn(chance) == in_turn(bursts) == in_turn([]) == 0.0
    for cycle in (1.3, 2.0, 2.37, 3.6):  # in ticks: a sample is new where a cycle ends within the tick
        phases = rng.random(len(sizes)) * cycle
        kept = [
            np.diff(np.floor((np.arange(n) + phase) / cycle), prepend=-1.0) == 0.0
            for n, phase in zip(sizes, phases, strict=True)
        ]
        noisy = [one | (rng.random(len(one)) < 0.05) for one in kept]
        assert in_turn(kept) > 500.0 and in_turn(noisy) > 200.0, cycle


def test_a_sensor_with_a_cycle_of_its_own_is_not_one_that_loses_samples():
    odd, _ = simulated_study(77, 1, plan=Plan("outside", (OUTSIDE["sensor.own-cycle"],), 0.7))
    lost, _ = simulated_study(77, 1, plan=Plan("single", (HIDDEN["sensor.dropout"],), 0.7))
    for one, regular in ((odd, True), (lost, False)):
        group = weigh_rig(one)
        assert "sensor.dropout" in group.answers[1].effects
        assert (group.answers[1].nonrandom > 500.0) == regular
        found = calibration().probabilities(group.answers, group.outside)[-1]
        assert found > 0.99 if regular else found < 0.2
