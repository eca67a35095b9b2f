"""Classes that Modelica sources declare, by their tokens, and the lookup of names in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..classes import within_clause
from ..lexer import Token, closing, tokenise
from .source_edits import path_end, path_of, statement_end

KINDS = frozenset("class model block connector type package function record".split())
PREFIXES = frozenset(
    "redeclare final inner outer replaceable encapsulated partial flow stream discrete parameter constant "
    "input output pure impure operator expandable each".split()
)
# Ends of the names of copies.
COPIED = "_adapted"


@dataclass(eq=False)
class ClassPart:
    """One element of a class: an `extends` clause, a clause of components, or a class.

    Attributes:
        first, end: indices of its first token and of its semicolon.
        path: first index, and the one behind the last, of the type or the base.
        names: of components: index of the name and of the bracket that modifies it, or -1.
        opening: index of the bracket that modifies the base or constrains the type, or -1.
        constrained: index of `constrainedby`, or -1.
        prefixes: words before it.
        owner: the class, where it is one.
    """

    kind: str
    first: int
    end: int
    path: tuple[int, int] = (0, 0)
    names: list[tuple[int, int]] = field(default_factory=list)
    opening: int = -1
    constrained: int = -1
    prefixes: frozenset[str] = frozenset()
    owner: DeclaredClass | None = None


@dataclass(eq=False)
class DeclaredClass:
    """A class: `short` is its definition by `=` as a base class, `parts` are the elements of others."""

    name: str
    kind: str
    text: str
    file: str
    tokens: Sequence[Token]
    label: int  # index of its name
    first: int
    end: int = 0  # of its semicolon
    body: int = 0
    parts: list[ClassPart] = field(default_factory=list)
    short: ClassPart | None = None
    beside: list[str] = field(default_factory=list)  # classes to put behind it
    within: list[str] = field(default_factory=list)  # classes to put at its beginning


@dataclass(frozen=True)
class Replacement:
    """What an element becomes: another type, or another class, and redeclarations within it."""

    path: str
    kind: str
    inner: tuple[tuple[str, Replacement], ...] = ()


Changes = dict[str, Replacement]
"""Names of elements, and what they become; one whose path is empty keeps its type."""


class DeclaredClasses:
    """The classes of sources, and those of libraries that they name.

    Args:
        texts: by file. label: of their folder, for messages. libraries: folders with those that they use.
        copied: whether redeclared elements become copies; else packages stay what constraining types name.
    """

    def __init__(
        self, texts: dict[str, str], label: str, libraries: Sequence[Path], copied: bool = True
    ) -> None:
        tops = [
            one for folder in libraries for one in ([folder] if _is_package(folder) else folder.iterdir())
        ]
        self._libraries = {
            one.name.partition(" ")[0].removesuffix(".mo"): one.with_suffix("") if one.is_file() else one
            for one in tops
            if _is_package(one) or one.suffix == ".mo"
        }
        self._read_files = set[str]()
        self._texts, self._label = texts, label
        self._copied = copied
        self._classes: dict[str, DeclaredClass] = {}
        self._copies: dict[tuple[str, str], str] = {}
        self._bases: set[str] = set()  # whose base classes are being looked up
        self._top: list[DeclaredClass] = []
        for file, text in texts.items():
            tokens = tokenise(text, label + file)
            self._top += self._read(text, file, tokens, within_clause(tokens))

    def all_classes(self) -> Iterator[DeclaredClass]:
        """The classes of the sources, each before those within it."""
        ahead = list(self._top)
        for one in ahead:
            yield one
            ahead += [part.owner for part in one.parts if part.owner is not None]

    def _read(self, text: str, file: str, tokens: Sequence[Token], scope: str) -> list[DeclaredClass]:
        found, at = [], 0
        while at < len(tokens):
            first = at
            while at < len(tokens) and tokens[at].text in PREFIXES:
                at += 1
            if at < len(tokens) and tokens[at].text in KINDS:
                one = self._class(text, file, tokens, first, at, scope)
                found.append(one)
                at = one.end
            at += 1
        return found

    def _class(
        self, text: str, file: str, tokens: Sequence[Token], first: int, at: int, scope: str
    ) -> DeclaredClass:
        kind = tokens[at].text
        extends = tokens[at + 1].text == "extends"
        label = at + 1 + extends
        name = tokens[label].text
        one = DeclaredClass(f"{scope}.{name}" if scope else name, kind, text, file, tokens, label, first)
        at = label + 1
        if tokens[at].text == "=":
            one.end = statement_end(tokens, at)
            begin = at + 1
            while tokens[begin].text in ("input", "output"):
                begin += 1
            behind = path_end(tokens, begin)
            if behind > begin and tokens[begin].text not in ("enumeration", "der"):
                one.short = ClassPart("extends", first, one.end, (begin, behind))
                at = closing(tokens, behind) + 1 if tokens[behind].text == "[" else behind
                if tokens[at].text == "(":
                    one.short.opening = at
                    at = closing(tokens, at) + 1
                if tokens[at].text == "constrainedby":
                    one.short.constrained = at
            one.body = one.end
        else:
            at = closing(tokens, at) + 1 if tokens[at].text == "(" else at
            while tokens[at].kind == "string" or tokens[at].text == "+":
                at += 1
            one.body = at
            self._elements(one, at)
        if not extends:
            self._classes.setdefault(one.name, one)
        return one

    def _elements(self, one: DeclaredClass, at: int) -> None:
        """Read the body, whose first token is at an index, and set the end."""
        tokens, last, section = one.tokens, one.tokens[one.label].text, False
        while at < len(tokens):
            text = tokens[at].text
            if text == "end" and tokens[at + 1].text == last:
                one.end = statement_end(tokens, at)
                return
            if text in ("public", "protected"):
                section = False
            elif text in ("equation", "algorithm", "external"):
                section = True
            elif text == "annotation" and tokens[at + 1].text == "(":
                at = closing(tokens, at + 1)
            elif not section and text not in (";", "initial"):
                part = self._element(one, at)
                one.parts.append(part)
                at = part.end
            at += 1
        one.end = len(tokens) - 1

    def _element(self, one: DeclaredClass, first: int) -> ClassPart:
        tokens, at = one.tokens, first
        while tokens[at].text in PREFIXES:
            at += 1
        prefixes = frozenset(token.text for token in tokens[first:at])
        if tokens[at - 1].text == "operator" and tokens[at].kind == "name":
            at -= 1  # the functions of one operator
        if tokens[at].text in KINDS or tokens[at].text == "operator":
            inner = self._class(one.text, one.file, tokens, first, at, one.name)
            named = "extends" if tokens[at + 1].text == "extends" else "class"
            return ClassPart(named + " class", first, inner.end, prefixes=prefixes, owner=inner)
        end = statement_end(tokens, at)
        if tokens[at].text == "extends":
            behind = path_end(tokens, at + 1)
            opening = behind if tokens[behind].text == "(" else -1
            return ClassPart("extends", first, end, (at + 1, behind), [], opening)
        part = ClassPart(tokens[at].text, first, end, prefixes=prefixes)
        behind = path_end(tokens, at)
        if tokens[at].text == "import" or behind == at:
            return part
        part.kind, part.path = "components", (at, behind)
        at = closing(tokens, behind) + 1 if tokens[behind].text == "[" else behind
        expected = True
        while at < end:
            if tokens[at].text == "constrainedby":
                part.constrained = at
                behind = path_end(tokens, at + 1)
                part.opening = behind if tokens[behind].text == "(" else -1
            elif expected and tokens[at].kind == "name":
                opening = at + 1
                if tokens[opening].text == "[":
                    opening = closing(tokens, opening) + 1
                part.names.append((at, opening if tokens[opening].text == "(" else -1))
                expected = False
            elif tokens[at].text == ",":
                expected = True
            elif tokens[at].text in ("(", "[", "{"):
                at = closing(tokens, at)
            at += 1
        return part

    def _get(self, name: str) -> DeclaredClass | None:
        """A class by its qualified name, also of a library, whose files are read as they are needed."""
        found = self._classes.get(name)
        top, *parts = name.split(".")
        while found is None and top in self._libraries and parts != [""]:
            place = self._libraries[top].joinpath(*parts)
            for file in (place / "package.mo", place.with_name(f"{place.name}.mo")):
                if str(file) not in self._read_files and file.is_file():
                    self._read_files.add(str(file))
                    text = file.read_text(encoding="utf-8")
                    tokens = tokenise(text, str(file))
                    self._read(text, str(file), tokens, within_clause(tokens))
            if not parts or name in self._classes:
                return self._classes.get(name)
            parts.pop()
        return found

    def _is_foreign(self, one: DeclaredClass | None) -> bool:
        return one is not None and one.file not in self._texts and bool(one.file)

    def _resolved(self, path: Sequence[str], scope: str, changes: Changes) -> DeclaredClass | None:
        """The class that a path names in a class, some of whose elements change; None if it is no own one."""
        if not path:
            return None
        if not path[0]:
            found = self._get(path[1])
            path = path[1:]
        else:
            found = None
            while found is None:
                if path[0] in changes and changes[path[0]].kind in KINDS:
                    found = self._absolute(changes[path[0]].path)
                    break
                found = self._member(scope, path[0])
                if found is not None and found.name != f"{scope}.{path[0]}".removeprefix("."):
                    return None  # inherited: what it uses may be another there
                found = found or self._imported(scope, path[0])
                if not scope or found is not None:
                    break
                changes, scope = {}, scope.rpartition(".")[0]
        for name in path[1:]:
            outer, found = found, self._member(found.name, name) if found is not None else None
            if found is not None and outer is not None and found.name != f"{outer.name}.{name}":
                return None
        return found

    def _absolute(self, path: str) -> DeclaredClass | None:
        return self._get(path.removeprefix(".")) if path.startswith(".") else None

    def _member(self, scope: str, name: str) -> DeclaredClass | None:
        """A class within another, or at the top, its own or inherited."""
        if found := self._get(f"{scope}.{name}" if scope else name):
            return found
        one = self._get(scope)
        if one is None or scope in self._bases:
            return None
        self._bases.add(scope)
        try:
            for base in self._bases_of(one, {}):
                if base is not None and (found := self._member(base[1].name, name)):
                    return found
        finally:
            self._bases.discard(scope)
        return None

    def _imported(self, scope: str, name: str) -> DeclaredClass | None:
        one = self._get(scope)
        for part in one.parts if one is not None else ():
            if part.kind == "import":
                assert one is not None
                words = [
                    token.text for token in one.tokens[part.first + 1 : part.end] if token.kind != "string"
                ]
                alias, _, whole = "".join(words).rpartition("=")
                base, _, last = whole.rpartition(".")
                names = last.strip("{}").split(",")
                if whole.endswith(".*"):
                    base, names = whole.removesuffix(".*"), [name]
                if alias == name or (not alias and name in names):
                    if found := self._get(whole if alias else f"{base}.{name}"):
                        return found
        return None

    def _aliased(self, one: DeclaredClass) -> DeclaredClass | None:
        """The class that a definition by `=` names; None if it is no own one."""
        assert one.short is not None
        return self._resolved(path_of(one.tokens, *one.short.path), one.name.rpartition(".")[0], {})

    def _bases_of(
        self, one: DeclaredClass, changes: Changes
    ) -> Iterator[tuple[ClassPart, DeclaredClass] | None]:
        """The extends clauses of a class with what they name, so far as the sources define it."""
        for part in [one.short] if one.short else [one for one in one.parts if one.kind == "extends"]:
            scope = one.name.rpartition(".")[0] if one.short else one.name
            base = self._resolved(path_of(one.tokens, *part.path), scope, {} if one.short else changes)
            yield (part, base) if base is not None and base is not one else None

    def _declared(
        self, one: DeclaredClass, name: str, depth: int = 0
    ) -> tuple[DeclaredClass, ClassPart] | None:
        """The class that declares an element, and the element; None if a class of a library may do so."""
        for part in one.parts:
            if part.owner is not None and part.owner.tokens[part.owner.label].text == name:
                return None if "redeclare" in part.prefixes and part.kind != "class class" else (one, part)
            if any(one.tokens[at].text == name for at, _ in part.names):
                return one, part
        for base in self._bases_of(one, {}) if depth < 50 else ():
            if base is not None and (found := self._declared(base[1], name, depth + 1)):
                return found
        return None

    def _found(self, one: DeclaredClass, name: str) -> DeclaredClass | None:
        scope, found = one.name, None
        while found is None and scope:
            found = self._member(scope, name) or self._imported(scope, name)
            scope = scope.rpartition(".")[0]
        return found or self._get(name)

    def _named(self, path: str, one: DeclaredClass) -> str:
        """How a class names another; the compiler looks up even whole paths from within."""
        parts, scope = path.removeprefix(".").split("."), one.name
        while scope and path.startswith("."):
            depth = scope.count(".") + 1
            if parts[:depth] == scope.split(".") and len(parts) > depth:
                found = self._resolved([parts[depth]], one.name, {})
                same = found is not None and found.name == ".".join(parts[: depth + 1])
                if same or (found is None and COPIED in parts[depth]):
                    return ".".join(parts[depth:])
            scope = scope.rpartition(".")[0]
        return path


def own_tokens(one: DeclaredClass) -> Iterator[int]:
    """Indices of the tokens of a class without those of classes within it and of annotations."""
    inner = {part.first: part.end for part in one.parts if part.owner is not None}
    at = one.body
    while at < one.end:
        if at in inner:
            at = inner[at]
        elif one.tokens[at].text == "annotation":
            at = closing(one.tokens, at + 1)
        else:
            yield at
        at += 1


def dimensions(one: DeclaredClass, part: ClassPart, at: int) -> list[tuple[int, int]]:
    """First token of each size of a component whose name is at `at`, and the one behind it."""
    found = []
    for opening in (at + 1, part.path[1]):
        if one.tokens[opening].text != "[":
            continue
        end, begin = closing(one.tokens, opening), opening + 1
        place = begin
        while place <= end:
            if place == end or one.tokens[place].text == ",":
                found.append((begin, place))
                begin = place + 1
            elif one.tokens[place].text in ("(", "[", "{"):
                place = closing(one.tokens, place)
            place += 1
    return found


def _is_package(folder: Path) -> bool:
    return (folder / "package.mo").is_file()
