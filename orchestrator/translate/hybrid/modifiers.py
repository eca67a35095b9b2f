"""Modifiers with dotted names, written as nested ones: `(a.b = v)` as `(a(b = v))`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ..lexer import Token, closing

__all__ = ["DOTTED", "arguments", "in_brackets"]

DOTTED = re.compile(r"[(,]\s*(?:(?:each|final)\s+)*\w+(?:\s*\.\s*\w+)+\s*=(?!=)")
"""What stands in every file with such a modifier, unless comments separate it."""


@dataclass(frozen=True)
class _Modifier:
    """`prefix path(inner) value`, as `each a.b(c = 1) = 2`; without a path, `value` is all of the text."""

    prefix: str
    path: tuple[str, ...]
    inner: tuple[_Modifier, ...]
    value: str


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
    heads = ("(", ",", "each", "final")
    dotted = any(
        tokens[at].kind == "name"
        and tokens[at - 1].text in heads
        and tokens[at + 1].text == "."
        and _is_dotted(tokens, at)
        for at in range(opening + 1, end)
    )
    return f"({_written(_modifiers(tokens, opening))})" if dotted else ""


def _is_dotted(tokens: Sequence[Token], at: int) -> bool:
    while tokens[at + 1].text == ".":
        at += 2
    return tokens[at + 1].text == "="


def _modifiers(tokens: Sequence[Token], opening: int) -> tuple[_Modifier, ...]:
    return tuple(_modifier(tokens, first, last) for first, last in arguments(tokens, opening))


def _modifier(tokens: Sequence[Token], first: int, last: int) -> _Modifier:
    at = first
    while tokens[at].text in ("each", "final"):
        at += 1
    prefix = " ".join(one.text for one in tokens[first:at])
    path = []
    while tokens[at].kind == "name":
        path.append(tokens[at].text)
        at += 1
        if tokens[at].text != ".":
            break
        at += 1
    inner: tuple[_Modifier, ...] = ()
    end = last
    if path and tokens[at].text == "(" and at < last:
        end = closing(tokens, at)
        inner = _modifiers(tokens, at)
        at = end + 1
    if path and at <= last and tokens[at].text == "=":
        return _Modifier(prefix, tuple(path), inner, _text(tokens, at, last))
    if inner and at == last + 1:
        return _Modifier(prefix, tuple(path), inner, "")
    return _Modifier("", (), (), _text(tokens, first, last))


def _text(tokens: Sequence[Token], first: int, last: int) -> str:
    """Tokens with the nested modifiers of what is redeclared among them."""
    words, at = [], first
    while at <= last:
        if tokens[at].text == "(" and (nested := in_brackets(tokens, at)):
            words.append(nested)
            at = closing(tokens, at)
        else:
            words.append(tokens[at].text)
        at += 1
    return " ".join(words)


def _written(modifiers: Sequence[_Modifier]) -> str:
    """Those of one element are put together: no list may name an element twice."""
    groups: dict[object, list[_Modifier]] = {}
    for one in modifiers:
        groups.setdefault(one.path[0] if one.path else one, []).append(one)
    return ", ".join(_of_one(group) for group in groups.values())


def _of_one(group: Sequence[_Modifier]) -> str:
    if len(group) == 1 and len(group[0].path) < 2:
        one = group[0]
        nested = f"({_written(one.inner)})" if one.inner else ""
        return " ".join(part for part in (one.prefix, *one.path, nested, one.value) if part)
    inner, values, prefixes = [], [], []
    for one in group:
        if len(one.path) > 1:
            inner.append(_Modifier(one.prefix, one.path[1:], one.inner, one.value))
        else:
            inner += one.inner
            values.append(one.value)
            prefixes.append(one.prefix)
    parts = (*prefixes, group[0].path[0], f"({_written(inner)})", *values)
    return " ".join(part for part in parts if part)
