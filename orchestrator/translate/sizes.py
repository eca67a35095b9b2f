"""Sizes of arrays and ranges, judged before the compiler: at huge ones it fills the memory or aborts.

What is checked is the text: numbers, and names of Integers by the largest value that a declaration or
modification gives them. What is not known counts as one element.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from operator import add, mul, sub

from orchestrator.base.errors import BuildError

from .classes import used_classes
from .lexer import CLOSING, OPENING, Token, tokenise
from .sources import SourceTree

# Models of some thousand elements take minutes to build.
_LARGEST_SIZE, _MOST_ELEMENTS, _LARGEST_BOUND = 100_000, 10_000_000, 1_000_000
_LONGEST = 40  # tokens of an expression that is looked at
_OPERATORS = {ast.Add: add, ast.Sub: sub, ast.Mult: mul, ast.Pow: math.pow}
# Functions that make arrays: how many of the arguments are no sizes.
_MAKERS = {"zeros": 0, "ones": 0, "fill": 1, "identity": 0}
# Expressions by names.
_Given = dict[str, list[Sequence[Token]]]


def refuse_large_sizes(tree: SourceTree, model: str) -> None:
    """Refuse ranges and sizes that no memory holds, in files that a model may use. Raises: BuildError."""
    used = {one.file for one in used_classes(tree.classes, model)} if model in tree.classes else {*tree.texts}
    files = {path: tokenise(tree.texts[path], tree.shown(path)) for path in sorted(used)}
    modified: dict[str, float] = {}
    known = {path: _Values(tokens, modified) for path, tokens in files.items()}
    found = [one.modifications() for one in known.values()]
    for name, value in (pair for own in found for pair in own.items()):
        modified[name] = max(value, modified.get(name, 0.0))
    for path, tokens in files.items():
        values = known[path]
        for place, token in enumerate(tokens):
            if token.text not in (":", "[", "(") or not place:
                continue
            size, most, what = _judged(tokens, place, values)
            if size > most:
                raise BuildError(
                    f"{tree.shown(path)}:{token.line}: {what} {size:,.0f} is too large; "
                    f"at most {most:,} is taken"
                )


def refuse_other_sizes(tree: SourceTree, sizes: Mapping[str, Sequence[int]]) -> None:
    """Refuse an array whose equations use another size than its declaration has: the compiler takes theirs.

    Args:
        sizes: of the flat model's variables, by name.
    Raises: BuildError.
    """
    declared: dict[str, list[tuple[str, Token, list[int] | None]]] = {}
    for path, text in tree.texts.items():
        tokens = tokenise(text, tree.shown(path))
        for place, (before, name, bracket) in enumerate(zip(tokens, tokens[1:], tokens[2:], strict=False), 3):
            # Declared: behind a type or a comma of a list; anything else gives no size to go by.
            if name.kind != "name" or not (before.kind == "name" or before.text == ","):
                continue
            inside = tokens[place : place + _LONGEST] if bracket.text == "[" else ()
            end = next((n for n, one in enumerate(inside) if one.text == "]"), 0)
            numbers = [one for one in inside[:end] if one.text != ","]
            literal = bool(numbers) and all(one.kind == "number" and one.text.isdigit() for one in numbers)
            declared.setdefault(name.text, []).append(
                (path, name, [int(one.text) for one in numbers] if literal else None)
            )
    for name, size in sizes.items():
        found = declared.get(name.rpartition(".")[2].partition("[")[0], [])
        if not found or any(own is None for _, _, own in found):
            continue
        if not any(_within(own or [], list(size)) for _, _, own in found):
            path, token, own = found[0]
            raise BuildError(
                f"{tree.at(path, token)}: {name} is declared with the size {own}, its equations use "
                f"{list(size)}; correct the declaration or the subscripts"
            )


def _within(own: list[int], size: list[int]) -> bool:
    """Whether a declared size is part of a variable's: components and types may be arrays as well."""
    return any(size[n : n + len(own)] == own for n in range(len(size) - len(own) + 1))


def _judged(tokens: Sequence[Token], place: int, values: _Values) -> tuple[float, int, str]:
    """The size that begins at a token, or that of the range around it; the largest allowed; its name."""
    if tokens[place].text == ":":
        bounds = (tokens[place - 1 : place], tokens[place + 1 : place + 2])
        return max(values.bound(one) for one in bounds), _LARGEST_BOUND, "a range up to"
    known = [max(values.of(one) or 1.0, 1.0) for one in _sizes(tokens, place)]
    if max(known, default=0.0) > _LARGEST_SIZE:
        return max(known), _LARGEST_SIZE, "a size of"
    return math.prod(known), _MOST_ELEMENTS, "an array of so many elements:"


def _sizes(tokens: Sequence[Token], place: int) -> list[Sequence[Token]]:
    """The sizes in a bracket of a declaration, or of a call that makes an array; else none.

    Subscripts in equations count for nothing: their names are often those of other things elsewhere.
    """
    token, before = tokens[place], tokens[place - 1]
    maker = _MAKERS.get(before.text) if token.text == "(" else None
    if before.kind != "name" or (token.text == "(" and maker is None):
        return []
    found = list(_split(tokens, place + 1))
    if token.text == "[":
        # `Real x[n]` or `Real[n] x`
        end = place + 1 + sum(len(one) + 1 for one in found)
        declared = (*tokens[place - 2 : place - 1], *tokens[end : end + 1])
        return found if any(one.kind == "name" for one in declared) else []
    return 2 * found if before.text == "identity" else found[maker:]


def _split(tokens: Sequence[Token], begin: int) -> Iterator[Sequence[Token]]:
    """Expressions between commas, up to the bracket that closes."""
    depth, first = 0, begin
    for place in range(begin, len(tokens)):
        text = tokens[place].text
        if depth == 0 and (text in CLOSING or text in (",", ";")):
            yield tokens[first:place]
            if text != ",":
                return
            first = place + 1
        depth += (text in OPENING) - (text in CLOSING)


class _Values:
    """The largest values of Integers in a file: those that it declares, and those that modifications give.

    Args:
        tokens: of the file.
        modified: values by names, of all files.
    """

    def __init__(self, tokens: Sequence[Token], modified: Mapping[str, float]) -> None:
        declared, self._own = _given(tokens)
        names = {
            name
            for place, token in enumerate(tokens)
            if token.text == "Integer"
            for name in _declared(tokens, place + 1)
        }
        self._bindings = {name: declared.get(name, ()) for name in names}
        self._modified = modified
        self._known: dict[str, float | None] = {}

    def modifications(self) -> dict[str, float]:
        """Values that modifications in this file give, by name, as far as they follow from this file."""
        found = {name: [self.of(one) for one in some] for name, some in self._own.items()}
        self._known = {}
        return {
            name: max((one for one in some if one is not None), default=0.0) for name, some in found.items()
        }

    def of(self, tokens: Sequence[Token]) -> float | None:
        """Value of an expression; None where it is not known."""
        if not tokens or len(tokens) > _LONGEST or any(one.kind in ("string", "keyword") for one in tokens):
            return None
        if len(tokens) == 1 and tokens[0].kind == "sign":
            return None
        text = " ".join(one.text.replace("^", "**") for one in tokens)
        if text not in self._known:
            self._known[text] = None  # while it is looked for: a name that depends on itself
            with suppress(SyntaxError, ValueError, OverflowError, RecursionError, MemoryError):
                self._known[text] = self._value(ast.parse(text, mode="eval").body)
        return self._known[text]

    def bound(self, tokens: Sequence[Token]) -> float:
        """One bound of a range, be it of real numbers; 0 where it is not known."""
        if tokens and tokens[0].kind == "number":
            return float(tokens[0].text)
        return self.of(tokens) or 0.0

    def _value(self, node: ast.expr) -> float | None:
        match node:
            case ast.Constant(value=int() as whole):  # Integers are not written as 1e6
                return float(whole)
            case ast.Name(id=name) | ast.Attribute(attr=name):
                if name not in self._bindings:
                    return None
                values = [self._modified.get(name), *(self.of(one) for one in self._bindings[name])]
                return max((one for one in values if one is not None), default=None)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                value = self._value(operand)
                return None if value is None else -value
            case ast.BinOp(left=left, op=op, right=right):
                one, other = self._value(left), self._value(right)
                if one is None or other is None:
                    return None
                known = (found for kind, found in _OPERATORS.items() if isinstance(op, kind))
                return next((found(one, other) for found in known), None)
        return None


def _given(tokens: Sequence[Token]) -> tuple[_Given, _Given]:
    """What stands behind names and `=`: in declarations, and in parentheses, which are modifications."""
    declared: _Given = {}
    modified: _Given = {}
    depth = 0
    for place, token in enumerate(tokens):
        depth += (token.text == "(") - (token.text == ")")
        if token.text == "=" and (name := _owner(tokens, place)):
            expression = next(_split(tokens[place + 1 : place + 1 + _LONGEST], 0), ())
            (modified if depth > 0 else declared).setdefault(name, []).append(expression)
    return declared, modified


def _owner(tokens: Sequence[Token], place: int) -> str:
    """The name that a sign of equality stands behind, brackets left out; empty without one."""
    depth = 0
    for token in reversed(tokens[max(place - _LONGEST, 0) : place]):
        depth += (token.text in CLOSING) - (token.text in OPENING)
        if depth < 0 or (depth == 0 and token.text not in OPENING):
            return token.text if depth == 0 and token.kind == "name" else ""
    return ""


def _declared(tokens: Sequence[Token], place: int) -> Iterator[str]:
    """Names that a declaration declares, whose type stands before a place."""
    for part in _split(tokens, place):
        if (first := next((one for one in part if one.kind == "name"), None)) is not None:
            yield first.text
