"""The classes of a Modelica file that have a body, by their tokens, and edits of the file's text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from ..classes import CLASS_KEYWORDS, within_clause
from ..lexer import Token, closing, tokenise
from .source_edits import text_end

MARK = "adapted_"
"""Names that begin with this are made for the compiler; `dae` knows what they stand for."""
Edit = tuple[int, int, str]
"""Text in place of that between two offsets; see `source_edits.edited`."""


@dataclass
class ClassBody:
    """A class: `start`, `body` and `end` are indices of its keyword, its first token within and its `end`."""

    name: str
    path: str  # qualified name
    kind: str
    start: int
    body: int
    end: int = 0
    inner: list[ClassBody] = field(default_factory=list)

    def own(self) -> Iterator[int]:
        """Indices of its tokens without those of classes within it."""
        place = self.body
        for inner in self.inner:
            yield from range(place, inner.start)
            place = inner.end + 2
        yield from range(place, self.end)


class ModelicaFile:
    """A text with its tokens and its classes, each before those within it."""

    def __init__(self, text: str, file: str) -> None:
        self.text, self.file = text, file
        self.tokens = tokenise(text, file)

    @cached_property
    def classes(self) -> list[ClassBody]:
        return _classes(self.tokens, within_clause(self.tokens))

    def words(self, first: int, last: int) -> str:
        """The text of tokens, as it stands."""
        return self.text[self.tokens[first].start : text_end(self.tokens[last])]

    def replaced(self, first: int, last: int, new: str) -> Edit:
        """A text in place of tokens."""
        return self.tokens[first].start, text_end(self.tokens[last]), new

    def before(self, at: int, new: str) -> Edit:
        """A text before a token."""
        return self.tokens[at].start, self.tokens[at].start, new

    def behind(self, at: int, new: str) -> Edit:
        """A text behind a token."""
        return text_end(self.tokens[at]), text_end(self.tokens[at]), new


def _classes(tokens: Sequence[Token], scope: str) -> list[ClassBody]:
    found: list[ClassBody] = []
    around: list[ClassBody] = []
    for place, token in enumerate(tokens[:-2]):
        after = tokens[place + 1]
        if token.text == "end" and around and after.text == around[-1].name:
            around.pop().end = place
        if token.kind != "keyword" or token.text not in CLASS_KEYWORDS:
            continue
        at = place + (2 if after.text == "extends" else 1)
        if tokens[at].kind != "name" or (tokens[at + 1].text in ("=", ";", "(") and after.text != "extends"):
            continue
        body = at + 1
        if tokens[body].text == "(":
            body = closing(tokens, body) + 1
        while tokens[body].kind == "string" or tokens[body].text == "+":
            body += 1
        name, outer = tokens[at].text, around[-1].path if around else scope
        found.append(ClassBody(name, f"{outer}.{name}" if outer else name, token.text, place, body))
        if around:
            around[-1].inner.append(found[-1])
        around.append(found[-1])
    return found


def function_body(tokens: Sequence[Token], at: int = 0) -> tuple[int, int]:
    """Indices of the first token of the body, and of the `end`, of the class that begins at or after one."""
    found = next(one for one in _classes(tokens, "") if one.start >= at)
    return found.body, found.end


def class_texts(text: str, file: str, kind: str) -> dict[str, str]:
    """The text of each class of a kind in a file by its qualified name."""
    source, found = ModelicaFile(text, file), dict[str, str]()
    for one in source.classes:
        if one.kind == kind:
            first = one.start - (one.start > 0 and source.tokens[one.start - 1].text in ("pure", "impure"))
            found[one.path] = source.words(first, one.end + 2)
    return found
