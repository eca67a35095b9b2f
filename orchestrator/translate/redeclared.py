"""Packages that components replace differently: where one keeps the default, the compiler mixes them up.

With `Pipe a(redeclare package Medium = Oil); Pipe c;` rumoca 0.10.2 computes c with Oil as well, silently.
What is judged is the text of the model's own classes; types of libraries count by their names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from orchestrator.base.errors import BuildError

from .classes import ModelicaClass, used_classes
from .lexer import CLOSING, OPENING, Token
from .sources import SourceTree

__all__ = ["refuse_mixed_packages", "refuse_repeated_redeclarations"]

_PREFIXES = frozenset(
    "public protected final inner outer replaceable redeclare parameter constant flow stream input output "
    "discrete each".split()
)


def refuse_mixed_packages(tree: SourceTree, model: str) -> None:
    """Refuse a package that one component replaces while another keeps its default. Raises: BuildError."""
    classes = tree.classes
    if model not in classes:
        return
    used = used_classes(classes, model)
    uses = [one for item in used for one in _uses(item)]
    # Name of a package -> what replaces it; in passing on, as in `redeclare package P = P`, the default does.
    targets: dict[str, set[str]] = {}
    for _, _, own in uses:
        for package, (owner, target) in own.items():
            targets.setdefault(package, set()).add(_passed(tree, owner, package, target))
    for item in used:
        for package in _elements(tree, item):
            targets.setdefault(package, set()).add(_default(tree, f"{item.name}.{package}"))
    for package, found in targets.items():
        defaults = _defaults(tree, used, package)
        for token, kind, own in uses:
            default = defaults.get(kind, "")
            kept = package not in own or _passed(tree, own[package][0], package, own[package][1]) == default
            others = found - {default, ""}
            if default and kept and others:
                file = next(one.file for one in used if token in one.tokens)
                raise BuildError(
                    f"{tree.at(file, token)}: {kind} takes the package {package} = {default} here and "
                    f"{sorted(others)[0]} elsewhere in the model; the compiler would take one for both. Give "
                    f"this one a package of its own: `package Own extends {default}; end Own;` and "
                    f"`redeclare package {package} = Own`"
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


def _uses(item: ModelicaClass) -> Iterator[tuple[Token, str, dict[str, tuple[str, str]]]]:
    """Types of components and what they replace: package -> class that says so, and target."""
    for statement in _parts(item.tokens, ";"):
        rest = list(statement)
        while rest and rest[0].text in _PREFIXES:
            rest.pop(0)
        path, at = _path(rest, int(bool(rest) and rest[0].text == "extends"))
        # As by `model B = A(...)`, too.
        extends = "extends" in [one.text for one in rest[:1]] or "(" in [
            one.text for one in rest[at : at + 1]
        ]
        if not path or not (extends or (at < len(rest) and rest[at].kind == "name")):
            continue
        parts = [rest[at:]] if extends else list(_parts(rest[at:], ","))
        for part in parts:
            own = {name: (item.name, target) for name, target in _replaced(part)}
            # A base class that is not modified is no component; one that is replaces for all.
            if not extends or own:
                yield (rest[0], "" if extends else path, own)


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


def _replaced(tokens: Sequence[Token]) -> Iterator[tuple[str, str]]:
    """Packages that a modification replaces, and their targets."""
    for at, token in enumerate(tokens):
        if token.text == "package" and at + 2 < len(tokens) and tokens[at + 2].text == "=":
            yield tokens[at + 1].text, _path(tokens, at + 3)[0]


def _elements(tree: SourceTree, item: ModelicaClass) -> Iterator[str]:
    """Packages that a class defines by `=` beside a `redeclare` of its own: `redeclare package P = Q;`."""
    if any(one.text == "redeclare" for one in item.tokens):
        begin = f"{item.name}."
        inner = (name.removeprefix(begin) for name in tree.classes if name.startswith(begin))
        yield from (name for name in inner if "." not in name and _default(tree, begin + name))


def _passed(tree: SourceTree, owner: str, package: str, target: str) -> str:
    return _default(tree, f"{owner}.{package}") or target if target == package else target


def _default(tree: SourceTree, name: str) -> str:
    """What a package that is defined by `=` stands for; empty for others."""
    found = tree.classes.get(name)
    return _path(found.tokens, 0)[0] if found is not None else ""


def _defaults(tree: SourceTree, used: Sequence[ModelicaClass], package: str) -> dict[str, str]:
    """Classes, by their last names, with the default of a package of theirs or of their base classes."""
    own = {one.name.rpartition(".")[2]: _default(tree, f"{one.name}.{package}") for one in used}
    found = {name: default for name, default in own.items() if default}
    for _ in used:
        more = {
            one.name.rpartition(".")[2]: found[base]
            for one in used
            for base in _bases(one, package)
            if base in found and one.name.rpartition(".")[2] not in found
        }
        if not more:
            break
        found |= more
    return found


def _bases(item: ModelicaClass, package: str) -> Iterator[str]:
    """Base classes whose package a class keeps."""
    for statement in _parts(item.tokens, ";"):
        short = len(statement) == len(item.tokens)
        if statement and (short or statement[0].text == "extends"):
            name, at = _path(statement, int(not short))
            if package not in dict(_replaced(statement[at:])):
                yield name
