"""The types of components and functions in Modelica sources, and the sizes of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..lexer import closing
from .declared_classes import ClassPart, DeclaredClass, DeclaredClasses, dimensions
from .source_edits import path_of, words_of

BUILT_IN_TYPES = frozenset(("Real", "Integer", "Boolean", "String"))
Component = tuple[DeclaredClass, ClassPart, int]
"""The class that declares a component, its clause, and the index of its name."""


@dataclass(frozen=True)
class Input:
    """An input of a function: `depth` counts its dimensions."""

    name: str
    kind: str
    depth: int
    optional: bool


class TypedClasses(DeclaredClasses):
    """Classes, and the kinds of their components.

    A kind is ".name" of an operator record, a built-in type, "other", or "" where it is not known.
    """

    def __init__(self, texts: dict[str, str], label: str, libraries: Sequence[Path]) -> None:
        super().__init__(texts, label, libraries)
        self._known: dict[tuple[str, ...], DeclaredClass | None] = {}
        self._imported_by: dict[str, list[str]] = {}

    def _resolved(self, path: Sequence[str], scope: str, changes: object) -> DeclaredClass | None:
        """The class that a path names within another, inherited or not."""
        key = (scope, *path)
        if key not in self._known:
            self._known[key] = None  # of bases that are being looked up
            self._known[key] = self._looked_up(path, scope)
        return self._known[key]

    def _looked_up(self, path: Sequence[str], scope: str) -> DeclaredClass | None:
        if not path[0]:
            found, rest = self._get(path[1]), path[2:]
        else:
            found, rest = None, path[1:]
            while found is None:
                found = self._member(scope, path[0]) or self._imported(scope, path[0])
                if not scope:
                    break
                scope = scope.rpartition(".")[0]
        for name in rest:
            found = self._member(found.name, name) if found is not None else None
        return found

    def components(self, one: DeclaredClass, depth: int = 0) -> dict[str, Component]:
        """All components of a class by their names, those of bases first, with their declarations."""
        found: dict[str, Component] = {}
        for base in self._bases_of(one, {}) if depth < 50 else ():
            if base is not None:
                found |= self.components(base[1], depth + 1)
        for part in one.parts:
            found |= {one.tokens[at].text: (one, part, at) for at, _ in part.names}
        return found

    def kind_of(self, owner: DeclaredClass, part: ClassPart) -> tuple[str, DeclaredClass | None]:
        """The kind of a component, as of an expression's `Value`, and its class."""
        return self.kind(path_of(owner.tokens, *part.path), owner.name)

    def kind(self, path: Sequence[str], scope: str) -> tuple[str, DeclaredClass | None]:
        """The kind that a type's path names within a class, and its class."""
        if len(path) == 1 and path[0] in BUILT_IN_TYPES:
            return path[0], None
        found = self._resolved(path, scope, {})
        for _ in range(50):
            if found is None or found.short is None:
                break
            words = path_of(found.tokens, *found.short.path)
            if len(words) == 1 and words[0] in BUILT_IN_TYPES:
                return words[0], None
            after = self._resolved(words, found.name.rpartition(".")[0], {})
            found = None if after is found else after
        if found is None:
            return "", None
        return f".{found.name}" if is_overloading(found) else "other", found

    def component(self, one: DeclaredClass, name: str) -> Component | None:
        """A component of a class by its name, or a constant of those around it."""
        scope: DeclaredClass | None = one
        while scope is not None:
            if found := self.own_component(scope, name):
                return found
            scope = self._get(scope.name.rpartition(".")[0])
        return None

    def own_component(self, one: DeclaredClass, name: str) -> Component | None:
        """A component of a class or its bases by its name."""
        found = self._declared(one, name)
        if found is None or found[1].kind != "components":
            return None
        owner, part = found
        return owner, part, next(at for at, _ in part.names if owner.tokens[at].text == name)

    def constant(self, one: DeclaredClass, name: str) -> Component | None:
        """A constant that a class, or one around it, imports."""
        scope: DeclaredClass | None = one
        while scope is not None:
            for path in self._imports(scope):
                alias, _, whole = path.rpartition("=")
                package, _, last = whole.rpartition(".")
                if (alias or last) in (name, "*") and (owner := self._get(package)) is not None:
                    if found := self.own_component(owner, name if last == "*" else last):
                        return found
            scope = self._get(scope.name.rpartition(".")[0])
        return None

    def _imports(self, one: DeclaredClass) -> list[str]:
        """What follows the word import in a class, without descriptions."""
        if one.name not in self._imported_by:
            clauses = [part for part in one.parts if part.kind == "import"]
            texts = [words_of(one.tokens[part.first + 1 : part.end]).partition('"')[0] for part in clauses]
            self._imported_by[one.name] = [text.replace(" ", "") for text in texts]
        return self._imported_by[one.name]

    # Functions

    def operators(self, record: str, name: str) -> list[DeclaredClass]:
        """The functions of an operator of a record."""
        found = self._get(f"{record[1:]}.'{name}'")
        if found is None or found.kind == "function":
            return [found] if found is not None else []
        owners = [part.owner for part in found.parts]
        return [one for one in owners if one is not None and one.kind == "function"]

    def signature(self, one: DeclaredClass) -> tuple[list[Input], tuple[str, tuple[str, ...]]]:
        """The inputs of a function; kind and sizes of its first result."""
        inputs, output = [], ("", tuple[str, ...]())
        for name, (owner, part, at) in self.components(one).items():
            kind = self.kind_of(owner, part)[0]
            sizes = tuple(sizes_of((owner, part, at)))
            if "input" in part.prefixes:
                optional = binding(owner, part, at) >= 0
                inputs.append(Input(name, kind, len(sizes), optional))
            elif "output" in part.prefixes and not output[0]:
                output = kind, sizes
        return inputs, output

    def sum_functions(self, record: str) -> list[DeclaredClass]:
        """The functions that make sums of a record: its zero and its addition; none where it has none."""
        zero, plus = (self.operators(f".{record}", name) for name in "0+")
        return [*zero, *plus] if len(zero) == len(plus) == 1 else []


def sizes_of(component: Component) -> list[str]:
    """The sizes of an array as they are written; none of what is no array."""
    one, part, at = component
    return [words_of(one.tokens[first:end]) for first, end in dimensions(one, part, at)]


def is_overloading(one: DeclaredClass) -> bool:
    """Whether a class is an operator record."""
    ahead = one.tokens[one.first : one.label]
    return one.kind == "record" and any(token.text == "operator" for token in ahead)


def binding(one: DeclaredClass, part: ClassPart, at: int) -> int:
    """Index of the value of a component; -1 without one."""
    tokens, opening = one.tokens, dict(part.names)[at]
    behind = at + 1
    if tokens[behind].text == "[":
        behind = closing(tokens, behind) + 1
    if opening >= 0:
        behind = closing(tokens, opening) + 1
    return behind + 1 if tokens[behind].text in ("=", ":=") else -1
