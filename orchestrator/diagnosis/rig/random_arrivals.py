"""Detect commands that are lost or arrive late at random, by Kalman filters on the encoder."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp

from ...base.compiled_functions import njit
from .fit import Fit
from .model import RigModel
from .rig import HISTORY, Calibrated, _transition
from .stochastic import Noise
from .study import Array

PACKETS, JITTER = "link.packet-loss", "link.jitter"
# A hundred particles take one kind of random arrival for the other now and then.
_PARTICLES = 300
# Kinds of random arrival are weighed at these times the deviation found: particles starve where a kind is
# weaker than what the encoder deviates.
_STRENGTHS = (1.0, 1.4)
# Of the arrival of commands, all about as likely beforehand [s].
_DEVIATIONS = 2e-5 * 2.0 ** np.arange(7)
# Deviations of slow errors of the encoder, in its noise, and how fast they change [rad/s].
DEVIATIONS = (0.0, 0.15, 0.3, 0.6, 1.2)
SLOW = 2.0 * math.pi * 20.0
# Where machine code finds what it needs of the rig's numbers.
_OMEGA, _XI, _TAU, _TICK = map(
    int,
    (Calibrated.NATURAL_FREQUENCY, Calibrated.DAMPING_RATIO, Calibrated.RESPONSE_DELAY, Calibrated.TICK),
)


@njit(error_model="numpy", nogil=True)
def _filter(kind, amount, p, commands, encoder, noise, particles, seed):
    """Log likelihood of encoder samples if commands are lost or delayed at random (a particle filter).

    Args:
        kind: 0 for commands lost with a probability `amount`, 1 for delays of up to `amount` [s] more.
        commands: sent, shape (HISTORY + n,), as `run_rig` takes them; encoder: shape (n,) [m].
    """
    np.random.seed(seed)
    h = p[_TICK]
    subs = 5
    dt = h / subs
    e11, e12, e21, e22, _, _ = _transition(p[_OMEGA], p[_XI], dt)
    n = encoder.shape[0]
    # As many commands as a late one may be behind.
    most = p[_TAU] + (amount if kind == 1 else 0.0)
    depth = min(max(16, math.ceil(most / h) + 2), HISTORY)
    x, v = np.empty(particles), np.empty(particles)
    received = np.empty((particles, depth))
    for one in range(particles):
        x[one], v[one] = encoder[0], (commands[HISTORY] - commands[HISTORY - 1]) / h
        for back in range(depth):
            received[one, back] = commands[HISTORY - depth + back]
    weight = np.empty(particles)
    pick = np.empty(particles, np.int64)
    x2, v2, received2 = np.empty(particles), np.empty(particles), np.empty((particles, depth))
    total = 0.0
    for i in range(n - 1):
        top = -1e300
        for one in range(particles):
            last = received[one, depth - 1]
            for back in range(depth - 1):
                received[one, back] = received[one, back + 1]
            lost = kind == 0 and np.random.random() < amount
            received[one, depth - 1] = last if lost else commands[HISTORY + i]
            tau = p[_TAU] + (amount * np.random.random() if kind == 1 else 0.0)
            for sub in range(subs):
                since = (sub + 1) * dt - tau
                ticks = math.floor(since / h)
                index = depth - 1 + int(ticks)
                index = min(max(index, 1), depth - 1)
                share = min((since - ticks * h) / dt, 1.0)
                c = share * received[one, index] + (1.0 - share) * received[one, index - 1]
                a, b = x[one] - c, v[one]
                x[one] = c + e11 * a + e12 * b
                v[one] = e21 * a + e22 * b
            error = (encoder[i + 1] - x[one]) / noise
            weight[one] = -0.5 * error * error
            top = max(top, weight[one])
        sum_ = 0.0
        for one in range(particles):
            weight[one] = math.exp(weight[one] - top)
            sum_ += weight[one]
        total += top + math.log(sum_ / particles)
        # Systematic resampling.
        at = np.random.random() / particles
        have = weight[0] / sum_
        j = 0
        for one in range(particles):
            while have < at + one / particles and j < particles - 1:
                j += 1
                have += weight[j] / sum_
            pick[one] = j
        for one in range(particles):
            x2[one], v2[one] = x[pick[one]], v[pick[one]]
            received2[one] = received[pick[one]]
        x[:], v[:], received[:] = x2, v2, received2
    return total


@njit(error_model="numpy", nogil=True)
def _kicked(position_error, commands, deviation, slow, omega, xi, delay, tick, noise, innovations):
    """Log likelihood of the position error if commands arrive early or late at random (Kalman filter).

    A change of the command that is late by s kicks the servo by omega^2 s times the change.

    Args:
        position_error: measured minus replayed position, shape (n,) [m].
        commands: as `run_rig` takes them [m].
        deviation: of the arrival [s]; slow: of a slow error of the position beside it [m].
        innovations: normalised, shape (n,); written.
    """
    late = int(delay / tick)
    rest = tick - (delay - late * tick)
    a = np.zeros((3, 3))
    a[0, 0], a[0, 1], a[1, 0], a[1, 1], _, _ = _transition(omega, xi, tick)
    a[2, 2] = math.exp(-SLOW * tick)
    _, g1, _, g2, _, _ = _transition(omega, xi, rest)
    x, p, q = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    p[2, 2] = slow * slow
    fresh = slow * slow * (1.0 - a[2, 2] * a[2, 2])
    total = 0.0
    k = np.zeros(3)
    for n in range(position_error.shape[0]):
        s = p[0, 0] + 2.0 * p[0, 2] + p[2, 2] + noise * noise
        error = position_error[n] - x[0] - x[2]
        innovations[n] = error / math.sqrt(s)
        total -= 0.5 * (error * error / s + math.log(s / (noise * noise)))
        for i in range(3):
            k[i] = (p[i, 0] + p[i, 2]) / s
        for i in range(3):
            x[i] += k[i] * error
            for j in range(3):
                p[i, j] -= k[i] * k[j] * s
        x0 = a[0, 0] * x[0] + a[0, 1] * x[1]
        x[1] = a[1, 0] * x[0] + a[1, 1] * x[1]
        x[0], x[2] = x0, a[2, 2] * x[2]
        for i in range(3):
            for j in range(3):
                q[i, j] = a[i, 0] * p[0, j] + a[i, 1] * p[1, j] + a[i, 2] * p[2, j]
        for i in range(3):
            for j in range(3):
                p[i, j] = q[i, 0] * a[j, 0] + q[i, 1] * a[j, 1] + q[i, 2] * a[j, 2]
        at = HISTORY + n - late
        kick = omega * omega * deviation * (commands[at] - commands[at - 1])
        kick *= kick
        p[0, 0] += kick * g1 * g1
        p[0, 1] += kick * g1 * g2
        p[1, 0] += kick * g1 * g2
        p[1, 1] += kick * g2 * g2
        p[2, 2] += fresh
    return total


def random_arrival(model: RigModel, fit: Fit, left: Sequence[Array]) -> tuple[float, float]:
    """Whether the encoder residual of a fit is that of commands which arrive at random times.

    Both lost commands and random delays: to second moments each makes changes of the command arrive early
    or late, with a deviation of `jitter`/sqrt(12), or of sqrt(p)/(1 - p) ticks. Slow errors of the encoder,
    which every rig has, are weighed against it. It detects sizes far below those that show in the mean
    square.

    Args:
        fit: the best one without such an effect; left: its residuals of the encoder, normalised, by run.
    Returns: its log evidence over none, of its deviations and slow errors the mean [nats]; and the best of
        the deviations of the arrival [s].
    """
    servos = _servos(model, fit)
    found = np.zeros((1 + len(_DEVIATIONS), len(DEVIATIONS)))
    for row, deviation in enumerate((0.0, *_DEVIATIONS)):
        for column, slow in enumerate(DEVIATIONS):
            found[row, column], _ = _arriving(model, servos, left, deviation, slow)
    weighed = logsumexp(found, axis=1)
    evidence = float(logsumexp(weighed[1:]) - math.log(len(_DEVIATIONS)) - weighed[0])
    top = min(max(int(np.argmax(weighed[1:])), 1), len(_DEVIATIONS) - 2) + 1
    before, at, after = weighed[top - 1 : top + 2]
    bend = before - 2.0 * at + after
    share = float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0)) if bend < 0.0 else 0.0
    return evidence, float(_DEVIATIONS[top - 1] * 2.0**share)


def arrival_innovations(model: RigModel, fit: Fit, left: Sequence[Array], deviation: float) -> list[Array]:
    """Normalised innovations of the encoder, by run, if arrival times have a standard deviation.

    Arguments as those of `random_arrival`. It is white where that is what the encoder deviates by.
    """
    servos = _servos(model, fit)
    weighed = [_arriving(model, servos, left, deviation, slow) for slow in DEVIATIONS]
    return max(weighed, key=lambda one: one[0])[1]


def _servos(model: RigModel, fit: Fit) -> list[tuple[float, float, float]]:
    """Natural frequency [rad/s], damping ratio and delay [s] of the servo as fitted, by run."""
    found = []
    for index in range(len(model.runs)):
        p = model.parameters(index, fit.calibrated, fit.effects, fit.theta)
        delay = max(float(p[Calibrated.RESPONSE_DELAY]), 0.0)
        found.append((p[Calibrated.NATURAL_FREQUENCY], p[Calibrated.DAMPING_RATIO], delay))
    return found


def _arriving(
    model: RigModel,
    servos: Sequence[tuple[float, float, float]],
    left: Sequence[Array],
    deviation: float,
    slow: float,
) -> tuple[float, list[Array]]:
    """Log likelihood of the encoder if arrival times have a deviation [s], beside a slow error.

    Arguments as those of `random_arrival`; servos: see `_servos`; slow: deviation of the error, in the
    encoder's noise.

    Returns: it, and the normalised innovations by run.
    """
    noise, tick = model.noise[0], model.study.tick
    total, found = 0.0, []
    for r, sent, (omega, xi, delay) in zip(left, model.commands, servos, strict=True):
        innovations = np.empty(len(r))
        total += _kicked(
            noise * r, sent, deviation, noise * slow, omega, xi, delay, tick, noise, innovations
        )  # fmt: skip
        found.append(innovations)
    return total, found


def link_noise(model: RigModel, lag: float, deviation: float) -> list[Noise]:
    """Weigh lost commands and random delays by how well they explain the encoder samples.

    Args:
        lag: by which the robot follows a ramp of commands, as fitted [s]; delay, servo and the mean of what
            is random make it up. The servo is taken as calibrated, since a fit that knows of no randomness
            deviates in it.
        deviation: of the arrival of commands, as `random_arrival` finds it [s]: of so strong a kind of each,
            it is weighed which the samples are like.
    Returns: both, each at the likelier of two strengths, with its log likelihood, which is -chi2/2 where
        nothing is random.
    """
    noise, tick = model.noise[0], model.study.tick

    def likelihood(kind: int, amount: float, mean: float) -> float:
        total = 0.0
        for index, run in enumerate(model.runs):
            p = model.parameters(index, {}, (), np.zeros(0))
            servo = 2.0 * p[Calibrated.DAMPING_RATIO] / p[Calibrated.NATURAL_FREQUENCY]
            p[Calibrated.RESPONSE_DELAY] = max(lag - servo - mean, 0.0)
            commands = model.commands[index]
            total += _filter(kind, amount, p, commands, run["encoder_position"], noise, _PARTICLES, 7)
        return total

    found = []
    for name, kind in ((PACKETS, 0), (JITTER, 1)):
        weighed = []
        for strength in _STRENGTHS:
            late = strength * deviation
            ticks = late / tick
            # sqrt(p)/(1 - p) ticks; the width of what is uniform is sqrt(12) deviations.
            loss = ((math.sqrt(1.0 + 4.0 * ticks**2) - 1.0) / (2.0 * ticks)) ** 2
            amount = math.sqrt(12.0) * late if kind else loss
            mean = 0.5 * amount if kind else amount / (1.0 - amount) * tick
            weighed.append((likelihood(kind, amount, mean), amount))
        best, amount = max(weighed)
        found.append(Noise(name, (amount,), best))
    return found
