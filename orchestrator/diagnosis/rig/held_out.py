"""Judge the residual of answers on all runs, held-out ones included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from .coloured_noise import Colour
from .descent import cost_of
from .effect import Site
from .fit import Base, Fit, Fitter
from .nuisance import WAVY, Weighing, Weighted, force_weights, scatter, waves
from .residual_evidence import ResidualEvidence, own_error, residual_evidence
from .study import Array, Run

# Squares of residuals that are much, and share of those beyond their number that is most.
_MUCH, _MOST = 200.0, 0.5
# A wave that is small in some runs may be a little larger in all.
_WAVIER = 1.25 * WAVY
# Places of effects that may not show in slightly slower runs. And the ratio of the evidence for such an
# effect in further runs to that in the fitted runs, above which the fitted runs do not determine its size
# well enough.
_LIMITS, _DEEPER = (Site.RATE, Site.LIMIT), 1e3


class UnexplainedEvidence(NamedTuple):
    """Residual evidence of a fit on its own runs, and on all runs, which may be the same.

    Attributes:
        own_error: see `residual_evidence.own_error`, of all runs.
    """

    seen: ResidualEvidence
    every: ResidualEvidence
    own_error: float

    @property
    def parts(self) -> tuple[float, ...]:
        """See `answers.Answer`."""
        return (*self.seen, *self.every)

    @property
    def total(self) -> float:
        """Of all runs [nats]."""
        return self.every.total

    def changed(self, **parts: float) -> UnexplainedEvidence:
        """The same, with other parts."""
        return self._replace(seen=self.seen._replace(**parts), every=self.every._replace(**parts))


class FittedWeighing(NamedTuple):
    """A weighing, and its fitter."""

    weighing: Weighing
    fitter: Fitter


class TransferredFit(NamedTuple):
    """A fit on the runs that judge it.

    Attributes:
        by: by what it is judged.
        fit: on these runs; chosen: see `any_law`, None where it saw all of them.
    """

    by: FittedWeighing
    fit: Fit
    chosen: Array | None


@dataclass(frozen=True)
class Judge:
    """Judge of the residual evidence of fits.

    Attributes:
        weighing, fitter: by which fits were made; every: the same of all runs, if there are others.
        colour: small coloured noise of the force, see `stochastic.Force`.
        limited: whether further runs reach a limit that the others do not, and so are left out.
    """

    weighing: Weighing
    fitter: Fitter
    colour: Colour
    every: FittedWeighing | None = None
    limited: bool = False
    _carried: dict[int, tuple[Fit, TransferredFit]] = field(default_factory=dict, compare=False, repr=False)
    _leaves: dict[int, tuple[Fit, UnexplainedEvidence]] = field(
        default_factory=dict, compare=False, repr=False
    )

    def over(self, runs: Sequence[Run], best: Fit, noise_factor: float, lost: bool) -> Judge:
        """A judge that includes further runs.

        No number is fitted to these: they show whether a model that was fitted to others predicts them. It
        cannot where they reach a limit that the others do not, or hardly do.

        Args:
            runs: all of them; best: the best fit; louder, lost: see `nuisance.force_weights`.
        """
        model, weights = self.weighing.model.over(runs), force_weights(runs, noise_factor, lost)
        weighing = replace(self.weighing, model=model, weights=weights, known={})
        fitter = weighing.fitter()
        here, derivatives = fitter.carried(best, self.fitter)
        if _limited(weighing, fitter, here, derivatives) or _deeper(
            weighing, fitter, here, self.weighing.model.runs
        ):
            return replace(self, limited=True)
        return Judge(
            self.weighing,
            self.fitter,
            self.colour,
            FittedWeighing(weighing, fitter_with_nuisance(weighing, here, _WAVIER)),
        )

    def leaves(self, fit: Fit) -> UnexplainedEvidence:
        """Residual evidence of a fit."""
        if id(fit) not in self._leaves:
            self._leaves[id(fit)] = fit, self._left(fit)
        return self._leaves[id(fit)][1]

    def carried(self, fit: Fit) -> TransferredFit:
        """A fit on all runs, or on those that it saw, if there are no others: see `Fitter.carried`."""
        if self.every is None:
            return TransferredFit(FittedWeighing(self.weighing, self.fitter), fit, None)
        if id(fit) not in self._carried:
            self._carried[id(fit)] = (
                fit,
                TransferredFit(self.every, *self.every.fitter.carried(fit, self.fitter)),
            )
        return self._carried[id(fit)][1]

    def _left(self, fit: Fit) -> UnexplainedEvidence:
        seen = residual_evidence(self.weighing, self.fitter, fit, self.colour)
        by, here, chosen = self.carried(fit)
        every = seen if self.every is None else residual_evidence(*by, here, self.colour, chosen)
        return UnexplainedEvidence(seen, every, own_error(*by, here, every.total))


def _limited(weighing: Weighing, fitter: Fitter, here: Fit, derivatives: Array) -> bool:
    """Whether a limit that only further runs reach explains most of the residual of a fit.

    Args:
        fitter: of the weighing; here, derivatives: see `Fitter.carried`.
    """
    base = Base(here.effects, here.z, fitter.marginal.stacked(here.residuals), derivatives)
    cost = cost_of(base.r, base.z)
    least = max(_MUCH, _MOST * (cost - len(base.r)))
    limits = [one for one in weighing.effects if one.site in _LIMITS and one not in here.effects]
    return any(cost - fitter.screen(one, [base])[0] > least for one in limits)


def _deeper(weighing: Weighing, fitter: Fitter, here: Fit, seen: Sequence[Run]) -> bool:
    """Whether a fitted limit acts far more strongly in further runs than in the fitted ones.

    A servo at its limit forgets nothing: what the limit and the calibration are off by adds up there.

    Args:
        fitter: of the weighing; here: see `Fitter.carried`; seen: runs that it was fitted to.
    """
    known = {id(run) for run in seen}
    for place, effect in enumerate(here.effects):
        if effect.site not in _LIMITS:
            continue
        others = here.effects[:place] + here.effects[place + 1 :]
        without = fitter.residuals(others, here.without(place))
        gains = [0.0, 0.0]
        for index, (r, free) in enumerate(zip(here.residuals, without, strict=True)):
            with np.errstate(over="ignore", invalid="ignore"):
                gains[id(weighing.model.runs[index // 2]) in known] += float(free @ free - r @ r)
        if gains[False] > _DEEPER * max(gains[True], 1.0):
            return True
    return False


def fitter_with_nuisance(weighing: Weighing, best: Fit, largest: float = WAVY) -> Fitter:
    """A fitter that includes scatter of contacts, and a wave of the encoder's scale if there is one.

    Args:
        best: the best fit, on the weighing's runs; largest: see `nuisance.waves`.
    """
    scattered = scatter(weighing.model, Weighted(weighing.model, weighing.weights), best)
    fitter = weighing.fitter(None, scattered)
    waved = waves(weighing.model, fitter.marginal.left(best.residuals), weighing.weights, largest)
    return fitter if waved is None else weighing.fitter(waved, scattered)
