"""All effects that a diagnosis knows: its own, and those of installed packages."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import TypeVar

from ...base.errors import ConfigError, Problem
from .effect import Effect

_Kind = TypeVar("_Kind")

# A package adds an effect by an entry point of this group that names an Effect.
ENTRY_POINTS = "orchestrator.diagnosis.rig.effects"
# Places of the docking rig's software, which replays to the last digit; the others are its hardware's.
SOFTWARE = ("dynamics", "controller")


@lru_cache(maxsize=1)
def catalogue() -> dict[str, Effect]:
    """Effects by id, in the order of their ids.

    Raises: ConfigError if an entry point does not give an Effect, or two effects share an id.
    """
    found: dict[str, Effect] = {}
    problems: list[Problem] = []
    for path in sorted((Path(__file__).parent / "effects").glob("[!_]*.py")):
        found |= {one.id: one for one in import_module(f".effects.{path.stem}", __package__).EFFECTS}
    for place, effect in installed(ENTRY_POINTS, Effect, problems):
        if effect.id in found:
            problems.append(Problem(place, f"effect {effect.id} exists already", "an id of its own"))
        else:
            found[effect.id] = effect
    if problems:
        raise ConfigError(problems)
    return dict(sorted(found.items()))


def of_hardware() -> list[Effect]:
    """Hardware effects of the docking rig that are found by fits, not by statistics alone."""
    return [one for one in catalogue().values() if one.place not in SOFTWARE and not one.statistic]


def in_words(effect: Effect) -> str:
    """Description of an effect without a full stop: its words, or else the first line of its equation."""
    return (effect.words or effect.equation).splitlines()[0].removesuffix(".")


def installed(group: str, kind: type[_Kind], problems: list[Problem]) -> Iterator[tuple[str, _Kind]]:
    """Objects that installed packages register in an entry point group, each with its place for messages.

    Args:
        kind: that each must be; problems: what is wrong with others is added to it.
    """
    for point in entry_points(group=group):
        place = f"entry point {point.name} of {point.value}"
        try:
            one = point.load()
        except Exception as error:  # whatever a foreign module raises
            problems.append(Problem(place, f"cannot be loaded: {error!r}"))
            continue
        if isinstance(one, kind):
            yield place, one
        else:
            article = "an" if kind.__name__[0] in "AEIOU" else "a"
            problems.append(Problem(place, f"is {type(one).__name__}", f"{article} {kind.__name__}"))
