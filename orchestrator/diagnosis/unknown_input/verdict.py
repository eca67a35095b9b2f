"""Decide whether laws are the answer, nothing is missing, or the library lacks what is missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice

from .choice import AS_LIKELY, rare, significant, simplest
from .fits import Weighed
from .held_out_replay import HeldOutReplay, closed
from .law_fit import Fitted
from .search import LEAST, SECOND, Search

# Share of the gap on held-out runs that laws must close to be the answer, and to be named as the nearest.
_CLOSES, _HINT = 0.5, 0.1
# Share of what one law leaves that two must close on fitted and on held-out runs, where they do not halve it.
_THIRD = 1.0 / 3.0
# Rivals that may take the place of an answer that held-out runs contradict.
_RIVALS = 4
# Residual over the noise up to which nothing is missing.
_NOISE = 2.0
# Share of the logs' spread below which a residual without a name counts as none.
_SMALL = 0.05


def verdict_on(
    search: Search, best: Fitted, closes: float, share: float, calibrated: float
) -> tuple[str, list[str]]:
    """The verdict on the best laws, and remarks for the reader.

    Args:
        closes: share of the gap, calibrated within the tolerances, that the answer closes on held-out runs.
        share, calibrated: residual of the answer and without it, over the spread of the logs.
    """
    if best.laws and closes >= _CLOSES:
        return "law", []
    remains = search.base.remains
    left = (
        f"The calibrated model leaves {remains:.3g} times the noise, {100 * calibrated:.2g} % of the "
        "signals' spread. No law of the library explains it."
    )
    if best.laws:
        contradicted = (
            "The held-out runs contradict the nearest law: it closes less than half of the gap there."
        )
        # Such a law imitates noise, or what differs from run to run, which needs no name where it is small.
        if remains <= _NOISE or (closes < _HINT and calibrated <= _SMALL):
            return "none", [contradicted, left]
        return "outside", [contradicted]
    if remains > _NOISE and share > _SMALL:
        return "outside", []
    return "none", [left] if remains > _NOISE else []


def confirmed(
    search: Search, weighed: Sequence[Weighed], chosen: int, judged: Callable[[Fitted], HeldOutReplay],
    calibrated: float,
) -> tuple[int, HeldOutReplay, list[str]]:  # fmt: skip
    """The answer, or another one that held-out runs confirm.

    That is one about as likely, if these runs contradict the answer. Or it is a likelier one that was passed
    over for a parameter beyond its tolerance, if it halves what the answer leaves there; or two laws, if they
    close a third of what the one law of the answer leaves, on fitted and on held-out runs.

    Args:
        judged: replays held-out runs with laws.
        calibrated: what calibration leaves on held-out runs, over the noise.
    Returns: its index, its replay, and a remark on what was passed over.
    """
    answer = weighed[chosen]
    own = judged(answer.fitted)
    if not answer.fitted.laws:
        return chosen, own, []
    names = " + ".join(law.name for law in answer.fitted.laws)
    others = [
        (k, one) for k, one in enumerate(weighed)
        if k != chosen and len(one.fitted.laws) == len(answer.fitted.laws) and significant(one.fitted)
    ]  # fmt: skip
    far = bool(search.far(answer.polished.constants))
    # Answers to try: of what they have to close which share, and the remark on what is passed over.
    tried: list[tuple[int, float, float, str]] = []
    for k, one in others[: 0 if far else 1]:
        beyond = one.evidence > answer.evidence + LEAST and search.far(one.polished.constants)
        if beyond and rare(one.fitted) <= rare(answer.fitted):
            left = f"but leaves {own.remains:.3g} times the noise on held-out runs"
            remark = f"{names} needs no parameter beyond its tolerance, {left}."
            tried.append((k, own.remains, _CLOSES, remark))
    if closed(calibrated, own.remains) < _CLOSES:
        near = [
            k for k, one in others
            if abs(one.evidence - answer.evidence) < AS_LIKELY
            and (far or not search.far(one.polished.constants))
        ]  # fmt: skip
        remark = f"Fitted runs make {names} as likely, but held-out runs contradict it."
        usual_first = sorted(near, key=lambda one: rare(weighed[one].fitted))
        tried += [(k, calibrated, _CLOSES, remark) for k in usual_first[:_RIVALS]]
    elif own.remains > SECOND:
        remark = f"{names} alone leaves {own.remains:.3g} times the noise on held-out runs."
        tried += [(k, own.remains, _THIRD, remark) for k in _with_a_second(search, weighed, chosen)]
    for k, before, share, remark in tried:
        other = judged(weighed[k].fitted)
        if closed(before, other.remains) >= share:
            return k, other, [remark]
    return chosen, own, []


def _more_laws(weighed: Sequence[Weighed], chosen: int) -> list[int]:
    """Answers with more laws than a single one and clearly more evidence, best first."""
    answer = weighed[chosen]
    return [
        k for k, one in enumerate(weighed)
        if len(one.fitted.laws) > len(answer.fitted.laws) > 0 and significant(one.fitted)
        and one.evidence > answer.evidence + LEAST
    ]  # fmt: skip


def _with_a_second(search: Search, weighed: Sequence[Weighed], chosen: int) -> list[int]:
    """The likeliest two usual laws, if they close a third of what the answer, a single law, leaves."""
    usual = (
        k for k in _more_laws(weighed, chosen)
        if not rare(weighed[k].fitted) and not search.far(weighed[k].polished.constants)
    )  # fmt: skip
    found = [simplest(search, weighed, k) for k in islice(usual, 1)]
    before = weighed[chosen].polished.remains
    return [k for k in found if closed(before, weighed[k].polished.remains) >= _THIRD]


def nearest_laws(
    weighed: Sequence[Weighed], judged: Callable[[Fitted], HeldOutReplay], calibrated: float
) -> tuple[Fitted | None, list[str]]:
    """The likeliest laws, although they explain too little, and a remark; none that held-out runs refuse."""
    one = next((one.fitted for one in weighed if one.fitted.laws and significant(one.fitted)), None)
    if one is None:
        return None, []
    share = closed(calibrated, judged(one).remains)
    if share < _HINT:
        return None, []
    names = " + ".join(law.name for law in one.laws)
    return one, [f"The nearest laws close {100 * share:.0f} % of the calibrated gap there: {names}."]


def further_law(
    weighed: Sequence[Weighed], chosen: int, judged: Callable[[Fitted], HeldOutReplay], remains: float
) -> list[str]:
    """A remark on two laws that leave less on held-out runs than one, but too much to be the answer.

    Args:
        remains: what the answer leaves there, over the noise.
    """
    more = _more_laws(weighed, chosen)
    if not more:
        return []
    one = weighed[more[0]].fitted
    left = judged(one).remains
    if closed(remains, left) < _HINT:
        return []
    names = " + ".join(law.name for law in one.laws)
    return [
        f"Two laws leave {left:.3g} times the noise there instead of {remains:.3g}: {names}. "
        "A second law has to close a third of what one leaves, so that they are not the answer."
    ]
