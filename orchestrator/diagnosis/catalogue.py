"""All effects that a diagnosis knows: those that come with it, and those of installed packages."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

from ..errors import ConfigError, Problem
from .effect import Effect

__all__ = ["ENTRY_POINTS", "catalogue"]

# A package adds an effect by an entry point of this group that names an Effect.
ENTRY_POINTS = "orchestrator.diagnosis.effects"


@lru_cache(maxsize=1)
def catalogue() -> dict[str, Effect]:
    """Effects by id, in the order of their ids.

    Raises: ConfigError if an entry point does not give an Effect, or two effects share an id.
    """
    found: dict[str, Effect] = {}
    problems: list[Problem] = []
    for path in sorted((Path(__file__).parent / "effects").glob("[!_]*.py")):
        effect = import_module(f".effects.{path.stem}", __package__).EFFECT
        found[effect.id] = effect
    for point in entry_points(group=ENTRY_POINTS):
        place = f"entry point {point.name} of {point.value}"
        try:
            effect = point.load()
        except Exception as error:  # whatever a foreign module raises
            problems.append(Problem(place, f"cannot be loaded: {error!r}"))
            continue
        if not isinstance(effect, Effect):
            problems.append(Problem(place, f"is {type(effect).__name__}", "an Effect"))
        elif effect.id in found:
            problems.append(Problem(place, f"effect {effect.id} exists already", "an id of its own"))
        else:
            found[effect.id] = effect
    if problems:
        raise ConfigError(problems)
    return dict(sorted(found.items()))
