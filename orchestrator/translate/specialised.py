"""Redeclarations carried out in the sources: a class of its own for each set of them.

rumoca 0.10.2 takes some classes for others, silently. Of two levels of redeclarations it keeps the inner one.
It mixes up packages of components, constants of packages with a common base, and functions of equal names. It
forgets modifiers of a redeclared class, and those of a base beside those of its heir.

Here `S s(redeclare B part(k = 2))` becomes `S_adapted1 s(part(k = 2))`, where `S_adapted1` is a copy of S
whose `part` is a B. What concerns elements that classes of libraries declare stays.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

from orchestrator.base.errors import BuildError, listed

from .classes import within_clause
from .lexer import Token, closing, tokenise
from .modifiers import Modifiers, arguments, complete, modifiers_of, written
from .sources import SourceTree, line_mark, location

__all__ = ["specialised", "told_apart"]

_KINDS = frozenset("class model block connector type package function record".split())
_PREFIXES = frozenset(
    "redeclare final inner outer replaceable encapsulated partial flow stream discrete parameter constant "
    "input output pure impure operator expandable each".split()
)
_MARK = "_adapted"
_NAMED = re.compile(r"\b(function|package|outer)\b|\bconnect\s*\([^;]*\]\s*[,)]")
_LARGEST = 3_000_000  # characters of a library; the Modelica Standard Library has more
_CONCERNED = re.compile(r"\b(package|record|redeclare)\b|\bextends\s+[\w.]+\s*\(|=\s*[\w.]+\s*\(\s*\w+\s*\(")


@dataclass(eq=False)
class _Part:
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
    owner: _Class | None = None


@dataclass(eq=False)
class _Class:
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
    parts: list[_Part] = field(default_factory=list)
    short: _Part | None = None
    beside: list[str] = field(default_factory=list)  # classes to put behind it
    within: list[str] = field(default_factory=list)  # classes to put at its beginning


@dataclass(frozen=True)
class _New:
    """What an element becomes: another type, or another class, and redeclarations within it."""

    path: str
    kind: str
    inner: tuple[tuple[str, _New], ...] = ()


Changes = dict[str, _New]
"""Names of elements, and what they become; one whose path is empty keeps its type."""


@lru_cache(maxsize=8)
def _texts(
    items: tuple[tuple[str, str], ...],
    label: str,
    model: str,
    libraries: tuple[Path, ...],
    copied: bool = True,
) -> dict[str, str]:
    texts = dict(items)
    if any(_CONCERNED.search(text) for text in texts.values()):
        texts = _Sources(texts, label, libraries, copied).written()
    if any(_NAMED.search(text) for text in texts.values()):
        texts = _Sources(texts, label, libraries, copied).with_whole_paths(model)
    return texts


def specialised(tree: SourceTree, model: str = "", libraries: Sequence[Path] = ()) -> SourceTree:
    """The sources without redeclarations of elements of their own classes; lines stay where they are.

    Args:
        model: qualified name of what is built.
        libraries: folders with those that the sources use.
    Raises: BuildError for text that is no Modelica.
    """
    return replace(tree, texts=_texts(tuple(tree.texts.items()), tree.label, model, tuple(libraries)))


def told_apart(texts: dict[str, str], label: str, library: Path) -> dict[str, str]:
    """As `specialised`, for the files of a library, unless it is so large that this takes minutes."""
    if sum(map(len, texts.values())) > _LARGEST:
        return texts
    # Its packages stay what constraining types of its classes name.
    return _texts(tuple(texts.items()), label, "", (library,), False)


def _is_package(folder: Path) -> bool:
    return (folder / "package.mo").is_file()


class _Sources:
    def __init__(
        self, texts: dict[str, str], label: str, libraries: Sequence[Path], copied: bool = True
    ) -> None:
        tops = [
            one for folder in libraries for one in ([folder] if _is_package(folder) else folder.iterdir())
        ]
        self._libraries = {
            one.stem.partition(" ")[0] if one.is_file() else one.name.partition(" ")[0]: one
            for one in tops
            if _is_package(one)
        }
        self._read_files = set[str]()
        self._texts, self._label = texts, label
        self._copied = copied
        self._classes: dict[str, _Class] = {}
        self._copies: dict[tuple[str, str], str] = {}
        self._bases: set[str] = set()  # whose base classes are being looked up
        self._top: list[_Class] = []
        for file, text in texts.items():
            tokens = tokenise(text, label + file)
            self._top += self._read(text, file, tokens, within_clause(tokens))

    def written(self) -> dict[str, str]:
        edits: dict[str, list[tuple[int, int, str]]] = {}
        for one in self._top:
            edits.setdefault(one.file, []).extend(self._edits(one, {}))
        # Copies are made while classes are written, so that only now all are known.
        for one in self._classes.values():
            if one.file in self._texts and (one.beside or one.within):
                for where, texts in ((one.end, one.beside), (one.body - 1, one.within)):
                    token = one.tokens[where]
                    place = token.start + len(token.text)
                    if texts:
                        line = token.line + token.text.count("\n")
                        edits[one.file].append((place, place, f" {' '.join(texts)} {line_mark(line)}"))
        return {file: _edited(text, edits.get(file, ())) for file, text in self._texts.items()}

    def with_whole_paths(self, model: str) -> dict[str, str]:
        """The texts, in which classes name functions and packages by whole paths if others are called so.

        The compiler would take one of these for all.
        """
        places: dict[str, int] = {}
        kept = set[str]()
        for one in self._all():
            label = one.tokens[one.label]
            if one.kind == "function":
                places[label.text] = places.get(label.text, 0) + 1
                ahead = {token.text for token in one.tokens[one.first : one.label]}
                if "extends" in ahead or ("replaceable" in ahead and not self._copied):
                    kept.add(label.text)  # what it stands for differs from class to class
        packages = {
            one.tokens[one.label].text
            for one in self._all()
            if one.kind == "package" and one.short is not None and self._copied and not self._in_package(one)
        } - kept
        shared = {name for name, count in places.items() if count > 1} - kept
        edits: dict[str, list[tuple[int, int, str]]] = {}
        for one in self._all():
            if one.short is None:
                found = edits.setdefault(one.file, [])
                found += self._path_edits(one, packages, shared, model)
                found += [*self._element_edits(one), *self._outer_edits(one)]
        return {file: _edited(text, edits.get(file, ())) for file, text in self._texts.items()}

    def _path_edits(
        self, one: _Class, packages: set[str], shared: set[str], model: str
    ) -> Iterator[tuple[int, int, str]]:
        """Whole paths of functions, of packages and of what packages inherit."""
        modifiers = {at for part in one.parts for at in self._modifier_names(one, part)}
        typed = dict(self._inherited_types(one)) if self._copied else {}
        for begin, (end, path) in typed.items():
            yield one.tokens[begin].start, _behind(one.tokens[end - 1]), path
        for at in _own(one):
            token, before, after = one.tokens[at], one.tokens[at - 1].text, one.tokens[at + 1].text
            path = ""
            if token.text in packages and before != "." and after == "." and at not in typed:
                path = self._named(self._package(one, token.text), one)
            elif token.text in shared and after == "(" and before not in (".", "end"):
                if at not in modifiers and one.kind != "function":
                    path = self._function(one, token.text, model)
            if path and path != token.text:
                yield token.start, _behind(token), path

    def _element_edits(self, one: _Class) -> Iterator[tuple[int, int, str]]:
        """Equations in place of connections of a discrete signal to several elements, which are refused."""
        tokens = one.tokens
        found: dict[tuple[str, str], list[tuple[int, str]]] = {}
        for at in _own(one):
            if tokens[at].text != "connect" or tokens[at + 1].text != "(":
                continue
            ends = [tokens[first : last + 1] for first, last in arguments(tokens, at + 1)]
            for element, other in (ends, ends[::-1]) if len(ends) == 2 else ():
                if [token.text for token in element[-3::2]] == ["[", "]"]:
                    key = "".join(token.text for token in element[:-3]), _words(other)
                    found.setdefault(key, []).append((at, _words(element)))
        for (vector, signal), places in found.items():
            if len(places) > 1 and self._builtin(one, vector) in ("Boolean", "Integer"):
                for at, element in places:
                    yield tokens[at].start, _behind(tokens[closing(tokens, at + 1)]), f"{element} = {signal}"

    def _outer_edits(self, one: _Class) -> Iterator[tuple[int, int, str]]:
        """Outer variables of built-in types as parameters, which stand for the inner ones all the same.

        The compiler would ask for an equation for each, too.
        """
        for part in one.parts:
            if part.prefixes == {"outer"} and part.names:
                if self._builtin(one, one.tokens[part.names[0][0]].text) in ("Real", "Integer", "Boolean"):
                    start = one.tokens[part.path[0]].start
                    yield start, start, "parameter "

    def _builtin(self, one: _Class, path: str) -> str:
        """The built-in type of a component of a class, by its path; "" for another."""
        words = [""]
        for name in re.sub(r"\[[^\]]*\]", "", path).split("."):
            found = self._declared(one, name)
            if found is None or found[1].owner is not None:
                return ""
            words = _path(found[0].tokens, *found[1].path)
            after = self._resolved(words, found[0].name, {})
            one = after or found[0]
        while one.short is not None:
            words = _path(one.tokens, *one.short.path)
            after = self._resolved(words, one.name.rpartition(".")[0], {})
            if after is None:
                break
            one = after
        return words[0]

    def _function(self, one: _Class, name: str, model: str) -> str:
        """How a class names a function that it calls; "" if that is none of the sources."""
        found = self._found(one, name)
        while found is not None and found.short is not None and found.short.opening < 0:
            outer = found.name.rpartition(".")[0]
            after = self._resolved(_path(found.tokens, *found.short.path), outer, {})
            if after is None or after is found:
                break
            found = after
        if found is None or found.kind != "function":
            return ""
        last = found.name.rpartition(".")[2]
        plain = found.name.rpartition(".")[0] == model and self._resolved([last], one.name, {}) is found
        if plain:
            return last
        top = self._resolved([found.name.partition(".")[0]], one.name, {})
        hidden = top is None or "." in top.name
        return self._named(f".{found.name}", one) if hidden else f".{found.name}"

    def _inherited_types(self, one: _Class) -> Iterator[tuple[int, tuple[int, str]]]:
        """Types that packages inherit: the first index; the one behind the last, and the path of each."""
        for part in one.parts:
            words = _path(one.tokens, *part.path) if part.path[1] > part.path[0] + 1 else []
            found = self._found(one, words[0]) if words and words[0] else None
            inherits = False
            for word in words[1:]:
                while found is not None and found.short is not None and found.short.opening < 0:
                    names = _path(found.tokens, *found.short.path)
                    found = self._resolved(names, found.name.rpartition(".")[0], {})
                outer, found = found, self._member(found.name, word) if found is not None else None
                inherits |= found is not None and outer is not None and found.name != f"{outer.name}.{word}"
            if found is not None and inherits and not self._is_foreign(found):
                yield part.path[0], (part.path[1], self._named(f".{found.name}", one))

    def _in_package(self, one: _Class) -> bool:
        outer = self._get(one.name.rpartition(".")[0])
        return outer is None or outer.kind == "package"

    def _package(self, one: _Class, name: str) -> str:
        """What a package of a model that is defined by `=` stands for; "" for another."""
        found = self._found(one, name)
        path = ""
        while found is not None and found.short is not None and found.short.opening < 0:
            if found.kind != "package" or (not path and self._in_package(found)):
                return ""
            words = _path(found.tokens, *found.short.path)
            after = self._resolved(words, found.name.rpartition(".")[0], {})
            if after is None:
                return f".{'.'.join(words)}" if words[0] == "Modelica" else ""
            found, path = after, f".{after.name}"
            if self._is_foreign(found):
                break
        return path

    def _found(self, one: _Class, name: str) -> _Class | None:
        scope, found = one.name, None
        while found is None and scope:
            found = self._member(scope, name) or self._imported(scope, name)
            scope = scope.rpartition(".")[0]
        return found or self._get(name)

    def _modifier_names(self, one: _Class, part: _Part) -> Iterator[int]:
        ahead = [opening for _, opening in part.names] + [part.opening]
        for opening in ahead:
            for first, last in arguments(one.tokens, opening) if opening >= 0 else ():
                at = first
                while one.tokens[at].text in _PREFIXES:
                    at += 1
                behind = _path_end(one.tokens, at)
                yield at
                if behind <= last and one.tokens[behind].text == "(":
                    ahead.append(behind)

    def _all(self) -> Iterator[_Class]:
        ahead = list(self._top)
        for one in ahead:
            yield one
            ahead += [part.owner for part in one.parts if part.owner is not None]

    # Reading

    def _read(self, text: str, file: str, tokens: Sequence[Token], scope: str) -> list[_Class]:
        found, at = [], 0
        while at < len(tokens):
            first = at
            while at < len(tokens) and tokens[at].text in _PREFIXES:
                at += 1
            if at < len(tokens) and tokens[at].text in _KINDS:
                one = self._class(text, file, tokens, first, at, scope)
                found.append(one)
                at = one.end
            at += 1
        return found

    def _class(
        self, text: str, file: str, tokens: Sequence[Token], first: int, at: int, scope: str
    ) -> _Class:
        kind = tokens[at].text
        extends = tokens[at + 1].text == "extends"
        label = at + 1 + extends
        name = tokens[label].text
        one = _Class(f"{scope}.{name}" if scope else name, kind, text, file, tokens, label, first)
        at = label + 1
        if tokens[at].text == "=":
            one.end = _statement_end(tokens, at)
            begin = at + 1
            while tokens[begin].text in ("input", "output"):
                begin += 1
            behind = _path_end(tokens, begin)
            if behind > begin and tokens[begin].text not in ("enumeration", "der"):
                one.short = _Part("extends", first, one.end, (begin, behind))
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

    def _elements(self, one: _Class, at: int) -> None:
        """Read the body, whose first token is at an index, and set the end."""
        tokens, last, section = one.tokens, one.tokens[one.label].text, False
        while at < len(tokens):
            text = tokens[at].text
            if text == "end" and tokens[at + 1].text == last:
                one.end = _statement_end(tokens, at)
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

    def _element(self, one: _Class, first: int) -> _Part:
        tokens, at = one.tokens, first
        while tokens[at].text in _PREFIXES:
            at += 1
        prefixes = frozenset(token.text for token in tokens[first:at])
        if tokens[at].text in _KINDS:
            inner = self._class(one.text, one.file, tokens, first, at, one.name)
            named = "extends" if tokens[at + 1].text == "extends" else "class"
            return _Part(named + " class", first, inner.end, prefixes=prefixes, owner=inner)
        end = _statement_end(tokens, at)
        if tokens[at].text == "extends":
            behind = _path_end(tokens, at + 1)
            opening = behind if tokens[behind].text == "(" else -1
            return _Part("extends", first, end, (at + 1, behind), [], opening)
        part = _Part(tokens[at].text, first, end, prefixes=prefixes)
        behind = _path_end(tokens, at)
        if tokens[at].text == "import" or behind == at:
            return part
        part.kind, part.path = "components", (at, behind)
        at = closing(tokens, behind) + 1 if tokens[behind].text == "[" else behind
        expected = True
        while at < end:
            if tokens[at].text == "constrainedby":
                part.constrained = at
                behind = _path_end(tokens, at + 1)
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

    # Names

    def _get(self, name: str) -> _Class | None:
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

    def _is_foreign(self, one: _Class | None) -> bool:
        return one is not None and one.file not in self._texts and bool(one.file)

    def _resolved(self, path: Sequence[str], scope: str, changes: Changes) -> _Class | None:
        """The class that a path names in a class, some of whose elements change; None if it is no own one."""
        if not path:
            return None
        if not path[0]:
            found = self._get(path[1])
            path = path[1:]
        else:
            found = None
            while found is None:
                if path[0] in changes and changes[path[0]].kind in _KINDS:
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

    def _named(self, path: str, one: _Class) -> str:
        """How a class names another; the compiler looks up even whole paths from within."""
        parts, scope = path.removeprefix(".").split("."), one.name
        while scope and path.startswith("."):
            depth = scope.count(".") + 1
            if parts[:depth] == scope.split(".") and len(parts) > depth:
                found = self._resolved([parts[depth]], one.name, {})
                same = found is not None and found.name == ".".join(parts[: depth + 1])
                if same or (found is None and _MARK in parts[depth]):
                    return ".".join(parts[depth:])
            scope = scope.rpartition(".")[0]
        return path

    def _absolute(self, path: str) -> _Class | None:
        return self._get(path.removeprefix(".")) if path.startswith(".") else None

    def _member(self, scope: str, name: str) -> _Class | None:
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

    def _imported(self, scope: str, name: str) -> _Class | None:
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

    def _bases_of(self, one: _Class, changes: Changes) -> Iterator[tuple[_Part, _Class] | None]:
        """The extends clauses of a class with what they name, so far as the sources define it."""
        for part in [one.short] if one.short else [one for one in one.parts if one.kind == "extends"]:
            scope = one.name.rpartition(".")[0] if one.short else one.name
            base = self._resolved(_path(one.tokens, *part.path), scope, {} if one.short else changes)
            yield (part, base) if base is not None and base is not one else None

    def _declared(self, one: _Class, name: str, depth: int = 0) -> tuple[_Class, _Part] | None:
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

    # Changes

    def _wanted(self, one: _Class, opening: int, changes: Changes) -> Changes:
        """What a bracket of modifiers redeclares, in the scope of a class some of whose elements change."""
        found: Changes = {}
        tokens = one.tokens
        for first, last in arguments(tokens, opening) if opening >= 0 else ():
            at = first
            while tokens[at].text in _PREFIXES:
                at += 1
            words = {token.text for token in tokens[first:at]}
            if "redeclare" in words:
                new = self._redeclared(one, at, last, words, changes)
                if new is not None:
                    found[new[0]] = new[1]
                continue
            behind = _path_end(tokens, at)
            if one.kind == "package" and self._copied and behind == at + 1 and tokens[behind].text == "=":
                # Of packages with a common base the compiler would take the constants of one for all.
                value = self._said(tokens[behind : last + 1], one)
                found[tokens[at].text] = _New(value, "value")
            if behind > at and tokens[behind].text == "(":
                inner = self._wanted(one, behind, changes)
                for name in reversed(_path(tokens, at, behind)) if inner else ():
                    inner = {name: _New("", "", tuple(inner.items()))}
                found = _merged(found, inner)
        return found

    def _redeclared(
        self, one: _Class, at: int, last: int, words: set[str], changes: Changes
    ) -> tuple[str, _New] | None:
        """A redeclaration by its name; None if it stays."""
        tokens = one.tokens
        if tokens[at].text in _KINDS:
            if tokens[at + 2].text != "=":
                return None
            behind = _path_end(tokens, at + 3)
            path = self._target(one, (at + 3, behind), changes)
            if path is None or tokens[behind].text == "[":
                return None
            if tokens[behind].text == "(":
                path = self._wrapped(one, tokens[at].text, path, behind, changes)
            return tokens[at + 1].text, _New(path, tokens[at].text)
        behind = _path_end(tokens, at)
        path = self._target(one, (at, behind), changes)
        if path is None or tokens[behind].kind != "name" or words & {"inner", "outer", "flow", "stream"}:
            return None
        opening = closing(tokens, behind + 1) + 1 if tokens[behind + 1].text == "[" else behind + 1
        inner = self._wanted(one, opening if tokens[opening].text == "(" else -1, changes)
        return tokens[behind].text, _New(path, "component", tuple(inner.items()))

    def _target(self, one: _Class, place: tuple[int, int], changes: Changes) -> str | None:
        """A path that means the same in every class; None if there is none."""
        path = _path(one.tokens, *place)
        found = self._resolved(path, one.name, changes)
        # What another class of the same name by default stands for: `redeclare package P = P`.
        while (
            found is not None and found.short is not None and found.short.opening < 0 and found.kind != "type"
        ):
            scope = found.name.rpartition(".")[0]
            after = self._resolved(_path(found.tokens, *found.short.path), scope, {})
            if after is None or after is found or self._is_foreign(found):
                break
            found = after
        if found is not None:
            return f".{found.name}"
        if path[0] in ("Real", "Integer", "Boolean", "String"):
            return path[0]
        return f".{'.'.join(path)}" if path[0] == "Modelica" else None

    def _wrapped(self, one: _Class, kind: str, path: str, opening: int, changes: Changes) -> str:
        """A class that extends another with modifiers, within the class where these stand."""
        base = self._absolute(path)
        wanted = self._pruned(base, self._wanted(one, opening, changes))
        text = self._stripped(one, opening, wanted, {}, changes)
        path = self._copy(base, wanted) if base is not None and wanted else path
        return self._heir(one, kind, path, text, one.tokens[opening].line)

    def _heir(self, one: _Class, kind: str, path: str, text: str, number: int) -> str:
        """The path of a class, in another or beside it, that extends one with modifiers of a line."""
        name = f"{path.rpartition('.')[2]}{_MARK}{len(self._copies) + 1}"
        inside = one.short is None and one.kind != "record"
        scope, host = (one.name, one.within) if inside else (one.name.rpartition(".")[0], one.beside)
        key = (f"{scope} {path}", f"{kind} {text}")
        if key not in self._copies:
            self._copies[key] = f".{scope}.{name}" if scope else f".{name}"
            path = self._named(path, one)
            body = f"= {path}{text};" if kind == "type" else f"extends {path}{text}; end {name};"
            written = f"{kind} {name} {body}"
            host.append(f"{line_mark(number)} {written}")
            self._read(written, "", tokenise(written, name), scope)[0].beside = host
        return self._copies[key]

    def _pruned(self, one: _Class | None, wanted: Changes) -> Changes:
        """Those changes that concern replaceable elements of a class's own sources."""
        found: Changes = {}
        for name, new in wanted.items() if one is not None and not self._is_foreign(one) else ():
            assert one is not None
            declared = self._declared(one, name)
            if declared is None or self._is_foreign(declared[0]):
                continue
            owner, part = declared
            if new.path and (part.owner is None) == (new.kind in _KINDS):
                continue
            if new.kind == "value":
                found[name] = new
            elif new.path:
                if not part.prefixes & {"replaceable", "redeclare"}:
                    continue
                target = self._absolute(new.path)
                inner = self._pruned(target, dict(new.inner))
                found[name] = replace(new, inner=tuple(inner.items()))
            elif part.owner is None:
                target = self._resolved(_path(owner.tokens, *part.path), owner.name, {})
                if inner := self._pruned(target, dict(new.inner)):
                    found[name] = replace(new, inner=tuple(inner.items()))
        return found

    def _copy(self, one: _Class, changes: Changes) -> str:
        """The path of a copy of a class with changes."""
        key = one.name, repr(sorted(changes.items(), key=lambda item: item[0]))
        if key not in self._copies:
            name = f"{one.tokens[one.label].text}{_MARK}{len(self._copies) + 1}"
            scope = one.name.rpartition(".")[0]
            self._copies[key] = f".{scope}.{name}" if scope else f".{name}"
            self._refuse_inner(one, changes)
            edits = list(self._edits(one, changes))
            start, end = one.tokens[one.first].start, one.tokens[one.end].start + 1
            head = list(_renamed(one, name, one.first))
            shifted = [(a - start, b - start, text) for a, b, text in (*edits, *head)]
            lines = one.tokens[one.first].line
            one.beside.append(_on_one_line(_edited(one.text[start:end], shifted, marked=lines)))
        return self._copies[key]

    def _refuse_inner(self, one: _Class, changes: Changes) -> None:
        for part in one.parts if any(new.kind in _KINDS for new in changes.values()) else ():
            inner = part.owner if part.kind == "class class" else None
            words = inner.tokens[inner.first : inner.end] if inner is not None and inner.parts else ()
            if token := next((token for token in words if token.text == "redeclare"), None):
                raise BuildError(
                    f"{location(self._label + one.file, one.text, token.start)}: a redeclaration in a class "
                    f"within {one.name}, of which {listed(sorted(changes))} is redeclared itself, is not "
                    "supported; put the inner class beside the outer one"
                )

    # Writing

    def _edits(self, one: _Class, changes: Changes) -> Iterator[tuple[int, int, str]]:
        """What changes in the text of a class."""
        if one.short is not None:
            yield from self._base_edits(one, one.short, changes, {})
            return
        own, texts = self._of_body(one, changes)
        for part in one.parts:
            names = {one.tokens[at].text for at, _ in part.names}
            if part.owner is not None:
                names = {one.tokens[part.owner.label].text}
            if "redeclare" in part.prefixes and names and names <= own.keys():
                name = own[min(names)].path.rpartition(".")[2]
                if part.owner is not None and part.owner.short is None:
                    yield from self._edits(part.owner, {})
                    yield from _renamed(part.owner, name, part.first)
                else:
                    yield one.tokens[part.first].start, one.tokens[part.end].start + 1, ""
            elif part.kind == "extends":
                yield from self._base_edits(one, part, changes, own, texts)
            elif part.kind == "components":
                yield from self._component_edits(one, part, changes)
            elif part.owner is not None:
                label = one.tokens[part.owner.label].text
                first, end = one.tokens[part.first].start, one.tokens[part.end].start
                if part.kind == "class class" and label in changes and changes[label].path:
                    # Its default is not needed any more; what replaces it cannot be replaced again.
                    path = self._named(changes[label].path, one)
                    yield first, end, f"{part.owner.kind} {label} = {path}"
                else:
                    yield from self._edits(part.owner, {})

    def _of_body(self, one: _Class, changes: Changes) -> tuple[Changes, dict[str, str]]:
        """Elements that a class redeclares of its bases in its body, and the modifiers of those."""
        found: Changes = {}
        texts: dict[str, str] = {}
        for part in one.parts:
            if "redeclare" not in part.prefixes or len(part.names) > 1:
                continue
            at = part.first
            while one.tokens[at].text in _PREFIXES:
                at += 1
            new = self._redeclared(one, at, part.end, set(part.prefixes), changes)
            if (
                part.kind == "class class"
                and part.owner is not None
                and part.owner.parts
                and one.kind != "package"
            ):
                # Written under another name, as the base gets one of its own.
                label = one.tokens[part.owner.label].text
                path = f"{one.name}.{label}{_MARK}"
                self._classes[path] = part.owner
                new = label, _New(f".{path}", part.owner.kind)
            if new is None:
                continue
            name = new[0]
            if any(base and self._pruned(base[1], {name: new[1]}) for base in self._bases_of(one, changes)):
                found[name] = new[1]
                if part.names and name not in changes:
                    at, opening = part.names[0]
                    wanted = self._pruned(self._absolute(new[1].path), dict(new[1].inner))
                    behind = closing(one.tokens, opening) + 1 if opening >= 0 else at + 1
                    value = " ".join(
                        token.text for token in one.tokens[behind : part.end] if token.kind != "string"
                    )
                    brackets = self._stripped(one, opening, wanted, {}, changes) if opening >= 0 else ""
                    if brackets or value.startswith("="):
                        texts[name] = f"{name}{brackets} {value if value.startswith('=') else ''}"
        return found, texts

    def _base_edits(
        self, one: _Class, part: _Part, changes: Changes, own: Changes, texts: dict[str, str] | None = None
    ) -> Iterator[tuple[int, int, str]]:
        """What changes of an extends clause, or of a definition by `=`."""
        tokens = one.tokens
        base = next((found[1] for found in self._bases_of(one, changes) if found and found[0] is part), None)
        wanted = self._pruned(base, _merged(self._wanted(one, part.opening, changes), own))
        mine = {name for name in changes if one.short is None and self._is_own(one, name)}
        outer = {name: new for name, new in changes.items() if name not in mine or name in own}
        outer = self._pruned(base, outer)
        all_of = _merged(wanted, outer)
        begin, end = part.path
        if base is not None and all_of:
            path = self._named(self._copy(base, all_of), one)
            yield tokens[begin].start, _behind(tokens[end - 1]), path
        added = [text for name, text in (texts or {}).items() if name in wanted]
        if part.opening >= 0:
            last = closing(tokens, part.opening)
            text = self._completed(self._stripped(one, part.opening, wanted, outer, changes, added), base)
            if _words_alone(text) != _words_alone(_words(tokens[part.opening : last + 1])):
                yield tokens[part.opening].start, _behind(tokens[last]), text
        elif added:
            place = _behind(tokens[end - 1])
            yield place, place, f"({', '.join(added)})"

    def _completed(self, text: str, base: _Class | None) -> str:
        """Modifiers of a base, with those of its own within them, which the compiler would forget."""
        if base is None or text.count("(") < 3:
            return text
        tokens = (*tokenise(text, base.name), Token("sign", ";", len(text), 0))
        given = modifiers_of(tokens, 0, _words)
        more = False
        for name, one in given.inner.items():
            known = self._given(base, name) if one.inner and name != one.value else Modifiers()
            for inner, two in one.inner.items():
                if two.inner and inner in known.inner:
                    more |= complete(two, known.inner[inner])
        return written(given) if more else text

    def _given(self, one: _Class, name: str, depth: int = 0) -> Modifiers:
        """What a class gives an element, own or inherited, in words that its heirs understand."""
        found = Modifiers()

        def said(tokens: Sequence[Token]) -> str:
            return self._said(tokens, one)

        for part in one.parts:
            for at, opening in part.names:
                if one.tokens[at].text == name:
                    return modifiers_of(one.tokens, opening, said) if opening >= 0 else found
        for base in self._bases_of(one, {}) if depth < 50 else ():
            if base is not None and self._declared(base[1], name):
                opening = base[0].opening
                if opening >= 0:
                    found = modifiers_of(one.tokens, opening, said).inner.get(name, found)
                complete(found, self._given(base[1], name, depth + 1))
        return found

    def _said(self, tokens: Sequence[Token], one: _Class) -> str:
        """The text of a value, in which classes and constants around a class have their whole paths."""
        texts = []
        for at, token in enumerate(tokens):
            text = token.text
            after = tokens[at + 1].text if at + 1 < len(tokens) else ""
            if token.kind == "name" and tokens[at - 1].text != "." and after != "=":
                scope = one.name
                while scope and self._declares_component(scope, text) is False:
                    scope = scope.rpartition(".")[0]
                found = self._found(one, text)
                if scope and scope != one.name:
                    text = f".{scope}.{text}"
                elif not scope and found is not None:
                    text = f".{found.name}"
            texts.append(text)
        return " ".join(texts)

    def _declares_component(self, scope: str, name: str) -> bool:
        one = self._get(scope)
        found = self._declared(one, name) if one is not None else None
        return found is not None and found[1].owner is None

    def _is_own(self, one: _Class, name: str) -> bool:
        return any(
            name in {one.tokens[at].text for at, _ in part.names}
            or (part.owner is not None and one.tokens[part.owner.label].text == name)
            for part in one.parts
            if "redeclare" not in part.prefixes
        )

    def _component_edits(self, one: _Class, part: _Part, changes: Changes) -> Iterator[tuple[int, int, str]]:
        tokens = one.tokens
        original = self._resolved(_path(tokens, *part.path), one.name, changes)
        clauses: list[tuple[str, str]] = []
        same = True
        dimensions = _words(tokens[part.path[1] : part.names[0][0]])
        for number, (at, opening) in enumerate(part.names):
            new = changes.get(tokens[at].text)
            target, path = original, ""
            used, opened = opening, opening
            if new is not None and new.kind == "component":
                target, path = self._absolute(new.path), new.path
                if part.constrained >= 0:
                    used = part.opening
            wanted = self._wanted(one, used, changes)
            inner = dict(new.inner) if new is not None else {}
            outer = self._pruned(target, inner)
            own = self._pruned(target, wanted)
            if all_of := _merged(own, outer):
                assert target is not None
                path = self._copy(target, all_of)
            brackets = self._stripped(one, used, own, outer, changes) if used >= 0 else ""
            if (
                new is None or new.kind != "component"
            ) and part.opening >= 0:  # also of the type that constrains it
                brackets = self._joined(one, opening, brackets, part.opening, changes)
            behind = closing(tokens, opened) + 1 if opened >= 0 else at + 1
            end = part.names[number + 1][0] - 1 if number + 1 < len(part.names) else part.end
            if part.constrained >= 0 and number + 1 == len(part.names):
                end = part.constrained
            dims = slice(at, behind if opened < 0 else opened)
            name = _words(tokens[dims])
            if opened < 0 and tokens[at + 1].text == "[":
                behind = closing(tokens, at + 1) + 1
                name = _words(tokens[at:behind])
            rest = _words(tokens[behind:end])
            held = _words(tokens[opening : closing(tokens, opening) + 1]) if opening >= 0 else ""
            plain = used == opening >= 0 and not rest.startswith("=") and "[" not in (*dimensions, *name)
            if plain and target is not None and (heir := self._record(one, part, target, name, brackets)):
                path, brackets = heir, ""
            same &= not path and _words_alone(brackets) == _words_alone(held)
            path = self._named(path, one)
            if new is not None and new.kind == "value":
                rest, same = new.path, False
            clauses.append((path, f"{name}{brackets} {rest}".strip()))
        if same:
            return
        type_text = "".join(token.text for token in tokens[slice(*part.path)])
        before = " ".join(
            word.text
            for word in tokens[part.first : part.path[0]]
            if word.text not in ("replaceable", "redeclare")
        )
        kept = _words(tokens[part.constrained : part.end]) if part.constrained >= 0 else ""
        keeps = " ".join(word.text for word in tokens[part.first : part.path[0]])
        texts = []
        for path, text in clauses:
            changed = any(tokens[at].text in changes for at, _ in part.names)
            prefix, suffix = (before, "") if changed or path else (keeps, kept)
            texts.append(
                " ".join(one for one in (prefix, path or type_text, dimensions, text, suffix) if one)
            )
        yield tokens[part.first].start, tokens[part.end].start, "; ".join(texts)

    def _record(self, one: _Class, part: _Part, target: _Class, name: str, brackets: str) -> str:
        """A type in place of a record's modifiers, which the compiler would keep where heirs bind all of it.

        Returns: its path; "" where none binds it, or the modifiers need components of the class.
        """
        bound = re.compile(rf"[(,.]\s*(final\s+|each\s+)*{re.escape(name)}\s*=(?!=)")
        if target.kind != "record" or one.kind == "function" or not brackets:
            return ""
        if one.kind != "record" and not any(bound.search(text) for text in self._texts.values()):
            return ""
        tokens = (*tokenise(brackets, name), Token("sign", ";", len(brackets), 0))
        if any(token.text in ("redeclare", "final") for token in tokens) or any(
            token.kind == "name"
            and after.text not in ("=", "(")
            and self._declares_component(one.name, token.text)
            for before, token, after in zip(tokens, tokens[1:], tokens[2:], strict=False)
            if before.text != "."
        ):
            return ""
        line = one.tokens[part.first].line
        return self._heir(one, "record", f".{target.name}", self._said(tokens[:-1], one), line)

    def _joined(self, one: _Class, opening: int, brackets: str, other: int, changes: Changes) -> str:
        """Modifiers, with those of another bracket for elements that they do not name."""
        tokens = one.tokens

        def named(place: int) -> dict[str, str]:
            found = {}
            for first, last in arguments(tokens, place) if place >= 0 else ():
                at = first
                while tokens[at].text in _PREFIXES or tokens[at].text in _KINDS:
                    at += 1
                found[tokens[at].text] = _words(tokens[first : last + 1])
            return found

        more = [text for name, text in named(other).items() if name not in named(opening)]
        if not more or any("redeclare" in text for text in more):
            return brackets
        held = brackets[1:-1].strip()
        return f"({', '.join(part for part in (held, *more) if part)})"

    def _stripped(
        self,
        one: _Class,
        opening: int,
        done: Changes,
        outer: Changes,
        changes: Changes,
        added: Sequence[str] = (),
    ) -> str:
        """A bracket of modifiers without the redeclarations that are done; "" if nothing is left.

        What an outer redeclaration replaces goes with its modifiers.
        """
        tokens, texts = one.tokens, list[str]()
        for first, last in arguments(tokens, opening):
            whole = _words(tokens[first : last + 1])
            at = first
            while tokens[at].text in _PREFIXES:
                at += 1
            words = [token.text for token in tokens[first:at]]
            each = " ".join(word for word in words if word in ("each", "final"))
            if "redeclare" in words:
                of_class = tokens[at].text in _KINDS
                place = at + 1 if of_class else _path_end(tokens, at)
                name = tokens[place].text
                if name not in done or not done[name].path:
                    new = self._redeclared(one, at, last, set(words), changes) if of_class else None
                    path = f"{tokens[at].text} {name} = {new[1].path}" if new else ""
                    behind = _path_end(tokens, at + 3) if of_class else last
                    modified = new and behind < last and tokens[behind].text == "("
                    further_words = _words(tokens[closing(tokens, behind) + 1 : last + 1]) if modified else ""
                    texts.append(f"{' '.join(words)} {path} {further_words}" if modified else whole)
                    continue
                if of_class or (name in outer and outer[name].path):
                    continue
                behind = closing(tokens, place + 1) + 1 if tokens[place + 1].text == "[" else place + 1
                inner = ""
                if tokens[behind].text == "(" and behind <= last:
                    further = dict(outer[name].inner) if name in outer else {}
                    inner = self._stripped(one, behind, dict(done[name].inner), further, changes)
                    behind = closing(tokens, behind) + 1
                value = ""
                if behind <= last and tokens[behind].text == "=":
                    until = next(
                        (k for k in range(behind, last + 1) if tokens[k].text == "constrainedby"), last + 1
                    )
                    value = _words(tokens[behind:until])
                if inner or value:
                    texts.append(f"{each} {name}{inner} {value}".strip())
                continue
            behind = _path_end(tokens, at)
            names = _path(tokens, at, behind)
            mine, further = done, outer
            for name in names:
                mine = dict(mine[name].inner) if name in mine else {}
                further = dict(further[name].inner) if name in further else {}
            if len(names) == 1 and names[0] in done and done[names[0]].kind == "value":
                continue
            if behind > at and tokens[behind].text == "(" and mine:
                inner = self._stripped(one, behind, mine, further, changes)
                behind = closing(tokens, behind) + 1
                value = _words(tokens[behind : last + 1])
                if inner or value:
                    texts.append(f"{each} {'.'.join(names)}{inner} {value}".strip())
                continue
            texts.append(whole)
        texts += added
        return f"({', '.join(texts)})" if texts else ""


def _merged(inner: Changes, outer: Changes) -> Changes:
    """Changes of two levels: the outer one holds."""
    found = dict(inner)
    for name, new in outer.items():
        old = found.get(name)
        if old is None:
            found[name] = new
        elif not new.path:
            found[name] = replace(old, inner=tuple(_merged(dict(old.inner), dict(new.inner)).items()))
        else:
            further = dict(old.inner) if not old.path else {}
            found[name] = replace(new, inner=tuple(_merged(further, dict(new.inner)).items()))
    return found


def _own(one: _Class) -> Iterator[int]:
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


def _last_end(one: _Class) -> int:
    """The index of the `end` of a class."""
    ends = (at for at in range(one.end - 1, 0, -1) if one.tokens[at].text == "end")
    return next(at for at in ends if one.tokens[at + 1].text == one.tokens[one.label].text)


def _renamed(one: _Class, name: str, first: int) -> Iterator[tuple[int, int, str]]:
    """Edits that give a class another name, and let nothing replace it; its prefixes begin at `first`."""
    for token in one.tokens[first : one.label]:
        if token.text in ("replaceable", "redeclare", "final"):
            yield token.start, _behind(token), ""
    label = one.tokens[one.label]
    yield label.start, _behind(label), name
    if one.short is None:
        token = one.tokens[_last_end(one) + 1]
        yield token.start, _behind(token), name


def _path_end(tokens: Sequence[Token], at: int) -> int:
    """The index behind a path, which may begin with a dot."""
    begin = at
    at += tokens[at].text == "."
    while tokens[at].kind == "name":
        at += 1
        if tokens[at].text != "." or tokens[at + 1].kind != "name":
            return at
        at += 1
    return begin


def _path(tokens: Sequence[Token], begin: int, end: int) -> list[str]:
    return "".join(token.text for token in tokens[begin:end]).split(".")


def _words_alone(text: str) -> str:
    return text.replace(" ", "")


def _words(tokens: Sequence[Token]) -> str:
    """Tokens as text, without comments."""
    return " ".join(token.text for token in tokens)


def _statement_end(tokens: Sequence[Token], at: int) -> int:
    while at < len(tokens) - 1 and tokens[at].text != ";":
        at = closing(tokens, at) + 1 if tokens[at].text in ("(", "[", "{") else at + 1
    return at


def _behind(token: Token) -> int:
    return token.start + len(token.text)


def _edited(text: str, edits: Sequence[tuple[int, int, str]], marked: int = 0) -> str:
    """A text with edits, which keep the line breaks of what they replace.

    Args:
        marked: where it is to stand on one line, the number of its first line.
    """
    new, place, line = list[str](), 0, marked
    for start, end, put in sorted(edits, key=lambda one: one[:2]):
        new += [_marked(text[place:start], line), put] if marked else [text[place:start], put]
        line += text[place:end].count("\n")
        if not marked:
            new.append("\n" * max(0, text[start:end].count("\n") - put.count("\n")))
        elif "\n" in text[start:end]:
            new.append(f" {line_mark(line)} ")
        place = end
    return "".join([*new, _marked(text[place:], line) if marked else text[place:]])


def _marked(text: str, line: int) -> str:
    """A piece of text whose line breaks are marks."""
    first, *rest = text.split("\n")
    return "\n".join([first, *(f" {line_mark(line + n)} {one}" for n, one in enumerate(rest, 1))])


def _on_one_line(text: str) -> str:
    """The text without line breaks, and without comments but the marks of lines."""
    tokens, place, words = tokenise(text, "copy"), 0, list[str]()
    for token in tokens:
        words += _marks(text[place : token.start])
        words.append(token.text.replace("\n", "\\n"))
        place = _behind(token)
    return " ".join(words)


def _marks(blank: str) -> list[str]:
    begin, end = line_mark(0).split("0")
    return [f"{begin}{one.partition(end)[0]}{end}" for one in blank.split(begin)[1:]][-1:]
