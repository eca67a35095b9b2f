"""Split Modelica text into tokens: enough to find keywords and calls outside strings and comments."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

from orchestrator.base.errors import BuildError

KEYWORDS = frozenset(
    "algorithm and annotation block break class connect connector constant constrainedby der discrete each "
    "else elseif elsewhen encapsulated end enumeration equation expandable extends external false final flow "
    "for function if import impure in initial inner input loop model not operator or outer output package "
    "parameter partial protected public pure record redeclare replaceable return stream then true type when "
    "while within".split()
)

OPENING, CLOSING = frozenset("([{"), frozenset(")]}")

_TOKEN = re.compile(
    r"""(?P<blank>\s+|//[^\n]*|/\*.*?\*/)
      | (?P<string>"(?:[^"\\]|\\.)*")
      | (?P<quoted>'(?:[^'\\]|\\.)*')
      | (?P<word>[A-Za-z_][A-Za-z0-9_]*)
      | (?P<number>\d+(?:\.\d*)?(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)
      | (?P<sign>:=|<>|<=|>=|==|\.\*|\./|\.\^|\.\+|\.-|[-+*/^()\[\]{},;:=<>.])
    """,
    re.VERBOSE | re.DOTALL,
)


@dataclass(frozen=True, slots=True)
class Token:
    """One token.

    Attributes:
        kind: "string", "name", "keyword", "number" or "sign".
        text: as written.
        start: offset of its first character in the text.
        line: counted from 1.
    """

    kind: str
    text: str
    start: int
    line: int


@lru_cache(maxsize=64)
def tokenise(text: str, file: str) -> tuple[Token, ...]:
    """Return the tokens of a Modelica file, without blanks and comments.

    Args:
        text: content of the file.
        file: its name, for the message of an error.
    Raises: BuildError at a character that starts no token, such as an open string.
    """
    return tuple(_tokens(text, file))


def _unreadable(character: str) -> str:
    if character in "\"'":
        return f"what begins with this {character} is not closed by another one; put it behind the text"
    if character.isalpha():
        return (
            f"{character!r} stands in texts and comments only; names hold letters from a to z, digits and _"
        )
    return f"{character!r} has no meaning in Modelica; drop it, or put it into a text or comment"


def _tokens(text: str, file: str) -> Iterator[Token]:
    position, line = 0, 1
    if text.startswith("\ufeff"):
        position = 1
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            column = position - text.rfind("\n", 0, position)
            raise BuildError(f"{file}:{line}:{column}: {_unreadable(text[position])}")
        kind = match.lastgroup
        if kind == "word":
            yield Token("keyword" if match[0] in KEYWORDS else "name", match[0], position, line)
        elif kind == "quoted":
            yield Token("name", match[0], position, line)
        elif kind != "blank":
            yield Token(kind or "", match[0], position, line)
        line += match[0].count("\n")
        position = match.end()


def closing(tokens: Sequence[Token], position: int) -> int:
    """Index of the token that closes the bracket at `position`; of the last token if none does."""
    depth = 0
    for index in range(position, len(tokens)):
        if tokens[index].kind == "sign":
            depth += (tokens[index].text in OPENING) - (tokens[index].text in CLOSING)
        if not depth:
            return index
    return len(tokens) - 1
