"""Fits of effects whose residuals are smooth functions of their parameters from afar only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from ..descent import cost_of
from ..effect import Effect
from ..fit import Base, Fit, Fitter
from ..study import Array
from .chance import chance_saves
from .comb import Comb
from .effect import PortEffect

__all__ = ["WaryFitter"]

# Factors by which a parameter is changed while that does better, those of one that runs tell only from very
# near, and that by which a size is screened.
_STRIDES, _FINE, _LONG = (3.0, 1.7, 1.3, 1.1, 1.03), (1.03, 1.01, 1.003, 1.001, 1.0003), 3.0
# Those of them that are tried again after a descent.
_AGAIN = slice(1, None, 2)
# Walks and descents in turn, walks over all parameters at one stride, at most; and of cost that is worth one.
_TURNS, _WALKS, _WORTH = 4, 6, 1.0
# Of a parameter, by which it is moved for a derivative, of one that runs tell only from very near, and of the
# prior at least.
_SHARE, _LITTLE, _SMALLEST = 0.05, 3e-4, 5e-5


class WaryFitter(Fitter):
    """Fits as `Fitter` does, but finds its way by differences from afar.

    A limit, a play or dry friction switches from one sample to the next: a descent by derivatives ends in
    some dent. So each parameter is first changed by factors, by less and less, while that does better, and
    derivatives are taken over some share of a parameter; both in turn.
    """

    _patient: ClassVar[bool] = True

    def fit(
        self,
        effects: tuple[Effect, ...],
        begin: Array | None = None,
        start: Array | None = None,
        known: Array | None = None,
        aim: float = math.inf,
    ) -> Fit:
        """See `Fitter`."""
        if not effects or start is None:
            return super().fit(effects, begin, start, known, aim)
        count = len(self.nominal)
        z = np.concatenate([self.nominal if begin is None else begin, start])
        found = None
        for turn in range(_TURNS):
            z, cost = self._walked(effects, z, _AGAIN if turn else slice(None))
            if found is not None and not cost < found.cost - _WORTH:
                break
            ahead = super().fit(effects, z[:count], z[count:], None, aim)
            if found is not None and not ahead.cost < found.cost - _WORTH:
                break
            found, z = ahead, ahead.z
            if found.cost > aim:
                break
        assert found is not None
        return found if found.cost > aim else self._paying(found)

    def _paying(self, fit: Fit) -> Fit:
        """A fit whose volume is as small as chance makes it where values were sought among many: see
        `chance_saves`. For less Laplace's has paid.
        """
        for place, effect in enumerate(fit.effects):
            comb = effect.comb if isinstance(effect, PortEffect) else None
            if comb is None or not comb.chance or not fit.z[self._first(fit.effects, place)]:
                continue
            fit = replace(fit, log_determinant=fit.log_determinant + 2.0 * self._unpaid(fit, place, comb))
        return fit

    def _unpaid(self, fit: Fit, place: int, comb: Comb) -> float:
        """What chance saves beyond what the volume of a fit pays for one of its effects [nats]."""
        effect, at = fit.effects[place], self._first(fit.effects, place)
        others, z = fit.effects[:place] + fit.effects[place + 1 :], fit.without(place)
        r = self.stacked(others, z)
        if not np.isfinite(r).all():
            return 0.0  # without it the model runs away, which is not what chance mends
        columns = self.jacobian(others, z, r, range(len(z)))
        scale = effect.parameters[0].scale

        def trace(value: float) -> Array:
            ahead = fit.z.copy()
            ahead[at] = value / scale
            return self.stacked(fit.effects, ahead)

        value = float(fit.z[at]) * scale
        saved = chance_saves(comb, value, trace, (r, trace(value)), columns, z)
        _, rest = np.linalg.slogdet(columns.T @ columns + np.eye(len(z)))
        return max(saved - 0.5 * (fit.log_determinant - float(rest)), 0.0)

    def _first(self, effects: tuple[Effect, ...], place: int) -> int:
        """Where the parameters of an effect begin."""
        return len(self.nominal) + sum(len(one.parameters) for one in effects[:place])

    def _column(self, effects: tuple[Effect, ...], z: Array, r: Array, place: int) -> Array:
        """See `Fitter`; by the effects' parameters over a share of them."""
        count = len(self.nominal)
        if place < count:
            return super()._column(effects, z, r, place)
        one = [one for effect in effects for one in effect.parameters][place - count]
        share = _SHARE if one.smooth else _LITTLE
        return self._difference(effects, z, r, place, max(share * abs(z[place]), _SMALLEST))

    def screen(self, effect: Effect, bases: Sequence[Base]) -> tuple[float, Base, Array]:
        """See `Fitter`; also from where the best start leads."""
        cost, base, start = super().screen(effect, bases)
        if not math.isfinite(cost) or not effect.parameters[0].smooth:
            return cost, base, start
        effects, place = (*base.effects, effect), len(base.z)
        z = np.concatenate([base.z, start])
        z, _ = self._changed(effects, z, cost_of(self.stacked(effects, z), z), place, _LONG)
        ahead = self._promise(effect, base, z[place:])
        return (ahead, base, z[place:]) if ahead < cost else (cost, base, start)

    def _walked(self, effects: tuple[Effect, ...], z: Array, some: slice) -> tuple[Array, float]:
        """Where changes by some of the factors lead, and its cost."""
        cost = cost_of(self.stacked(effects, z), z)
        parameters = [one for effect in effects for one in effect.parameters]
        for stride, fine in zip(_STRIDES[some], _FINE[some], strict=True):
            for _ in range(_WALKS):
                before = cost
                for place, one in enumerate(parameters, len(self.nominal)):
                    z, cost = self._changed(effects, z, cost, place, stride if one.smooth else fine)
                if cost == before:
                    break
        return z, cost

    def _changed(
        self, effects: tuple[Effect, ...], z: Array, cost: float, place: int, stride: float
    ) -> tuple[Array, float]:
        """One parameter by a factor or its inverse, again and again while that does better."""
        one = [one for effect in effects for one in effect.parameters][place - len(self.nominal)]
        before = cost
        for factor in (1.0 / stride, stride):
            if cost < before:
                break  # the other way lies what it came from
            while True:
                ahead = z.copy()
                ahead[place] = z[place] + math.log(factor) / one.scale if one.shape else z[place] * factor
                ahead = self._bounded(effects, ahead)
                if ahead[place] == z[place]:
                    break
                cost_ahead = cost_of(self.stacked(effects, ahead), ahead)
                if not cost_ahead < cost - _WORTH:
                    break
                z, cost = ahead, cost_ahead
        return z, cost
