"""Effects of the link: commands lost or delayed at random, detected in the encoder."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from .answers import Answer
from .effect import Effect
from .fit import Fit, Fitter
from .lost_commands import Losses, lost_commands
from .marginal import inflation
from .model import RigModel, ramp_lag
from .nuisance import Weighing, Weighted
from .random_arrivals import PACKETS, arrival_innovations, link_noise, random_arrival
from .search import Search, search
from .stochastic import Noise
from .study import Array

# Log evidence of commands lost or delayed at random from which they are weighed [nats].
_CLEAR = 5.0
# The same for single lost commands; a few may occur by chance.
_LOSSES_CLEAR = 15.0
# Log evidence of single lost commands over that of random arrivals from which these count as such losses; and
# the share of it that may remain after the losses are removed.
_LIKELIER, _REST = 2.0, 0.1
# Factors of the log evidence of losses, and of random arrivals, when they are compared with commands out of
# order: few of those are found where they overlap, and random arrivals are more flexible.
_UNSURE, _FREER = 1.4, 0.7
# Share of the mean square of what the encoder deviates that effects leave at most where they explain much of
# it; what imitates random arrivals alone leaves nearly all.
_MOST = 0.7


class Arrivals(NamedTuple):
    """Evidence in the encoder for commands that arrive at random, beside a fit.

    Attributes:
        seen: log evidence of random arrivals over none [nats].
        log_evidence: the same, minus evidence in their innovations: they absorb any deviation of the encoder,
            but then the innovations are not white. Zero if nothing is clear.
        deviation: of the arrival times [s].
        unforeseen: normalised innovations of the encoder, by run; empty if nothing is clear.
        losses: commands lost one by one, where these were sought.
        apart: whether losses are what arrivals are, one by one.
    """

    seen: float
    log_evidence: float
    deviation: float
    unforeseen: list[Array]
    losses: Losses | None = None
    apart: bool = False

    @property
    def regular(self) -> float:
        """Log likelihood that arrivals are not random: they are periodic, or out of order [nats].

        Random losses have no period, and neither loss nor delay brings an older command after a newer one.
        """
        if self.losses is None:
            return 0.0
        chance = max(_UNSURE * self.losses.log_evidence, _FREER * self.seen)
        return max(self.losses.regular, self.losses.disorder - chance)

    @property
    def periodic(self) -> float:
        """Log evidence of periodic losses that are too few to be reported as random ones [nats].

        Random losses have no period, so that the evidence of the period is added to that of the losses.
        """
        if self.losses is None or self.regular == 0.0 or self.seen > _CLEAR:
            return 0.0
        evidence = self.losses.log_evidence + self.regular
        return evidence if evidence > _LOSSES_CLEAR else 0.0


def arrivals(model: RigModel, fit: Fit, left: Sequence[Array], seek_losses: bool) -> Arrivals:
    """Evidence in the encoder for random arrivals beside a fit.

    Args:
        left: the fit's residuals of the encoder, normalised, by run.
        seek_losses: whether commands may be lost one by one, too.
    """
    seen, deviation = random_arrival(model, fit, left)
    losses = lost_commands(model, fit, left) if seek_losses else None
    if losses is not None and _are_losses(model, fit, left, losses, seen):
        return Arrivals(seen, 0.0, deviation, [], losses, apart=True)
    if seen <= _CLEAR:
        return Arrivals(seen, 0.0, deviation, [], losses)
    unforeseen = arrival_innovations(model, fit, left, deviation)
    log_evidence = seen / inflation(unforeseen)
    return Arrivals(seen, log_evidence if log_evidence > _CLEAR else 0.0, deviation, unforeseen, losses)


def _are_losses(model: RigModel, fit: Fit, left: Sequence[Array], losses: Losses, arrival: float) -> bool:
    """Whether losses explain the encoder better than random arrivals do, and one by one.

    Not where they are so many that they run into each other.

    Args:
        arrival: log evidence of random arrivals [nats].
    """
    if losses.log_evidence < max(_LOSSES_CLEAR, _LIKELIER * arrival):
        return False
    rest = [r - moved / model.noise[0] for r, moved in zip(left, losses.moved, strict=True)]
    after, _ = random_arrival(model, fit, rest)
    return after < max(_REST * losses.log_evidence, _CLEAR)


def random_links(model: RigModel, none: Fit, found: Arrivals, without: Collection[str]) -> list[Noise]:
    """Commands lost or delayed at random, the one that explains the encoder better first.

    That has the evidence of random arrivals, the other less by what it explains less.

    Args:
        none: the fit of the calibration alone; without: ids that are not sought.
    """
    if found.log_evidence == 0.0:
        return []
    lag = ramp_lag(none.calibrated)
    links = [one for one in link_noise(model, lag, found.deviation) if one.id not in without]
    # Random delays leave lost commands, sought one by one, far below random arrivals.
    surplus = found.losses.log_evidence - found.seen if found.losses is not None else 0.0
    if surplus > 0.0:
        links = [replace(one, log_evidence=surplus if one.id == PACKETS else 0.0) for one in links]
    links.sort(key=lambda one: -one.log_evidence)
    return [
        replace(one, log_evidence=found.log_evidence + one.log_evidence - links[0].log_evidence, scale=1.0)
        for one in links
    ]


def search_behind(weighing: Weighing, always: tuple[Effect, ...], best: Fit) -> tuple[Weighing, Search]:
    """Search again where the encoder's residuals are mostly the link's.

    They count less, and no more in the contact, which is given the position that was measured. Where other
    effects explain much of what the encoder deviates, what they leave is the link's.

    Args:
        always: the link's effect; best: the best fit without it.
    Returns: by what was searched, a weighing of its own; and what was found.
    """
    model, weights = weighing.model, list(weighing.weights)
    fitter, start = Fitter(Weighted(model, weights)), Fitter(model).starts(always[0])[0]
    fit = fitter.fit(always, None, start)
    if best.effects:
        count = len(best.deviation)
        begun = np.concatenate([start, best.z[count:]])
        beside = fitter.fit((*always, *best.effects), best.z[:count], begun)
        fit = beside if _encoder_residual(beside) < _MOST * _encoder_residual(fit) else fit
    smoothed = []
    for index, run in enumerate(model.runs):
        out = model.replay(index, fit.calibrated, fit.effects, fit.theta)
        smooth = gaussian_filter1d(run["encoder_position"] - out[2], 3.0)
        smoothed.append(np.append(smooth, smooth[-1]))
    for index in range(len(model.runs)):
        r = fit.residuals[2 * index]
        n = len(r) // 16
        sums = r[: 16 * n].reshape(n, 16).sum(axis=1)
        noise = max(1.0, math.sqrt(float(np.mean(sums**2)) / 16.0), float(r.std()))
        weights[2 * index] = weights[2 * index] / noise
        weights[2 * index + 1] = 0.5 * weights[2 * index + 1]
    behind = replace(weighing, model=model.corrected(smoothed), weights=weights, known={})
    return behind, search(behind.fitter(), weighing.effects, always)


def _encoder_residual(fit: Fit) -> float:
    """Mean square of the encoder residual of a fit."""
    return float(np.mean(np.concatenate(fit.residuals[0::2]) ** 2))


def other_link(answers: Sequence[Answer], links: Sequence[Noise]) -> list[Answer]:
    """The best answers with the other kind of randomness, which was not fitted."""
    found = []
    for other in links[1:]:
        for answer in answers[:3]:
            names = {*answer.effects} - {links[0].id} | {other.id}
            noises = (*(one for one in answer.noises if one is not links[0]), other)
            worse = links[0].log_evidence - other.log_evidence
            changed = {"gain": answer.gain - worse, "random": answer.random - worse, "noises": noises}
            found.append(replace(answer, effects=tuple(sorted(names)), fit=None, **changed))
    return found
