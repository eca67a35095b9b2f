"""Overloaded operators, written as calls of the functions that operator records declare.

rumoca 0.10.2 keeps an operator record, and takes `.R.'+'(a, b)` for what it says. It refuses `a + b` and
`R(1)`, and equations of records that are more than a name on one side. So these are written for each member,
by functions of the record that return one of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from orchestrator.base.errors import BuildError

from ..classes import find_classes, used_classes
from ..lexer import closing
from .declared_classes import KINDS, DeclaredClass, dimensions, own_tokens
from .modifiers import arguments
from .operator_expressions import Expressions
from .operator_values import INDEX, MAKER, SUM, NotRead, Value, getter
from .source_edits import edited, path_end, path_of, statement_end, text_end, words_of
from .typed_classes import BUILT_IN_TYPES, TypedClasses, binding, is_overloading, sizes_of

_RECORD = re.compile(r"\boperator\s+record\b")
_ENDS = frozenset((";", ",", ")", "then", "loop", "annotation", "if", "constrainedby"))


def overloads(texts: dict[str, str], libraries: Sequence[Path]) -> bool:
    """Whether sources, or a library that is one file, have records with operators."""
    alone = [one for folder in libraries if folder.is_dir() for one in folder.glob("*.mo")]
    return any(_RECORD.search(text) for text in texts.values()) or any(
        _RECORD.search(one.read_text(encoding="utf-8")) for one in alone
    )


def with_calls(
    texts: dict[str, str], label: str, libraries: Sequence[Path], model: str = ""
) -> dict[str, str]:
    """The sources with calls in place of overloaded operators; lines stay where they are.

    Args:
        label: of their folder, for messages. libraries: folders with those that they use.
        model: qualified name of what is built; what has no meaning is refused in classes that it uses, and
            stays elsewhere.
    Raises: BuildError.
    """
    classes = find_classes(texts, label) if model else {}
    strict = frozenset(one.name for one in used_classes(classes, model)) if model in classes else frozenset()
    return _Overloaded(texts, label, libraries).lowered(strict)


class _Overloaded(TypedClasses):
    """The classes, whose text changes."""

    def lowered(self, strict: frozenset[str]) -> dict[str, str]:
        edits: dict[str, list[tuple[int, int, str]]] = {}
        names = self._carriers()
        for one in [*self.all_classes()]:
            found = edits.setdefault(one.file, [])
            concerned = self._libraries or any(one.tokens[at].text in names for at in _all_tokens(one))
            if is_overloading(one):
                found += self._record_edits(one)
            if concerned and not (one.short is not None and is_overloading(one)):
                found += [*_output_edits(self, one), *_Body(self, one, one.name in strict).edits()]
        return {file: edited(text, edits.get(file, ())) for file, text in self._texts.items()}

    def _carriers(self) -> set[str]:
        """Last names of classes that may hold operator records."""
        uses: dict[str, set[str]] = {}
        names = set[str]()
        for one in self.all_classes():
            last = one.tokens[one.label].text
            if is_overloading(one):
                names.add(last)
            for part in (*one.parts, *([one.short] if one.short else [])):
                if part.kind in ("components", "extends"):
                    uses.setdefault(one.tokens[part.path[1] - 1].text, set()).add(last)
        ahead = list(names)
        while ahead:
            more = uses.get(ahead.pop(), set()) - names
            names |= more
            ahead += more
        return names

    def _record_edits(self, one: DeclaredClass) -> Iterator[tuple[int, int, str]]:
        tokens = one.tokens
        if one.short is not None:  # its units are kept; the compiler would take redeclared types for others
            if one.short.opening >= 0:
                inner = []
                for first, last in arguments(tokens, one.short.opening):
                    at = first + (tokens[first].text == "redeclare")
                    behind = at
                    while tokens[behind].text == "." or tokens[behind + 1].text == ".":
                        behind += 1
                    words = path_of(tokens, at, behind + 1)
                    unit = self._unit(words, one) if at > first else ""
                    if at == first:
                        inner.append(words_of(tokens[first : last + 1]))
                    elif unit:
                        inner.append(f"{tokens[behind + 1].text}(unit={unit})")
                end = text_end(tokens[closing(tokens, one.short.opening)])
                yield tokens[one.short.opening].start, end, f"({', '.join(inner)})" if inner else ""
            return
        made, members = list[str](), list[tuple[str, str, str]]()
        own = tokens[one.label].text
        for name, (owner, part, at) in self.components(one).items():
            kind, _ = self.kind_of(owner, part)
            if kind in BUILT_IN_TYPES:
                sizes = "".join(f"[{size}]" for size in sizes_of((owner, part, at)))
                members.append((name, kind, sizes))
                made.append(
                    f"encapsulated function {getter(name)} import {one.name}; input {own} record_; "
                    f"output {kind} value{sizes}; algorithm value := record_.{name}; end {getter(name)};"
                )
        inputs = " ".join(f"input {kind} {name}{sizes};" for name, kind, sizes in members)
        values = " ".join(f"record_.{name} := {name};" for name, _, _ in members)
        made.append(
            f"encapsulated function {MAKER} import {one.name}; input {own} other_; {inputs} "
            f"output {own} record_; algorithm {values} end {MAKER};"
        )
        if functions := self.sum_functions(one.name):
            zero, plus = (f"{own}{function.name.removeprefix(one.name)}" for function in functions)
            made.append(
                f"encapsulated function {SUM} import {one.name}; input {own} others_[:]; "
                f"output {own} record_; algorithm record_ := {zero}(); "
                f"for index_ in 1:size(others_, 1) loop "
                f"record_ := {plus}(record_, others_[index_]); end for; end {SUM};"
            )
        yield tokens[one.body].start, tokens[one.body].start, " ".join([*made, ""])

    def _unit(self, path: Sequence[str], one: DeclaredClass) -> str:
        """The unit that a type declares, as text; "" without one."""
        found = self._resolved(path, one.name, {})
        while found is not None and found.short is not None:
            opening = found.short.opening
            for first, last in arguments(found.tokens, opening) if opening >= 0 else ():
                words = [token.text for token in found.tokens[first : last + 1] if token.text != "final"]
                if words[:2] == ["unit", "="]:
                    return words[2]
            found = self._aliased(found)
        return ""


class _Body(Expressions):
    """The equations, statements and values of one class."""

    def edits(self) -> Iterator[tuple[int, int, str]]:
        if self.one.short is not None:
            yield from self._modified(self.one.short.opening) if self.one.short.opening >= 0 else ()
            return
        inside = {part.first: part.end for part in self.one.parts}
        for part in self.one.parts:
            for at, opening in part.names:
                if opening >= 0:
                    yield from self._modified(opening)
                if (value := binding(self.one, part, at)) >= 0:
                    yield from self._expression(value)
            if part.opening >= 0:
                yield from self._modified(part.opening)
        at = self.one.body
        while at < self.one.end:
            if at in inside:
                at = inside[at] + 1
                continue
            yield from self._statement(at)
            at = self.at

    def _modified(self, opening: int) -> Iterator[tuple[int, int, str]]:
        """Values in a bracket of modifiers."""
        tokens = self._tokens
        for first, last in arguments(tokens, opening):
            at = first
            while at < last and tokens[at].text not in ("=", "("):
                at += 1
            if tokens[at].text == "(":
                yield from self._modified(at)
                at = closing(tokens, at) + 1
            if at >= last or tokens[at].text != "=":
                continue
            behind = path_end(tokens, at + 1)
            if not KINDS.isdisjoint(token.text for token in tokens[first:at]):
                if tokens[behind].text == "(":  # of a class
                    yield from self._modified(behind)
            else:
                yield from self._expression(at + 1)

    def _statement(self, at: int) -> Iterator[tuple[int, int, str]]:
        """One equation or statement, or the beginning of one that holds others; leaves `at` behind it."""
        tokens, word = self._tokens, self._tokens[at].text
        if word == "for":
            while tokens[at].text != "loop" and at < self.one.end:
                if tokens[at + 1].text in ("in", "loop", ","):
                    self.loops.append(tokens[at].text)
                at += 1
            self.at = at + 1
        elif word in ("if", "elseif", "when", "elsewhen", "while"):
            self.event |= word == "when"
            yield from self._expression(at + 1)
            self.at = max(self.at, at + 1)
        elif word in ("end", "connect", "annotation", "external"):
            if word == "end" and tokens[at + 1].text == "for" and self.loops:
                self.loops.pop()
            self.event &= tokens[at + 1].text != "when"
            self.at = statement_end(tokens, at) + 1
        elif tokens[at].kind in ("keyword", "string") and word not in ("not", "der", "true", "false", "pure"):
            self.at = at + 1
        elif word == ";" or word in ("then", "loop"):
            self.at = at + 1
        else:
            yield from self._equation(at)
            self.at = statement_end(tokens, at) + 1

    def _equation(self, begin: int) -> Iterator[tuple[int, int, str]]:
        def read() -> str:
            left = self._or()
            sign = self._word()
            if sign not in ("=", ":="):
                return left.text
            self.at += 1
            return self._equal(begin, left, self._choice(), sign)

        yield from self._rewritten(begin, read)

    def _rewritten(self, begin: int, read: Callable[[], str]) -> Iterator[tuple[int, int, str]]:
        """What is read from a token onwards, if records with operators are in it."""
        self.at, self.rewritten = begin, False
        try:
            text = read()
            if self._word() not in _ENDS and self._tokens[self.at].kind != "string":
                raise NotRead
        except NotRead:
            self._refuse_constructors(begin)
        except BuildError:
            if self.strict:
                raise
        else:
            if self.rewritten:
                yield self._tokens[begin].start, text_end(self._tokens[self.at - 1]), text

    def _refuse_constructors(self, begin: int) -> None:
        """Refuse calls of constructors in what is not read: the compiler would take others."""
        tokens = self._tokens
        for at in range(begin, statement_end(tokens, begin) if self.strict else begin):
            behind = path_end(tokens, at)
            if behind > at and tokens[at - 1].text != "." and tokens[behind].text == "(":
                kind = self.known.kind(path_of(tokens, at, behind), self.one.name)[0]
                if kind.startswith("."):
                    raise self._error(at, f"{kind[1:]}() in this expression", "give its value a variable")

    def _equal(self, begin: int, left: Value, right: Value, sign: str) -> str:
        sides = (left, right)
        named = not any(one.called for one in sides)
        if sign == ":=" and not left.sizes:
            return f"{left.text} := {right.text}"
        if not all(one.is_record for one in sides):
            return f"{left.text} {sign} {right.text}"
        if left.sizes or right.sizes:
            size, self.rewritten = left.sizes or right.sizes, True
            if len(size) != 1 or not all(one.element for one in sides):
                what = f"this equation of arrays of {left.kind[1:]}"
                raise self._error(begin, what, "write it for the elements")
            inner = self._equal(begin, self._element(left), self._element(right), sign)
            return f"for {INDEX} in 1:{size[0]} loop {inner}; end for"
        if self.event and not named:
            raise self._error(
                begin, f"a when-equation of {left.kind[1:]} with a call or operator",
                "write an algorithm section, or give the value a variable",
            )  # fmt: skip
        self.rewritten = True
        members = self.known.components(self._record(left.kind))
        return "; ".join(f"{self._member(left, one)} {sign} {self._member(right, one)}" for one in members)

    def _expression(self, begin: int) -> Iterator[tuple[int, int, str]]:
        yield from self._rewritten(begin, lambda: self._choice().text)


def _all_tokens(one: DeclaredClass) -> Iterator[int]:
    return iter(range(one.label, one.end)) if one.short is not None else own_tokens(one)


def _output_edits(known: _Overloaded, one: DeclaredClass) -> Iterator[tuple[int, int, str]]:
    """Values in the modifiers of a function's results as statements, and sizes of inputs left open."""
    tokens, values = one.tokens, list[str]()
    for part in one.parts if one.kind == "function" else ():
        for at, _ in part.names if "input" in part.prefixes else ():
            sizes = dimensions(one, part, at) if known.kind_of(one, part)[0].startswith(".") else []
            for first, end in sizes:
                if tokens[first].text == "size":  # the compiler does not take sizes of other inputs
                    yield tokens[first].start, text_end(tokens[end - 1]), ":"
        for at, opening in part.names if "output" in part.prefixes else ():
            if opening < 0 or not known.kind_of(one, part)[0].startswith("."):
                continue
            for first, last in arguments(tokens, opening):
                value = words_of(tokens[first + 2 : last + 1])
                values.append(f"{tokens[at].text}.{tokens[first].text} := {value};")
            yield tokens[opening].start, text_end(tokens[closing(tokens, opening)]), ""
    if values:
        behind = max(part.end for part in one.parts)
        place = next((at for at in range(behind, one.end) if tokens[at].text == "algorithm"), -1)
        start = text_end(tokens[place]) if place >= 0 else text_end(tokens[behind])
        yield start, start, f" {'' if place >= 0 else 'algorithm '}{' '.join(values)}"
