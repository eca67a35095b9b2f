"""Families: forms of one cause at one place, reported together if logs cannot separate them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol

__all__ = ["Kin", "families_of", "kin_of", "together"]


class Kin(NamedTuple):
    """The common cause of a family, and its place."""

    name: str
    place: str

    def __str__(self) -> str:
        return f"{self.name} at {self.place}"


class _Likely(Protocol):
    """An answer and its probability."""

    @property
    def effects(self) -> Sequence[str]: ...

    @property
    def probability(self) -> float: ...


class _Family(Protocol):
    """A family as it is reported."""

    @property
    def name(self) -> str: ...

    @property
    def place(self) -> str: ...

    @property
    def members(self) -> Collection[str]: ...


def families_of(
    answers: Iterable[_Likely], kin: Mapping[str, Kin]
) -> dict[Kin, tuple[float, dict[str, float]]]:
    """Families with more than one effect among the answers.

    Args:
        kin: of the effects that have any, by id.
    Returns: the probability that some effect of a family acts, whatever acts beside it, and that of each;
        most probable first.
    """
    whole: dict[Kin, float] = {}
    members: dict[Kin, dict[str, float]] = {}
    for one in answers:
        for family in {kin[name] for name in one.effects if name in kin}:
            whole[family] = whole.get(family, 0.0) + one.probability
        for name in one.effects:
            if name in kin:
                own = members.setdefault(kin[name], {})
                own[name] = own.get(name, 0.0) + one.probability
    found = sorted((family for family in whole if len(members[family]) > 1), key=lambda one: -whole[one])
    return {
        family: (whole[family], dict(sorted(members[family].items(), key=lambda item: -item[1])))
        for family in found
    }


def kin_of(families: Iterable[_Family]) -> dict[str, Kin]:
    """Reported families by the ids of their effects."""
    return {name: Kin(one.name, one.place) for one in families for name in one.members}


def together(
    effects: Sequence[str], answers: Iterable[_Likely], kin: Mapping[str, Kin]
) -> tuple[float, dict[str, float]]:
    """Probability of all answers that differ only in effects of the same families.

    Args:
        effects: of the one.
    Returns: their probability together; and, of the effects with kin in them, that of each.
    """
    asked, whole = _form(effects, kin), 0.0
    members: dict[str, float] = {}
    for one in answers:
        if _form(one.effects, kin) == asked:
            whole += one.probability
            for name in one.effects:
                if name in kin:
                    members[name] = members.get(name, 0.0) + one.probability
    return whole, dict(sorted(members.items(), key=lambda item: -item[1]))


def _form(effects: Sequence[str], kin: Mapping[str, Kin]) -> frozenset[Kin | str]:
    return frozenset(kin.get(name, name) for name in effects)
