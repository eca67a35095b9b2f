"""Choose the answer among fitted laws, and weigh it against its rivals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .fits import Weighed
from .held_out_replay import closed
from .law_fit import Fitted
from .search import LEAST, SECOND, Search

# Shares of the residual that a law must close: the first or a rarer one, and a second one.
_FIRST_CLOSES, _SECOND_CLOSES = 0.3, 0.5
# Share that an answer must close of what another one leaves, if it moves a parameter beyond its tolerance, or
# has more numbers than the other, of the same family.
_HALF = 0.5
# Nats that count as one. Learned on 92 laws of `orchestrator challenge --random 12200 --count 150` as 0.61,
# with a weight of rivals beside it of 0.99.
_TEMPERATURE = 0.6
# Weight of a rival that is less likely before the logs are seen. It holds the answer as a special case, as
# Stribeck's friction holds Coulomb's: chosen among 0.1, 0.3, 0.5 and 1 on the seeds 12200 to 12729. Or a rare
# law is in it, but not in the answer: where the answer leaves noise, 11 of 12 such were right on the seeds
# 12850 to 13749, stated with 45 to 75 % before.
_UNUSUAL = 0.1
# Standard deviation over a number, below which the simulation does not answer to the number.
_IDLE = 1e-9
# Nats within which the same laws at another place explain the logs as well.
AS_LIKELY = 3.0


class Rival(NamedTuple):
    """Laws that may be right instead of the answer.

    Attributes:
        fitted: the laws. probability: of them.
        nats: their evidence over that of the answer, at most 0.
        weight: how likely they are beside the answer before the logs are seen.
    """

    fitted: Fitted
    probability: float
    nats: float
    weight: float


def choose_answer(search: Search, weighed: Sequence[Weighed]) -> int:
    """Index of the answer.

    A second law must halve what the best single one leaves, if that is twice the noise or more, or bring
    parameters back to their tolerances. If no single law is an answer, two laws must explain the logs.
    An answer that moves a parameter beyond its tolerance must halve what the best one leaves that does not.
    A rare law must close as much of what the others leave as any law in its place. A law must halve what one
    with fewer numbers and states leaves, of its family at its component.
    """

    def closed_share(before: int, after: int) -> float:
        begin = weighed[before]
        remains = begin.polished.remains
        if not begin.fitted.laws and not search.far(weighed[after].polished.constants):
            # A law takes the place of a parameter that calibration moves far beyond its tolerance.
            remains = max([remains, *(one.polished.remains for one in search.begins)])
        return closed(remains, weighed[after].polished.remains, 0.0)

    def best_of(ranked: Sequence[int]) -> int:
        """The first one within the tolerances, unless the first of all halves what it leaves."""
        near = [k for k in ranked if not search.far(weighed[k].polished.constants)]
        return near[0] if near and closed_share(near[0], ranked[0]) <= _HALF else ranked[0]

    def enough(before: int, after: int) -> bool:
        """Whether laws explain enough of what an answer with fewer leaves."""
        one, two = weighed[before], weighed[after]
        pair = len(two.fitted.laws) == 2
        far, still = (search.far(each.polished.constants) for each in (one, two))
        if two.evidence - one.evidence <= LEAST:
            return False
        if pair and not one.fitted.laws and two.polished.remains > SECOND:
            return False
        if pair and one.fitted.laws and one.polished.remains < SECOND:
            # One law explains the logs, unless it needs what the tolerances do not allow.
            return bool(far) and not still
        # What calibration explains only by parameters beyond their tolerances, a law explains without.
        needless = not pair and bool(far) and not still
        return needless or closed_share(before, after) >= (_SECOND_CLOSES if pair else _FIRST_CLOSES)

    chosen = next(k for k, one in enumerate(weighed) if not one.fitted.laws)
    for count in (1, 2):
        ranked = [
            k for k, one in enumerate(weighed)
            if len(one.fitted.laws) == count and significant(one.fitted)
        ]  # fmt: skip
        usual = [k for k in ranked if not rare(weighed[k].fitted)]
        if usual:
            gain = closed_share(usual[0], ranked[0])
            # Usual laws that are no answer need not be halved by rare ones.
            short = count == 2 and not enough(chosen, best_of(usual))
            if gain <= (_SECOND_CLOSES if count == 2 and not short else _FIRST_CLOSES):
                ranked = usual
        if ranked and enough(chosen, best_of(ranked)):
            chosen = best_of(ranked)
    return simplest(search, weighed, chosen)


def simplest(search: Search, weighed: Sequence[Weighed], chosen: int) -> int:
    """Index of an answer, or of the same with laws of its families that have fewer numbers and states.

    That is where the answer does not halve what those leave.
    """
    answer = weighed[chosen]
    kind, size, count = _kind(answer.fitted), _size(answer.fitted), len(answer.fitted.laws)
    as_usual = [(k, one) for k, one in enumerate(weighed) if rare(one.fitted) <= rare(answer.fitted)]
    # What an answer of another family explains clearly better is no answer, however few its numbers.
    others = [
        one.evidence for _, one in as_usual
        if len(one.fitted.laws) == count and _kind(one.fitted) != kind
        and significant(one.fitted) and not search.far(one.polished.constants)
    ]  # fmt: skip
    simpler = (
        k for k, one in as_usual
        if _kind(one.fitted) == kind and _size(one.fitted) < size
        and closed(one.polished.remains, answer.polished.remains) < _HALF
        and one.evidence > max(others, default=-np.inf) - LEAST
    )  # fmt: skip
    return next(simpler, chosen)


def rare(one: Fitted) -> bool:
    """Whether a rare law is among the laws."""
    return any(law.law.rare for law in one.laws)


def _size(one: Fitted) -> int:
    """Numbers and states of laws; a delay, whose states serve filters only, is as simple as a lag."""
    return len(one.numbers) + sum(1 if law.law.delay else law.law.states for law in one.laws)


def _kind(one: Fitted) -> tuple[tuple[str, int], ...]:
    """Families of laws and the components where they act."""
    return tuple(sorted((law.law.family, law.place.component) for law in one.laws))


def significant(one: Fitted) -> bool:
    """Whether a number of each of two laws differs from 0 by more than three standard deviations.

    The amplitude, where a law has one. A number that the simulation does not answer to has none to speak of.
    """
    return len(one.laws) < 2 or all(
        any(
            _IDLE * abs(value) < sigma < abs(value) / 3.0
            for value, sigma in zip(*(part[:1] if law.law.linear else part for part in parts), strict=True)
        )
        for law, *parts in one.by_law()
    )


def rivals_of(
    search: Search, weighed: Sequence[Weighed], chosen: int, trust: float, leaves: bool
) -> tuple[float, list[Rival], list[Fitted]]:
    """Probability of the answer among those with as many laws; others with theirs; the same laws elsewhere.

    Args:
        trust: probability that one of them is right.
        leaves: whether the answer leaves more than noise. Where it does not, the same laws elsewhere that
            explain the logs as well act the same on them; they count for the answer.
    """
    best, _, evidence = weighed[chosen]
    same = [one for one in weighed if len(one.fitted.laws) == len(best.laws)]
    # Rivals that need a parameter beyond its tolerance, where the answer does not, are no rivals.
    same = [one for one in same if one.evidence <= evidence or not search.far(one.polished.constants)]
    # The same laws at other places of the same components are the same answer.
    merged: dict[tuple[tuple[str, int], ...], list[Any]] = {}
    elsewhere: list[Fitted] = []
    for one, _, nats in sorted(same, key=lambda each: each.fitted is not best):
        weight = float(np.exp(np.clip((nats - evidence) / _TEMPERATURE, -700.0, 0.0)))
        alike = not leaves and _names(one) == _names(best) and abs(nats - evidence) < AS_LIKELY
        if alike and _alias(one) != _alias(best):
            elsewhere.append(one)
        merged.setdefault(_alias(best if alike else one), [one, 0.0])[1] += weight
    answer = merged.pop(_alias(best))[1]
    # A rival with more evidence lost by the rules of `choose_answer`, so that it is not the likelier one.
    rivals = []
    for one, weight in merged.values():
        wider = _kind(one) == _kind(best) and _size(one) > _size(best)
        unusual = wider or (rare(one) and not rare(best))
        rivals.append((one, min(weight / answer, 1.0), _UNUSUAL if unusual else 1.0))
    whole = 1.0 + sum(odds * weight for _, odds, weight in rivals)
    others = [
        Rival(one, trust * odds * weight / whole, _TEMPERATURE * float(np.log(max(odds, 1e-300))), weight)
        for one, odds, weight in rivals if one.laws
    ]  # fmt: skip
    return trust / whole, sorted(others, key=lambda each: -each.probability), elsewhere


def _names(one: Fitted) -> list[str]:
    """Of laws, wherever they act."""
    return sorted(law.law.name for law in one.laws)


def _alias(one: Fitted) -> tuple[tuple[str, int], ...]:
    """Laws and the components where they act."""
    return tuple(sorted((law.law.name, law.place.component) for law in one.laws))
