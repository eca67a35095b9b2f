"""Arrays of components: sizes that the compiler cannot evaluate, and values of elements that it mistakes.

In silence it makes one component of an array whose size it does not know. What an array of components gets
by arithmetic, as `a[n](k=2*(1:n))`, it gives every element the complete array.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise

from orchestrator.base.errors import BuildError

from ..built_in import BUILT_IN, FUNCTIONS
from ..lexer import Token, closing
from ..sources import SourceTree
from .declared_classes import DeclaredClass, dimensions, own_tokens
from .modifiers import arguments
from .operator_values import INDEX
from .source_edits import edited, outermost, path_end, text_end, words_of
from .typed_classes import Component, TypedClasses, sizes_of

_SIGNS = frozenset(("(", ")", "+", "-", "*", "/", ".*", "./", ".+", ".-"))
_CLASS = re.compile(r"\b(?:model|block|class|connector|record)\s+\w+")
_MOST_ROUNDS = 20
_ELEMENT = re.compile(r"\.(?![^\[]*\])")


def refuse_single_components(tree: SourceTree, model: str, names: Iterable[str]) -> None:
    """Refuse a component that is declared as an array, and is none in the flat model.

    Args:
        tree: the sources as the compiler sees them.
        names: of the flat model's variables.
    Raises: BuildError.
    """
    names = [one for one in names if "." in one]
    if names and model in tree.classes:
        _Components(tree.texts, tree.label, ()).refuse_single(tree, model, names)


def with_component_arrays(texts: Mapping[str, str]) -> dict[str, str]:
    """The files that change, with these: sizes are written out, and what elements get, element by element."""
    classes = sum(len(_CLASS.findall(text)) for text in texts.values())
    if classes < 2 or not any("[" in text for text in texts.values()):
        return {}
    changed: dict[str, str] = {}
    for _ in range(_MOST_ROUNDS):  # a size may follow from another one
        found = _Components({**texts, **changed}, "", ()).edits()
        if not found:
            break
        changed |= {path: edited(changed.get(path, texts[path]), edits) for path, edits in found.items()}
    return changed


class _Components(TypedClasses):
    """Components of classes, and their sizes as arrays."""

    def refuse_single(self, tree: SourceTree, model: str, names: Iterable[str]) -> None:
        seen = set[str]()
        for name in names:
            *path, _ = _ELEMENT.split(name.removeprefix("der(")) or [""]
            one = self._get(model)
            for depth, element in enumerate(path, 1):
                found = self.own_component(one, element.partition("[")[0]) if one is not None else None
                if found is None:
                    break
                owner, part, at = found
                whole = ".".join(path[:depth])
                if "[" not in element and whole not in seen and dimensions(owner, part, at):
                    place = tree.at(owner.file, owner.tokens[at])
                    raise BuildError(
                        f"{place}: the size of the array `{whole}` is not known to the compiler, which is "
                        "not supported; give it by numbers and Integer parameters"
                    )
                seen.add(whole)
                one = self.kind_of(owner, part)[1]

    def edits(self) -> dict[str, list[tuple[int, int, str]]]:
        found: dict[str, list[tuple[int, int, str]]] = {}
        for one in self.all_classes():
            if one.file in self._texts:
                places = list(own_tokens(one))
                edits = found.setdefault(one.file, [])
                edits += [*self._sizes_of(one, places, True), *self._ends(one, places)]
            for part in one.parts if one.file in self._texts else ():
                for at, opening in part.names if part.kind == "components" else ():
                    sizes, edits = dimensions(one, part, at), found.setdefault(one.file, [])
                    kind = self.kind_of(one, part)[1]
                    for first, end in sizes:
                        edits += self._sizes_of(one, range(first, end), kind is None)
                    if len(sizes) == 1 and opening >= 0 and kind is not None:
                        edits += self._given(one, opening, words_of(one.tokens[slice(*sizes[0])]))
                    elif not sizes and opening >= 0:
                        edits += self._within(one, opening, kind)
                if part.kind == "extends" and part.opening >= 0:
                    edits = found.setdefault(one.file, [])
                    edits += self._within(one, part.opening, self.kind_of(one, part)[1])
        return {file: outermost(set(edits)) for file, edits in found.items() if edits}

    def _within(
        self, one: DeclaredClass, opening: int, kind: DeclaredClass | None
    ) -> Iterator[tuple[int, int, str]]:
        """As `_given`, for arrays of components within what a bracket modifies, which is of a class."""
        tokens = one.tokens
        for first, _ in arguments(tokens, opening) if kind is not None else ():
            at = first + (tokens[first].text == "final")
            if tokens[at].kind != "name" or tokens[at + 1].text != "(":
                continue
            found = self.own_component(kind, tokens[at].text)
            if found is None:
                continue
            sizes = self._sizes(found, True)
            if len(sizes) == 1:  # a name may mean something else here
                yield from self._given(one, at + 1, sizes[0] if sizes[0].isdigit() else "")
            elif not sizes:
                yield from self._within(one, at + 1, self.kind_of(*found[:2])[1])

    def _given(self, one: DeclaredClass, opening: int, size: str) -> Iterator[tuple[int, int, str]]:
        """Values in the bracket that modifies an array of components, written element by element."""
        tokens = one.tokens
        for first, last in arguments(tokens, opening):
            first += tokens[first].text == "final"
            at = path_end(tokens, first)
            if tokens[at].text == "(" and at > first:
                yield from self._given(one, at, size)
                at = closing(tokens, at) + 1
            if first < at < last and tokens[at].text == "=":
                text = _matrix(tokens[at + 1 : last + 1]) or self._vector(one, at + 1, last + 1, size)
                if text:
                    yield tokens[at + 1].start, text_end(tokens[last]), text

    def _vector(self, one: DeclaredClass, first: int, end: int, size: str) -> str:
        """A vector as a comprehension; "" where it is none, or is not understood."""
        tokens = one.tokens
        if len(bounds := _range(tokens, first, end)) == 2:
            first_one, last_one = bounds
            if first_one == "1" and _differ(last_one, size):
                return ""
            return f"{{{INDEX} for {INDEX} in {first_one}:{last_one}}}"
        if bounds and size:
            return f"{{{_element_of(bounds)} for {INDEX} in 1:{size}}}"
        if path_end([*tokens[first:end], tokens[end]], 0) == end - first:
            return ""  # a name, which the compiler takes
        words, vectors, at, wanted = list[str](), 0, first, size
        depth = product = before = 0  # whether a term multiplies; vectors before it
        while at < end:
            token, behind = tokens[at], path_end(tokens, at)
            close = closing(tokens, at) if token.text == "(" else 0
            if close and (bounds := _range(tokens, at + 1, close)):
                words.append(_element_of(bounds))
                at, vectors = close + 1, vectors + 1
                if bounds[0] == "1":
                    size = bounds[-1] if len(bounds) == 2 else size
            elif behind > at and tokens[behind].text == "(":
                inner = [words_of(tokens[a : b + 1]) for a, b in arguments(tokens, behind)]
                name = words_of(tokens[at:behind])
                if name in FUNCTIONS and BUILT_IN[name].inputs == 1:
                    words.append(name)
                    at = behind
                    continue
                values = {
                    ("linspace", 3): "({0} + (({1}) - ({0}))*({i} - 1)/(({2}) - 1))",
                    ("ones", 1): "1", ("zeros", 1): "0", ("fill", 2): "({0})",
                }  # fmt: skip
                if (value := values.get((name, len(inner)))) is None:
                    return ""
                words.append(value.format(*inner, i=INDEX))
                size = inner[-1]
                at, vectors = closing(tokens, behind) + 1, vectors + 1
            elif behind > at:
                text, sizes, at = self._name(one, at, behind)
                if sizes is None or len(sizes) > 1:
                    return ""
                words.append(text)
                vectors += len(sizes)
                size = next((one for one in sizes if one != ":"), size)
            elif token.kind == "number" or token.text in _SIGNS:
                words.append(token.text.lstrip(".") if token.kind == "sign" else token.text)
                at += 1
                depth += (token.text == "(") - (token.text == ")")
                product += token.text == "*"
                if not depth and words[-1] in ("+", "-"):
                    product, before = 0, vectors
            else:
                return ""
            if (product and vectors - before > 1) or _differ(size, wanted):
                return ""  # it may be a scalar product, or has another size, as the compiler finds
        return "" if not vectors or not size else f"{{{' '.join(words)} for {INDEX} in 1:{size}}}"

    def _name(self, one: DeclaredClass, at: int, behind: int) -> tuple[str, list[str] | None, int]:
        """A name's element, its sizes (None where they are not known), and the token behind it."""
        tokens, text = one.tokens, words_of(one.tokens[at:behind])
        if text.startswith("Modelica . Constants"):
            return text, [], behind
        inner: DeclaredClass | None = one
        texts, all_sizes, sizes = list[str](), list[str](), list[str]()
        for name in text.split(" . "):
            found = self.own_component(inner, name) if inner is not None else None
            if found is None:
                return text, None, behind
            sizes = sizes_of(found)
            texts.append(f"{name}[{INDEX}]" if sizes else name)
            all_sizes += sizes
            inner = self.kind_of(*found[:2])[1]
        if tokens[behind].text != "[":
            return ".".join(texts), all_sizes, behind
        close = closing(tokens, behind)
        inside = [words_of(tokens[a : b + 1]) for a, b in arguments(tokens, behind)]
        if len(inside) != len(sizes) or sizes != all_sizes or any(set("{(") & set(one) for one in inside):
            return text, None, behind
        left = [size for size, one in zip(sizes, inside, strict=True) if one == ":"]
        if any(":" in one and one != ":" for one in inside):
            return text, None, behind
        subscripts = ", ".join(INDEX if one == ":" else one for one in inside)
        return f"{text}[{subscripts}]", left, close + 1

    def _sizes_of(
        self, one: DeclaredClass, places: Iterable[int], of_components: bool
    ) -> Iterator[tuple[int, int, str]]:
        """Sizes of arrays, written out; of arrays of components alone, or of all."""
        tokens = one.tokens
        for at in places:
            words = [token.text for token in tokens[at : at + 6]]
            if [*words[:2], *words[3::2]] != ["size", "(", ",", ")"] or not words[4].isdigit():
                continue
            sizes = self._sizes(self.own_component(one, words[2]), of_components)
            number = int(words[4])
            if 0 < number <= len(sizes) and sizes[number - 1] != ":":
                yield tokens[at].start, text_end(tokens[at + 5]), f"({sizes[number - 1]})"

    def _ends(self, one: DeclaredClass, places: Iterable[int]) -> Iterator[tuple[int, int, str]]:
        """The last subscript of an array of components, written out."""
        tokens = one.tokens
        for at in places:
            if tokens[at].text != "[" or tokens[at - 1].kind != "name" or tokens[at - 2].text == ".":
                continue
            close = closing(tokens, at)
            ends = [place for place in range(at + 1, close) if tokens[place].text == "end"]
            if not ends or any(tokens[place].text == "[" for place in range(at + 1, close)):
                continue
            sizes = self._sizes(self.own_component(one, tokens[at - 1].text), True)
            for place in ends if len(sizes) == 1 else ():
                yield tokens[place].start, text_end(tokens[place]), f"({sizes[0]})"

    def _sizes(self, found: Component | None, of_components: bool) -> list[str]:
        """The sizes of an element of a class, as text; none where only arrays of components are wanted."""
        if found is None or (of_components and self.kind_of(*found[:2])[1] is None):
            return []  # the compiler knows it
        return sizes_of(found)


def _range(tokens: Sequence[Token], first: int, end: int) -> list[str]:
    """The bounds of a range, as text; none where tokens are no range."""
    cuts, at = [first - 1], first
    while at < end:
        if tokens[at].text == ":":
            cuts.append(at)
        at = closing(tokens, at) + 1 if tokens[at].text in ("(", "[", "{") else at + 1
    cuts.append(end)
    return [words_of(tokens[a + 1 : b]) for a, b in pairwise(cuts)] if len(cuts) > 2 else []


def _differ(one: str, other: str) -> bool:
    """Whether two sizes are unlike numbers."""
    return one.isdigit() and other.isdigit() and int(one) != int(other)


def _element_of(bounds: Sequence[str]) -> str:
    """One element of a range."""
    return f"({bounds[0]} + ({bounds[1] if len(bounds) == 3 else '1'})*({INDEX} - 1))"


def _matrix(tokens: Sequence[Token]) -> str:
    """A matrix of numbers in brackets as one in braces; "" of anything else."""
    inside = tokens[1:-1]
    if tokens[0].text != "[" or not all(
        one.kind == "number" or one.text in ("-", ",", ";") for one in inside
    ):
        return ""
    rows = words_of(inside).split(";")
    return f"{{{', '.join(f'{{{row.strip()}}}' for row in rows)}}}"
