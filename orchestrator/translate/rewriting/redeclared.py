"""Redeclarations that the compiler would take for others, silently, and that `specialised` leaves.

They concern elements of classes of libraries; what is checked is the text of the model's own classes.
"""

from __future__ import annotations

from collections.abc import Iterator

from orchestrator.base.errors import BuildError

from ..classes import used_classes
from ..lexer import Token
from ..sources import SourceTree
from .declared_classes import PREFIXES, ClassPart, DeclaredClass, DeclaredClasses
from .modifiers import arguments
from .source_edits import path_end


def refuse_repeated_redeclarations(tree: SourceTree, model: str) -> None:
    """Refuse a component that `extends` redeclares of a class which does not itself declare it.

    The compiler would silently keep what the class inherits or redeclares.

    Raises: BuildError.
    """
    if model in tree.classes and any("redeclare" in text for text in tree.texts.values()):
        names = [item.name for item in used_classes(tree.classes, model)]
        if wrong := list(_Redeclarations(tree.texts, tree.label, ()).wrong(tree, names)):
            raise BuildError("\n".join(wrong))


class _Redeclarations(DeclaredClasses):
    """Classes whose bases have components redeclared; bases are known by their last names."""

    def wrong(self, tree: SourceTree, names: list[str]) -> Iterator[str]:
        """Messages on those of the classes named."""
        extended: dict[str, list[tuple[str, dict[str, Token]]]] = {}
        own: list[tuple[DeclaredClass, str, dict[str, Token]]] = []
        for one in (self._classes[name] for name in names if name in self._classes):
            for part in [one.short] if one.short else one.parts:
                if part.kind == "extends":
                    base = one.tokens[part.path[1] - 1].text
                    found = dict(_redeclared(one, part))
                    extended.setdefault(one.tokens[one.label].text, []).append((base, found))
                    own.append((one, base, found))
        for one, name, found in own:
            inner, bases = dict[str, str](), [name]
            for base in bases:
                for further, redeclared in extended.get(base, ()):
                    inner |= dict.fromkeys(redeclared, base)
                    bases += [further] * (further not in bases)
            yield from (
                f"{tree.at(one.file, token)}: `{part}` is redeclared here and where {inner[part]} extends "
                f"its base, which the compiler would keep; extend that base instead"
                for part, token in found.items()
                if part in inner
            )
            used = [other for other in self.all_classes() if other.tokens[other.label].text == name]
            yield from (
                f"{tree.at(one.file, token)}: `{part}` is redeclared here, but {name} inherits it, so that "
                f"the compiler would keep what it is there; extend the class that declares `{part}` instead"
                for part, token in found.items()
                if used and part not in inner and not any(_declares(other, part) for other in used)
            )


def _declares(one: DeclaredClass, name: str) -> bool:
    return any(one.tokens[at].text == name for part in one.parts for at, _ in part.names)


def _redeclared(one: DeclaredClass, part: ClassPart) -> Iterator[tuple[str, Token]]:
    """Components that the modification behind a base class redeclares, not those of its components."""
    tokens = one.tokens
    for first, _ in arguments(tokens, part.opening) if part.opening >= 0 else ():
        at = first
        while tokens[at].text in PREFIXES:
            at += 1
        behind = path_end(tokens, at)
        redeclares = any(token.text == "redeclare" for token in tokens[first:at])
        if redeclares and behind > at and tokens[behind].kind == "name":
            yield tokens[behind].text, tokens[behind]
