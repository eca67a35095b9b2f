"""Whether answers foresee runs that no fit saw: by what it is judged what they leave unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from .benign import WAVY, Weighing, Weighted, force_weights, scatter, waves
from .colour import Colour
from .descent import cost_of
from .effect import Site
from .fit import Base, Fit, Fitter
from .remainder import Remains, own_error, remains
from .study import Array, Run

__all__ = ["Judge", "Leaves", "reckoned"]

# Squares of residuals that are much, and share of those beyond their number that is most.
_MUCH, _MOST = 200.0, 0.5
# A wave that is small in some runs may be a little larger in all.
_WAVIER = 1.25 * WAVY
# Where effects act that may not show at all in runs a little slower than others.
_LIMITS = (Site.RATE, Site.LIMIT)


class Leaves(NamedTuple):
    """What a fit leaves unexplained of the runs that it saw, and of all, which may be the same.

    Attributes:
        own_error: see `remainder.own_error`, of all runs.
    """

    seen: Remains
    every: Remains
    own_error: float

    @property
    def parts(self) -> tuple[float, ...]:
        """See `answers.Answer`."""
        return (*self.seen, *self.every)

    @property
    def total(self) -> float:
        """Of all runs [nats]."""
        return self.every.total

    def changed(self, **parts: float) -> Leaves:
        """The same, with other parts."""
        return self._replace(seen=self.seen._replace(**parts), every=self.every._replace(**parts))


class _By(NamedTuple):
    """A weighing, and its fitter."""

    weighing: Weighing
    fitter: Fitter


@dataclass(frozen=True)
class Judge:
    """By what it is judged what fits leave.

    Attributes:
        weighing, fitter: by which fits were made; every: the same of all runs, if there are others.
        colour: small coloured noise of the force, see `stochastic.Force`.
        limited: whether further runs reach a limit that the others do not, and so are left out.
    """

    weighing: Weighing
    fitter: Fitter
    colour: Colour
    every: _By | None = None
    limited: bool = False
    _carried: dict[int, tuple[Fit, Array]] = field(default_factory=dict, compare=False, repr=False)
    _leaves: dict[int, tuple[Fit, Leaves]] = field(default_factory=dict, compare=False, repr=False)

    def over(self, runs: Sequence[Run], best: Fit, louder: float, lost: bool) -> Judge:
        """A judge of further runs, too.

        No number is fitted to these: they show whether a model that was fitted to others foresees them. It
        cannot where they reach a limit that the others do not.

        Args:
            runs: all of them; best: the best fit; louder, lost: see `benign.force_weights`.
        """
        model, weights = self.weighing.model.over(runs), force_weights(runs, louder, lost)
        weighing = replace(self.weighing, model=model, weights=weights, known={})
        fitter = weighing.fitter()
        here, derivatives = fitter.carried(best)
        if _limited(weighing, fitter, here, derivatives):
            return replace(self, limited=True)
        return Judge(
            self.weighing, self.fitter, self.colour, _By(weighing, reckoned(weighing, here, _WAVIER))
        )

    def leaves(self, fit: Fit) -> Leaves:
        """What a fit leaves unexplained."""
        if id(fit) not in self._leaves:
            self._leaves[id(fit)] = fit, self._left(fit)
        return self._leaves[id(fit)][1]

    def carried(self, fit: Fit) -> tuple[Fit, Array]:
        """A fit on all runs, if there are others than it saw: see `Fitter.carried`."""
        assert self.every is not None
        if id(fit) not in self._carried:
            self._carried[id(fit)] = self.every.fitter.carried(fit)
        return self._carried[id(fit)]

    def _left(self, fit: Fit) -> Leaves:
        seen = remains(self.weighing, self.fitter, fit, self.colour)
        if self.every is None:
            return Leaves(seen, seen, own_error(self.weighing, self.fitter, fit, seen.total))
        here, chosen = self.carried(fit)
        every = remains(*self.every, here, self.colour, chosen)
        return Leaves(seen, every, own_error(*self.every, here, every.total))


def _limited(weighing: Weighing, fitter: Fitter, here: Fit, derivatives: Array) -> bool:
    """Whether a limit that runs themselves show, and no fit has met, explains most of what a fit leaves.

    Args:
        fitter: of the weighing; here, derivatives: see `Fitter.carried`.
    """
    base = Base(here.effects, here.z, fitter.marginal.stacked(here.residuals), derivatives)
    cost = cost_of(base.r, base.z)
    least = max(_MUCH, _MOST * (cost - len(base.r)))
    limits = [one for one in weighing.effects if one.site in _LIMITS and one not in here.effects]
    return any(cost - fitter.screen(one, [base])[0] > least for one in limits)


def reckoned(weighing: Weighing, best: Fit, largest: float = WAVY) -> Fitter:
    """A fitter that reckons with contacts that scatter and a wave of the encoder's scale, if there is one.

    Args:
        best: the best fit, on the weighing's runs; largest: see `benign.waves`.
    """
    scattered = scatter(weighing.model, Weighted(weighing.model, weighing.weights), best)
    fitter = weighing.fitter(None, scattered)
    waved = waves(weighing.model, fitter.marginal.left(best.residuals), weighing.weights, largest)
    return fitter if waved is None else weighing.fitter(waved, scattered)
