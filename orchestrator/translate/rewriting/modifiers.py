"""Brackets of modifiers: those with dotted names, and those that a class and its base class give."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ..lexer import Token, closing

DOTTED = re.compile(r"[(,]\s*(?:(?:each|final)\s+)*\w+(?:\s*\.\s*\w+)+\s*=(?!=)")
"""What stands in every file with such a modifier, unless comments separate it."""
_PREFIXES = ("each", "final")


@dataclass
class Modifiers:
    """What one element gets.

    Attributes:
        inner: what its own elements get, by their names; redeclarations by their whole texts.
        value: as "= 3", or the text of a redeclaration; "" without one.
        prefix: "each", "final" or both, of the value; what is within has its own.
    """

    inner: dict[str, Modifiers] = field(default_factory=dict)
    value: str = ""
    prefix: frozenset[str] = frozenset()


def arguments(tokens: Sequence[Token], opening: int) -> list[tuple[int, int]]:
    """First and last token of each argument of a call."""
    end, found, begin, place = closing(tokens, opening), [], opening + 1, opening + 1
    while place <= end:
        text = tokens[place].text
        if place == end or text == ",":
            if place > begin:
                found.append((begin, place - 1))
            begin = place + 1
        elif tokens[place].kind == "sign" and text in "([{":
            place = closing(tokens, place)
        place += 1
    return found


def in_brackets(tokens: Sequence[Token], opening: int) -> str:
    """What a bracket holds, with it and its nested modifiers; "" if there is no dotted name in it."""
    end = closing(tokens, opening)
    dotted = any(
        tokens[at].kind == "name"
        and tokens[at - 1].text in ("(", ",", *_PREFIXES)
        and tokens[at + 1].text == "."
        and _is_dotted(tokens, at)
        for at in range(opening + 1, end)
    )
    return written(modifiers_of(tokens, opening)) if dotted else ""


def _is_dotted(tokens: Sequence[Token], at: int) -> bool:
    while tokens[at + 1].text == ".":
        at += 2
    return tokens[at + 1].text == "="


def words(tokens: Sequence[Token]) -> str:
    """Tokens as text, with the nested modifiers of what is redeclared among them."""
    texts, at = [], 0
    while at < len(tokens):
        if tokens[at].text == "(" and (nested := in_brackets(tokens, at)):
            texts.append(nested)
            at = closing(tokens, at)
        else:
            texts.append(tokens[at].text)
        at += 1
    return " ".join(texts)


def modifiers_of(
    tokens: Sequence[Token],
    opening: int,
    said: Callable[[Sequence[Token]], str] = words,
    prefix: frozenset[str] = frozenset(),
) -> Modifiers:
    """The modifiers in a bracket.

    Args:
        said: gives the text of values.
        prefix: of all that stands in it.
    """
    found = Modifiers()
    for first, last in arguments(tokens, opening):
        at = first
        while tokens[at].text in _PREFIXES:
            at += 1
        own = prefix | {token.text for token in tokens[first:at]}
        path = list[str]()
        if tokens[at].kind == "name":
            path = [tokens[at].text]
            while tokens[at + 1].text == ".":
                at += 2
                path.append(tokens[at].text)
            at += 1
        if not path or tokens[at].text not in ("(", "="):
            text = said(tokens[first : last + 1])
            found.inner[text] = Modifiers(value=text)
            continue
        here = found
        for name in path:
            here = here.inner.setdefault(name, Modifiers())
        if tokens[at].text == "(":
            _put(here, modifiers_of(tokens, at, said, own))
            at = closing(tokens, at) + 1
        if at <= last:
            here.value, here.prefix = said(tokens[at : last + 1]), own
    return found


def _put(one: Modifiers, more: Modifiers) -> None:
    for name, inner in more.inner.items():
        here = one.inner.setdefault(name, Modifiers())
        _put(here, inner)
        if inner.value:
            here.value, here.prefix = inner.value, inner.prefix


def complete(given: Modifiers, base: Modifiers) -> bool:
    """Add what a base gives and the modifiers do not name; returns whether there is any."""
    more = False
    for name, one in base.inner.items():
        mine = given.inner.get(name)
        if mine is None:
            if name != one.value:  # redeclarations are done
                given.inner[name], more = one, True
            continue
        more |= complete(mine, one)
        if one.value and not mine.value:
            mine.value, mine.prefix, more = one.value, one.prefix, True
    return more


def written(one: Modifiers, prefix: frozenset[str] = frozenset()) -> str:
    """The bracket, with what is not `prefix` of all within; "" if it holds nothing."""
    parts = []
    for name, inner in one.inner.items():
        ahead = sorted(inner.prefix - prefix)
        bracket = written(inner, prefix | inner.prefix if inner.value else prefix)
        parts.append(" ".join([*ahead, f"{name}{bracket}", *([inner.value] if inner.value else [])]))
        if name == inner.value:
            parts[-1] = name
    return f"({', '.join(parts)})" if parts else ""
