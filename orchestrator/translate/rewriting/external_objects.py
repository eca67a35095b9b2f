"""External objects, which the compiler refuses, as numbers and parameters beside them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

from ..lexer import closing
from .class_bodies import MARK, Edit, ModelicaFile
from .modifiers import arguments

Objects = Mapping[str, Sequence[tuple[str, str, str]]]
"""Names of classes of objects -> name, type and dimensions of what their constructors get."""
_OBJECT = re.compile(
    r"\b(?:class|type|model)\s+(\w+)(?:\s*\"(?:[^\"\\]|\\.)*\")*\s*extends\s+ExternalObject\s*;"
)
_INPUT = re.compile(r"\binput\s+([\w.]+)\s+(\w+)\s*(\[[^\]]*\])?")


def external_objects(texts: Iterable[str]) -> dict[str, list[tuple[str, str, str]]]:
    """The classes that extend ExternalObject, as `Objects`."""
    found = {}
    for text in texts:
        for match in _OBJECT.finditer(text) if "ExternalObject" in text else ():
            body = text[match.end() : text.index("end constructor", match.end())]
            found[match[1]] = [(name, kind, size) for kind, name, size in _INPUT.findall(body)]
    return found


def with_objects_as_numbers(source: ModelicaFile, objects: Objects) -> Iterator[Edit]:
    """An object becomes the number 0, and what its constructor gets parameters beside it.

    The class itself becomes the constructor, so that imports of its name still hold.
    """
    tokens, inside = source.tokens, list[range]()
    for one in source.classes:
        if one.name in objects and any(tokens[place].text == "ExternalObject" for place in one.own()):
            made = next((inner for inner in one.inner if inner.name == "constructor"), None)
            if made is None:
                continue
            inside.append(range(one.start, one.end + 3))
            body = source.words(made.body, made.end - 1)
            body = re.sub(rf"\boutput\s+{one.name}\b", "output Real", body)
            yield source.replaced(one.start, one.end + 2, f"function {one.name} {body} end {one.name};")
    for place, token in enumerate(tokens[:-2]):
        if token.text not in objects or any(place in one for one in inside):
            continue
        name = tokens[place + 1]
        if name.kind != "name" or tokens[place - 1].text == "end":
            continue
        first = place
        while tokens[first - 1].text == ".":
            first -= 2
        if tokens[place + 2].text != "=":
            yield source.replaced(first, place + 1, f"Real {name.text}")
            continue
        opening = place + 3
        while tokens[opening].text != "(":
            opening += 1
        while tokens[first - 1].text in ("final", "parameter", "constant"):
            first -= 1
        inputs = {one[0]: one for one in objects[token.text]}
        lines = [f"final parameter Real {name.text} = 0"]
        for label, (a, b) in zip(inputs, arguments(tokens, opening), strict=False):
            if tokens[a].kind == "name" and tokens[a + 1].text == "=":
                label, a = tokens[a].text, a + 2
            _, kind, size = inputs[label]
            if kind != "String":
                value = source.words(a, b)
                lines.append(f"final parameter {kind} {MARK}{name.text}_{label}{size} = {value}")
        yield source.replaced(first, closing(tokens, opening), "; ".join(lines))
