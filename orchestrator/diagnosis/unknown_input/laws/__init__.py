"""The library of laws: one file a domain, each with a list `LAWS`."""

from __future__ import annotations

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
