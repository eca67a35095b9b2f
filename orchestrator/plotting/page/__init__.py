"""Pages that need no network: one style, tables that sort, interactive plots and a view of motion."""

from .html import (
    aside,
    bar,
    card,
    details,
    document,
    figure,
    heading,
    note,
    number,
    provenance,
    table,
)
from .signals import SignalStore

__all__ = [
    "SignalStore",
    "aside",
    "bar",
    "card",
    "details",
    "document",
    "figure",
    "heading",
    "note",
    "number",
    "provenance",
    "table",
]
