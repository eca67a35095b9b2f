"""Units given element by element, `Real q[2](unit={"m", "rad"})`: the compiler passes on single ones only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from orchestrator.base.errors import BuildError

from .expressions import Json
from .lexer import Token, tokenise
from .sources import SourceTree

_TEXTS = {"unit": "unit", "displayUnit": "display_unit", "quantity": "quantity"}


def keep_unit_arrays(tree: SourceTree, flat: Json, files: Mapping[int, str]) -> None:
    """Put units that are arrays back into the flat representation, as lists of texts.

    Args:
        tree: the source files.
        flat: the compiler's representation; the attributes unit, display_unit and quantity are completed.
        files: paths of the sources by their numbers in it.
    Raises: BuildError for an array that is not one text for each element.
    """
    tokens: dict[str, tuple[Token, ...]] = {}
    for name, body in flat["variables"].items():
        span = body["source_span"]
        path = files.get(span["source"], "")
        if not body["dims"] or path not in tree.texts:
            continue
        if path not in tokens:
            tokens[path] = tokenise(tree.texts[path], tree.shown(path))
        text = tree.texts[path]
        end = len(text.encode()[: span["end"]].decode())
        rest = [token for token in tokens[path] if token.start >= end]
        for key, given in _arrays(rest).items():
            texts = _texts(given)
            if len(body["dims"]) != 1 or texts is None or len(texts) != body["dims"][0]:
                raise BuildError(
                    f"{tree.place(path, span['start'])}: {key} of {name} has to be one text, or one for each "
                    f'of its {"x".join(map(str, body["dims"]))} elements: {{"m", "rad"}}'
                )
            body[_TEXTS[key]] = texts


def _arrays(tokens: Sequence[Token]) -> dict[str, list[Token]]:
    """What stands between the braces of `unit = {...}` and its like in the modification that begins here."""
    found: dict[str, list[Token]] = {}
    depth = 0
    for index, token in enumerate(tokens):
        if depth == 0 and token.text not in ("[", "("):
            break  # the declaration has no modification, or it has ended
        depth += {"(": 1, "[": 1, "{": 1, ")": -1, "]": -1, "}": -1}.get(token.text, 0)
        opening = [one.text for one in tokens[index : index + 3]]
        if depth == 1 and opening[0] in _TEXTS and opening[1:] == ["=", "{"]:
            rest = tokens[index + 3 :]
            closing = next(place for place, one in enumerate(rest) if one.text == "}")
            found[opening[0]] = list(rest[:closing])
    return found


def _texts(tokens: Sequence[Token]) -> list[str] | None:
    """The texts of a list of them; None if it is anything else."""
    values, commas = tokens[::2], tokens[1::2]
    if any(token.kind != "string" for token in values) or any(token.text != "," for token in commas):
        return None
    return [token.text[1:-1] for token in values]
