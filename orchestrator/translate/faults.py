"""Faults of a model as its author sees them: the place, the line with a caret, what to write instead."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from orchestrator.base.errors import BuildError

from .sources import Location, SourceTree

_FILE = r"(?:[A-Za-z]:)?[^:,\n]+?\.mo"
_PLACE = re.compile(rf"\s*({_FILE}):(\d+)(?::(\d+))?")
_HEAD = re.compile(rf"(?:{_FILE}:\d+(?::\d+)?(?:, |(?=: )))+: ")
_WORD = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*|\"[^\"\n]*\"|\d[\w.]*|[^\w\s]{1,2}")


class PlacedError(BuildError):
    """A refusal that names its place."""


def placed(error: BuildError, place: Location | None) -> BuildError:
    """An error with a place, unless it has one already or none is known."""
    if place is None or isinstance(error, PlacedError):
        return error
    return PlacedError(f"{place}: {error}")


@dataclass(frozen=True)
class Fault:
    """One fault of a model.

    Attributes:
        places: file, line and column of each place concerned; the column is 0 where it is not known.
        what: what is wrong, and what to write instead.
        details: further lines of the message.
    """

    places: tuple[tuple[str, int, int], ...]
    what: str
    details: tuple[str, ...] = ()


def faults_of(text: str) -> list[Fault]:
    """The faults that a message lists: each begins a line, with `file:line:column: ` or several of these."""
    found: list[Fault] = []
    for line in text.splitlines():
        if line.startswith(" ") and found:
            last = found[-1]
            found[-1] = Fault(last.places, last.what, (*last.details, line))
            continue
        head = _HEAD.match(line)
        places = tuple(
            (one[1], int(one[2]), int(one[3] or 0)) for one in _PLACE.finditer(head[0] if head else "")
        )
        found.append(Fault(places, line[head.end() :] if head else line))
    return found


def illustrated(text: str, tree: SourceTree | None = None) -> str:
    """A message with the line of each place in it, and a caret under the construct."""
    texts = {tree.shown(path): content for path, content in tree.texts.items()} if tree else {}
    lines = []
    for fault in faults_of(text):
        shown = ", ".join(str(Location(*place)) for place in fault.places)
        lines.append(f"{shown}: {fault.what}" if shown else fault.what)
        lines += fault.details
        for place in fault.places[:4]:
            lines += _picture(place, fault.what, texts)
    return "\n".join(lines)


def _picture(place: tuple[str, int, int], what: str, texts: Mapping[str, str]) -> list[str]:
    file, number, column = place
    if file not in texts and not Path(file).is_file():
        return []
    content = (texts[file] if file in texts else Path(file).read_text(errors="replace")).splitlines()
    if not 0 < number <= len(content):
        return []
    line = content[number - 1]
    start = column - 1 if column else _named(line, what)
    word = _WORD.match(line, start)
    width = len(word[0]) if word else 1
    margin = f"{number:>6} | "
    # Tabs stay tabs, so that the caret stands where it must.
    before = re.sub(r"[^\t]", " ", line[:start])
    return [f"{margin}{line.rstrip()}", f"{' ' * 6} | {before}{'^' * width}"]


def _named(line: str, what: str) -> int:
    """Where the first name or construct of a message stands in a line; its first letter if none does."""
    for name in re.findall(r"[A-Za-z_][\w.]*", what):
        if found := re.search(rf"(?<![\w.]){re.escape(name)}(?![\w])", line):
            return found.start()
    return len(line) - len(line.lstrip())
