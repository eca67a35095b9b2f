"""Read a law off the estimated unknown input, then fit it in the filter itself.

A regression of w on each law of the library finds the few that are worth a fit. The fit puts the law into the
system, with its numbers as constants of the filter beside the calibrated parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.units import parse_unit
from .evaluation import Inserted, Kinds, Place
from .laws import Law, dimension, library
from .model import StateModel
from .places import Ranked, Runs, loglik, smoothed_at

Array = NDArray[np.float64]
# Samples of a run that the regression looks at.
_SAMPLES = 400
# Candidates with states of their own that are fitted.
_BLIND = 12
# Intensities of the unknown input beside a law, in turn.
_WEAKER = (1.0, 1e-2, 1e-4)
# What joins parts of a machine rather than flows between them, by `_dimension`; see `Law.unlogged`.
_JOINS = ("speed", "travel", "angle", "potential", "pressure")
_SPEED = parse_unit("m/s")
# Places of laws that name none.
_USUAL = (Kinds.INPUT, Kinds.RATE, Kinds.OUTPUT)


@dataclass(frozen=True)
class Candidate:
    """A law at a place, reading a signal.

    Attributes:
        share: of w's power on the stretches that the regression did not see, which the law explains.
        numbers: where its fit begins. second: the second signal that the law reads, or "".
        odds: how likely the law is there before the logs are seen.
        beside: parameters, numbers of laws that are fitted already, and start states of each run, which suit
            the law by its score.
    """

    law: Law
    place: Place
    signal: str
    inserted: Inserted
    numbers: tuple[float, ...]
    share: float
    second: str = ""
    odds: float = 1.0
    beside: tuple[Array, list[Array]] | None = field(default=None, compare=False, repr=False)

    @property
    def name(self) -> str:
        """Place, law and signals."""
        if self.place.kind is Kinds.EXCHANGE:
            return f"{self.law.name} from {self.signal} to {self.second}"
        second = f" and {self.second}" if self.second else ""
        return f"{self.law.name} at {self.place.name} of {self.signal}{second}"


@dataclass(frozen=True)
class Fitted:
    """Laws fitted together.

    Attributes:
        laws: candidates; numbers: theirs, one after the other; sigmas: standard deviations.
        loglik: of the runs. constants: mean and covariance of parameters and numbers.
        beside: share of the unknown input's intensity that is left beside the laws.
    """

    laws: tuple[Candidate, ...]
    numbers: Array
    sigmas: Array
    loglik: float
    constants: tuple[Array, Array]
    beside: float = 0.0

    def by_law(self) -> Iterator[tuple[Candidate, Array, Array]]:
        """Each law with its numbers and their standard deviations."""
        at = 0
        for one in self.laws:
            part = slice(at, at := at + len(one.law.numbers))
            yield one, self.numbers[part], self.sigmas[part]


def _unit(model: StateModel, index: int) -> str:
    ports = [*model.states, *model.inputs, *model.outputs]
    return model.study.unit(ports[index])


def _dimension(model: StateModel, place: Place) -> str:
    """What a quantity at a place measures, as laws ask for it; see `Law.at`.

    The derivative of a speed counts as a force, unless the component is given speeds of this kind, but no
    forces, and does not hold its travel: then it may be a filter of them. A speed counts as a flow only in a
    component with a level, and without forces and speeds of its own.
    """
    nx, nu = len(model.states), len(model.inputs)
    row = model.rows[place.component]
    units = [_unit(model, k) for k in model.states_of(row)]
    states = set(map(dimension, units))
    inputs = {dimension(_unit(model, nx + k)) for k in model.inputs_of(row)}
    if place.kind in (Kinds.RATE, Kinds.EXCHANGE):
        found = dimension(_unit(model, place.index))
        found = {"rate": "force", "travel": "rate"}.get(found, found)
        given = (parse_unit(_unit(model, nx + k)) for k in model.inputs_of(row))
        own = parse_unit(_unit(model, place.index))
        filters = "force" not in inputs and place.index not in model.speeds.values()
        if found == "force" and filters and any(map(own.same_dimension, given)):
            return "filtered"
    else:
        at = (nx if place.kind is Kinds.INPUT else nx + nu) + place.index
        found = dimension(_unit(model, at))
        if found == "temperature":
            return "potential"  # heat flows into its derivative, not into a temperature that is given
    moves = "force" in inputs or any(map(_SPEED.same_dimension, map(parse_unit, units)))
    if found == "rate" and ("travel" not in states or moves):
        return "speed"
    return found


def readable(model: StateModel, place: Place, rare: bool = False) -> list[Candidate]:
    """Laws that can act at a place, each with the signals there that it reads.

    Args:
        rare: rare laws, and not the others.
    """
    own, what = model.own_signal(place), _dimension(model, place)
    signals = model.signals_of(place)
    if own is not None:
        signals = {**signals, place.name: own}
    logged = place.name in {str(port) for port in (*model.fed, *model.compared)}
    joins = what in _JOINS and not logged
    found = []
    for law in library():
        if law.rare is not rare or int(place.kind) not in (law.kinds or _USUAL):
            continue
        if law.second and not model.filters:
            continue  # a system that is replayed by its master reads one signal
        if joins and not law.unlogged:
            continue
        for name, index in signals.items():
            if not law.fits(_unit(model, index), index == own, what):
                continue
            if not law.second:
                found.append(_candidate(law, place, name, (index,), joins))
            found += [
                _candidate(law, place, name, (index, other), joins, second)
                for second, other in signals.items()
                if law.second
                and other != index
                and law.fits_second(_unit(model, other))
                and place.other != index  # an exchange is read one way
            ]
    return found


def _candidate(
    law: Law, place: Place, name: str, read: tuple[int, ...], joins: bool = False, second: str = ""
) -> Candidate:
    put = Inserted(place, law.address, read, len(law.numbers), law.states, law.settled, law.delay)
    return Candidate(law, place, name, put, (), 0.0, second, law.odds * (law.unlogged if joins else 1.0))


def starts_of(one: Candidate, runs: Runs) -> list[list[float]]:
    """Numbers where fits of a law begin, by the signals that it reads and the logs' interval."""
    first, second = one.inserted.signals[0], one.inserted.signals[-1]
    spread, interval = runs.spread[first], runs.model.study.interval
    sizes = {
        "spread": spread, "interval": interval, "rate": 1.0 / interval, "one": 1.0,
        "run": runs.length, "tone": runs.tone, "slope": runs.slope[first], "step": spread * interval,
        "second step": runs.spread[second] * interval,
        "most": max(abs(runs.low[first]), abs(runs.high[first])),
        "second": max(abs(runs.low[second]), abs(runs.high[second])),
        "product": spread * runs.spread[second],
        "range": runs.high[first] - runs.low[first],
        "second range": runs.high[second] - runs.low[second],
    }  # fmt: skip
    begins = {"range": runs.low[first], "second range": runs.low[second]}
    if sizes["range"] < one.law.covers or any(sizes[number.by] == 0.0 for number in one.law.numbers[1:]):
        return []
    return one.law.starts(sizes, begins)


def screened(
    runs: Runs, places: Sequence[Ranked], fixed: Fitted | None = None, most: int = 14
) -> list[Candidate]:
    """Laws that w at these places may be, best first; laws with states of their own come last, unscreened."""
    model, found, beyond, blind = runs.model, list[Candidate](), list[Candidate](), list[Candidate]()
    laws = () if fixed is None else tuple(one.inserted for one in fixed.laws)
    priors = () if fixed is None else list(zip(fixed.numbers, fixed.sigmas, strict=True))
    for ranked in places:
        place = ranked.place
        smoothed = smoothed_at(runs, ranked, laws, priors)
        if len(smoothed) < 1:
            continue
        pieces: list[tuple[Any, ...]] = []
        settled = model.study.settled
        for run in smoothed:
            stride = max(1, len(run["w"]) // _SAMPLES)
            at = slice(settled, None, stride)
            time = np.arange(len(run["w"]))[at] * model.study.interval
            weight = 1.0 / np.sqrt(np.abs(run["variance"][at]) + 1e-12 * run["w"].var() + 1e-300)
            pieces.append((time, run["w"][at], weight, run["signals"][at]))
        if len(pieces) == 1:  # the second half judges
            half = len(pieces[0][0]) // 2
            pieces = [tuple(v[:half] for v in pieces[0]), tuple(v[half:] for v in pieces[0])]
        known = sorted(set(model.signals_of(place).values()))
        for one in readable(model, place):
            starts = starts_of(one, runs)
            if one.law.states:
                blind += [replace(one, numbers=tuple(n)) for n in starts]
                continue
            both = _regressed(one, pieces, known, starts)
            for some, best in zip((found, beyond), both, strict=True):
                if best is not None and np.isfinite(best[1]).all():
                    some.append(replace(one, numbers=tuple(best[1]), share=best[0]))
    kept = spread_out(found, most, 3)
    kept += spread_out([one for one in beyond if one.name not in {k.name for k in kept}], most // 2, 2)
    return [*kept, *[*_sensors(model, runs), *blind][:_BLIND]]


def _sensors(model: StateModel, runs: Runs) -> list[Candidate]:
    """Lags and delays of what is compared, which no input of the plant imitates."""
    nx, nu = len(model.states), len(model.inputs)
    outputs = set(model.measured.tolist())
    return [
        replace(one, numbers=tuple(start))
        for place in model.places()
        if place.kind is Kinds.OUTPUT and place.index in outputs
        for law in library()
        if law.states and 3 in law.kinds and law.reads == "own" and not law.rare
        for one in [_candidate(law, place, place.name, (nx + nu + place.index,))]
        for start in starts_of(one, runs)
    ]


def spread_out(found: Sequence[Candidate], most: int, each: int) -> list[Candidate]:
    """The best ones, at most `each` of one law, or more where they lie at one component, to reach `each`."""
    kept: list[Candidate] = []
    for one in sorted(found, key=lambda one: one.share, reverse=True):
        like = [k.place.component for k in kept if k.law.name == one.law.name]
        another = one.place.component not in like and len(set(like)) < each
        if one.share > 0.02 and (len(like) < each or another):
            kept.append(one)
        if len(kept) == most:
            break
    return kept


def _regressed(
    one: Candidate, pieces: Sequence[Any], known: Sequence[int], starts: Sequence[list[float]]
) -> tuple[tuple[float, list[float]] | None, tuple[float, list[float]] | None]:
    """How much of w the best start of a law explains: alone, and beside terms that calibration makes.

    Args:
        known: signals at the place, in proportion to which calibration can leave errors.
    """
    alone = beside = None
    law, read = one.law, list(one.inserted.signals)
    linear, judged = (
        np.vstack([np.column_stack([p[3][:, known], np.ones(len(p[1]))]) * p[2][:, None] for p in some])
        for some in (pieces[:-1], pieces[-1:])
    )
    size = np.linalg.norm(linear, axis=0) + 1e-300
    b, d = np.concatenate([p[1] * p[2] for p in pieces[:-1]]), pieces[-1][1] * pieces[-1][2]
    without = np.linalg.lstsq(linear / size, b, rcond=1e-8)[0] / size
    left, whole = float(((d - judged @ without) ** 2).sum()), float((d**2).sum())
    for start in starts:
        columns = [law.values(time, np.ascontiguousarray(s[:, read]), start) for time, _, _, s in pieces]
        a = np.concatenate([c * p[2] for c, p in zip(columns[:-1], pieces[:-1], strict=True)])
        c, power = columns[-1] * pieces[-1][2], float(a @ a)
        if not np.isfinite(power) or power <= 0.0 or not whole > 0.0:
            continue
        factor = float(a @ b) / power
        share = 1.0 - float(((d - factor * c) ** 2).sum()) / whole
        if alone is None or share > alone[0]:
            alone = share, ([factor, *start[1:]] if law.linear else start)
        both = np.linalg.lstsq(np.column_stack([linear / size, a / np.sqrt(power)]), b, rcond=1e-8)[0]
        both = both / np.append(size, np.sqrt(power))
        share = 1.0 - float(((d - judged @ both[:-1] - both[-1] * c) ** 2).sum()) / max(left, 1e-300)
        if beside is None or share > beside[0]:
            beside = share, ([float(both[-1]), *start[1:]] if law.linear else start)
    return alone, beside


def fit_by_filter(
    runs: Runs, laws: Sequence[Candidate], beside: Ranked | None = None, start: Array | None = None
) -> Fitted:
    """Fit laws together: passes of the filter, each linearised where the last one ended.

    Args:
        beside: the unknown input that is there as well, weaker from pass to pass. With it the filter keeps
            track where a law is not all that is missing.
        start: numbers to begin with; by default those of the candidates.
    """
    inserted = [one.inserted for one in laws]
    numbers = np.array([v for one in laws for v in one.numbers]) if start is None else start.copy()
    wide = np.abs(numbers) + 1e-12
    count = len(runs.model.nominal)
    best = Fitted(
        tuple(laws), numbers, wide, -np.inf, (np.r_[runs.model.nominal, numbers], np.eye(0)), np.inf
    )
    begin = len(runs.model.states) + sum(one.states for one in inserted)
    at = slice(begin, begin + count + len(numbers))
    first = numbers
    for weaker in ((*_WEAKER, 0.0, 0.0, 0.0), (0.0,) * 4)[beside is None :]:
        numbers, last = first, -np.inf
        for factor in weaker:
            priors = list(zip(numbers, wide, strict=True))
            if factor > 0.0 and beside is not None:
                passes = runs.passes(
                    inserted, priors, beside.order, beside.intensity * factor, w=beside.place,
                    w_scale=runs.spread_at(beside.place),
                )  # fmt: skip
            else:
                passes = runs.passes(inserted, priors)
            value = loglik(passes)
            if not np.isfinite(value) or (factor == 0.0 and value < last + 0.5):
                break
            if factor == 0.0:
                last = value
            mean, covariance = passes[-1].z[at], passes[-1].covariance[at, at]
            if value > best.loglik:
                sigmas = np.sqrt(np.abs(np.diag(covariance)[count:]))
                constants = mean.copy(), covariance.copy()
                best = Fitted(tuple(laws), mean[count:].copy(), sigmas, value, constants, factor)
            numbers = mean[count:].copy()
    return best
