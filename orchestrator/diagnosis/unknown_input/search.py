"""The diagnosis by unknown inputs: places, laws, judgement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from ..ports.study import PortStudy, Role
from .judge import closed, replayed
from .law_fit import Fitted, fit, screened
from .model import StateModel
from .places import Ranked, Runs, rank

__all__ = ["Answer", "answer"]

# Gain of log likelihood that a place or a law needs: at the least, and a compared value.
_LEAST, _PER_VALUE = 20.0, 0.02
# A second law must halve what the first leaves, if that is beyond so many times the noise.
_LEFT, _HALF = 1.2, 0.5
# Places whose w explains the logs about as well, within so many nats a value, are read.
_NEAR = 0.5
_PLACES = 8


@dataclass(frozen=True)
class Answer:
    """What is missing.

    Attributes:
        verdict: "none", "law", or "outside": something that no law of the library explains.
        places: by gain. fitted: the laws of the answer. rivals: others, best first.
        gap: root mean square of the held-out residual over the noise, as configured.
        calibrated, remains: the same with calibrated parameters alone, and with the answer.
        closed: share of the gap closed on held-out runs.
        seconds: taken.
    """

    verdict: str
    places: list[Ranked]
    fitted: Fitted | None
    rivals: list[Fitted] = field(default_factory=list)
    gap: float = 0.0
    calibrated: float = 0.0
    remains: float = 0.0
    closed: float = 0.0
    seconds: float = 0.0


def answer(study: PortStudy, progress: Callable[[str], None] = lambda _: None) -> Answer:
    """Find what is missing.

    Raises: ConfigError if a component gives no access to its states.
    """
    begin = perf_counter()
    with StateModel(study) as model:
        runs = Runs(model, study.of(Role.TRAIN, Role.VALIDATION))
        values = sum(int((~np.isnan(one[2])).sum()) for one in runs.data)
        needed = max(_LEAST, _PER_VALUE * values)
        progress("places")
        alone, places = rank(runs)
        first: list[Ranked] = []
        base = fit(runs, ())
        best: Fitted | None = None
        rivals: list[Fitted] = []
        while len(best.laws if best else ()) < 2:
            if places[0].gain < needed:
                break
            progress("laws")
            near = [one for one in places if one.gain > places[0].gain - _NEAR * values][:_PLACES]
            before = best.laws if best else ()
            made = [
                fit(runs, (*before, one), places[0], np.r_[best.numbers, one.numbers] if best else None)
                for one in screened(runs, near, best)
            ]
            bar = alone + places[0].gain + needed
            # What explains the logs with no unknown input left goes before what needs one beside it.
            made.sort(key=lambda one: (one.loglik >= bar, one.beside == 0.0, one.loglik), reverse=True)
            if not made or made[0].loglik < bar:
                break
            if best is not None and not _halves(runs, best, made[0]):
                break
            best, rivals = made[0], made[1:]
            first = first or places
            if len(best.laws) > 1 or _left(runs, best) <= _LEFT:
                break
            progress("places")
            priors = [(v, abs(v)) for v in best.numbers.tolist()]
            alone, left = rank(
                runs, [one.place for one in places], [one.inserted for one in best.laws], priors
            )
            places = left
        first = first or places
        progress("judge")
        held = Runs(model, study.of(Role.HELDOUT) or study.of(Role.VALIDATION, Role.TRAIN))
        gap = replayed(held, (), model.nominal, as_configured=True).remains
        calibrated = replayed(held, (), base.constants[0]).remains
        remains = calibrated
        if best is not None:
            remains = replayed(held, [one.inserted for one in best.laws], best.constants[0]).remains
    share = closed(gap, remains)
    verdict = "none" if first[0].gain < needed else "outside"
    if best is not None and closed(calibrated, remains) >= 0.5:
        verdict = "law"
    seconds = perf_counter() - begin
    return Answer(verdict, first, best, rivals, gap, calibrated, remains, share, seconds)


def _left(runs: Runs, one: Fitted) -> float:
    """What replays of the runs leave, over the noise."""
    return replayed(runs, [law.inserted for law in one.laws], one.constants[0]).remains


def _halves(runs: Runs, first: Fitted, second: Fitted) -> bool:
    """Whether one more law halves what the first leaves beyond the noise."""
    return closed(_left(runs, first), _left(runs, second)) >= _HALF
