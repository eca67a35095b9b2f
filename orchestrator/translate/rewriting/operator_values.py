"""Expressions of Modelica with their types, as far as operator records need them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

INDEX = "adapted_index"
"""The iterator over elements of arrays."""
MAKER = "adapted_record"
"""The function of a record that makes one of its members."""
SUM = "adapted_sum"
"""The function of a record that sums a vector."""
_TRUTHS = frozenset(("or", "and", "<", "<=", ">", ">=", "==", "<>"))


class NotRead(Exception):
    """What is no expression that this module reads; it stays."""


@dataclass(frozen=True)
class Value:
    """An expression.

    Attributes:
        kind: ".name" of an operator record, a built-in type, "other", or "" where it is not known.
        sizes: of an array. element: text of one element, at `INDEX`; "" where there is none.
        members: gives the text of a member of a record.
        called: whether it is more than a name.
    """

    text: str
    kind: str = ""
    sizes: tuple[str, ...] = ()
    element: str = ""
    members: Callable[[str], str] | None = field(default=None, compare=False)
    called: bool = True

    @property
    def is_record(self) -> bool:
        return self.kind.startswith(".")


def over_elements(value: Value, size: str) -> Value:
    """An array of what holds for each element."""
    text = f"{{{value.text} for {INDEX} in 1:{size}}}"
    return Value(text, value.kind, (size,), value.text, value.members)


def built_in_operator(sign: str, given: Sequence[Value]) -> Value:
    """An operator of operands that are no records."""
    kinds = {one.kind for one in given}
    kind = "Boolean" if sign in _TRUTHS or sign == "not" else ""
    if not kind and kinds <= {"Real", "Integer"}:
        kind = "Integer" if kinds == {"Integer"} and sign not in ("/", "^") else "Real"
    elif kinds == {"String"} and not kind:
        kind = "String"
    texts = [one.text for one in given]
    arrays = [one for one in given if one.sizes]
    joint = f" {sign} " if sign.isalpha() or sign[0] == "." or len(given) > 1 else sign
    text = joint.join(texts) if len(given) > 1 else f"{joint.lstrip()}{texts[0]}"
    if not arrays:
        return Value(text, kind)
    plain = sign[0] == "." or len(given) == 1 or (sign in "+-") or (sign in "*/" and len(arrays) == 1)
    if not plain:
        return Value(text)
    elements = [one.element if one.sizes else one.text for one in given]
    joint = f" {sign.removeprefix('.')} "
    element = f"({joint.join(['', *(f'({one})' for one in elements)][-2:])})"
    plain = all(elements) and len(arrays[0].sizes) == 1
    return Value(text, kind, arrays[0].sizes, element if plain else "")


def fits(kind: str, wanted: str) -> bool:
    """Whether an argument of a kind can be given where another is wanted."""
    return kind == wanted or (kind, wanted) == ("Integer", "Real")


def getter(name: str) -> str:
    """The function of a record that gives a member."""
    return f"adapted_{name}"
