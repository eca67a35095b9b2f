"""The library of laws: one file a domain, each with a list `LAWS`."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from .law import Law, Number, dimension

__all__ = ["Law", "Number", "dimension", "library"]


@cache
def library() -> list[Law]:
    """All laws of the files in this package."""
    found: list[Law] = []
    for module in iter_modules(__path__):
        found += getattr(import_module(f"{__name__}.{module.name}"), "LAWS", [])
    return found
