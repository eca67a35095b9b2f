"""Redeclarations that the compiler would take for others, silently, and that `specialised` leaves.

They concern elements of classes of libraries; what is judged is the text of the model's own classes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from orchestrator.base.errors import BuildError

from ..classes import ModelicaClass, used_classes
from ..lexer import CLOSING, OPENING, Token
from ..sources import SourceTree

_PREFIXES = frozenset(
    "public protected final inner outer replaceable redeclare parameter constant flow stream input output "
    "discrete each".split()
)


def refuse_repeated_redeclarations(tree: SourceTree, model: str) -> None:
    """Refuse a component that `extends` redeclares of a class which does not itself declare it.

    The compiler would silently keep what the class inherits or redeclares.

    Raises: BuildError.
    """
    if model not in tree.classes:
        return
    extended: dict[str, list[tuple[str, dict[str, Token]]]] = {}
    own: list[tuple[ModelicaClass, str, dict[str, Token]]] = []
    for item in used_classes(tree.classes, model):
        for statement in _parts(item.tokens, ";"):
            short = len(statement) == len(item.tokens)
            if statement and (short or statement[0].text == "extends"):
                name, at = _path(statement, int(not short))
                found = dict(_redeclared(statement[at:]))
                extended.setdefault(item.name.rpartition(".")[2], []).append((name, found))
                own.append((item, name, found))
    wrong = []
    for item, name, found in own:
        inner, bases = dict[str, str](), [name]
        for base in bases:
            for further, redeclared in extended.get(base, ()):
                inner |= dict.fromkeys(redeclared, base)
                bases += [further] * (further not in bases)
        wrong += [
            f"{tree.at(item.file, token)}: `{part}` is redeclared here and where {inner[part]} extends "
            f"its base, which the compiler would keep; extend that base instead"
            for part, token in found.items()
            if part in inner
        ]
        used = [one for one in tree.classes.values() if one.name.rpartition(".")[2] == name]
        wrong += [
            f"{tree.at(item.file, token)}: `{part}` is redeclared here, but {name} inherits it, so that the "
            f"compiler would keep what it is there; extend the class that declares `{part}` instead"
            for part, token in found.items()
            if used and part not in inner and not any(_declares(one, part) for one in used)
        ]
    if wrong:
        raise BuildError("\n".join(wrong))


def _declares(item: ModelicaClass, name: str) -> bool:
    pairs = zip(item.tokens, item.tokens[1:], strict=False)
    return any(one.text == name and (last.kind == "name" or last.text in ("]", ",")) for last, one in pairs)


def _redeclared(tokens: Sequence[Token]) -> Iterator[tuple[str, Token]]:
    """Components that the modification behind a base class redeclares, not those of its components."""
    depth = 0
    for at, token in enumerate(tokens):
        depth += (token.text in OPENING) - (token.text in CLOSING)
        if token.text == "redeclare" and depth == 1:
            at += 1
            while at < len(tokens) and tokens[at].text in _PREFIXES:
                at += 1
            _, behind = _path(tokens, at)
            if at < behind < len(tokens) and tokens[behind].kind == "name":
                yield tokens[behind].text, tokens[behind]


def _parts(tokens: Sequence[Token], mark: str) -> Iterator[list[Token]]:
    """What stands between marks outside brackets: statements by ";", declarators by ","."""
    depth, held = 0, list[Token]()
    for token in tokens:
        if not held and token.kind == "string":  # the description of the class, before its first element
            continue
        depth += (token.text in OPENING) - (token.text in CLOSING)
        if token.text == mark and depth <= 0:
            yield held
            depth, held = 0, []
        else:
            held.append(token)
    yield held


def _path(tokens: Sequence[Token], at: int) -> tuple[str, int]:
    """Last name of a path, and the place behind it."""
    name = ""
    while at < len(tokens) and tokens[at].kind == "name":
        name, at = tokens[at].text, at + 1
        if at < len(tokens) and tokens[at].text == ".":
            at += 1
        else:
            break
    return name, at
