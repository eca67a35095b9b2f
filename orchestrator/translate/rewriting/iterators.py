"""Iterators that the compiler refuses, written in those that it takes: ranges of Integers, one for each loop.

Loops over enumerations, over Booleans, over values in braces and over Real ranges are unrolled; loops over
arrays count their elements. Numbers of enumerations, as Integer(E.one), become choices.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from ..lexer import CLOSING, OPENING, Token, closing, tokenise
from .modifiers import arguments
from .source_edits import edited, on_one_line, outermost, path_end, statement_end, text_end

_MOST_VALUES = 1000
_REDUCTIONS = frozenset(("sum", "product", "min", "max", "array"))
_Edit = tuple[int, int, str]
_Kinds = Mapping[str, Sequence[str]]  # enumerations by their last names


@dataclass(frozen=True)
class _Iterator:
    """One of a loop: its name, and the tokens of what it runs over; none where subscripts determine that."""

    name: str
    over: Sequence[Token]
    start: int  # tokens
    end: int


def with_plain_iterators(texts: Mapping[str, str]) -> dict[str, str]:
    """The files that change, with these.

    Args:
        texts: path -> content of all files of a model.
    """
    if not any(re.search(r"\b(for|Integer\s*\()", text) for text in texts.values()):
        return {}
    kinds = _enumerations(texts)
    changed = {}
    for path, before in texts.items():
        text = before
        while edits := outermost(_edits(text, tokenise(text, path), kinds)):
            text = edited(text, edits)
        if text != before:
            changed[path] = text
    return changed


def _enumerations(texts: Mapping[str, str]) -> _Kinds:
    """The members of enumerations; those whose names stand for several are left out."""
    found: dict[str, set[tuple[str, ...]]] = {}
    for path, text in texts.items():
        tokens = tokenise(text, path) if "enumeration" in text else ()
        for place, token in enumerate(tokens):
            if token.text != "enumeration" or [one.text for one in tokens[place - 1 : place + 2 : 2]] != [
                "=",
                "(",
            ]:
                continue
            inside = range(place + 2, closing(tokens, place + 1))
            members = tuple(tokens[at].text for at in inside if tokens[at - 1].text in ("(", ","))
            found.setdefault(tokens[place - 2].text, set()).add(members)
    return {name: next(iter(some)) for name, some in found.items() if len(some) == 1}


def _number(tokens: Sequence[Token], first: int, end: int, kinds: _Kinds) -> str:
    """The number of an enumeration's member, or of a variable that is one; "" of anything else."""
    words = [token.text for token in tokens[first:end]]
    *path, name = "".join(words).split(".")
    members = kinds.get(path[-1], ()) if path else ()
    if name in members:
        return str(members.index(name) + 1)
    if not name.isidentifier() or path:
        return ""
    types = set()
    for at in range(2, len(tokens)):
        if tokens[at].text == name and tokens[at - 1].kind == "name":
            begin = at - 1
            while tokens[begin - 1].text == ".":
                begin -= 2
            types.add("".join(token.text for token in tokens[begin:at]))
    kind = types.pop() if len(types) == 1 else ""
    members = kinds.get(kind.rpartition(".")[2], ())
    if not members:
        return ""
    cases = [f"if {name} == {kind}.{member} then {n}" for n, member in enumerate(members[:-1], 1)]
    return f"({' else '.join(cases)} else {len(members)})" if cases else "1"


def _edits(text: str, tokens: Sequence[Token], kinds: _Kinds) -> Iterator[_Edit]:
    for place, token in enumerate(tokens):
        if token.text == "Integer" and tokens[place + 1 : place + 2] and tokens[place + 1].text == "(":
            end = closing(tokens, place + 1)
            if number := _number(tokens, place + 2, end, kinds):
                yield token.start, text_end(tokens[end]), number
        if token.text != "for" or token.kind != "keyword" or tokens[place - 1].text == "end":
            continue
        iterators, end = _iterators(tokens, place)
        if not iterators:
            continue
        if tokens[end].text == "loop":
            last = _loop_end(tokens, end)
            if last:
                yield from _loop(text, tokens, place, iterators, (end + 1, last), kinds)
        elif (opening := _opening(tokens, place)) >= 0:
            yield from _comprehension(text, tokens, opening, place, iterators, end, kinds)


def _iterators(tokens: Sequence[Token], place: int) -> tuple[list[_Iterator], int]:
    """Those behind a `for`, and the token behind them; none where the text is no loop."""
    found: list[_Iterator] = []
    at = place + 1
    while at < len(tokens) - 1 and tokens[at].kind == "name":
        begin = at
        at += 1
        over = at
        if tokens[at].text == "in":
            at = over = at + 1
            while (
                at < len(tokens) - 1
                and tokens[at].text not in (",", "loop", ";")
                and tokens[at].text not in CLOSING
            ):
                at = closing(tokens, at) + 1 if tokens[at].text in OPENING else at + 1
        found.append(_Iterator(tokens[begin].text, tokens[over:at], begin, at))
        if tokens[at].text != ",":
            break
        at += 1
    ends = tokens[at].text == "loop" or tokens[at].text in CLOSING
    return (found if ends else []), at


def _loop_end(tokens: Sequence[Token], loop: int) -> int:
    """The `end` of a loop; 0 where there is none."""
    depth = 1
    for at in range(loop, len(tokens) - 1):
        if tokens[at].text == "loop" and at > loop and tokens[at].kind == "keyword":
            depth += 1
        if tokens[at].text == "end" and tokens[at + 1].text in ("for", "while"):
            depth -= 1
            if not depth:
                return at
    return 0


def _opening(tokens: Sequence[Token], place: int) -> int:
    """The bracket around a token; -1 without one."""
    depth = 0
    for at in range(place - 1, -1, -1):
        depth += (tokens[at].text in CLOSING) - (tokens[at].text in OPENING)
        if depth < 0:
            return at
        if not depth and tokens[at].text == ";":
            return -1
    return -1


def _loop(
    text: str,
    tokens: Sequence[Token],
    place: int,
    iterators: Sequence[_Iterator],
    body: tuple[int, int],
    kinds: _Kinds,
) -> Iterator[_Edit]:
    """A loop of equations or statements."""
    first, end = body
    plain = [_is_plain(one, kinds) for one in iterators]
    if all(plain) or any(token.text == "break" for token in tokens[first:end]):
        return
    if len(iterators) > 1:
        for one in iterators[:-1]:
            yield tokens[one.end].start, text_end(tokens[one.end]), " loop for"
        close = text_end(tokens[end + 1])
        yield close, close, "; end for" * (len(iterators) - 1)
        return
    one = iterators[0]
    new = _counted(text, tokens, one, (first, end))
    if new is not None:
        over, value = new
        yield tokens[one.start].start, text_end(tokens[one.end - 1]), over
        yield from _uses(tokens, (first, end), one.name, value)
        return
    values = _values(one.over, kinds)
    if values is None or _hides(tokens, (first, end), one.name):
        return
    last = statement_end(tokens, end)
    begin, behind = tokens[place].start, text_end(tokens[last])
    lines = text[begin : tokens[first].start].count("\n") if first < end else 0
    copies = [_put(text, tokens, (first, end), one.name, value) for value in values]
    yield begin, behind, "\n" * lines + " ".join([*copies[:1], *map(on_one_line, copies[1:])])


def _comprehension(
    text: str,
    tokens: Sequence[Token],
    opening: int,
    place: int,
    iterators: Sequence[_Iterator],
    end: int,
    kinds: _Kinds,
) -> Iterator[_Edit]:
    """An array constructor or a reduction with iterators; `end` is the bracket that closes it."""
    braces = tokens[opening].text == "{"
    plain = all(_is_plain(one, kinds) for one in iterators)
    if not braces:
        if plain or tokens[opening - 1].text not in _REDUCTIONS:
            return
        yield text_end(tokens[opening]), text_end(tokens[opening]), "{"
        yield tokens[end].start, tokens[end].start, "}"
    elif len(iterators) > 1:
        yield tokens[opening].start, tokens[opening].start, "{" * (len(iterators) - 1)
        for one in iterators[:-1]:
            yield tokens[one.end].start, text_end(tokens[one.end]), "} for"
    elif not plain:
        one, inside = iterators[0], (opening + 1, place)
        new = _counted(text, tokens, one, inside)
        if new is not None:
            over, value = new
            yield tokens[one.start].start, text_end(tokens[one.end - 1]), over
            yield from _uses(tokens, inside, one.name, value)
            return
        values = _values(one.over, kinds)
        if values is not None and not _hides(tokens, inside, one.name):
            put = partial(_put, text, tokens, inside, one.name)
            yield (
                text_end(tokens[opening]),
                tokens[end].start,
                ", ".join(on_one_line(put(one)) for one in values),
            )


def _is_plain(one: _Iterator, kinds: _Kinds) -> bool:
    """Whether the compiler takes it, or nothing here helps."""
    if not one.over:
        return False
    return _values(one.over, kinds) is None and not _is_array(one.over)


def _is_array(over: Sequence[Token]) -> bool:
    """Whether it is the name of an array, whose last part begins with a small letter."""
    names = [token for token in over if token.kind == "name"]
    return bool(names) and path_end([*over, over[-1]], 0) == len(over) and names[-1].text[0].islower()


def _counted(
    text: str, tokens: Sequence[Token], one: _Iterator, inside: tuple[int, int]
) -> tuple[str, str] | None:
    """An iterator over the elements of an array as one over its subscripts, and what then stands for it."""
    if _hides(tokens, inside, one.name):
        return None
    if not one.over:  # the size of an array that has it as a subscript
        size = _size_of_subscript(tokens, inside, one.name)
        return (f"{one.name} in 1:{size}", one.name) if size else None
    if not _is_array(one.over):
        return None
    array = "".join(token.text for token in one.over)
    if any(
        token.text == one.over[-1].text and tokens[at + 1].text in (":=", "[")
        for at, token in enumerate(tokens[inside[0] : inside[1]], inside[0])
        if token.kind == "name"
    ):
        return None  # the loop may assign its elements, while it runs over those that were
    return f"{one.name} in 1:size({array}, 1)", f"{array}[{one.name}]"


def _size_of_subscript(tokens: Sequence[Token], inside: tuple[int, int], name: str) -> str:
    for at in range(*inside):
        if tokens[at].text != "[" or tokens[at - 1].kind != "name":
            continue
        begin = at - 1
        while tokens[begin - 1].text == "." and tokens[begin - 2].kind == "name":
            begin -= 2
        if tokens[begin - 1].text == ".":
            continue
        array, number = "".join(token.text for token in tokens[begin:at]), 1
        for place in range(at + 1, closing(tokens, at)):
            number += tokens[place].text == ","
            around = tokens[place - 1].text in ("[", ",") and tokens[place + 1].text in ("]", ",")
            if tokens[place].text == name and around:
                return f"size({array}, {number})"
    return ""


def _values(over: Sequence[Token], kinds: _Kinds) -> list[str] | None:
    """What an iterator runs over, each as text; None where that does not follow from the text."""
    words = [token.text for token in over]
    if words == ["Boolean"] or words == ["false", ":", "true"]:
        return ["false", "true"]
    if words[0] == "{" and closing(over, 0) == len(over) - 1 and "for" not in words:
        return [f"({one})" if " " in one else one for one in _elements(over)]
    name = "".join(words)
    if name.rpartition(".")[2] in kinds and path_end([*over, over[-1]], 0) == len(over):
        return [f"{name}.{one}" for one in kinds[name.rpartition(".")[2]]]
    parts = re.split(":", name)
    if len(parts) == 2 and all("." in one for one in parts):
        (first, low), (second, high) = (part.rpartition(".")[::2] for part in parts)
        members = kinds.get(first.rpartition(".")[2], ())
        if first == second and low in members and high in members:
            return [f"{first}.{one}" for one in members[members.index(low) : members.index(high) + 1]]
    return _real_range(parts) if len(parts) in (2, 3) else None


def _real_range(parts: Sequence[str]) -> list[str] | None:
    """The numbers of a range of literal numbers, of which one is a Real."""
    if not all(re.fullmatch(r"-?[\d.]+([eE][+-]?\d+)?", one) for one in parts):
        return None
    if all(re.fullmatch(r"-?\d+", one) for one in parts):
        return None
    first, *steps, last = map(float, parts)
    step = steps[0] if steps else 1.0
    count = int((last - first) / step * (1 + 1e-12) + 1e-9) + 1 if step else 0
    if not 0 < count <= _MOST_VALUES:
        return None
    return [f"({first + step * n!r})" for n in range(count)]


def _elements(over: Sequence[Token]) -> list[str]:
    """The elements between the braces around them."""
    texts = ([token.text for token in over[first : last + 1]] for first, last in arguments(over, 0))
    return ["".join(one) if one[1:2] == ["."] else " ".join(one) for one in texts]


def _hides(tokens: Sequence[Token], inside: tuple[int, int], name: str) -> bool:
    """Whether a loop within has an iterator of this name."""
    return any(
        tokens[at].text == name
        and tokens[at - 1].text in ("for", ",")
        and tokens[at + 1].text in ("in", "loop")
        for at in range(*inside)
    )


def _uses(tokens: Sequence[Token], inside: tuple[int, int], name: str, value: str) -> Iterator[_Edit]:
    """Replacements of an iterator's name by a value."""
    for at in range(*inside) if name != value else ():
        if tokens[at].text != name or tokens[at].kind != "name" or tokens[at - 1].text == ".":
            continue
        if tokens[at + 1].text == "=" and tokens[at - 1].text in ("(", ","):  # the name of an argument
            continue
        yield tokens[at].start, text_end(tokens[at]), value


def _put(text: str, tokens: Sequence[Token], inside: tuple[int, int], name: str, value: str) -> str:
    """A part of a text with a value in place of an iterator."""
    first, end = inside
    if first >= end:
        return ""
    begin = tokens[first].start
    uses = [(start - begin, stop - begin, put) for start, stop, put in _uses(tokens, inside, name, value)]
    return edited(text[begin : text_end(tokens[end - 1])], uses)
