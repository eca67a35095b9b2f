"""Search for the effects that explain a system's logs, whose residuals are neither white nor as specified."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...system.connection import Port
from ..descent import cost_of
from ..effect import Effect
from ..fit import Fit, Fitter
from ..search import Search, each, exchanged, search
from ..search_progress import counted_calls, stage
from ..study import Array
from .comb import Comb
from .effect import PortEffect
from .replay import PortReplay, Weighted
from .study import PortRun
from .wary import WaryFitter

__all__ = ["carries", "is_noise", "sought"]

# What residuals that are but noise carry at most; see `carries`.
_NOISE = 1.5
# How many effects an answer may hold.
_LONGEST = 4
# Values that fits begin from, of what runs tell only from very near.
_STARTS = 2
# Values of a logged signal that the begin of a run must hold for a resolution to be looked for in it.
_MANY = 32
# Of what the most promising effect promises to save of the cost: what such a value must save from afar.
_SHARE = 0.1
# Searches with better and better weights at most, and how much better they must be for another one.
_ROUNDS, _BETTER = 2, 1.5
# Fits of the search before that are taken up with better weights.
_RESUMED = 8


def carries(r: Array) -> float:
    """What the square of a normalised residual is divided by: its mean square times its correlation time.

    The correlation time is 1 + 2 times the sum of autocorrelations until the first that is not positive, in
    samples. Residuals that are noise as specified give about one.

    Args:
        r: shape (n,).
    """
    n = len(r)
    square = float(np.mean(r**2))
    if not math.isfinite(square) or square == 0.0:
        return 1.0
    spectrum = np.abs(np.fft.rfft(r, 2 * n)) ** 2
    correlation = np.fft.irfft(spectrum)[:n]
    correlation /= correlation[0]
    below = np.flatnonzero(correlation <= 0.0)
    last = int(below[0]) if below.size else n
    time = 1.0 + 2.0 * float(correlation[1:last].sum())
    # A few percent above one are chance.
    return max(square * time, 1.0) if time > 1.5 or square > 1.5 else 1.0


def is_noise(replay: PortReplay, fit: Fit) -> bool:
    """Whether a fit leaves nothing but noise as specified, of any run and port."""
    return max(map(carries, replay.of(fit))) <= _NOISE


def sought(replay: PortReplay, effects: Sequence[Effect], workers: int) -> tuple[Fitter, Search]:
    """The effects, and up to four of them together, that explain logs best.

    Args:
        workers: threads; what is found does not depend on them.
    Returns: by what they were fitted, its replay weighted by what each channel's residuals carry; and what
        was found.
    """
    stage("candidates")
    plain = WaryFitter(replay).fit(())
    # What a channel carries is recognised by what the best model at hand leaves of it: what an effect would
    # explain is slow, and makes a channel seem to carry little before the effect is found. So effects are
    # first sought as if residuals were white, only to see what remains.
    white = WaryFitter(Weighted(replay, _weights(replay, plain.residuals, _square)))
    about = white.base((), white.fit(()).z)

    def promise(effect: Effect) -> float:
        return white.screen(effect, [about])[0]

    promised = min(each(counted_calls(promise, False, workers), effects, workers), default=math.inf)
    # Where others promise to explain much, what hardly explains anything is looked for beside them.
    cost = cost_of(about.r, about.z)
    share = _SHARE * max(1.0 - promised / cost, 0.0) if cost > 0.0 else 0.0
    effects = _combed(replay, effects, plain, workers, share)

    stage("white")
    explored = search(white, effects, workers=workers, enough=lambda fit: is_noise(replay, fit))
    if is_noise(replay, explored.best):
        # Few effects were tried beside others.
        return _found(replay, effects, explored, explored.best, workers)
    best = min((explored.none, *explored.fits), key=lambda fit: fit.cost)
    some = _combed(replay, _promising(effects, explored), best, workers)
    return _found(replay, some, explored, best, workers)


def _combed(
    replay: PortReplay, effects: Sequence[Effect], base: Fit, workers: int, share: float = 0.0
) -> tuple[Effect, ...]:
    """Effects with starts, of those that runs tell only from very near, where they do best beside a model.

    Args:
        share: see `Comb.best`.
    """
    step = replay.study.interval
    looked = [_parts(replay, run) for run in _telling(replay)]

    def combed(effect: Effect) -> Effect:
        comb = effect.comb if isinstance(effect, PortEffect) else None
        if comb is None or any(effect.id == one.id for one in base.effects):
            return effect
        for parts in looked:
            best = sought_in(parts, comb, effect)
            if best:
                return replace(effect, parameters=(replace(effect.parameters[0], starts=tuple(best)),))
        return effect

    def sought_in(parts: dict[int, PortReplay], comb: Comb, effect: Effect) -> list[float]:
        def cost(value: float, samples: int) -> float:
            model = (*base.effects, effect), np.array([*base.theta, value])
            left = parts[samples].residuals(base.calibrated, *model)
            total = sum(float(r @ r) for r in left)
            return total if math.isfinite(total) else math.inf

        ends = [end for end in parts if not comb.chance or many(parts[end], effect, end)]
        return comb.best(cost, [(end, end * step) for end in ends or [*parts][-1:]], share)[:_STARTS]

    def many(part: PortReplay, effect: Effect, end: int) -> bool:
        # Of a signal that is held for long the begin of a run has few values, which many steps meet.
        log = part.runs[0].logs.get(effect.port) if isinstance(effect, PortEffect) and effect.port else None
        return log is None or len(np.unique(log[:end])) > _MANY

    return tuple(each(counted_calls(combed, False, workers), effects, workers))


def _telling(replay: PortReplay) -> list[PortRun]:
    """Runs of which each is compared where none before it is: one will do where all have all logs."""
    found, seen = [], set[Port]()
    for run in replay.runs:
        if not set(replay.compared(run)) <= seen:
            seen |= set(replay.compared(run))
            found.append(run)
    return found


def _parts(replay: PortReplay, run: PortRun) -> dict[int, PortReplay]:
    """Replays of the beginnings of a run, the longest of which is all of it, by their numbers of samples."""
    settled = replay.study.settled
    more = len(run) - settled
    ends = [settled + max(more // part, 1) for part in (8, 4, 2, 1)]
    return {end: PortReplay(replay.study, [run.until(end)]) for end in ends}


def _promising(effects: Sequence[Effect], explored: Search) -> tuple[Effect, ...]:
    """Effects that came near the best, in whatever form: what did not then will not with other weights."""
    near = {one for fit in explored.fits for effect in fit.effects for one in _names(effect)}
    return tuple(one for one in effects if near & _names(one))


def _names(effect: Effect) -> set[str]:
    family = effect.family if isinstance(effect, PortEffect) else ""
    return {effect.id, family} if family else {effect.id}


def _found(
    replay: PortReplay, effects: Sequence[Effect], explored: Search, best: Fit, workers: int
) -> tuple[Fitter, Search]:
    """A search in which channels count by what the best model at hand leaves of them, and its fitter.

    Where it finds a much better one, channels carry more than that, and are searched again.

    Args:
        explored: a search by other weights.
    """
    weights = _carried(replay, best)
    for _ in range(_ROUNDS):
        stage("single")
        fitter = WaryFitter(Weighted(replay, weights))
        first = search(fitter, effects, longest=_LONGEST, workers=workers)
        first = first.beside(_resumed(fitter, effects, explored, workers))
        explored = found = _reconsidered(fitter, effects, first, workers)
        effects = _promising(effects, found)
        before, weights = weights, _carried(replay, found.best)
        if max(now / then for now, then in zip(weights, before, strict=True)) < _BETTER:
            break
    return fitter, found


def _resumed(fitter: Fitter, effects: Sequence[Effect], explored: Search, workers: int) -> list[Fit]:
    """Fits like the best of a search by other weights, begun where they ended.

    What switches from one sample to the next, as dry friction, has many dents: from its own starts a fit
    may end in another one than it did before, and a law that can do less is then taken for a worse one.
    """
    by_id, count = {one.id: one for one in effects}, len(fitter.nominal)
    known = [fit for fit in explored.fits if all(one.id in by_id for one in fit.effects)]

    def resumed(fit: Fit) -> Fit | None:
        some = tuple(by_id[one.id] for one in fit.effects)
        try:
            return fitter.fit(some, fit.z[:count], fit.z[count:])
        except np.linalg.LinAlgError:
            return None

    fits = each(counted_calls(resumed, True, workers), known[:_RESUMED], workers)
    return [fit for fit in fits if fit is not None and math.isfinite(fit.cost)]


def _carried(replay: PortReplay, fit: Fit) -> list[float]:
    return _weights(replay, replay.of(fit), carries)


def _reconsidered(fitter: Fitter, effects: Sequence[Effect], found: Search, workers: int) -> Search:
    """A search whose best pair was tried with others, where two effects or more do best.

    The first one may have been a wrong one that the others make good.
    """
    pairs = [fit for fit in found.fits if len(fit.effects) == 2]
    if len(found.best.effects) < 2 or not pairs:
        return found
    return found.beside(exchanged(fitter, effects, pairs[0], workers))


def _square(r: Array) -> float:
    return max(float(np.mean(r**2)), 1.0)


def _weights(
    replay: PortReplay, residuals: Sequence[Array], divisor: Callable[[Array], float]
) -> list[float]:
    """Weights by what is left of channels; of several runs' like channels, by the mean."""
    kept: dict[Port, list[float]] = {}
    for (_, port), r in zip(replay.channels, residuals, strict=True):
        kept.setdefault(port, []).append(divisor(r))
    return [1.0 / math.sqrt(float(np.mean(kept[port]))) for _, port in replay.channels]
