"""Sources as the compiler takes them: constructs that it refuses, written in others of the same meaning."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

from ..lexer import Token, closing
from .class_bodies import MARK, Edit, ModelicaFile
from .external_functions import with_external_functions
from .external_objects import Objects, with_objects_as_numbers
from .hidden_sections import Sections, with_whens_as_sections, without_sections
from .modifiers import DOTTED, in_brackets
from .reductions import with_reductions_as_equations
from .source_edits import edited, words_of

ANY = f"{MARK}any"
ANY_MODEL = f"partial model {ANY}\nend {ANY};\n"
"""What every model extends: the compiler asks for a common ancestor where Modelica asks for equal parts."""
_IMPORT = re.compile(r"\bimport\s+(?:\w+\s*=\s*)?([\w.]+)\s*;")


def adapted(
    text: str,
    file: str,
    objects: Objects | None = None,
    common: bool = False,
    models: frozenset[str] = frozenset(),
    functions: frozenset[str] | None = frozenset(),
    sections: Sections | None = None,
    whens: bool = False,
) -> str:
    """A file as the compiler takes it.

    Args:
        file: its name, for messages.
        objects: what `external_objects` found.
        common: whether its models extend `ANY`.
        models: qualified names of models, which imports must not go through.
        functions: those that become external beside all with while, break or return, which the compiler does
            not evaluate, by the ends of their names; None: none becomes external.
        sections: where algorithm sections are put which the compiler is not to see; None: it sees them.
        whens: whether when-equations count as such, each as a section of its own.
    """

    def holds(pattern: str) -> bool:
        return re.search(pattern, text) is not None

    # In this order, each where the text calls for it.
    rewrites: list[tuple[bool, Callable[[ModelicaFile], Iterator[Edit]]]] = [
        (whens and holds(r"\bwhen\b"), with_whens_as_sections),
        (
            sections is not None and holds(r"\b(algorithm|when)\b"),
            lambda source: without_sections(source, {} if sections is None else sections),
        ),
        (bool(DOTTED.search(text)), _dotted),
        (holds(r"\bder\s*\(\s*(?![\w.\[\]]*\s*\))"), _derivatives),
        (holds(r"=[^;=]*\([^;]*\bfor\b"), with_reductions_as_equations),
        (
            any(one in text for one in objects or ()),
            lambda source: with_objects_as_numbers(source, objects or {}),
        ),
        (holds(r"\bderivative\s*[=(]"), _annotated),
        (
            functions is not None and (bool(functions) or holds(r"\b(while|break|return)\b")),
            lambda source: with_external_functions(source, functions or frozenset()),
        ),
        (holds(r"\bencapsulated\s+partial\s+model\b"), _lifted),
        (
            any({one.rsplit(".", 1)[0], one.rsplit(".", 2)[0]} & models for one in _IMPORT.findall(text)),
            lambda source: _imports(source, models),
        ),
        (common, _related),
    ]
    for wanted, rewrite in rewrites:
        if wanted:
            text = edited(text, list(rewrite(ModelicaFile(text, file))))
    return text


def has_dotted_modifiers(text: str, file: str) -> bool:
    """Whether the compiler would pass over modifiers of a file; see `adapted`."""
    return bool(DOTTED.search(text)) and any(_dotted(ModelicaFile(text, file)))


def _dotted(source: ModelicaFile) -> Iterator[Edit]:
    """(a.b = v) -> (a(b = v)): the compiler passes over dotted names, where they name attributes."""
    tokens, place = source.tokens, 0
    while place < len(tokens) - 1:
        if tokens[place].text == "annotation":
            place = closing(tokens, place + 1)
        elif tokens[place].text == "(":
            if new := in_brackets(tokens, place):
                end = closing(tokens, place)
                yield source.replaced(place, end, new)
                place = end
        place += 1


def _derivatives(source: ModelicaFile) -> Iterator[Edit]:
    """der(expression) -> der(v), where v is a new variable with v = expression."""
    tokens = source.tokens
    for one in source.classes:
        count, section, loops = 0, None, 0
        added: dict[int, list[str]] = {}
        for place in one.own():
            word, before = tokens[place].text, tokens[place - 1].text
            if word in ("equation", "algorithm"):
                kind = word
                section = place - 1 if before == "initial" else place
                loops = 0
            if word == "for" and section is not None:
                loops += -1 if before == "end" else 1
            if word != "der" or tokens[place + 1].text != "(" or section is None or loops:
                continue
            last = closing(tokens, place + 1)
            inside = tokens[place + 2 : last]
            if kind == "algorithm" or _is_reference(inside):
                continue
            count += 1
            name = f"{MARK}{count}_of_{one.name}"
            line = f"protected Real {name}; equation {name} = {words_of(inside)};"
            added.setdefault(section, []).append(line)
            yield source.replaced(place + 2, last - 1, name)
        for place, lines in added.items():
            yield source.before(place, " ".join([*lines, ""]))


def _is_reference(tokens: Sequence[Token]) -> bool:
    depth = 0
    for one in tokens:
        depth += (one.text == "[") - (one.text == "]")
        if not depth and one.kind != "name" and one.text not in (".", "]"):
            return False
    return True


def _annotated(source: ModelicaFile) -> Iterator[Edit]:
    """Drop what names the derivative of a function: that follows from its statements or its table."""
    tokens = source.tokens
    for one in source.classes:
        for place in range(one.body, one.end) if one.kind == "function" else ():
            if tokens[place].text != "derivative" or tokens[place - 1].text not in ("(", ","):
                continue
            last = place + 1
            while tokens[last].text not in (",", ")"):
                last = (closing(tokens, last) if tokens[last].text == "(" else last) + 1
            if tokens[last].text == ",":
                yield source.replaced(place, last, "")
            else:
                yield source.replaced(place - (tokens[place - 1].text == ","), last - 1, "")


def _lifted(source: ModelicaFile) -> Iterator[Edit]:
    """A class that the class around it extends moves up beside that: it sees nothing of it anyway."""
    tokens = source.tokens
    for outer in source.classes:
        words = [tokens[place] for place in outer.own()]
        extended = {after.text for one, after in pairwise(words) if one.text == "extends"}
        for inner in outer.inner:
            first = inner.start
            while tokens[first - 1].text in ("encapsulated", "partial"):
                first -= 1
            if inner.name not in extended or tokens[first].text != "encapsulated":
                continue
            name = f"{MARK}{inner.name}_of_{outer.name}"
            yield source.replaced(first, inner.end + 2, "")
            start = outer.start
            while tokens[start - 1].text in ("encapsulated", "partial", "replaceable", "redeclare", "final"):
                start -= 1
            body = words_of(tokens[inner.body : inner.end]).replace("\n", " ")
            yield source.before(start, f"partial model {name} {body} end {name}; ")
            for one, after in pairwise(words):
                if one.text == "extends" and after.text == inner.name:
                    yield after.start, after.start + len(after.text), name


def _imports(source: ModelicaFile, models: frozenset[str]) -> Iterator[Edit]:
    """What is imported from within a model gets its full name where it is used."""
    tokens = source.tokens
    for one in source.classes:
        for place in one.own():
            if tokens[place].text != "import":
                continue
            end = place
            while tokens[end].text != ";":
                end += 1
            words = [token.text for token in tokens[place + 1 : end]]
            path = "".join(words[2:] if "=" in words else words)
            parts = path.split(".")
            if not any(".".join(parts[:depth]) in models for depth in range(1, len(parts))):
                continue
            yield source.replaced(place, end, "")
            alias = words[0] if "=" in words else parts[-1]
            for at in range(one.body, one.end):
                here = tokens[at].text == alias and not place <= at <= end
                if here and tokens[at - 1].text != "." and tokens[at + 1].text != "=":
                    yield source.replaced(at, at, path)


def _related(source: ModelicaFile) -> Iterator[Edit]:
    """Let models extend `ANY`, and replaceable components be constrained by it."""
    tokens = source.tokens
    for one in source.classes:
        if one.kind in ("model", "block", "class"):
            yield source.before(one.body, f"extends .{ANY}; ")
        for place in one.own():
            if tokens[place].text != "replaceable" or tokens[place + 1].kind != "name":
                continue
            at = place + 2
            while tokens[at].text == ".":
                at += 2
            if tokens[at].kind != "name":
                continue
            at += 1
            while tokens[at].text in ("(", "["):
                at = closing(tokens, at) + 1
            if tokens[at].text != "constrainedby":
                yield source.behind(at - 1, f" constrainedby .{ANY}")
