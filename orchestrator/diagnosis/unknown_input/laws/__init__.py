"""The library of laws: one file a domain, each with a list `LAWS`."""

from __future__ import annotations

import copyreg
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from .law import Law, Number, dimension

__all__ = ["Law", "Number", "dimension", "domains", "library"]


@cache
def domains() -> dict[str, list[Law]]:
    """Laws by the title of the file that holds them."""
    modules = [import_module(f"{__name__}.{one.name}") for one in iter_modules(__path__)]
    return {str(one.__doc__).splitlines()[0].rstrip("."): one.LAWS for one in modules if hasattr(one, "LAWS")}


@cache
def library() -> list[Law]:
    """All laws of the files in this package."""
    return [law for laws in domains().values() for law in laws]


def _named(name: str) -> Law:
    return next(law for law in library() if law.name == name)


def _by_name(law: Law) -> tuple[Callable[[str], Law], tuple[str]]:
    return _named, (law.name,)


# Other processes get laws by name, since their machine code cannot be copied.
copyreg.pickle(Law, _by_name)
