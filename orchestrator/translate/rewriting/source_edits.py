"""Edits of Modelica sources that keep the lines of what they leave alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ..lexer import Token, closing, tokenise
from ..sources import line_mark


def path_end(tokens: Sequence[Token], at: int) -> int:
    """The index behind a path, which may begin with a dot."""
    begin = at
    at += tokens[at].text == "."
    while tokens[at].kind == "name":
        at += 1
        if tokens[at].text != "." or tokens[at + 1].kind != "name":
            return at
        at += 1
    return begin


def path_of(tokens: Sequence[Token], begin: int, end: int) -> list[str]:
    """The names of a path; the first is empty where it begins with a dot."""
    return "".join(token.text for token in tokens[begin:end]).split(".")


def words_of(tokens: Sequence[Token]) -> str:
    """Tokens as text, without comments."""
    return " ".join(token.text for token in tokens)


def statement_end(tokens: Sequence[Token], at: int) -> int:
    """The index of the semicolon that ends a statement."""
    while at < len(tokens) - 1 and tokens[at].text != ";":
        at = closing(tokens, at) + 1 if tokens[at].text in ("(", "[", "{") else at + 1
    return at


def text_end(token: Token) -> int:
    """The place behind a token in its text."""
    return token.start + len(token.text)


def edited(text: str, edits: Sequence[tuple[int, int, str]], marked: int = 0) -> str:
    """A text with edits, which keep the line breaks of what they replace.

    Args:
        marked: where it is to stand on one line, the number of its first line.
    """
    new, place, line = list[str](), 0, marked
    for start, end, put in sorted(edits, key=lambda one: one[:2]):
        new += [_marked(text[place:start], line), put] if marked else [text[place:start], put]
        line += text[place:end].count("\n")
        if not marked:
            new.append("\n" * max(0, text[start:end].count("\n") - put.count("\n")))
        elif "\n" in text[start:end]:
            new.append(f" {line_mark(line)} ")
        place = end
    return "".join([*new, _marked(text[place:], line) if marked else text[place:]])


def outermost(edits: Iterable[tuple[int, int, str]]) -> list[tuple[int, int, str]]:
    """Edits of which none begins within another: the rest follows in later rounds."""
    kept: list[tuple[int, int, str]] = []
    for one in sorted(edits, key=lambda edit: (edit[0], -edit[1])):
        if not kept or one[0] >= kept[-1][1]:
            kept.append(one)
    return kept


def _marked(text: str, line: int) -> str:
    """A piece of text whose line breaks are marks."""
    first, *rest = text.split("\n")
    return "\n".join([first, *(f" {line_mark(line + n)} {one}" for n, one in enumerate(rest, 1))])


def on_one_line(text: str) -> str:
    """The text without line breaks, and without comments but the marks of lines."""
    tokens, place, words = tokenise(text, "copy"), 0, list[str]()
    for token in tokens:
        words += _marks(text[place : token.start])
        words.append(token.text.replace("\n", "\\n"))
        place = text_end(token)
    return " ".join(words)


def _marks(blank: str) -> list[str]:
    begin, end = line_mark(0).split("0")
    return [f"{begin}{one.partition(end)[0]}{end}" for one in blank.split(begin)[1:]][-1:]
