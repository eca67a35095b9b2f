"""Forward search for the effects that explain a group of logs, alone and combined."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from .descent import cost_of
from .effect import Effect
from .fit import Base, Fit, Fitter
from .study import Array

# Effects at this share of their priors are roughness that every rig has, where nothing better was learned.
_ROUGH = 0.005
# Share of the prior by which they are moved for a derivative.
_MOVED = 0.02
_KEPT_SINGLES, _KEPT_PAIRS, _LONGEST = 7, 4, 3
# Fits that stay this far above the best cost found are given up.
HOPELESS = 60.0
# An effect is sought beside another one, and beside several, where the linearised problem promises to lower
# the cost by this much.
_PROMISING, _PROMISING_MORE = 6.0, 20.0

# Threads that fit.
_THREADS = 2

_In, _Out = TypeVar("_In"), TypeVar("_Out")


@dataclass(frozen=True)
class Search:
    """What a search found.

    Attributes:
        none: the fit of the calibration alone; beside what is there anyway.
        fits: of one effect and more, largest log evidence first.
    """

    none: Fit
    fits: tuple[Fit, ...]

    @property
    def best(self) -> Fit:
        """The fit of the largest log evidence, none where no effect has any."""
        return self.fits[0] if self.fits and self.gain(self.fits[0]) > 0.0 else self.none

    def gain(self, fit: Fit) -> float:
        """Log evidence of a fit over that of none [nats]."""
        return fit.log_evidence - self.none.log_evidence

    def including(self, fits: Sequence[Fit]) -> Search:
        """With further fits, of the same effects the ones of least cost."""
        unique: dict[frozenset[str], Fit] = {}
        for fit in (*self.fits, *fits):
            key = _key(fit.effects)
            if key not in unique or fit.cost < unique[key].cost:
                unique[key] = fit
        return Search(self.none, tuple(sorted(unique.values(), key=lambda fit: -fit.log_evidence)))


def each(function: Callable[[_In], _Out], items: Sequence[_In]) -> list[_Out]:
    """A function's results in the order of the items; replays release the interpreter's lock."""
    with ThreadPoolExecutor(max_workers=_THREADS) as pool:
        return list(pool.map(function, items))


class Direction(NamedTuple):
    """Derivative of the stacked residuals by the size of an effect.

    Attributes:
        place: of the start of its shape, among all of them that there are; many: how many.
    """

    effect: Effect
    place: int
    many: int
    column: Array


def roughness(
    fitter: Fitter,
    effects: Sequence[Effect],
    sizes: Mapping[str, Sequence[float]] | None = None,
    about: Fit | None = None,
) -> Array:
    """Directions of the stacked residuals in which every rig deviates a little, as effects would move them.

    Args:
        sizes: standard deviations, as shares of the effect's prior, one per start of its shape, by id.
        about: of a model with other effects; by default, the nominal one.
    Returns: one column per effect and start, scaled to one standard deviation, shape (residuals, k).
    """
    at, beside = (None, ()) if about is None else (about.z, about.effects)
    columns = []
    for effect, place, many, column in directions(fitter, effects, at, beside):
        own = (sizes or {}).get(effect.id, ())
        # An effect whose starts are others by now is taken to be as rough along each as before on average.
        usual = math.sqrt(sum(one**2 for one in own) / many) if own else _ROUGH / math.sqrt(many)
        columns.append((own[place] if len(own) == many else usual) * column)
    return np.column_stack(columns) if columns else np.zeros((fitter.stacked((), fitter.nominal).size, 0))


def directions(
    fitter: Fitter, effects: Sequence[Effect], at: Array | None = None, beside: tuple[Effect, ...] = ()
) -> list[Direction]:
    """Derivatives of the stacked residuals by the sizes of effects, at size zero.

    Effects whose size is no continuous parameter that vanishes at zero are left out.

    Args:
        at: normalised parameters; the nominal calibration by default.
        beside: effects that are there.
    """
    z = fitter.nominal if at is None else at
    r = fitter.stacked(beside, z)
    found = []
    for effect in effects:
        if effect.parameters[0].whole or effect.parameters[0].shape or effect.statistic or effect in beside:
            continue
        shapes = sorted({tuple(one[1:]) for one in fitter.starts(effect)})
        for place, shape in enumerate(shapes):
            column = (fitter.stacked((*beside, effect), np.concatenate([z, [_MOVED], shape])) - r) / _MOVED
            if np.isfinite(column).all():
                found.append(Direction(effect, place, len(shapes), column))
    return found


def search(
    fitter: Fitter,
    effects: Sequence[Effect],
    always: tuple[Effect, ...] = (),
    longest: int = _LONGEST,
    thorough: bool = False,
) -> Search:
    """Fit none, the most promising single effects, and combinations built from the best of them.

    Args:
        effects: to choose from.
        always: effects that every model holds.
        longest: how many effects a combination may have.
        thorough: whether each effect of the best combination is tried to be exchanged for others.
    """
    count = len(fitter.replay.tolerances)
    start = np.concatenate([fitter.starts(one)[0] for one in always]) if always else None
    none = fitter.fit(always, None, start)
    nominal = np.concatenate([np.zeros(count), none.z[count:]])
    bases = each(lambda z: fitter.base(always, z), [nominal, none.z])
    found: list[Fit] = _grow(fitter, effects, bases, none.cost, _KEPT_SINGLES)
    level = found
    for size in range(2, longest + 1):
        level = sorted(level, key=lambda fit: -fit.log_evidence)[:2]
        promising = _PROMISING if size == 2 else _PROMISING_MORE
        if not level or level[0].cost > none.cost - promising:
            break
        before = level[0]
        bases = each(lambda fit: fitter.base(fit.effects, fit.z), level)
        level = _grow(fitter, effects, bases, level[0].cost - promising, _KEPT_PAIRS)
        level = [fit for fit in level if len(fit.effects) == size + len(always)]
        found += level
        if max((fit.log_evidence for fit in level), default=-math.inf) < before.log_evidence + 5.0:
            break
    made = Search(none, ()).including(found)
    best = made.fits[0] if made.fits else none
    shorter = _without_one(fitter, best, len(always)) if len(best.effects) - len(always) > 2 else []
    top = max([best, *shorter], key=lambda fit: fit.log_evidence)
    others = shorter
    if top is not best or (thorough and len(top.effects) - len(always) > 1):
        # An effect that is not needed misled the search: others like the remaining ones were never fitted.
        begun = shorter if shorter and top is best else _without_one(fitter, top, len(always))
        others = [*shorter, *_further(fitter, effects, begun)]
    known = {_key(fit.effects) for fit in made.fits}
    return made.including([fit for fit in others if _key(fit.effects) not in known])


def _further(fitter: Fitter, effects: Sequence[Effect], begun: Sequence[Fit]) -> list[Fit]:
    """Fits with one effect more than those begun with, the most promising ones."""
    bases = each(lambda fit: fitter.base(fit.effects, fit.z), begun)
    return _grow(fitter, effects, bases, math.inf, _KEPT_PAIRS)


def _key(effects: Sequence[Effect]) -> frozenset[str]:
    return frozenset(effect.id for effect in effects)


def _without_one(fitter: Fitter, fit: Fit, kept: int) -> list[Fit]:
    """Fits of all effects but one, begun where a fit of all ended.

    Forward search may begin with an effect that the right ones, once they are all there, leave nothing to do.

    Args:
        kept: how many effects, the first ones, always stay.
    """
    count, found = len(fitter.replay.tolerances), []
    for place in range(kept, len(fit.effects)):
        z = fit.without(place)
        others = fit.effects[:place] + fit.effects[place + 1 :]
        try:
            found.append(fitter.fit(others, z[:count], z[count:], aim=fit.cost + HOPELESS))
        except np.linalg.LinAlgError:
            continue
    return [one for one in found if math.isfinite(one.cost)]


def _grow(
    fitter: Fitter, effects: Sequence[Effect], bases: Sequence[Base], highest: float, kept: int
) -> list[Fit]:
    """Fit the most promising effects on top of some bases.

    Args:
        highest: cost that the linearised problem must promise to stay below.
        kept: how many are fitted at most.
    """
    tasks = [
        (effect, base)
        for effect in effects
        for base in _distinct(bases)
        if all(effect.id != other.id for other in base[0].effects)
    ]

    def promise(task: tuple[Effect, tuple[Base, ...]]) -> tuple[float, Base, Array]:
        return fitter.screen(task[0], task[1])

    screened = [
        (cost, effect, base, start)
        for (effect, _), (cost, base, start) in zip(tasks, each(promise, tasks), strict=True)
        if cost < highest
    ]
    screened.sort(key=lambda one: one[0])
    chosen, seen = [], set()
    for one in screened:
        key = frozenset([*(effect.id for effect in one[2].effects), one[1].id])
        if key not in seen and len(chosen) < kept:
            chosen.append(one)
            seen.add(key)

    aim = math.inf

    def fitted(one: tuple[float, Effect, Base, Array]) -> Fit | None:
        _, effect, base, start = one
        count = len(fitter.replay.tolerances)
        try:
            fit = fitter.fit(
                (*base.effects, effect), base.z[:count], np.concatenate([base.z[count:], start]),
                base.jacobian[:, :count], aim,
            )  # fmt: skip
            return counted(fitter, fit, count, aim) if effect.parameters[0].whole else fit
        except np.linalg.LinAlgError:
            return None

    found: list[Fit] = []
    for first in range(0, len(chosen), 2):  # two at a time: what is given up does not depend on the machine
        fits = each(fitted, chosen[first : first + 2])
        found += [fit for fit in fits if fit is not None and math.isfinite(fit.cost)]
        aim = min([fit.cost for fit in found], default=math.inf) + HOPELESS
    return found


def counted(fitter: Fitter, fit: Fit, count: int, aim: float) -> Fit:
    """A fit, or the better one with another integer parameter of its last effect.

    Where the number was screened, calibration and other effects had taken up what it does. Beside the
    nominal calibration they have not.

    Args:
        count: of calibrated numbers; aim: see `Fitter.fit`.
    """
    place = len(fit.z) - len(fit.effects[-1].parameters)
    number = fit.effects[-1].parameters[0]
    best, least = fit.z, math.inf
    for value in range(math.ceil(number.low), math.floor(number.high) + 1):
        z = fit.z.copy()
        z[:count], z[place] = 0.0, value / number.scale
        cost = cost_of(fitter.stacked(fit.effects, z), z)
        if cost < least:
            best, least = z, cost
    if best[place] == fit.z[place]:
        return fit
    other = fitter.fit(fit.effects, None, best[count:], None, aim)
    return other if other.cost < fit.cost else fit


def _distinct(bases: Sequence[Base]) -> list[tuple[Base, ...]]:
    """Bases grouped by their effects: an effect is screened from all bases with equal effects at once."""
    groups: dict[tuple[Effect, ...], list[Base]] = {}
    for base in bases:
        groups.setdefault(base.effects, []).append(base)
    return [tuple(group) for group in groups.values()]


def separation(fitter: Fitter, one: Fit, other: Fit) -> float:
    """Log evidence that data like these give between two fitted models, if one of them is true [nats]."""
    apart = fitter.stacked(one.effects, one.z) - fitter.stacked(other.effects, other.z)
    return 0.5 * float(apart @ apart)
