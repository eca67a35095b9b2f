"""Sums, products, minima and maxima over iterators in declarations, as equations where that is needed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..built_in import BUILT_IN, STEPS
from ..lexer import Token, closing
from .class_bodies import ClassBody, Edit, ModelicaFile
from .source_edits import path_end, statement_end, words_of

# Functions that the compiler takes in what an iterator repeats.
_TAKEN = frozenset(name for name, one in BUILT_IN.items() if one.value and name not in STEPS) | {"sum"}
_SECTIONS = ("equation", "algorithm", "initial", "annotation")


def with_reductions_as_equations(source: ModelicaFile) -> Iterator[Edit]:
    """Real x = sum({f(k) for k in 1:n}) -> Real x; equation x = ...: else the compiler takes no k."""
    for one in source.classes:
        if one.kind in ("model", "block"):
            yield from _moved(source, one)


def _moved(source: ModelicaFile, one: ClassBody) -> Iterator[Edit]:
    tokens, own = source.tokens, list(one.own())
    moved, begin = list[str](), 0
    while begin < len(own) and tokens[own[begin]].text not in _SECTIONS:
        first = own[begin]
        last = statement_end(tokens, first)
        begin = next((n for n, place in enumerate(own) if place > last), len(own))
        first += tokens[first].text in ("public", "protected")
        first += tokens[first].text == "output"
        if tokens[first].kind == "name":
            name, sign, end = _bound(tokens, first, last)
            if sign and _reduces(tokens, sign + 1, end):
                moved.append(f"{name} = {words_of(tokens[sign + 1 : end])};")
                yield source.replaced(sign, end - 1, "")
    if moved:
        sections = (
            at for at in own if tokens[at].text in _SECTIONS and (tokens[at - 1].text == ";" or at == own[0])
        )
        yield source.before(next(sections, one.end), f"equation {' '.join(moved)} ")


def _bound(tokens: Sequence[Token], at: int, last: int) -> tuple[str, int, int]:
    """The only component of a clause: its name, the place of its `=` and the end of its value, or 0."""
    behind = path_end(tokens, at)
    at = closing(tokens, behind) + 1 if tokens[behind].text == "[" else behind
    name = tokens[at].text
    while at < last and tokens[at].text not in ("=", ","):
        at = closing(tokens, at) + 1 if tokens[at].text in ("(", "[", "{") else at + 1
    end = at
    while end < last and tokens[end].kind != "string" and tokens[end].text not in (",", "annotation"):
        end = closing(tokens, end) + 1 if tokens[end].text in ("(", "[", "{") else end + 1
    several = tokens[at].text != "=" or tokens[end].text == ","
    return (name, 0, 0) if several else (name, at, end)


def _reduces(tokens: Sequence[Token], first: int, end: int) -> bool:
    """Whether an iterator within a call has functions of the model in what it repeats."""
    for at in range(first, end):
        if tokens[at].text != "for":
            continue
        opening = max(
            place
            for place in range(first, at)
            if tokens[place].text in ("(", "{") and closing(tokens, place) > at
        )
        calls = {
            tokens[place].text for place in range(opening + 1, at)
            if tokens[place].kind == "name" and tokens[place + 1].text == "("
        }  # fmt: skip
        if (tokens[opening].text == "(" or opening > first) and calls - _TAKEN:
            return True
    return False
