"""Overloaded operators, written as calls of the functions that operator records declare.

rumoca 0.10.2 keeps an operator record, and takes `.R.'+'(a, b)` for what it says. It refuses `a + b` and
`R(1)`, and equations of records that are more than a name on one side. So these are written for each member,
by functions of the record that return one of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from orchestrator.base.errors import BuildError, listed

from .classes import find_classes, used_classes
from .component_arrays import dimensions
from .declared_classes import KINDS, DeclaredClass, own_tokens
from .lexer import Token, closing
from .modifiers import arguments
from .source_edits import edited, path_end, path_of, statement_end, text_end, words_of
from .sources import location
from .typed_classes import BUILT_IN, TypedClasses, binding, is_overloading

__all__ = ["overloads", "with_calls"]

_RECORD = re.compile(r"\boperator\s+record\b")
_INDEX = "adapted_index"
_MAKER = "adapted_record"
_SUM = "adapted_sum"
_COUNTED = re.compile(r"for (\w+) in 1 : ([^,]+)")
_LEVELS = (
    ("or",), ("and",), ("<", "<=", ">", ">=", "==", "<>"), ("+", "-", ".+", ".-"), ("*", "/", ".*", "./"),
    ("^", ".^"),
)  # fmt: skip
_ENDS = frozenset((";", ",", ")", "then", "loop", "annotation", "if", "constrainedby"))
_TRUTHS = frozenset(("or", "and", *_LEVELS[2]))
_REALS = frozenset(
    "abs sqrt exp log log10 sin cos tan asin acos atan atan2 sinh cosh tanh sign mod rem div max min floor "
    "ceil der delay semiLinear".split()
)
_OTHERS = dict.fromkeys(("size", "integer", "ndims"), "Integer") | dict.fromkeys(
    ("initial", "sample", "edge", "change", "terminal"), "Boolean"
)
# Of their arguments' type; those of records are applied to each member.
_SAME = frozenset(("noEvent", "pre", "smooth", "homotopy", "inStream", "actualStream"))


class _NotRead(Exception):
    """What is no expression that this module reads; it stays."""


@dataclass(frozen=True)
class _Value:
    """An expression.

    Attributes:
        kind: ".name" of an operator record, a built-in type, "other", or "" where it is not known.
        sizes: of an array. element: text of one element, at `_INDEX`; "" where there is none.
        members: gives the text of a member of a record.
        called: whether it is more than a name.
    """

    text: str
    kind: str = ""
    sizes: tuple[str, ...] = ()
    element: str = ""
    members: Callable[[str], str] | None = field(default=None, compare=False)
    called: bool = True

    @property
    def is_record(self) -> bool:
        return self.kind.startswith(".")


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
        for one in [*self._all()]:
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
        for one in self._all():
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
            if kind in BUILT_IN:
                sizes = "".join(f"[{words_of(owner.tokens[a:b])}]" for a, b in dimensions(owner, part, at))
                members.append((name, kind, sizes))
                made.append(
                    f"encapsulated function {_getter(name)} import {one.name}; input {own} record_; "
                    f"output {kind} value{sizes}; algorithm value := record_.{name}; end {_getter(name)};"
                )
        inputs = " ".join(f"input {kind} {name}{sizes};" for name, kind, sizes in members)
        values = " ".join(f"record_.{name} := {name};" for name, _, _ in members)
        made.append(
            f"encapsulated function {_MAKER} import {one.name}; input {own} other_; {inputs} "
            f"output {own} record_; algorithm {values} end {_MAKER};"
        )
        if functions := self.sum_functions(one.name):
            zero, plus = (f"{own}{function.name.removeprefix(one.name)}" for function in functions)
            made.append(
                f"encapsulated function {_SUM} import {one.name}; input {own} others_[:]; "
                f"output {own} record_; algorithm record_ := {zero}(); "
                f"for index_ in 1:size(others_, 1) loop "
                f"record_ := {plus}(record_, others_[index_]); end for; end {_SUM};"
            )
        yield tokens[one.body].start, tokens[one.body].start, " ".join([*made, ""])

    def sum_functions(self, record: str) -> list[DeclaredClass]:
        """The functions that make sums of a record: its zero and its addition; none where it has none."""
        zero, plus = (self.operators(f".{record}", name) for name in "0+")
        return [*zero, *plus] if len(zero) == len(plus) == 1 else []

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


@dataclass
class _Body:
    """The expressions of one class."""

    known: _Overloaded
    one: DeclaredClass
    strict: bool
    loops: list[str] = field(default_factory=list)
    at: int = 0
    rewritten: bool = False
    event: bool = False

    @property
    def _tokens(self) -> Sequence[Token]:
        return self.one.tokens

    def _word(self) -> str:
        return self._tokens[self.at].text

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
        """What is read from a token on, if records with operators are in it."""
        self.at, self.rewritten = begin, False
        try:
            text = read()
            if self._word() not in _ENDS and self._tokens[self.at].kind != "string":
                raise _NotRead
        except _NotRead:
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

    def _equal(self, begin: int, left: _Value, right: _Value, sign: str) -> str:
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
            return f"for {_INDEX} in 1:{size[0]} loop {inner}; end for"
        if self.event and not named:
            raise self._error(
                begin, f"a when-equation of {left.kind[1:]} with a call or operator",
                "write an algorithm section, or give the value a variable",
            )  # fmt: skip
        self.rewritten = True
        members = self.known.components(self._record(left.kind))
        return "; ".join(f"{self._member(left, one)} {sign} {self._member(right, one)}" for one in members)

    def _record(self, kind: str) -> DeclaredClass:
        found = self.known._get(kind[1:])
        assert found is not None
        return found

    def _member(self, one: _Value, name: str) -> str:
        if one.members is not None:
            return one.members(name)
        return f"{self._path(one.kind)}.{_getter(name)}({one.text})"

    def _path(self, name: str) -> str:
        self.rewritten = True
        return self.known._named(name, self.one)

    def _element(self, one: _Value) -> _Value:
        if not one.sizes:
            return one
        members = one.members if one.called else lambda name: f"{one.element}.{name}"
        return replace(one, text=one.element, sizes=one.sizes[1:], element="", members=members)

    def _error(self, at: int, what: str, remedy: str) -> BuildError:
        one = self.one
        place = location(self.known._label + one.file, one.text, one.tokens[at].start)
        return BuildError(f"{place}: {what} is not supported; {remedy}")

    def _expression(self, begin: int) -> Iterator[tuple[int, int, str]]:
        yield from self._rewritten(begin, lambda: self._choice().text)

    # Expressions: each method reads one from `at` on, and leaves `at` behind it.

    def _choice(self) -> _Value:
        if self._word() != "if":
            return self._range()
        begin, words, values = self.at, list[str](), list[_Value]()
        while self._word() in ("if", "elseif"):
            words.append(self._word())
            self.at += 1
            words.append(self._choice().text)
            self._expect("then")
            values.append(self._choice())
        self._expect("else")
        values.append(self._choice())

        def written(texts: Sequence[str]) -> str:
            parts = [f"{word} {condition} then {text}" for word, condition, text in
                     zip(words[::2], words[1::2], texts, strict=False)]  # fmt: skip
            return f"({' '.join(parts)} else {texts[-1]})"

        kinds = {one.kind for one in values}
        kind = kinds.pop() if len(kinds) == 1 else "Real" if kinds == {"Real", "Integer"} else ""
        sizes, element = values[0].sizes, ""
        if not kind.startswith("."):
            elements = [self._element(one).text for one in values]
            element = written(elements) if sizes and all(elements) else ""
            return _Value(written([one.text for one in values])[1:-1], kind, sizes, element)
        if not sizes:
            return self._chosen(kind, values, written)
        if len(sizes) > 1 or not all(one.element for one in values):
            raise self._error(begin, "an if-expression of these arrays", "write it for their elements")
        return _over(self._chosen(kind, [self._element(one) for one in values], written), sizes[0])

    def _chosen(self, kind: str, values: Sequence[_Value], written: Callable[[Sequence[str]], str]) -> _Value:
        """One of several records, member by member: the compiler takes no others as arguments."""

        def members(name: str) -> str:
            return written([self._member(one, name) for one in values])

        texts = [members(name) for name in self.known.components(self._record(kind))]
        # The compiler asks for a record among the arguments.
        text = f"{self._path(kind)}.{_MAKER}({', '.join([values[0].text, *texts])})"
        return _Value(text, kind, members=members)

    def _range(self) -> _Value:
        first = self._or()
        if self._word() != ":":
            return first
        texts = [first.text]
        while self._word() == ":":
            self.at += 1
            texts.append(self._or().text)
        return _Value(":".join(texts), "Real", (f"size({':'.join(texts)}, 1)",))

    def _or(self) -> _Value:
        return self._level(0)

    def _level(self, level: int) -> _Value:
        if level == len(_LEVELS):
            return self._primary()
        begin = self.at
        if _LEVELS[level][0] == "<" and self._word() == "not":
            self.at += 1
            value = self._level(level)
            return self._applied(begin, "not", [value])
        if _LEVELS[level][0] == "+" and self._word() in ("+", "-", ".+", ".-"):
            sign = self._word()
            self.at += 1
            left = self._applied(begin, sign, [self._level(level + 1)])
        else:
            left = self._level(level + 1)
        while self._word() in _LEVELS[level]:
            place, sign = self.at, self._word()
            self.at += 1
            left = self._applied(place, sign, [left, self._level(level + 1)])
        return left

    def _applied(self, at: int, sign: str, given: list[_Value]) -> _Value:
        """An operator of built-in operands, or the call of its function."""
        if not any(one.is_record for one in given):
            return _built_in(sign, given)
        name = sign.removeprefix(".") or sign
        if sign.strip(".") == "+" and len(given) == 1:
            return given[0]
        if unknown := next((one for one in given if not one.kind), None):
            raise self._error(
                at, f"`{sign}` with `{unknown.text}`, whose type is not found,",
                "declare a variable of the type that it has, and use that",
            )  # fmt: skip
        records = dict.fromkeys(one.kind for one in given if one.is_record)
        functions = [one for record in records for one in self.known.operators(record, name)]
        exact = [one for one in functions if self._matches(one, given)]
        if not exact and any(one.sizes for one in given):
            return self._each(at, sign, given)
        if len(exact) == 1:
            return self._call(exact[0], given)
        fitting = functions if not exact else []
        converted = [(one, more) for one in fitting if (more := self._converted(one, given))]
        if len(converted) == 1:
            return self._call(*converted[0])
        several = "several operators" if exact or converted else "no operator"
        raise self._error(
            at, f"`{sign}` of {' and '.join(one.kind.strip('.') for one in given)}, for which {several} of "
            f"{listed([record[1:] for record in records])} could stand,",
            f"declare an operator '{name}' for it, or call a function",
        )  # fmt: skip

    def _each(self, at: int, sign: str, given: list[_Value]) -> _Value:
        """An operator of each element of arrays."""
        sizes = [one.sizes for one in given if one.sizes]
        both = len(given) == 2 and all(one.sizes for one in given)
        scalar = len(given) == 2 and not both
        fits = sign[0] == "." or (sign in "+-" and not scalar)
        fits = fits or (sign in "*/" and not both and not (sign == "/" and given[-1].sizes))
        fits = fits and all(len(one) == 1 for one in sizes)
        if not fits or any(one.sizes and not one.element for one in given):
            raise self._error(at, f"`{sign}` of these arrays", "write it for their elements")
        value = self._applied(at, sign.removeprefix("."), [self._element(one) for one in given])
        return _over(value, sizes[0][0])

    def _matches(self, one: DeclaredClass, given: Sequence[_Value], names: Sequence[str] = ()) -> bool:
        inputs = self.known.signature(one)[0]
        rest = {other.name: other for other in inputs}
        for place, value in enumerate(given):
            name = names[place] if place < len(names) else ""
            wanted = rest.pop(name or (inputs[place].name if place < len(inputs) else ""), None)
            if wanted is None or len(value.sizes) != wanted.depth or not _fits(value.kind, wanted.kind):
                return False
        return all(other.optional for other in rest.values())

    def _converted(self, one: DeclaredClass, given: Sequence[_Value]) -> list[_Value]:
        """The operands, those that do not fit made by constructors; none where this does not help."""
        inputs, made = self.known.signature(one)[0], []
        if len(inputs) < len(given) or any(not other.optional for other in inputs[len(given) :]):
            return []
        for wanted, value in zip(inputs, given, strict=False):
            if wanted.kind != value.kind and wanted.kind.startswith("."):
                makers = self.known.operators(wanted.kind, "constructor")
                makers = [maker for maker in makers if self._matches(maker, [value])]
                if len(makers) != 1:
                    return []
                value = self._call(makers[0], [value])
            elif not _fits(value.kind, wanted.kind):
                return []
            if len(value.sizes) != wanted.depth:
                return []
            made.append(value)
        return made

    def _call(self, one: DeclaredClass, given: Sequence[_Value], names: Sequence[str] = ()) -> _Value:
        named = [
            f"{names[place]} = {value.text}" if place < len(names) and names[place] else value.text
            for place, value in enumerate(given)
        ]
        kind, sizes = self.known.signature(one)[1]
        record, _, rest = one.name.partition(".'")
        return _Value(f"{self._path(f'.{record}')}.'{rest}({', '.join(named)})", kind, sizes)

    def _expect(self, word: str) -> None:
        if self._word() != word:
            raise _NotRead
        self.at += 1

    def _primary(self) -> _Value:
        token = self._tokens[self.at]
        if token.kind == "number":
            self.at += 1
            return _Value(token.text, "Integer" if token.text.isdigit() else "Real")
        if token.kind == "string" or token.text in ("true", "false", "end"):
            self.at += 1
            kinds = {"end": "Integer", "true": "Boolean", "false": "Boolean"}
            return _Value(token.text, kinds.get(token.text, "String"))
        if token.text == "(":
            return self._bracket()
        if token.text == "{":
            return self._array()
        if token.text == "[":
            raise _NotRead
        if token.text in ("der", "initial", "pure") and self._tokens[self.at + 1].text == "(":
            self.at += 1
            values, _ = self._arguments()
            texts = ", ".join(one.text for one in values)
            if token.text == "der" and values and values[0].is_record:
                return self._of_each_member("der", values, f"der({texts})")
            sizes = values[0].sizes if values else ()
            return _Value(f"{token.text}({texts})", _OTHERS.get(token.text, "Real"), sizes)
        if token.kind == "name" or token.text == ".":
            return self._reference()
        raise _NotRead

    def _bracket(self) -> _Value:
        end, texts = closing(self._tokens, self.at), list[str]()
        self.at += 1
        value = None
        while self.at <= end:
            if self._word() in (",", ")"):
                texts.append("")
            else:
                value = self._choice()
                texts.append(value.text)
            if self._word() == ")":
                break
            self._expect(",")
        self._expect(")")
        if len(texts) != 1 or value is None:
            return _Value(f"({', '.join(texts)})")
        element = f"({value.element})" if value.element else ""
        return replace(value, text=f"({value.text})", element=element)

    def _array(self) -> _Value:
        values, over = self._arguments()
        texts = [one.text for one in values]
        if over:
            return self._comprehension(values[0], over) if values else _Value("")
        kinds = {one.kind for one in values}
        kind = kinds.pop() if len(kinds) == 1 else "Real" if kinds == {"Real", "Integer"} else ""
        sizes = (str(len(values)), *(values[0].sizes if values else ()))
        text = f"{{{', '.join(texts)}}}"
        if len(sizes) > 1 or not kind:
            return _Value(text, kind, sizes)

        def written(texts: Sequence[str]) -> str:
            tests = [f"if {_INDEX} == {n} then {one} else" for n, one in enumerate(texts[:-1], 1)]
            return f"({' '.join([*tests, texts[-1]])})"

        if not kind.startswith("."):
            return _Value(text, kind, sizes, written(texts))
        one = self._chosen(kind, values, written)
        return replace(one, text=text, sizes=sizes, element=one.text)

    def _comprehension(self, value: _Value, over: str) -> _Value:
        text, counted = f"{{{value.text} {over}}}", _COUNTED.fullmatch(over)
        if counted is None or value.sizes:
            return _Value(text, value.kind, ("",) * (1 + over.count(" in ") + len(value.sizes)))
        name = re.compile(rf"(?<![.\w]){counted[1]}\b(?!\s*=(?!=))")

        def element(of: str) -> str:
            return name.sub(_INDEX, of)

        members = (lambda one: element(self._member(value, one))) if value.is_record else None
        return _Value(text, value.kind, (counted[2],), element(value.text), members)

    def _arguments(self) -> tuple[list[_Value], str]:
        """Positional arguments of a call or elements of an array, and the iterators behind them, as text."""
        values, names, over = self._all_arguments()
        return [replace(one, text=f"{name} = {one.text}") if name else one for one, name in
                zip(values, names, strict=True)], over  # fmt: skip

    def _all_arguments(self) -> tuple[list[_Value], list[str], str]:
        tokens, opening = self._tokens, self.at
        end = closing(tokens, opening)
        loops = len(self.loops)
        at = place = opening + 1
        while at < end:
            if tokens[at].text == "for":
                place = at
                self.loops += [tokens[k - 1].text for k in range(at, end) if tokens[k].text == "in"]
                break
            at = closing(tokens, at) + 1 if tokens[at].text in ("(", "[", "{") else at + 1
        values, names, over = list[_Value](), list[str](), ""
        self.at = opening + 1
        while self.at < end:
            name = ""
            if tokens[self.at].kind == "name" and tokens[self.at + 1].text == "=":
                name = tokens[self.at].text
                self.at += 2
            if self._word() == "function":
                raise _NotRead
            values.append(self._choice())
            names.append(name)
            if self._word() == "for" and self.at == place:
                over = words_of(tokens[self.at : end])
                self.at = end
            elif self.at < end:
                self._expect(",")
        self.at = end + 1
        del self.loops[loops:]
        return values, names, over

    def _reference(self) -> _Value:
        """A name with subscripts, or a call."""
        tokens, begin = self._tokens, self.at
        names: list[tuple[str, list[str] | None]] = []
        if self._word() == ".":
            names.append(("", None))
            self.at += 1
        while True:
            if tokens[self.at].kind != "name":
                raise _NotRead
            name = self._word()
            self.at += 1
            inside = self._subscripts() if self._word() == "[" else None
            names.append((name, inside))
            if self._word() != ".":
                break
            self.at += 1
        if self._word() == "(":
            if any(inside is not None for _, inside in names):
                raise _NotRead
            return self._called(begin, [name for name, _ in names])
        text = ".".join(name + (f"[{', '.join(inside)}]" if inside else "") for name, inside in names)
        if names[0][0] in self.loops or text in ("time", "true", "false"):
            return _Value(text, "Real" if text == "time" else "Integer", called=False)
        return self._component(names, text)

    def _subscripts(self) -> list[str]:
        end, texts = closing(self._tokens, self.at), list[str]()
        self.at += 1
        while self.at < end:
            if self._word() == ":":
                self.at += 1
                texts.append(":")
            else:
                texts.append(self._choice().text)
            if self.at < end:
                self._expect(",")
        self.at = end + 1
        return texts

    def _component(self, names: list[tuple[str, list[str] | None]], text: str) -> _Value:
        unknown = _Value(text, called=False)
        first, place = names[0][0], 0
        found = self.known.own_component(self.one, first)
        own_one = found is not None
        found = found or self.known.component(self.one, first) or self.known.constant(self.one, first)
        if found is None:
            path = [name for name, _ in names]
            for place in range(len(path) - 1, 0, -1):
                owner = self.known.kind(path[:place], self.one.name)[1] if path[:place] != [""] else None
                if owner is not None and (found := self.known.own_component(owner, path[place])):
                    break
        if found is None:
            return unknown
        before = ".".join(name for name, _ in names[:place])
        whole, element, sizes = before, before, list[str]()
        kind, cls, sliced = "", None, False
        for number, (name, inside) in enumerate(names[place:], place):
            if number > place:
                if cls is None:
                    return unknown
                found = self.known.own_component(cls, name)
                if found is None:
                    return unknown
            assert found is not None
            owner, part, at = found
            record, (kind, cls) = kind, self.known.kind_of(owner, part)
            places = dimensions(owner, part, at)
            own = [self._size(owner, words_of(owner.tokens[a:b]), whole) for a, b in places]
            before = f"{whole}.{name}" if whole else name
            own = [f"size({before}, {n})" if size == ":" else size for n, size in enumerate(own, 1)]
            sliced |= record.startswith(".") and bool(sizes)
            given = inside if inside is not None else [":"] * len(own)
            if len(given) < len(own):
                given = [*given, *[":"] * (len(own) - len(given))]
            left = [size for size, one in zip(own, given, strict=False) if ":" in one]
            sizes += left
            shown = [_INDEX if one == ":" else one for one in given]
            joint = "." if whole or number > place else ""
            whole = f"{whole}{joint}{name}" + (f"[{', '.join(inside)}]" if inside else "")
            element = f"{element}{joint}{name}" + (f"[{', '.join(shown)}]" if shown else "")
            if any(":" in one and one != ":" for one in given):
                return unknown if kind.startswith(".") else replace(unknown, kind=kind, sizes=tuple(sizes))
        if len(sizes) > 1:
            element = ""
        if sliced and element:  # the compiler takes no members of all elements
            self.rewritten = True
            text = f"{{{element} for {_INDEX} in 1:{sizes[0]}}}"
        # The compiler takes no members of constants of packages.
        members = (lambda name: f"{text}.{name}") if own_one else None
        return _Value(text, kind, tuple(sizes), element if sizes else "", members, not own_one)

    def _size(self, owner: DeclaredClass, text: str, whole: str) -> str:
        """The size of a component of another one, as it is named here."""
        words = text.split(" ")
        prefix = f"{whole}." if whole else ""
        return " ".join(
            f"{prefix}{word}" if word.isidentifier() and (at == 0 or words[at - 1] != ".")
            and self.known.own_component(owner, word) else word
            for at, word in enumerate(words)
        )  # fmt: skip

    def _called(self, begin: int, path: list[str]) -> _Value:
        name = ".".join(path)
        values, names, over = self._all_arguments()
        pairs = zip(values, names, strict=True)
        texts = [f"{label} = {one.text}" if label else one.text for one, label in pairs]
        text = f"{name}({', '.join(texts)}{f' {over}' if over else ''})"
        last = path[-1]
        found = self.known.kind(path, self.one.name)
        records = any(one.is_record for one in values)
        if found[1] is None and name.removeprefix(".") == last:
            if last in _SAME and values:
                return self._of_each_member(last, values, text)
            if last in _OTHERS or (last in _REALS and not over and not records):
                sizes = next((one.sizes for one in values if one.sizes), ()) if last in _REALS else ()
                return _Value(text, _OTHERS.get(last, "Real"), sizes)
            if last == "fill" and values:
                sizes = tuple(one.text for one in values[1:])
                return _Value(text, values[0].kind, sizes, values[0].text if len(sizes) == 1 else "")
            if last == "String" and values and values[0].is_record:
                makers = self.known.operators(values[0].kind, "String")
                if len(makers) == 1:
                    return replace(self._call(makers[0], values, names), kind="String")
            vector = len(values) == 1 and len(values[0].sizes) == 1 and not over
            if last == "sum" and records and vector and self.known.sum_functions(values[0].kind[1:]):
                return _Value(f"{self._path(values[0].kind)}.{_SUM}({texts[0]})", values[0].kind)
            if last in ("sum", "product") and records:
                what = f"`{last}` of {values[0].kind[1:]}"
                raise self._error(begin, what, "write it with the operator")
            if last in ("sum", "product"):
                return _Value(text, "Real" if values and values[0].kind in ("Real", "Integer") else "")
            return _Value(text, "Integer" if last == "Integer" else "String" if last == "String" else "")
        if found[0].startswith("."):
            return self._constructed(begin, found[0], values, names, text)
        if found[1] is None or found[1].kind != "function":
            return _Value(text, "other" if found[1] is not None else "")
        if len(path) == 1 and name in {
            *_REALS,
            *_OTHERS,
            "sum",
            "product",
        }:  # the compiler would take the built-in one
            scope = found[1].name.rpartition(".")[0]
            text = f"{self._path(f'.{scope}')}.{text}"
            name = text.partition("(")[0]
        inputs, (kind, sizes) = self.known.signature(found[1])
        deeper = [
            one for one, wanted in zip(values, inputs, strict=False)
            if one.is_record and len(one.sizes) == wanted.depth + 1 == 1
        ]  # fmt: skip
        if not deeper:
            return _Value(text, kind, sizes)
        if any(names) or not all(one.element for one in deeper):
            raise self._error(begin, f"{name}() of an array, for each element,", "call it for the elements")
        self.rewritten = True
        elements = [self._element(one) if one in deeper else one for one in values]
        return _over(_Value(f"{name}({', '.join(one.text for one in elements)})", kind), deeper[0].sizes[0])

    def _of_each_member(self, name: str, values: Sequence[_Value], text: str) -> _Value:
        first = values[-1] if name == "smooth" else values[0]

        def members(member: str) -> str:
            texts = [self._member(one, member) if one.is_record else one.text for one in values]
            return f"{name}({', '.join(texts)})"

        return _Value(text, first.kind, first.sizes, "", members if first.is_record else None)

    def _constructed(
        self, begin: int, kind: str, values: Sequence[_Value], names: Sequence[str], text: str
    ) -> _Value:
        makers = self.known.operators(kind, "constructor")
        if not makers:
            return _Value(text, kind)
        fitting = [one for one in makers if self._matches(one, values, names)]
        if len(fitting) == 1:
            return replace(self._call(fitting[0], values, names), kind=kind)
        if any(not one.kind for one in values) and len(makers) == 1 and not any(one.sizes for one in values):
            return replace(self._call(makers[0], values, names), kind=kind)
        raise self._error(
            begin, f"{kind[1:]}() with {len(values)} arguments of these types",
            "give those of one of its constructors",
        )  # fmt: skip


def _over(value: _Value, size: str) -> _Value:
    """An array of what holds for each element."""
    text = f"{{{value.text} for {_INDEX} in 1:{size}}}"
    return _Value(text, value.kind, (size,), value.text, value.members)


def _built_in(sign: str, given: Sequence[_Value]) -> _Value:
    kinds = {one.kind for one in given}
    kind = "Boolean" if sign in _TRUTHS or sign == "not" else ""
    if not kind and kinds <= {"Real", "Integer"}:
        kind = "Integer" if kinds == {"Integer"} and sign not in ("/", "^") else "Real"
    elif kinds == {"String"} and not kind:
        kind = "String"
    texts = [one.text for one in given]
    arrays = [one for one in given if one.sizes]
    joint = f" {sign} " if sign.isalpha() or sign[0] == "." or len(given) > 1 else sign
    text = joint.join(texts) if len(given) > 1 else f"{joint.lstrip()}{texts[0]}"
    if not arrays:
        return _Value(text, kind)
    plain = sign[0] == "." or len(given) == 1 or (sign in "+-") or (sign in "*/" and len(arrays) == 1)
    if not plain:
        return _Value(text)
    elements = [one.element if one.sizes else one.text for one in given]
    joint = f" {sign.removeprefix('.')} "
    element = f"({joint.join(['', *(f'({one})' for one in elements)][-2:])})"
    plain = all(elements) and len(arrays[0].sizes) == 1
    return _Value(text, kind, arrays[0].sizes, element if plain else "")


def _all_tokens(one: DeclaredClass) -> Iterator[int]:
    return iter(range(one.label, one.end)) if one.short is not None else own_tokens(one)


def _fits(kind: str, wanted: str) -> bool:
    return kind == wanted or (kind, wanted) == ("Integer", "Real")


def _getter(name: str) -> str:
    return f"adapted_{name}"


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
