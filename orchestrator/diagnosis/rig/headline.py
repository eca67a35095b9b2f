"""The verdict of a diagnosis in a sentence or two."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .catalogue import catalogue
from .verdict import SUSPECTED, WITHIN, Diagnosis, Experiment, Gap, Which, chance_outside

# An answer that is likelier than this is named alone, its ties after it.
_SURE = 0.8
# Evidence below which an experiment distinguishes nothing [nats].
SEPARATES = 1.0
# Beyond this an experiment decides; how far beyond only says how many digits exact software has [nats].
_DECIDES = 1000.0
# Error over the noise, on runs that no fit saw, from which the model does not explain the logs.
_MISFITS = 2.0
# A share that is no more is rounding.
_NOTHING = 1e-7


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in a sentence or two, and whether something outside the catalogue may act instead."""
    text, outside = _answer(diagnosis), chance_outside(diagnosis.which)
    if "outside" in diagnosis.verdict.effects or outside < SUSPECTED or "outside the catalogue" in text:
        return text
    return f"{text} It may be something outside the catalogue instead ({percent(outside)})."


def _answer(diagnosis: Diagnosis) -> str:
    effects, first = diagnosis.verdict.effects, chosen_answer(diagnosis)
    chance = f"probability {percent(first.probability)}"
    gap = diagnosis.how_far
    if not effects:
        text = f"No unmodelled effect is needed: the calibrated model explains the logs ({chance})."
        hint = diagnosis.which[0]
        if hint.effects:
            likelier = " and ".join(hint.effects).replace("outside", "something outside the catalogue")
            text = (
                f"No effect is named: the logs hint at {likelier} ({percent(hint.probability)}), but by less "
                f"than a nat over none ({percent(first.probability)})."
            )
        times = 0.0 if gap is None else _error_over_noise(gap)
        if times > _MISFITS:
            larger = f"{times:.1f} times" if math.isfinite(times) else "beyond"
            text = (
                f"The runs that were fitted show no effect ({chance}), but on runs that no fit saw "
                f"the error is {larger} the noise: something acts there that shows in them alone, as a "
                "limit that only they reach. Give one of them the role train."
            )
        if diagnosis.doubtful_tolerances:
            text = (
                "The calibration is farther off than its tolerances allow, and no effect explains it: doubt "
                f"the tolerances ({chance} that no effect is hidden)."
            )
        return text
    if effects == ["outside"]:
        return (
            f"An effect outside the catalogue acts ({chance}), most likely at the {diagnosis.outside_place}. "
            f"None of the {len(catalogue())} known effects leaves only noise."
        )
    named = both = " and ".join(effects)
    tied = [one for one in diagnosis.which if len(one.effects) == 1 and one.effects[0] in first.ties]
    among = len(effects) == 1 and bool(tied) and first.probability < _SURE
    if among:
        whole = first.probability + sum(one.probability for one in tied)
        named = f"One of {listed_or([*effects, *first.ties])}"
        chance = f"together {percent(whole)}; these logs cannot separate them"
    it = "them" if len(effects) > 1 else effects[0] if among else "it"
    tied_ones, many = "them" if len(effects) > 1 else "it", len(effects) > 1
    text = f"{named} {'cause' if many else 'causes'} the gap ({chance})"
    if gap is not None and _contradicted(gap):
        grows = f"by {percent(-gap.closure)} of it" if gap.closure is not None else "without bounds"
        if gap.within_floor:
            grows = "beyond the noise"
        text = (
            f"The fitted runs support {both} ({chance}), but on runs that no fit saw "
            f"the gap grows {grows} with {it}: do not rely on this answer"
        )
    elif gap is not None and gap.within_floor:
        text += "; on runs that no fit saw the gap is within the noise, so that they do not confirm it"
    elif gap is not None and gap.closure is not None:
        closed = percent(gap.closure) if gap.closure < 1.0 else "all"
        text += f"; adding {it} closes {closed} of the gap on runs that no fit saw"
    text += "."
    if first.ties and not among:
        text += f" These logs cannot separate {tied_ones} from {listed_or(first.ties)}."
    return text


def _contradicted(gap: Gap) -> bool:
    """Whether held-out runs contradict the answer: the gap is larger with it, or the model diverges."""
    if gap.within_floor and gap.before is not None and gap.after is not None:
        return gap.after > WITHIN * max(gap.before, gap.noise_floor or 0.0)
    if gap.closure is None:
        return gap.before is not None and gap.after is None
    return gap.closure < 0.0 and (gap.interval is None or gap.interval[1] < 0.0)


def _error_over_noise(gap: Gap) -> float:
    """Error of the calibrated model on held-out runs over the noise; 0 where it is within, or unknown."""
    if gap.within_floor or not gap.noise_floor or gap.before is None:
        return 0.0
    return math.inf if gap.after is None else gap.after / gap.noise_floor


def chosen_answer(diagnosis: Diagnosis) -> Which:
    """The answer that the verdict names."""
    effects = set(diagnosis.verdict.effects)
    return next((one for one in diagnosis.which if set(one.effects) == effects), diagnosis.which[0])


def leaves_in_words(one: Experiment) -> str:
    """Pairs that an experiment does not separate, and the experiment that would."""
    pairs = "; ".join(" from ".join(pair) for pair in one.leaves)
    return f"It does not separate {pairs}" + (f": {one.then} does." if one.then else ".")


def listed_or(names: Sequence[str]) -> str:
    """Names as "a, b or c"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def percent(value: float) -> str:
    """A share or probability with its significant digits."""
    if 0.999 < value < 1.0:
        return "over 99.9 %"
    if _NOTHING < value < 0.0005:
        return "under 0.1 %"
    digits = 1 if 0.0005 <= abs(value) < 0.0995 or 0.99 < value < 1.0 else 0
    text = f"{100 * value:.{digits}f} %"
    return text.removeprefix("-") if abs(value) < 0.0005 else text


def nats(evidence: float) -> str:
    """Expected log evidence with its significant digits."""
    return f"over {_DECIDES:.0f} nats" if evidence > _DECIDES else f"{float(f'{evidence:.3g}'):g} nats"
