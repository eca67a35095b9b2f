"""Arrays of components: sizes that the compiler cannot evaluate, and values of elements that it mistakes.

In silence it makes one component of an array whose size it does not know. What an array of components gets
by arithmetic, as `a[n](k=2*(1:n))`, it gives every element the complete array.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise

from ..base.errors import BuildError
from .built_in import BUILT_IN, FUNCTIONS
from .declared_classes import ClassPart, DeclaredClass, DeclaredClasses, own_tokens
from .lexer import Token, closing
from .modifiers import arguments
from .source_edits import edited, outermost, path_end, path_of, text_end, words_of
from .sources import SourceTree

_INDEX = "adapted_index"
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
                if at is not None and whole not in seen and dimensions(owner, part, at):
                    place = tree.at(owner.file, owner.tokens[at])
                    raise BuildError(
                        f"{place}: the size of the array `{whole}` is not known to the compiler, which is "
                        "not supported; give it by numbers and Integer parameters"
                    )
                seen.add(whole)
                one = self._type_of(owner, part)

    def edits(self) -> dict[str, list[tuple[int, int, str]]]:
        found: dict[str, list[tuple[int, int, str]]] = {}
        for one in self._all():
            if one.file in self._texts:
                places = list(own_tokens(one))
                edits = found.setdefault(one.file, [])
                edits += [*self._sizes_of(one, places, True), *self._ends(one, places)]
            for part in one.parts if one.file in self._texts else ():
                for at, opening in part.names if part.kind == "components" else ():
                    sizes, edits = dimensions(one, part, at), found.setdefault(one.file, [])
                    built_in = self._is_built_in(one, part)
                    for first, end in sizes:
                        edits += self._sizes_of(one, range(first, end), built_in)
                    if len(sizes) == 1 and opening >= 0 and not built_in:
                        edits += self._given(one, opening, words_of(one.tokens[slice(*sizes[0])]))
                    elif not sizes and opening >= 0:
                        edits += self._within(one, opening, self._type_of(one, part))
                if part.kind == "extends" and part.opening >= 0:
                    edits = found.setdefault(one.file, [])
                    edits += self._within(one, part.opening, self._type_of(one, part))
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
            found = self._declared(kind, tokens[at].text)
            if found is None or found[1].kind != "components":
                continue
            sizes = self._sizes(kind, tokens[at].text, True)
            if len(sizes) == 1:  # a name may mean something else here
                yield from self._given(one, at + 1, sizes[0] if sizes[0].isdigit() else "")
            elif not sizes:
                yield from self._within(one, at + 1, self._type_of(*found))

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
            return f"{{{_INDEX} for {_INDEX} in {first_one}:{last_one}}}"
        if bounds and size:
            return f"{{{_element_of(bounds)} for {_INDEX} in 1:{size}}}"
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
                words.append(value.format(*inner, i=_INDEX))
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
        return "" if not vectors or not size else f"{{{' '.join(words)} for {_INDEX} in 1:{size}}}"

    def _name(self, one: DeclaredClass, at: int, behind: int) -> tuple[str, list[str] | None, int]:
        """A name's element, its sizes (None where they are not known), and the token behind it."""
        tokens, text = one.tokens, words_of(one.tokens[at:behind])
        if text.startswith("Modelica . Constants"):
            return text, [], behind
        inner: DeclaredClass | None = one
        texts, all_sizes, sizes = list[str](), list[str](), list[str]()
        for name in text.split(" . "):
            found = self._declared(inner, name) if inner is not None else None
            if found is None or found[1].path[1] == 0:
                return text, None, behind
            owner, part = found
            place = next(here for here, _ in part.names if owner.tokens[here].text == name)
            sizes = [words_of(owner.tokens[slice(*size)]) for size in dimensions(owner, part, place)]
            texts.append(f"{name}[{_INDEX}]" if sizes else name)
            all_sizes += sizes
            inner = self._type_of(owner, part)
        if tokens[behind].text != "[":
            return ".".join(texts), all_sizes, behind
        close = closing(tokens, behind)
        inside = [words_of(tokens[a : b + 1]) for a, b in arguments(tokens, behind)]
        if len(inside) != len(sizes) or sizes != all_sizes or any(set("{(") & set(one) for one in inside):
            return text, None, behind
        left = [size for size, one in zip(sizes, inside, strict=True) if one == ":"]
        if any(":" in one and one != ":" for one in inside):
            return text, None, behind
        subscripts = ", ".join(_INDEX if one == ":" else one for one in inside)
        return f"{text}[{subscripts}]", left, close + 1

    def _is_built_in(self, one: DeclaredClass, part: ClassPart) -> bool:
        """Whether an element is of a built-in type, or one whose class is not known."""
        return self._type_of(one, part) is None

    def _type_of(self, one: DeclaredClass, part: ClassPart) -> DeclaredClass | None:
        return self._resolved(path_of(one.tokens, *part.path), one.name, {}) if part.path[1] else None

    def _sizes_of(
        self, one: DeclaredClass, places: Iterable[int], built_in: bool
    ) -> Iterator[tuple[int, int, str]]:
        """Sizes of arrays, written out; `built_in`: those of arrays of components alone."""
        tokens = one.tokens
        for at in places:
            words = [token.text for token in tokens[at : at + 6]]
            if [*words[:2], *words[3::2]] != ["size", "(", ",", ")"] or not words[4].isdigit():
                continue
            sizes = self._sizes(one, words[2], built_in)
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
            sizes = self._sizes(one, tokens[at - 1].text, True)
            for place in ends if len(sizes) == 1 else ():
                yield tokens[place].start, text_end(tokens[place]), f"({sizes[0]})"

    def _sizes(self, one: DeclaredClass, name: str, built_in: bool) -> list[str]:
        """The sizes of an element of a class, as text; `built_in`: those of arrays of components alone."""
        found = self._declared(one, name)
        if found is None or found[1].kind != "components":
            return []
        owner, part = found
        if built_in and self._is_built_in(owner, part):
            return []  # the compiler knows it
        place = next(at for at, _ in part.names if owner.tokens[at].text == name)
        return [words_of(owner.tokens[slice(*size)]) for size in dimensions(owner, part, place)]


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
    return f"({bounds[0]} + ({bounds[1] if len(bounds) == 3 else '1'})*({_INDEX} - 1))"


def _matrix(tokens: Sequence[Token]) -> str:
    """A matrix of numbers in brackets as one in braces; "" of anything else."""
    inside = tokens[1:-1]
    if tokens[0].text != "[" or not all(
        one.kind == "number" or one.text in ("-", ",", ";") for one in inside
    ):
        return ""
    rows = words_of(inside).split(";")
    return f"{{{', '.join(f'{{{row.strip()}}}' for row in rows)}}}"


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
