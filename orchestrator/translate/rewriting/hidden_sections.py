"""Algorithm sections that the compiler is not to see, and when-equations that are to count as such."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from orchestrator.base.digests import digest_of

from ..lexer import Token, closing
from .class_bodies import MARK, ClassBody, Edit, ModelicaFile
from .source_edits import words_of

_BEGINS = frozenset("equation algorithm initial public protected annotation external".split())


@dataclass(frozen=True)
class Section:
    """An algorithm section that the compiler does not see.

    Attributes:
        scope: qualified name of its class.
        text: its statements.
        initial: whether it is an initial algorithm.
        file, line: where it stands.
    """

    scope: str
    text: str
    initial: bool
    file: str
    line: int


Sections = dict[str, Section]


def without_sections(source: ModelicaFile, sections: Sections) -> Iterator[Edit]:
    """Algorithm sections are taken out and put into `sections`; a parameter stands for each."""
    tokens = source.tokens
    for one in _with_sections(source):
        own = list(one.own())
        for number, place in enumerate(own):
            if tokens[place].text != "algorithm":
                continue
            last = number + 1
            while last < len(own) and not _begins_section(tokens, own[last]):
                last += 1
            if own[last - 1] == place or own[last - 1] - place != last - 1 - number:  # a class stands within
                continue
            initial = tokens[place - 1].text == "initial"
            statements = source.words(place + 1, own[last - 1])
            made = Section(one.path, statements, initial, source.file, tokens[place].line)
            key = digest_of(repr(made).encode())[:12]
            sections[key] = made
            name = f"{MARK}section_{key}_of_{one.name if one.name.isidentifier() else 'class'}"
            new = f"protected final parameter Real {name} = 0; equation"
            yield source.replaced(place - initial, own[last - 1], new)


def with_whens_as_sections(source: ModelicaFile) -> Iterator[Edit]:
    """When-equations, alone or within one for-equation, become algorithm sections behind the equations."""
    tokens = source.tokens
    for one in _with_sections(source):
        own = list(one.own())
        section, loops, place = "", [], 0
        while place < len(own):
            at = own[place]
            word, before = tokens[at].text, tokens[at - 1].text
            if _begins_section(tokens, at) and word != "initial":
                section = word if before != "initial" else ""
            elif section == "equation" and word == "for" and before != "end":
                if before in (";", "loop", "equation", "then", "else"):  # else of an array
                    loops.append(at)
            elif section == "equation" and word == "for" and loops:
                loops.pop()
            elif section == "equation" and word == "when" and before != "end" and len(loops) < 2:
                last = place
                while [tokens[n].text for n in own[last : last + 2]] != ["end", "when"]:
                    last += 1
                yield from _as_section(source, at, own[last + 2], loops)
                place = last + 2
            place += 1


def _with_sections(source: ModelicaFile) -> Iterator[ClassBody]:
    return (one for one in source.classes if one.kind in ("model", "block", "class"))


def _begins_section(tokens: Sequence[Token], place: int) -> bool:
    word = tokens[place].text
    if word not in _BEGINS or tokens[place].kind != "keyword":
        return False
    return word != "initial" or tokens[place + 1].text in ("equation", "algorithm")


def _as_section(source: ModelicaFile, first: int, last: int, loops: Sequence[int]) -> Iterator[Edit]:
    """One when-equation; `first` and `last` token of it, the `for` around it."""
    tokens, parts, at = source.tokens, list[str](), first
    while at < last - 2:
        then = next(n for n in range(at, last) if tokens[n].text == "then")
        end = next(n for n in range(then, last) if tokens[n].text in ("elsewhen", "end"))
        statements = _in_order(tokens, then + 1, end)
        if statements is None:
            return
        parts += [words_of(tokens[at : then + 1]), *statements]
        at = end
    made, close = " ".join([*parts, "end when;"]), ""
    for at in loops:
        body = next(n for n in range(at, first) if tokens[n].text == "loop")
        made, close = f"{words_of(tokens[at : body + 1])} {made}", " end for;"
    after = last
    if loops:  # behind the loop
        while [tokens[n].text for n in (after + 1, after + 2)] != ["end", "for"]:
            after += 1
        after += 3
    yield source.replaced(first, last, "")
    yield source.behind(after, f" algorithm {made}{close} equation ")


def _in_order(tokens: Sequence[Token], first: int, end: int) -> list[str] | None:
    """The equations of a when-equation as statements, each behind those that set what it reads.

    None where that is not known: of if- and for-equations, and of equations that need each other.
    """
    waiting: list[tuple[str, set[str], str]] = []  # what it sets, what it reads, the statement
    begin, depth, sign, before = first, 0, 0, 0
    reads: set[str] = set()
    for at in range(first, end):
        word = tokens[at].text
        depth += (word in "([{") - (word in ")]}")
        if word == "pre" and tokens[at + 1].text == "(":
            before = closing(tokens, at + 1)
        elif word == "=" and depth == 0:
            sign = at
        elif word == ";" and depth == 0:
            whole = words_of(tokens[begin : at + 1])
            if sign:
                whole = f"{words_of(tokens[begin:sign])} := {words_of(tokens[sign + 1 : at + 1])}"
            waiting.append((tokens[begin].text if sign else "", reads, whole))
            begin, sign, reads = at + 1, 0, set()
        elif at == begin and (tokens[at].kind == "keyword" or word == "("):
            return None
        elif tokens[at].kind == "name" and at > before and (sign or at > begin):
            reads.add(word)
    found: list[str] = []
    while waiting:
        sets = {name for name, _, _ in waiting if name}
        ready = next((one for one in waiting if not one[1] & sets), None)
        if ready is None:
            return None
        waiting.remove(ready)
        found.append(ready[2])
    return found
