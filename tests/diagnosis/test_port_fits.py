"""Fits of a system of FMUs where derivatives lead nowhere: combs of values, differences from afar."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from orchestrator.diagnosis.effect import Parameter
from orchestrator.diagnosis.fit import Fit, Fitter
from orchestrator.diagnosis.ports import seek
from orchestrator.diagnosis.ports.candidates import _apart, _periods, _resolutions
from orchestrator.diagnosis.ports.chance import chance_saves
from orchestrator.diagnosis.ports.conjugate import pairs
from orchestrator.diagnosis.ports.effect import PortEffect
from orchestrator.diagnosis.ports.study import PortRun, Role
from orchestrator.diagnosis.ports.wary import WaryFitter
from orchestrator.diagnosis.ports.weigh import _answers
from orchestrator.diagnosis.ports.where import _Loss, _most
from orchestrator.diagnosis.search import Search
from orchestrator.effects.gain import Gain
from orchestrator.system.system import Port

STEP = 1e-3
TIME = STEP * np.arange(8000)
SWING = np.sin(2.0 * np.pi * 0.7 * TIME) * np.exp(-0.05 * TIME)
ENDS = [(samples, samples * STEP) for samples in (1000, 2000, 4000, 8000)]


def rounded(x, resolution):
    return resolution * np.round(x / resolution) if resolution else x


def held(x, period):
    return np.interp(period * np.floor(TIME / period + 1e-9), TIME, x) if period else x


@pytest.mark.parametrize("hidden", [0.3, 0.0421, 0.0177])
def test_a_resolution_is_found_from_afar(hidden):
    noise = 0.2 * hidden * np.random.default_rng(3).standard_normal(len(TIME))
    log = rounded(SWING, hidden) + noise
    peak = np.abs(SWING).max()
    comb = _resolutions(peak)

    def cost(value, samples):
        return float(np.sum(((log - rounded(SWING, value))[:samples] / np.std(noise)) ** 2))

    best = comb.best(cost, ENDS)
    assert best[0] == pytest.approx(hidden, rel=2e-3)
    # No worse than the hidden one.
    assert cost(best[0], 8000) < cost(hidden, 8000) + 20.0


@pytest.mark.parametrize("hidden", [23.3e-3, 4.17e-3])
def test_a_sampling_period_is_found_where_it_shows_after_seconds_only(hidden):
    draw = np.random.default_rng(4)
    log = held(SWING, hidden) + 2e-3 * draw.standard_normal(len(TIME))
    comb = _periods(STEP)

    def cost(value, samples):
        return float(np.sum(((log - held(SWING, value))[:samples] / 2e-3) ** 2))

    best = comb.best(cost, ENDS)
    # The last sample is taken to a tenth of a period when it should be.
    assert best[0] == pytest.approx(hidden, rel=0.1 * hidden / TIME[-1])


def test_where_no_value_does_better_none_is_told():
    log = SWING + 1e-2 * np.random.default_rng(5).standard_normal(len(TIME))
    assert (
        _resolutions(1.0).best(lambda v, n: float(np.sum(((log - rounded(SWING, v))[:n] / 1e-2) ** 2)), ENDS)
        == []
    )


def test_what_hardly_explains_anything_is_not_looked_at_closely():
    tried = []

    def cost(value, samples):
        tried.append(value)
        return 1000.0 - 100.0 * (value > 0.0)

    comb = _resolutions(1.0)
    assert comb.best(cost, ENDS, 0.2) == []
    assert len(tried) == len(comb.coarse) + 1
    assert comb.best(cost, ENDS, 0.05) != []


class Logs:
    """In place of a replay: a run without the port at which readings are rounded, and one with it."""

    study = SimpleNamespace(settled=0, interval=STEP)
    read, other = Port("a", "read"), Port("a", "other")

    def __init__(self, _, runs):
        self.runs = runs

    def compared(self, run):
        return list(run.logs)

    def residuals(self, calibrated, effects, theta):
        run = self.runs[0]
        given = {self.read: rounded(SWING, theta[-1] if len(theta) else 0.0), self.other: np.zeros(len(TIME))}
        return [(log - given[port][: len(log)]) / 1e-3 for port, log in run.logs.items()]


@pytest.mark.parametrize("last", [False, True])
def test_a_resolution_is_sought_in_a_run_that_has_the_port(last, monkeypatch):
    monkeypatch.setattr(seek, "PortReplay", Logs)
    noise = 1e-3 * np.random.default_rng(5).standard_normal((2, len(TIME)))
    logs = [{Logs.other: noise[0]}, {Logs.read: rounded(SWING, 0.0421) + noise[1]}]
    runs = [PortRun(str(number), Role.TRAIN, one) for number, one in enumerate(logs if last else logs[::-1])]
    effect = PortEffect(
        "a.read.quantise",
        "",
        "",
        (Parameter("resolution", "1", 1.0, 0.0, 3.0),),
        port=Logs.read,
        make=lambda p: Gain(factor=p[0]),
        comb=_resolutions(1.0),
    )
    base = SimpleNamespace(effects=(), theta=np.zeros(0), calibrated={})
    (found,) = seek._combed(Logs(None, runs), [effect], base, 1)
    assert found.parameters[0].starts[0] == pytest.approx(0.0421, rel=1e-4)


@pytest.mark.parametrize("hidden", [0.0377, 0.0533, 0.0711])
def test_a_resolution_of_a_held_signal_is_sought_in_all_of_a_run(hidden, monkeypatch):
    """Its begin has two values, which one step meets as well as the other."""
    held_long = np.repeat(np.random.default_rng(9).uniform(0.3, 1.0, 16), 500)

    class Held(Logs):
        def residuals(self, calibrated, effects, theta):
            log = self.runs[0].logs[self.other]
            given = rounded(held_long, theta[-1] if len(theta) else 0.0)
            return [(log - given[: len(log)]) / 1e-3]

    monkeypatch.setattr(seek, "PortReplay", Held)
    log = rounded(held_long, hidden) + 1e-3 * np.random.default_rng(5).standard_normal(len(TIME))
    run = PortRun("only", Role.TRAIN, {Logs.read: held_long, Logs.other: log})
    size = Parameter("resolution", "1", 1.0, 0.0, 3.0)
    effect = PortEffect(
        "a.read.quantise", "", "", (size,), port=Logs.read, make=lambda p: Gain(factor=p[0]),
        comb=_resolutions(1.0),
    )  # fmt: skip
    base = SimpleNamespace(effects=(), theta=np.zeros(0), calibrated={})
    (found,) = seek._combed(Held(None, [run]), [effect], base, 1)
    assert found.parameters[0].starts[0] == pytest.approx(hidden, rel=5e-3)


class Relay:
    """A replay of a switch with hysteresis: which samples differ is no smooth function of its width."""

    tolerances = {"level": (1.0, 0.05)}  # noqa: RUF012
    width, level = 0.31, 1.02

    def __init__(self):
        self.noise = 0.05 * np.random.default_rng(6).standard_normal(len(TIME))

    def given(self, level, width):
        state, out = 1.0, np.empty(len(TIME))
        for place, x in enumerate(SWING):
            if state > 0.0 and x < -width:
                state = -1.0
            elif state < 0.0 and x > width:
                state = 1.0
            out[place] = level * state
        return out

    def residuals(self, calibrated, effects, theta):
        log = self.given(self.level, self.width) + self.noise
        return [(log - self.given(calibrated["level"], theta[0] if effects else 0.0)) / 0.05]


@pytest.mark.parametrize("start", [0.02, 0.1, 0.6])
def test_a_width_is_found_over_dents(start):
    port = Port("a", "b")
    effect = PortEffect(
        "a.width",
        "",
        "",
        (Parameter("width", "1", 1.0, 0.0, 3.0),),
        port=port,
        make=lambda p: Gain(factor=p[0]),
    )
    replay = Relay()
    fit = WaryFitter(replay).fit((effect,), None, np.array([start]))
    truth = float(np.sum((replay.noise / 0.05) ** 2))
    assert fit.cost < truth + 5.0
    assert fit.calibrated["level"] == pytest.approx(1.02, abs=3e-3)
    # Steps along derivatives alone stay where they began.
    assert Fitter(replay).fit((effect,), None, np.array([start])).cost > 2.0 * truth


class Rounding:
    """A replay of a signal that passes as it is, or rounded; the log holds more than it.

    Args:
        signal: shape (n,); more: what the log holds besides noise, shape (n,).
    """

    tolerances = {"level": (1.0, 0.05)}  # noqa: RUF012

    def __init__(self, signal, more):
        self.signal = signal
        self.log = signal + more + 1e-3 * np.random.default_rng(8).standard_normal(len(signal))

    def residuals(self, calibrated, effects, theta):
        given = rounded(self.signal, theta[0] if effects else 0.0)
        return [(self.log - calibrated["level"] * given) / 1e-3]

    def gain(self, fitter):
        """Log evidence of the resolution of least cost over none [nats]."""
        peak = float(np.abs(self.signal).max())
        comb = _resolutions(peak)
        size = Parameter("resolution", "1", 0.1 * float(self.signal.std()), 0.0, jagged=True)
        effect = PortEffect(
            "a.b.quantise", "", "", (size,), port=Port("a", "b"), make=lambda p: Gain(factor=p[0]), comb=comb
        )

        def cost(value, samples):
            (r,) = self.residuals({"level": 1.0}, (effect,), np.array([value]))
            return float(r[:samples] @ r[:samples])

        steps = (peak / np.arange(20.0, 150.0, 0.25)).tolist()
        best = min(steps, key=lambda value: cost(value, len(self.signal)))
        found = comb.best(cost, [(len(self.signal), 1.0)])
        fits = [fitter.fit((effect,), None, np.array([value / size.scale])) for value in (best, *found)]
        return max(fit.log_evidence for fit in fits) - fitter.fit(()).log_evidence


def levels(count):
    """A signal that holds each of so many values for some time, and which of them it is."""
    draw = np.random.default_rng(count)
    which = np.repeat(np.arange(count), 100)
    return draw.uniform(0.3, 1.0, count)[which], which


def test_a_resolution_pays_for_having_been_sought():
    """Of a signal of 22 values some of the many steps meet what anything does that goes along with these."""
    signal, which = levels(22)
    blamed = []
    for seed in range(6):
        more = 3e-3 * np.random.default_rng(seed).standard_normal(22)[which]
        replay = Rounding(signal, more)
        assert replay.gain(WaryFitter(replay)) < 0.0
        blamed.append(replay.gain(Fitter(replay)) > 100.0)
    # Laplace's volume alone takes them for found.
    assert all(blamed)


@pytest.mark.parametrize("count", [22, 200])
def test_a_resolution_that_is_there_is_worth_its_price(count):
    signal, _ = levels(count)
    for step in (0.031, 0.0173):
        replay = Rounding(signal, rounded(signal, step) - signal)
        paid, alone = replay.gain(WaryFitter(replay)), replay.gain(Fitter(replay))
        assert alone > 1e4 and paid == pytest.approx(alone, abs=50.0)


def test_white_noise_makes_no_step_dearer_than_its_volume():
    """What the best of M steps saves of white noise is the logarithm of M."""
    comb = _resolutions(1.0)
    r = np.random.default_rng(2).standard_normal(len(TIME))
    none = np.zeros((len(r), 0))

    def trace(value):
        return r + rounded(SWING, value) - SWING

    saved = chance_saves(comb, 0.1, trace, (r, r), none, np.zeros(0))
    assert saved == pytest.approx(np.log(comb.tried(0.1)), rel=0.5)
    assert comb.tried(0.1) == pytest.approx(240, rel=0.02)
    assert comb.tried(1.0 / 120.0) == pytest.approx(480, rel=0.02)


def test_unrelated_steps_are_as_large_and_not_the_same():
    comb = _resolutions(1.0)
    found = np.array(comb.unrelated(0.1, 48))
    assert len(found) > 20 and (found > 0.05).all() and (found < 0.2).all()
    # Largest values of the signal fall a step beside those of the step found, or farther.
    assert (np.abs(1.0 / found - 10.0) > 0.99).all()


class Pit:
    """A replay whose misfit falls towards 0.1, and into a pit about 1 that no stride from there finds."""

    tolerances = {"level": (1.0, 0.05)}  # noqa: RUF012

    def residuals(self, calibrated, effects, theta):
        at = theta[0] if effects else 0.0
        missed = 100.0 * (at - 1.0) if abs(at - 1.0) < 0.2 else 20.0 + 50.0 * abs(at - 0.1)
        return [np.array([missed, calibrated["level"] - 1.0])]


def test_fits_are_taken_up_where_a_search_by_other_weights_left_them():
    port = Port("a", "b")
    effect, gone = (
        PortEffect(
            f"a.{name}",
            "",
            "",
            (Parameter("level", "1", 1.0, 0.0, 3.0),),
            port=port,
            make=lambda p: Gain(factor=p[0]),
        )
        for name in ("coulomb", "dahl")
    )
    fitter = WaryFitter(Pit())
    own = fitter.fit((effect,), None, fitter.starts(effect)[0])
    assert own.cost > 399.0
    before = [fitter.fit((one,), None, np.array([1.01])) for one in (gone, effect)]
    explored = Search(fitter.fit(()), tuple(before))
    (again,) = seek._resumed(fitter, [effect], explored, 1)
    assert again.effects == (effect,) and again.cost < 2.0
    assert Search(explored.none, (own,)).beside([again]).fits == (again,)


def test_friction_acts_along_each_axis():
    """Elements of vectors by their index, as many scalars in their order, else each with each."""
    axes = [("velocity[1]", "m/s"), ("velocity[2]", "m/s"), ("turn[1]", "rad/s")]
    forces = [("force[1]", "N"), ("force[2]", "N"), ("torque[1]", "N.m")]
    assert pairs(axes, forces) == [
        ("velocity[1]", "force[1]"),
        ("velocity[2]", "force[2]"),
        ("turn[1]", "torque[1]"),
    ]
    assert pairs([("a", "m/s"), ("b", "m/s")], [("f", "N")]) == [("a", "f"), ("b", "f")]
    assert pairs([("a", "m/s"), ("b", "m/s")], [("f", "N"), ("g", "N")]) == [("a", "f"), ("b", "g")]
    assert pairs([("a", "m/s")], [("t", "N.m")]) == []


def test_two_effects_of_one_name_are_told_apart():
    """As where a parameter is called as a law is."""
    one = PortEffect("drive.dahl", "", "", (Parameter("change", "N", 1.0),), changes={"drive.dahl": "change"})
    other = PortEffect(
        "drive.dahl",
        "",
        "",
        (Parameter("level", "N", 1.0),),
        port=Port("drive", "load"),
        make=lambda p: Gain(factor=p[0]),
    )
    assert [effect.id for effect in _apart([one, other])] == ["drive.dahl", "drive.dahl-law"]


class Heated:
    """A replay of two responses whose sizes and a common gain only count by their ratios."""

    tolerances = {"slow": (300.0, 10.0), "quick": (1200.0, 40.0)}  # noqa: RUF012
    gain = -0.15

    def __init__(self):
        self.noise = 1e-3 * np.random.default_rng(8).standard_normal(len(TIME))

    def given(self, slow, quick, gain):
        return (1.0 + gain) * (300.0 / slow * SWING + 1200.0 / quick * SWING**2)

    def residuals(self, calibrated, effects, theta):
        log = self.given(305.0, 1160.0, self.gain) + self.noise
        gain = theta[0] if effects else 0.0
        return [(log - self.given(calibrated["slow"], calibrated["quick"], gain)) / 1e-3]


def test_a_gain_is_found_from_where_the_calibration_took_it_up():
    """Along the valley nothing but tolerances counts, which are a millionth of how steep it is across."""
    port = Port("a", "b")
    effect = PortEffect(
        "a.gain",
        "y = x",
        "",
        (Parameter("gain", "1", 0.2),),
        port=port,
        make=lambda at: Gain(gain=at["gain"]),
    )
    fitter = WaryFitter(Heated())
    none = fitter.fit(())
    assert min(none.z) > 3.0
    fit = fitter.fit((effect,), none.z, fitter.starts(effect)[0])
    assert fit.theta[0] == pytest.approx(-0.15, abs=0.03) and fit.cost < none.cost - 20.0
    assert fit.cost == pytest.approx(fitter.fit((effect,), None, np.array([-0.75])).cost, abs=0.3)


def test_an_effect_that_keeps_the_model_from_running_away_is_an_answer(monkeypatch):
    """On validation runs the model without it runs away; by how much nobody can say."""

    def fit(effects, cost):
        nothing = np.zeros(0)
        return Fit(effects, {}, nothing, {}, cost, cost, 0.0, (np.zeros(3),), nothing)

    gain, lag = (PortEffect(f"a.{name}", "", "a", (), changes={name: ""}) for name in ("gain", "lag"))
    found = Search(fit((), 1e5), (fit((gain,), 100.0), fit((lag,), 90.0)))
    squares = {(): np.inf, (gain,): 120.0, (lag,): np.inf}
    monkeypatch.setattr("orchestrator.diagnosis.ports.weigh.tied", lambda fitter, answers: list(answers))
    monkeypatch.setattr("orchestrator.diagnosis.ports.weigh.alike", lambda *given: [])
    answers = _answers(None, found, lambda one: squares[one.effects], (gain, lag), 1)
    assert [one.effects for one in answers] == [(), ("a.gain",)]
    assert np.isfinite(answers[1].gain) and answers[1].gain > 1e5


def test_a_component_that_runs_away_in_a_window_loses_everything():
    assert _most({"a": _Loss(0.2, 0.1), "b": _Loss(np.nan, 0.1)}) == np.inf
    assert _most({"a": _Loss(0.2, 0.1)}) == 0.2
