"""Sources as the compiler takes them: constructs that it refuses, written in others of the same meaning.

Names that start with `MARK` are made here; `dae` knows what they stand for.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from orchestrator.base.digests import digest_of

from ..built_in import BUILT_IN, STEPS
from ..classes import within_clause
from ..lexer import Token, closing, tokenise
from ..modifiers import DOTTED, arguments, in_brackets
from ..source_edits import path_end, statement_end

Sections = dict[str, "Section"]
Objects = Mapping[str, Sequence[tuple[str, str, str]]]
__all__ = [
    "ANY",
    "ANY_MODEL",
    "CALL",
    "MARK",
    "Section",
    "adapted",
    "class_texts",
    "external_objects",
    "function_body",
    "has_dotted_modifiers",
]

MARK = "adapted_"
CALL = f"{MARK}call"
"""The external function that stands for one whose statements the compiler refuses."""
ANY = f"{MARK}any"
ANY_MODEL = f"partial model {ANY}\nend {ANY};\n"
"""What every model extends: the compiler asks for a common ancestor where Modelica asks for equal parts."""

_KINDS = frozenset("class model block connector type package function record operator".split())
_OBJECT = re.compile(
    r"\b(?:class|type|model)\s+(\w+)(?:\s*\"(?:[^\"\\]|\\.)*\")*\s*extends\s+ExternalObject\s*;"
)

_KEPT = frozenset(name for name, one in BUILT_IN.items() if one.value and name not in STEPS) | {"sum"}
_IMPORT = re.compile(r"\bimport\s+(?:\w+\s*=\s*)?([\w.]+)\s*;")
_INPUT = re.compile(r"\binput\s+([\w.]+)\s+(\w+)\s*(\[[^\]]*\])?")


@dataclass
class _Class:
    """A class with a body: indices of tokens."""

    name: str
    kind: str
    start: int
    body: int
    end: int = 0
    inner: list[_Class] = field(default_factory=list)


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


@dataclass(frozen=True)
class _Edit:
    """Text in place of that between two offsets."""

    start: int
    end: int
    text: str


def external_objects(texts: Iterable[str]) -> dict[str, list[tuple[str, str, str]]]:
    """Classes that extend ExternalObject -> name, type and dimensions of what their constructors get."""
    found = {}
    for text in texts:
        for match in _OBJECT.finditer(text) if "ExternalObject" in text else ():
            body = text[match.end() : text.index("end constructor", match.end())]
            found[match[1]] = [(name, kind, size) for kind, name, size in _INPUT.findall(body)]
    return found


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
    rewrites: list[tuple[bool, Callable[[str, Sequence[Token], list[_Class]], Iterator[_Edit]]]] = [
        (whens and bool(re.search(r"\bwhen\b", text)), _when_sections),
        (
            sections is not None and bool(re.search(r"\b(algorithm|when)\b", text)),
            lambda *all_of: _hidden(*all_of, {} if sections is None else sections, file),
        ),
        (bool(DOTTED.search(text)), _dotted),
        (bool(re.search(r"\bder\s*\(\s*(?![\w.\[\]]*\s*\))", text)), _derivatives),
        (bool(re.search(r"=[^;=]*\([^;]*\bfor\b", text)), _reductions),
        (any(one in text for one in objects or ()), lambda *all_of: _objects(*all_of, objects or {})),
        (bool(re.search(r"\bderivative\s*[=(]", text)), _annotated),
        (
            functions is not None and bool(functions or re.search(r"\b(while|break|return)\b", text)),
            lambda *all_of: _functions(*all_of, functions or frozenset()),
        ),
        (bool(re.search(r"\bencapsulated\s+partial\s+model\b", text)), _lifted),
        (
            any(
                one.rpartition(".")[0] in models or one.rpartition(".")[0].rpartition(".")[0] in models
                for one in _IMPORT.findall(text)
            )
            if models
            else False,
            lambda *all_of: _imports(*all_of, models),
        ),
        (common, _related),
    ]
    for wanted, rewrite in rewrites:
        if wanted:
            tokens = tokenise(text, file)
            edits = sorted(rewrite(text, tokens, _classes(tokens)), key=lambda one: one.start)
            for one in reversed(edits):
                text = text[: one.start] + one.text + text[one.end :]
    return text


def has_dotted_modifiers(text: str, file: str) -> bool:
    """Whether the compiler would pass over modifiers of a file; see `adapted`."""
    return bool(DOTTED.search(text)) and any(_dotted(text, tokenise(text, file), []))


def function_body(tokens: Sequence[Token], at: int = 0) -> tuple[int, int]:
    """Indices of the first token of the body, and of the `end`, of the class that begins at or after one."""
    found = min((one for one in _all(_classes(tokens)) if one.start >= at), key=lambda one: one.start)
    return found.body, found.end


def class_texts(text: str, file: str, kind: str) -> dict[str, str]:
    """The text of each class of a kind in a file by its qualified name."""
    tokens = tokenise(text, file)
    found: dict[str, str] = {}
    for name, one in _named(_classes(tokens), within_clause(tokens)):
        if one.kind == kind:
            first = one.start - (one.start > 0 and tokens[one.start - 1].text in ("pure", "impure"))
            found[name] = _slice(text, tokens, first, one.end + 2)
    return found


def _classes(tokens: Sequence[Token]) -> list[_Class]:
    """The classes with a body, outermost first, with those within them."""
    found: list[_Class] = []
    stack: list[_Class] = []
    for place, token in enumerate(tokens[:-2]):
        after = tokens[place + 1]
        if token.text == "end" and stack and after.text == stack[-1].name:
            stack.pop().end = place
        if token.kind != "keyword" or token.text not in _KINDS:
            continue
        at = place + (2 if after.text == "extends" else 1)
        if tokens[at].kind != "name" or (tokens[at + 1].text in ("=", ";", "(") and after.text != "extends"):
            continue
        body = at + 1
        if tokens[body].text == "(":
            body = closing(tokens, body) + 1
        while tokens[body].kind == "string" or tokens[body].text == "+":
            body += 1
        made = _Class(tokens[at].text, token.text, place, body)
        (stack[-1].inner if stack else found).append(made)
        stack.append(made)
    return found


def _all(classes: Iterable[_Class]) -> Iterator[_Class]:
    for one in classes:
        yield one
        yield from _all(one.inner)


def _own(one: _Class) -> Iterator[int]:
    """Indices of a class's tokens without those of classes within it."""
    place = one.body
    for inner in [*one.inner, None]:
        yield from range(place, inner.start if inner else one.end)
        place = inner.end + 2 if inner else one.end


def _end_of(token: Token) -> int:
    return token.start + len(token.text)


def _slice(text: str, tokens: Sequence[Token], first: int, last: int) -> str:
    return text[tokens[first].start : _end_of(tokens[last])]


# Modifiers


def _dotted(text: str, tokens: Sequence[Token], classes: list[_Class]) -> Iterator[_Edit]:
    """(a.b = v) -> (a(b = v)): the compiler passes over dotted names, where they name attributes."""
    place = 0
    while place < len(tokens) - 1:
        if tokens[place].text == "annotation":
            place = closing(tokens, place + 1)
        elif tokens[place].text == "(":
            end = closing(tokens, place)
            if new := in_brackets(tokens, place):
                old = _slice(text, tokens, place, end)
                yield _Edit(tokens[place].start, _end_of(tokens[end]), _lines_kept(old, new))
                place = end
        place += 1


# der() of expressions


def _derivatives(text: str, tokens: Sequence[Token], classes: list[_Class]) -> Iterator[_Edit]:
    """der(expression) -> der(v), where v is a new variable with v = expression."""
    for one in _all(classes):
        count, section, loops = 0, None, 0
        added: dict[int, list[str]] = {}
        for place in _own(one):
            token, before = tokens[place], tokens[place - 1]
            if token.text in ("equation", "algorithm"):
                kind = token.text
                section = place - 1 if before.text == "initial" else place
                loops = 0
            if token.text == "for" and section is not None:
                loops += -1 if before.text == "end" else 1
            if token.text != "der" or tokens[place + 1].text != "(" or section is None or loops:
                continue
            last = closing(tokens, place + 1)
            inside = tokens[place + 2 : last]
            if kind == "algorithm" or _is_reference(inside):
                continue
            count += 1
            name = f"{MARK}{count}_of_{one.name}"
            value = " ".join(one.text for one in inside)
            added.setdefault(section, []).append(f"protected Real {name}; equation {name} = {value};")
            old = _slice(text, tokens, place + 2, last - 1)
            yield _Edit(inside[0].start, _end_of(inside[-1]), _lines_kept(old, name))
        for place, lines in added.items():
            yield _Edit(tokens[place].start, tokens[place].start, " ".join([*lines, ""]))


def _is_reference(tokens: Sequence[Token]) -> bool:
    depth = 0
    for one in tokens:
        depth += (one.text == "[") - (one.text == "]")
        if not depth and one.kind != "name" and one.text not in (".", "]"):
            return False
    return True


# Calls in reductions


def _reductions(text: str, tokens: Sequence[Token], classes: list[_Class]) -> Iterator[_Edit]:
    """Real x = sum({f(k) for k in 1:n}) -> Real x; equation x = ...: else the compiler takes no k."""
    for one in _all(classes):
        own = list(_own(one)) if one.kind in ("model", "block") else []
        moved, begin, declares = list[str](), 0, True
        while begin < len(own) and declares:
            first = own[begin]
            last = statement_end(tokens, first)
            declares = tokens[first].text not in ("equation", "algorithm", "initial", "annotation")
            begin = next((n for n, place in enumerate(own) if place > last), len(own))
            first += tokens[first].text in ("public", "protected")
            first += tokens[first].text == "output"
            if declares and tokens[first].kind == "name":
                name, sign, end = _bound(tokens, first, last)
                if sign and _reduces(tokens, sign + 1, end):
                    moved.append(f"{name} = {' '.join(one.text for one in tokens[sign + 1 : end])};")
                    old = _slice(text, tokens, sign, end - 1)
                    yield _Edit(tokens[sign].start, _end_of(tokens[end - 1]), _lines_kept(old, ""))
        if moved:
            section = ("equation", "algorithm", "initial", "annotation")
            places = [
                at
                for at in own
                if tokens[at].text in section and (tokens[at - 1].text == ";" or at == own[0])
            ]
            at = places[0] if places else one.end
            yield _Edit(tokens[at].start, tokens[at].start, f"equation {' '.join(moved)} ")


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
    conditional = tokens[at].text != "=" or tokens[end].text == ","
    return (name, 0, 0) if conditional else (name, at, end)


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
        within = tokens[opening].text == "(" or opening > first
        calls = [
            tokens[place].text for place in range(opening + 1, at)
            if tokens[place].kind == "name" and tokens[place + 1].text == "("
        ]  # fmt: skip
        if within and set(calls) - _KEPT:
            return True
    return False


# External objects


def _objects(text: str, tokens: Sequence[Token], classes: list[_Class], names: Objects) -> Iterator[_Edit]:
    """An object becomes the number 0, and what its constructor gets parameters beside it.

    The class itself becomes the constructor, so that imports of its name still hold.
    """
    inside: list[range] = []
    for one in _all(classes):
        if one.name in names and any(tokens[place].text == "ExternalObject" for place in _own(one)):
            made = next((inner for inner in one.inner if inner.name == "constructor"), None)
            if made is None:
                continue
            inside.append(range(one.start, one.end + 3))
            body = _slice(text, tokens, made.body, made.end - 1)
            body = re.sub(rf"\boutput\s+{one.name}\b", "output Real", body)
            content = f"function {one.name} {body} end {one.name};"
            yield _Edit(tokens[one.start].start, _end_of(tokens[one.end + 2]), _lines_kept(
                _slice(text, tokens, one.start, one.end + 2), content))  # fmt: skip
    for place, token in enumerate(tokens[:-2]):
        if token.text not in names or any(place in one for one in inside):
            continue
        name = tokens[place + 1]
        if name.kind != "name" or tokens[place - 1].text == "end":
            continue
        first = place
        while tokens[first - 1].text == ".":
            first -= 2
        opening = place + 3
        while tokens[place + 2].text == "=" and tokens[opening].text == ".":
            opening += 1
        begin, end = tokens[first].start, _end_of(name)
        if tokens[place + 2].text != "=":
            yield _Edit(begin, end, f"Real {name.text}")
            continue
        while tokens[opening].text != "(":
            opening += 1
        last = closing(tokens, opening)
        start = first
        while tokens[start - 1].text in ("final", "parameter", "constant"):
            start -= 1
        inputs = {one[0]: one for one in names[token.text]}
        lines = [f"final parameter Real {name.text} = 0"]
        for (label, _, _), (a, b) in zip(names[token.text], arguments(tokens, opening), strict=False):
            if tokens[a].kind == "name" and tokens[a + 1].text == "=":
                label, a = tokens[a].text, a + 2
            _, kind, size = inputs[label]
            value = _slice(text, tokens, a, b)
            if kind != "String":
                lines.append(f"final parameter {kind} {MARK}{name.text}_{label}{size} = {value}")
        old = _slice(text, tokens, start, last)
        yield _Edit(tokens[start].start, _end_of(tokens[last]), _lines_kept(old, "; ".join(lines)))


def _lines_kept(old: str, new: str) -> str:
    """A text with the line breaks that it replaces."""
    return new + "\n" * max(0, old.count("\n") - new.count("\n"))


# Functions


def _functions(
    text: str, tokens: Sequence[Token], classes: list[_Class], named: frozenset[str]
) -> Iterator[_Edit]:
    """A function with while, break or return becomes an external one, as do those named; see `functions`."""
    within = -1
    for name, one in _named(classes, within_clause(tokens)):
        if one.start < within:  # of a function that is external as a whole
            continue
        own = list(_own(one)) if one.kind == "function" else []
        words = [tokens[place].text for place in own]
        if "algorithm" not in words:
            continue
        jumps = {"while", "break", "return"} & set(words[words.index("algorithm") :])
        if not jumps and not any(f".{name}".endswith(f".{end}") for end in named):
            continue
        kept: dict[str, list[str]] = {"input": [], "output": []}
        lines = []
        place = own[0]
        while tokens[place].text != "algorithm":
            begin = place
            while tokens[place].text != ";" and place in own:
                place = closing(tokens, place) if tokens[place].text in ("(", "[", "{") else place
                place += 1
            word = tokens[begin].text
            if word in kept:
                last = next((k for k in range(begin, place) if tokens[k].text == "annotation"), place)
                lines.append(f"{_slice(text, tokens, begin, last - 1)};")
                kept[word] += _names(tokens, begin, last)
            elif word in ("extends", "import"):
                lines.append(f"{_slice(text, tokens, begin, place)}")
            elif word in ("protected", "public"):
                place = begin
            elif tokens[begin].text in _KINDS or place not in own:
                place = next(inner.end + 2 for inner in one.inner if inner.end > begin)
            place += 1
        within = one.end
        inputs, outputs = ", ".join(kept["input"]), kept["output"]
        if not outputs:
            continue
        single = len(outputs) == 1 and not re.search(
            rf"\b{outputs[0]}\s*\[|\]\s*{outputs[0]}\b", " ".join(lines)
        )
        call = (
            f"{outputs[0]} = {CALL}({inputs})"
            if single
            else f"{CALL}({', '.join([*kept['input'], *outputs])})"
        )
        content = f'{" ".join(lines)} external "C" {call};'
        if tokens[one.start - 1].text not in ("pure", "impure"):
            yield _Edit(tokens[one.start].start, tokens[one.start].start, "pure ")
        old = _slice(text, tokens, one.body, one.end - 1)
        yield _Edit(tokens[one.body].start, _end_of(tokens[one.end - 1]), _lines_kept(old, content))


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


# Algorithms


_SECTIONS = frozenset("equation algorithm initial public protected annotation external".split())


def _hidden(
    text: str, tokens: Sequence[Token], classes: list[_Class], sections: Sections, file: str
) -> Iterator[_Edit]:
    """Algorithm sections are taken out; a parameter stands for each."""
    for scope, one in _named(classes, within_clause(tokens)):
        own = list(_own(one)) if one.kind in ("model", "block", "class") else []
        for number, place in enumerate(own):
            if tokens[place].text != "algorithm":
                continue
            last = number + 1
            while last < len(own) and not _begins_section(tokens, own[last]):
                last += 1
            if own[last - 1] == place or own[last - 1] - place != last - 1 - number:  # a class stands within
                continue
            initial = tokens[place - 1].text == "initial"
            statements = _slice(text, tokens, place + 1, own[last - 1])
            made = Section(scope, statements, initial, file, tokens[place].line)
            key = digest_of(repr(made).encode())[:12]
            sections[key] = made
            name = f"{MARK}section_{key}_of_{one.name if one.name.isidentifier() else 'class'}"
            old = _slice(text, tokens, place - initial, own[last - 1])
            yield _Edit(
                tokens[place - initial].start,
                _end_of(tokens[own[last - 1]]),
                _lines_kept(old, f"protected final parameter Real {name} = 0; equation"),
            )


def _when_sections(text: str, tokens: Sequence[Token], classes: list[_Class]) -> Iterator[_Edit]:
    """When-equations, alone or within one for-equation, become algorithm sections behind the equations."""
    for one in _all(classes):
        own = list(_own(one)) if one.kind in ("model", "block", "class") else []
        section, loops, place = "", [], 0
        while place < len(own):
            at = own[place]
            word = tokens[at].text
            if _begins_section(tokens, at) and word != "initial":
                section = word if tokens[at - 1].text != "initial" else ""
            elif section == "equation" and word == "for" and tokens[at - 1].text != "end":
                if tokens[at - 1].text in (";", "loop", "equation", "then", "else"):  # else of an array
                    loops.append(at)
            elif section == "equation" and word == "for" and loops:
                loops.pop()
            elif section == "equation" and word == "when" and tokens[at - 1].text != "end" and len(loops) < 2:
                last = place
                while [tokens[n].text for n in own[last : last + 2]] != ["end", "when"]:
                    last += 1
                yield from _as_section(text, tokens, at, own[last + 2], loops)
                place = last + 2
            place += 1


def _as_section(
    text: str, tokens: Sequence[Token], first: int, last: int, loops: Sequence[int]
) -> Iterator[_Edit]:
    """One when-equation; `first` and `last` token of it, the `for` around it."""
    parts: list[str] = []
    at = first
    while at < last - 2:
        then = next(n for n in range(at, last) if tokens[n].text == "then")
        end = next(n for n in range(then, last) if tokens[n].text in ("elsewhen", "end"))
        statements = _in_order(tokens, then + 1, end)
        if statements is None:
            return
        parts += [_words(tokens, at, then), *statements]
        at = end
    made, close = " ".join([*parts, "end when;"]), ""
    for at in loops:
        body = next(n for n in range(at, first) if tokens[n].text == "loop")
        made, close = f"{_words(tokens, at, body)} {made}", " end for;"
    after = last + 1
    if loops:  # behind the loop
        while [tokens[n].text for n in (after, after + 1)] != ["end", "for"]:
            after += 1
        after += 3
    yield _Edit(
        tokens[first].start, _end_of(tokens[last]), _lines_kept(_slice(text, tokens, first, last), "")
    )
    where = _end_of(tokens[after - 1])
    yield _Edit(where, where, f" algorithm {made}{close} equation ")


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
            whole = _words(tokens, begin, at)
            if sign:
                whole = f"{_words(tokens, begin, sign - 1)} := {_words(tokens, sign + 1, at)}"
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


def _words(tokens: Sequence[Token], first: int, last: int) -> str:
    """Tokens without the comments between them."""
    return " ".join(one.text for one in tokens[first : last + 1])


def _named(classes: Iterable[_Class], prefix: str) -> Iterator[tuple[str, _Class]]:
    """All classes with their qualified names."""
    for one in classes:
        name = f"{prefix}.{one.name}" if prefix else one.name
        yield name, one
        yield from _named(one.inner, name)


def _begins_section(tokens: Sequence[Token], place: int) -> bool:
    word = tokens[place].text
    if word not in _SECTIONS or tokens[place].kind != "keyword":
        return False
    if word == "initial":
        return tokens[place + 1].text in ("equation", "algorithm")
    return True


# Derivatives of functions


def _annotated(text: str, tokens: Sequence[Token], classes: list[_Class]) -> Iterator[_Edit]:
    """Drop what names the derivative of a function: that follows from its statements or its table."""
    for one in _all(classes):
        for place in range(one.body, one.end) if one.kind == "function" else ():
            if tokens[place].text != "derivative" or tokens[place - 1].text not in ("(", ","):
                continue
            last = place + 1
            while tokens[last].text not in (",", ")"):
                last = (closing(tokens, last) if tokens[last].text == "(" else last) + 1
            first = tokens[place].start
            if tokens[last].text == ",":
                yield _Edit(first, _end_of(tokens[last]), "")
            elif tokens[place - 1].text == ",":
                yield _Edit(tokens[place - 1].start, _end_of(tokens[last - 1]), "")
            else:
                yield _Edit(first, _end_of(tokens[last - 1]), "")


# Classes within classes that extend them


def _lifted(text: str, tokens: Sequence[Token], classes: list[_Class]) -> Iterator[_Edit]:
    """A class that the class around it extends moves up beside that: it sees nothing of it anyway."""
    for outer in _all(classes):
        words = [tokens[place] for place in _own(outer)]
        extended = {after.text for one, after in pairwise(words) if one.text == "extends"}
        for inner in outer.inner:
            first = inner.start
            while tokens[first - 1].text in ("encapsulated", "partial"):
                first -= 1
            if inner.name not in extended or tokens[first].text != "encapsulated":
                continue
            name = f"{MARK}{inner.name}_of_{outer.name}"
            old = _slice(text, tokens, first, inner.end + 2)
            yield _Edit(tokens[first].start, _end_of(tokens[inner.end + 2]), "\n" * old.count("\n"))
            start = outer.start
            while tokens[start - 1].text in ("encapsulated", "partial", "replaceable", "redeclare", "final"):
                start -= 1
            body = " ".join(token.text.replace("\n", " ") for token in tokens[inner.body : inner.end])
            moved = f"partial model {name} {body} end {name}; "
            yield _Edit(tokens[start].start, tokens[start].start, moved)
            for one, after in pairwise(words):
                if one.text == "extends" and after.text == inner.name:
                    yield _Edit(after.start, _end_of(after), name)


# Imports


def _imports(
    text: str, tokens: Sequence[Token], classes: list[_Class], models: frozenset[str]
) -> Iterator[_Edit]:
    """What is imported from within a model gets its full name where it is used."""
    for one in _all(classes):
        for place in list(_own(one)):
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
            yield _Edit(tokens[place].start, _end_of(tokens[end]), "")
            alias = words[0] if "=" in words else parts[-1]
            for at in range(one.body, one.end):
                here = tokens[at].text == alias and not place <= at <= end
                if here and tokens[at - 1].text != "." and tokens[at + 1].text != "=":
                    yield _Edit(tokens[at].start, _end_of(tokens[at]), path)


# Common ancestors


def _related(text: str, tokens: Sequence[Token], classes: list[_Class]) -> Iterator[_Edit]:
    """Let models extend `ANY`, and replaceable components be constrained by it."""
    for one in _all(classes):
        if one.kind in ("model", "block", "class"):
            yield _Edit(tokens[one.body].start, tokens[one.body].start, f"extends .{ANY}; ")
        for place in _own(one):
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
                end = _end_of(tokens[at - 1])
                yield _Edit(end, end, f" constrainedby .{ANY}")
