"""All effects that a diagnosis knows."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from pathlib import Path

from .effect import Effect

# Places of the docking rig's software, which replays to the last digit; the others are its hardware's.
SOFTWARE = ("dynamics", "controller")


@lru_cache(maxsize=1)
def catalogue() -> dict[str, Effect]:
    """Effects by id, in the order of their ids."""
    modules = (Path(__file__).parent / "effects").glob("[!_]*.py")
    found = [import_module(f".effects.{path.stem}", __package__).EFFECTS for path in modules]
    return {one.id: one for one in sorted(sum(found, ()), key=lambda one: one.id)}


def of_hardware() -> list[Effect]:
    """Hardware effects of the docking rig that are found by fits, not by statistics alone."""
    return [one for one in catalogue().values() if one.place not in SOFTWARE and not one.statistic]
