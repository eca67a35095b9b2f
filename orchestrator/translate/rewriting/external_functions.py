"""Functions that the compiler cannot evaluate, as external ones; `functions` writes their statements in C."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from ..classes import CLASS_KEYWORDS
from ..lexer import Token, closing
from .class_bodies import MARK, ClassBody, Edit, ModelicaFile

CALL = f"{MARK}call"
"""The external function that stands for one whose statements the compiler refuses."""


def with_external_functions(source: ModelicaFile, named: frozenset[str]) -> Iterator[Edit]:
    """A function with while, break or return becomes an external one, as do those named.

    Args:
        named: ends of their qualified names.
    """
    within = -1
    for one in source.classes:
        if one.start < within:  # of a function that is external as a whole
            continue
        words = [source.tokens[place].text for place in one.own()] if one.kind == "function" else []
        if "algorithm" not in words:
            continue
        jumps = {"while", "break", "return"} & set(words[words.index("algorithm") :])
        if jumps or any(f".{one.path}".endswith(f".{end}") for end in named):
            within = one.end
            yield from _external(source, one)


def _external(source: ModelicaFile, one: ClassBody) -> Iterator[Edit]:
    """A function with its declarations of inputs and results, and an external call."""
    tokens, own = source.tokens, list(one.own())
    kept: dict[str, list[str]] = {"input": [], "output": []}
    lines, place = list[str](), own[0]
    while tokens[place].text != "algorithm":
        begin = place
        while tokens[place].text != ";" and place in own:
            place = closing(tokens, place) if tokens[place].text in ("(", "[", "{") else place
            place += 1
        word = tokens[begin].text
        if word in kept:
            last = next((k for k in range(begin, place) if tokens[k].text == "annotation"), place)
            lines.append(f"{source.words(begin, last - 1)};")
            kept[word] += _names(tokens, begin, last)
        elif word in ("extends", "import"):
            lines.append(source.words(begin, place))
        elif word in ("protected", "public"):
            place = begin
        elif word in CLASS_KEYWORDS or place not in own:
            place = next(inner.end + 2 for inner in one.inner if inner.end > begin)
        place += 1
    inputs, outputs = kept["input"], kept["output"]
    if not outputs:
        return
    array = rf"\b{outputs[0]}\s*\[|\]\s*{outputs[0]}\b"
    if len(outputs) == 1 and not re.search(array, " ".join(lines)):
        call = f"{outputs[0]} = {CALL}({', '.join(inputs)})"
    else:
        call = f"{CALL}({', '.join([*inputs, *outputs])})"
    if tokens[one.start - 1].text not in ("pure", "impure"):
        yield source.before(one.start, "pure ")
    yield source.replaced(one.body, one.end - 1, f'{" ".join(lines)} external "C" {call};')


def _names(tokens: Sequence[Token], begin: int, end: int) -> list[str]:
    """The names that a declaration declares."""
    place = begin + 2
    while tokens[place].text == ".":
        place += 2
    if tokens[place].text == "[":
        place = closing(tokens, place) + 1
    found = [tokens[place].text]
    while place < end:
        place = closing(tokens, place) if tokens[place].text in ("(", "[", "{") else place
        if tokens[place].text == ",":
            found.append(tokens[place + 1].text)
        place += 1
    return found
