"""Arrays of components whose sizes the compiler cannot evaluate: it makes single components of them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping

from orchestrator.base.errors import BuildError

from .declared_classes import ClassPart, DeclaredClass, DeclaredClasses
from .lexer import closing
from .source_edits import edited, path_of, text_end, words_of
from .sources import SourceTree

__all__ = ["refuse_single_components", "with_known_sizes"]

_ELEMENT = re.compile(r"\.(?![^\[]*\])")


def refuse_single_components(tree: SourceTree, model: str, names: Iterable[str]) -> None:
    """Refuse a component that is declared as an array, and is none in the flat model.

    Args:
        tree: the sources as the compiler sees them.
        names: of the flat model's variables.
    Raises: BuildError.
    """
    if model in tree.classes:
        _Components(tree.texts, tree.label, ()).refuse_single(tree, model, names)


def with_known_sizes(texts: Mapping[str, str]) -> dict[str, str]:
    """The files in which arrays of components have the size of another array, with the size in its place."""
    found = {path: text for path, text in texts.items() if re.search(r"\[[^\]]*\bsize\s*\(", text)}
    if not found:
        return {}
    changed = {}
    for path, edits in _Components(dict(texts), "", ()).sizes().items():
        changed[path] = edited(texts[path], edits)
    return changed


class _Components(DeclaredClasses):
    """Components of classes, and whether they are arrays."""

    def refuse_single(self, tree: SourceTree, model: str, names: Iterable[str]) -> None:
        seen = set[str]()
        for name in names:
            *path, _ = _ELEMENT.split(name.removeprefix("der(")) or [""]
            one = self._get(model)
            for depth, element in enumerate(path, 1):
                found = self._declared(one, element.partition("[")[0]) if one is not None else None
                if found is None:
                    break
                owner, part = found
                whole = ".".join(path[:depth])
                at = next((at for at, _ in part.names if owner.tokens[at].text == element), None)
                if at is not None and whole not in seen and _dimensions(owner, part, at):
                    place = tree.at(owner.file, owner.tokens[at])
                    raise BuildError(
                        f"{place}: the size of the array `{whole}` is not known to the compiler, which is "
                        "not supported; give it by numbers and Integer parameters"
                    )
                seen.add(whole)
                one = self._type_of(owner, part)

    def sizes(self) -> dict[str, list[tuple[int, int, str]]]:
        found: dict[str, list[tuple[int, int, str]]] = {}
        for one in self._all():
            for part in one.parts if one.file in self._texts else ():
                if part.kind != "components":
                    continue
                for at, _ in part.names:
                    for first, end in _dimensions(one, part, at):
                        found.setdefault(one.file, []).extend(self._replaced(one, part, first, end))
        return {file: sorted(set(edits)) for file, edits in found.items() if edits}

    def _is_built_in(self, one: DeclaredClass, part: ClassPart) -> bool:
        """Whether an element is of a built-in type, or one whose class is not known."""
        return self._type_of(one, part) is None

    def _type_of(self, one: DeclaredClass, part: ClassPart) -> DeclaredClass | None:
        return self._resolved(path_of(one.tokens, *part.path), one.name, {}) if part.path[1] else None

    def _replaced(
        self, one: DeclaredClass, part: ClassPart, first: int, end: int
    ) -> Iterator[tuple[int, int, str]]:
        tokens, built_in = one.tokens, self._is_built_in(one, part)
        for at in range(first, end):
            words = [token.text for token in tokens[at : at + 6]]
            if [*words[:2], *words[3::2]] != ["size", "(", ",", ")"] or not words[4].isdigit():
                continue
            places = ((other, place) for other in one.parts for place, _ in other.names)
            declared = next((found for found in places if tokens[found[1]].text == words[2]), None)
            if declared is None or (built_in and self._is_built_in(one, declared[0])):
                continue  # the compiler knows it
            sizes = _dimensions(one, *declared)
            number = int(words[4])
            if 0 < number <= len(sizes):
                text = words_of(tokens[slice(*sizes[number - 1])])
                if text != ":":
                    yield tokens[at].start, text_end(tokens[at + 5]), f"({text})"


def _dimensions(one: DeclaredClass, part: ClassPart, at: int) -> list[tuple[int, int]]:
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
