"""Detect single commands that are lost or out of order; each one shows in the encoder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, ndtr

from ...base.compiled_functions import njit
from .fit import Fit
from .model import RigModel
from .random_arrivals import DEVIATIONS, SLOW
from .rig import HISTORY, Calibrated
from .servo import pulse_response
from .study import Array

# Probabilities of a loss, all about as likely beforehand.
_CHANCES = 5e-4 * 2.0 ** np.arange(8)
# Times in which the robot's answer to one command falls by e, after which it is over; and ticks at most.
_OVER, _LONGEST = 5.0, 128
# Rounds in which losses are sought between those that were found.
_ROUNDS = 8
# Fewer losses do not say whether they keep a period.
_FEWEST = 8
# Periods that are tried [ticks], as finely as this share of a turn over a run; how many of them are weighed
# in full; and how sharply losses may keep to them (von Mises' concentration).
_FASTEST, _SLOWEST, _TURN, _LIKELIEST = 20.0, 1000.0, 0.1, 20
_SHARP = 2.0 ** np.arange(7)
# By how many ticks a command may come after newer ones.
_LATE = range(2, 9)
# How wrong a command may be, standard deviations, all about as likely beforehand [m].
_WRONG = 5e-6 * 2.0 ** np.arange(7)


class Losses(NamedTuple):
    """Lost commands, one by one.

    Attributes:
        log_evidence: over no loss [nats]; chance: the likeliest probability of a loss.
        moved: what they moved the robot at the ticks, by run, each of shape (n,) [m].
        shorter: by which commands fell short, as those of `Seen`, by run, each of shape (n,) [m].
        regular: log likelihood that they keep a period, which chance does not [nats].
        disorder: log evidence over none that commands which come after newer ones are obeyed, or wrong ones
            that nobody sent [nats].
    """

    log_evidence: float
    chance: float
    moved: tuple[Array, ...]
    shorter: tuple[Array, ...]
    regular: float
    disorder: float = 0.0


class _Asked(NamedTuple):
    """Motion of the robot by a lost or wrong command in a run.

    Attributes:
        pulses: by how much each command falls short if it does, and one some ticks later, each of shape (n,)
            [m]; and that many ticks.
        answer: what the robot answers to a command of 1 m, over the encoder's noise, shape (k,).
    """

    pulses: tuple[tuple[Array, int], ...]
    answer: Array


def lost_commands(model: RigModel, fit: Fit, left: Sequence[Array]) -> Losses:
    """Find lost commands one by one; each lets the one before act for a further tick.

    Size and sign of the motion by a lost command are known, so that few of them suffice. Separate losses are
    summed over completely. Those between them are searched in the remaining residual.

    Args:
        fit: the best one without losses; left: its residuals of the encoder, normalised, by run.
    """
    noise, tick = model.noise[0], model.study.tick
    sent, answers = [], []
    for index, r in enumerate(left):
        p = model.parameters(index, fit.calibrated, fit.effects, fit.theta)
        sent.append(model.commands[index][: HISTORY - 1 + len(r)])
        answers.append(_answer(p, tick) / noise)
    asked = [_Asked(((_short(c, 1), 0),), answer) for c, answer in zip(sent, answers, strict=True)]
    # Losses look slow as well: both are weighed together, against what is slow alone.
    beside = [(slow, math.exp(-SLOW * tick)) for slow in DEVIATIONS]
    alone = [_plainly(left, slow) for slow in beside]
    found = [_found(left, asked, slow) for slow in beside]
    evidences = [one.log_evidence + plain for (one, *_), plain in zip(found, alone, strict=True)]
    top = int(np.argmax(evidences))
    best, at, shows = found[top]
    disorder = 0.0
    if max(evidences) - max(alone) > 0.0:
        runs = list(zip(sent, answers, strict=True))
        disorder = _disorder(left, runs, beside[top]) + alone[top] - max(alone)
    return best._replace(
        log_evidence=max(evidences) - max(alone),
        moved=tuple(noise * moved for moved in best.moved),
        regular=_regular(at, shows),
        disorder=disorder,
    )


def _disorder(left: Sequence[Array], runs: Sequence[tuple[Array, Array]], slow: tuple[float, float]) -> float:
    """See `Losses.disorder`.

    Args:
        runs: commands sent, and what the robot answers to one, see `_Asked`, by run.
    """
    evidences = [
        _found(left, [_late(*run, late, again) for run in runs], slow)[0].log_evidence
        for late in _LATE
        for again in (False, True)
    ]
    evidences.append(_falsified(left, [answer for _, answer in runs], slow))
    return max(evidences) - math.log(len(evidences))


def _falsified(left: Sequence[Array], answers: Sequence[Array], slow: tuple[float, float]) -> float:
    """Log evidence of single commands with errors of any size, over none; see `_found` [nats].

    Args:
        answers: what the robot answers to a command, see `_Asked`, by run.
    """
    matched = [_matched_filter(r, answer, slow) for r, answer in zip(left, answers, strict=True)]
    evidences = []
    for wrong in _WRONG:
        gains = [
            0.5 * (along**2 / (square + wrong**-2) - math.log1p(wrong**2 * square))
            for along, (square, *_) in matched
        ]
        evidences.append(_by_chance(gains, len(answers[0])))
    return float(logsumexp(evidences)) - math.log(np.size(evidences))


def _short(sent: Array, late: int) -> Array:
    """Difference from commands if one that is older by some ticks holds instead, shape (n,) [m]."""
    return sent[HISTORY - 2 - (late - 1) : len(sent) - late] - sent[HISTORY - 1 :]


def _late(sent: Array, answer: Array, late: int, again: bool) -> _Asked:
    """A command that holds some ticks late instead of a newer one; again: after it was in time."""
    after = np.append(_short(sent, late)[late:], np.zeros(late)), late
    return _Asked((after,) if again else ((_short(sent, 1), 0), after), answer)


def _found(
    left: Sequence[Array], asked: Sequence[_Asked], slow: tuple[float, float]
) -> tuple[Losses, list[Array], list[Array]]:
    """Lost or wrong commands beside a slow error, see `_power`; their effect is normalised.

    Args:
        asked: by run.
    Returns: them, but for `regular` and `disorder`, and what these are made of.
    """
    rest, missing = list(left), [np.zeros(len(r)) for r in left]
    gains, expected = zip(*(_gain(r, one, slow) for r, one in zip(rest, asked, strict=True)), strict=True)
    apart = len(asked[0].answer) + max(lag for _, lag in asked[0].pulses)
    by_chance = _by_chance(gains, apart)
    evidence = float(logsumexp(by_chance) - math.log(len(_CHANCES)))
    chance = float(np.exp(np.average(np.log(_CHANCES), weights=np.exp(by_chance - by_chance.max()))))
    first, counted = [], []
    for again in range(_ROUNDS):
        found = 0
        for index, one in enumerate(asked):
            gain = _gain(rest[index], one, slow)[0] if again else gains[index]
            lost = np.zeros(len(gain))
            _likeliest(gain, chance, apart, lost)
            at = np.flatnonzero(lost)
            short = _fallen(lost, one)
            rest[index] = rest[index] - np.convolve(short, one.answer)[: len(gain)]
            missing[index] += short
            found += len(at)
            if not again:
                first.append(at)
            evidence += float(gain[at].sum()) + len(at) * math.log(chance) if again else 0.0
        if not found:
            break
        counted.append(found)
    # Of losses that run into each other one was counted.
    chance *= sum(counted) / counted[0] if counted else 1.0
    moved = tuple(before - after for before, after in zip(left, rest, strict=True))
    # A loss is found where its log likelihood, which is normal about what is expected, pays for it.
    shows = [ndtr((one + math.log(chance)) / np.sqrt(2.0 * one + 1e-9)) for one in expected]
    return Losses(evidence, chance, moved, tuple(missing), 0.0), first, shows


def _fallen(lost: Array, asked: _Asked) -> Array:
    """Sum of the differences by lost or wrong commands [m], shape (n,)."""
    short = np.zeros(len(lost))
    for pulse, lag in asked.pulses:
        short[lag:] += (lost * pulse)[: len(lost) - lag]
    return short


def _gain(r: Array, asked: _Asked, slow: tuple[float, float]) -> tuple[Array, Array]:
    """Log likelihood of a loss at each tick, over none, beside white noise and a slow error.

    Returns: it, and what is to be expected of it if there is one.
    """
    along, shared = _matched_filter(r, asked.answer, slow)
    product, square = np.zeros(len(r)), np.zeros(len(r))
    for pulse, lag in asked.pulses:
        product[: len(r) - lag] += pulse[: len(r) - lag] * along[lag:]
        for other, before in asked.pulses:
            square += pulse * other * shared[abs(lag - before)]
    return product - 0.5 * square, 0.5 * square


def _matched_filter(r: Array, answer: Array, slow: tuple[float, float]) -> tuple[Array, Array]:
    """Products of residuals with the response to each command, and of responses with each other, by lag."""
    size = _size(len(r))
    matched = np.fft.rfft(answer, size)
    weighed = matched.conj() / _power(size, slow)
    along = np.fft.irfft(np.fft.rfft(r, size) * weighed, size)[: len(r)]
    return along, np.fft.irfft(matched * weighed, size)


def _by_chance(gains: Sequence[Array], apart: int) -> Array:
    """Log likelihood of all runs over no loss, by probability of one, see `_summed`, shape (chances,)."""
    return np.array([sum(_summed(one, chance, apart) for one in gains) for chance in _CHANCES])


def _plainly(left: Sequence[Array], slow: tuple[float, float]) -> float:
    """Whittle likelihood of residuals with slow deviations beside their noise."""
    total = 0.0
    for r in left:
        power = _power(_size(len(r)), slow)
        seen = np.abs(np.fft.rfft(r, _size(len(r)))) ** 2 / len(r)
        total -= 0.5 * len(r) * float(np.mean(np.log(power) + seen / power))
    return total


def _power(size: int, slow: tuple[float, float]) -> Array:
    """Spectrum of unit white noise and a slow error, given by its deviation and its correlation per tick."""
    deviation, keep = slow
    turn = np.cos(2.0 * math.pi * np.fft.rfftfreq(size))
    return 1.0 + deviation**2 * (1.0 - keep**2) / (1.0 - 2.0 * keep * turn + keep**2)


def _size(n: int) -> int:
    return 1 << (n + _LONGEST - 1).bit_length()


def _regular(at: Sequence[Array], shows: Sequence[Array]) -> float:
    """Log evidence that losses are periodic, with a phase for each run [nats].

    Phases have von Mises' distribution about it, over where losses show: where the robot is slow they do
    not. Losses that were not found leave gaps, which phases do not mind.

    Args:
        at: ticks of losses, by run; shows: chance that a loss at a tick is found, shape (n,), by run.
    """
    runs = [(one, seen / seen.sum()) for one, seen in zip(at, shows, strict=True) if len(one)]
    if sum(len(one) for one, _ in runs) < _FEWEST:
        return 0.0
    longest = max(len(seen) for _, seen in runs)
    turns = 2.0 * math.pi * np.arange(1.0 / _SLOWEST, 1.0 / _FASTEST, _TURN / longest)
    together = sum(np.abs(np.exp(1j * np.outer(turns, one)).sum(axis=1)) for one, _ in runs)
    best = 0.0
    for turn in turns[np.argsort(-together, kind="stable")[:_LIKELIEST]]:
        gains = np.zeros(len(_SHARP))
        for one, seen in runs:
            total = np.exp(1j * turn * one).sum()
            usual = np.exp(np.outer(_SHARP, np.cos(turn * np.arange(len(seen)) - np.angle(total)))) @ seen
            gains += _SHARP * abs(total) - len(one) * np.log(usual)
        best = max(best, float(gains.max()))
    free = sum(math.log(len(one)) for one, _ in runs)
    return max(best - math.log(len(turns) * len(_SHARP)) - 0.5 * free, 0.0)


def _answer(p: Array, tick: float) -> Array:
    """Position of the robot at the ticks after a command of 1 m that holds for one, until it is over [1]."""
    omega, xi = p[Calibrated.NATURAL_FREQUENCY], p[Calibrated.DAMPING_RATIO]
    delay = max(float(p[Calibrated.RESPONSE_DELAY]), 0.0)
    reach = math.ceil((delay + _OVER / (max(xi, 0.1) * omega)) / tick) + 1
    return pulse_response((omega, xi, delay), tick, min(reach, _LONGEST))


@njit(error_model="numpy")
def _summed(gain, chance, apart):
    """Log likelihood of a run over no loss, of all losses that lie apart, by a recursion over the ticks."""
    n = gain.shape[0]
    total = np.zeros(n + 1)
    stays, goes = math.log1p(-chance), math.log(chance)
    for i in range(n):
        without = total[i] + stays
        before = max(i + 1 - apart, 0)
        within = total[before] + goes + gain[before] if i + 1 >= apart else -math.inf
        top = max(without, within)
        total[i + 1] = top + math.log(math.exp(without - top) + math.exp(within - top))
    return total[n]


@njit(error_model="numpy")
def _likeliest(gain, chance, apart, lost):
    """Set `lost` to one at the losses of the likeliest such run."""
    n = gain.shape[0]
    best = np.zeros(n + 1)
    taken = np.zeros(n + 1)
    stays, goes = math.log1p(-chance), math.log(chance)
    for i in range(n):
        best[i + 1] = best[i] + stays
        if i + 1 >= apart:
            before = i + 1 - apart
            within = best[before] + goes + gain[before]
            if within > best[i + 1]:
                best[i + 1], taken[i + 1] = within, 1.0
    i = n
    while i > 0:
        if taken[i] > 0.0:
            i -= apart
            lost[i] = 1.0
        else:
            i -= 1
