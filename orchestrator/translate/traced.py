"""Numbers that remember how they were computed, so that plain Python code becomes expressions.

They are CasADi expressions inside, but with Python's meaning: integers stay integers, round() goes to the
even neighbour, and nothing is simplified on the way, so the order of rounding stays the source's. A truth
value asked for by `if`, `and` or `while` is decided by the tape's owner, which runs the code once per answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import casadi as ca
import numpy as np

from orchestrator.base.errors import BuildError

LARGEST = 1.7976931348623157e308
_OPEN, _CLOSE = "\ue000", "\ue001"  # private-use characters: no message has them


class TraceError(BuildError):
    """The code asks for something of a number that is known only where the model runs."""


OPERATIONS: dict[str, Callable[..., ca.SX]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "pow": lambda a, b: a**b,
    "fmod": ca.fmod,
    "copysign": ca.copysign,
    "atan2": ca.atan2,
    "hypot": ca.hypot,
    "neg": lambda a: -a,
    "abs": ca.fabs,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "eq": lambda a, b: a == b,
    "and": ca.logic_and,
    "or": ca.logic_or,
    "not": ca.logic_not,
    "select": ca.if_else,
    "floor": ca.floor,
    "ceil": ca.ceil,
    **{
        name: getattr(ca, name)
        for name in (
            *("sqrt", "exp", "log", "log10", "log1p", "expm1", "sin", "cos", "tan", "asin", "acos"),
            *("atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
        )
    },
}
_UNARY = tuple(name for name in OPERATIONS if hasattr(math, name) and name not in
               ("pow", "fmod", "copysign", "atan2", "hypot", "floor", "ceil"))  # fmt: skip


class Tape:
    """Makes traced numbers, each computation once, and keeps what messages say about them.

    Attributes:
        decide: answers what the truth of a traced condition is on the present path.
        texts: the parts of messages that are known only at run time, by number: ("name",),
            ("number", value, format) or ("choice", condition, text, other text).
    """

    def __init__(self) -> None:
        self._known: dict[tuple, Traced] = {}
        self._marks: dict[tuple, int] = {}
        self.decide: Callable[[Traced], bool] = _undecided
        self.texts: list[tuple] = []

    def symbol(self, name: str, kind: str) -> Traced:
        """A number that is given at run time; kind: float, int or bool."""
        return Traced(self, ca.SX.sym(name), kind, "symbol", ())

    def make(self, operation: str, kind: str, *operands: Any) -> Traced:
        """The result of an operation; asking for the same again gives the same object."""
        key = (operation, kind, *(x.number if isinstance(x, Traced) else repr(float(x)) for x in operands))
        if key not in self._known:
            expression = OPERATIONS[operation](*(self.expression(x) for x in operands))
            self._known[key] = Traced(self, expression, kind, operation, operands)
        return self._known[key]

    @staticmethod
    def expression(value: Any) -> ca.SX:
        """CasADi's expression of a traced or a plain number."""
        return value.sx if isinstance(value, Traced) else ca.SX(float(value))

    def select(self, condition: Traced, a: Any, b: Any) -> Any:
        """`a` where the condition holds, else `b`: for numbers, texts, and tuples and dicts of them."""
        if a is b:
            return a
        if isinstance(a, str) and isinstance(b, str):
            return a if a == b else TracedText(self.mark("choice", condition, a, b), self)
        if isinstance(a, tuple):
            parts = [self.select(condition, x, y) for x, y in zip(a, b, strict=True)]
            return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)
        if isinstance(a, dict):
            return {key: self.select(condition, a[key], b[key]) for key in a}
        if not isinstance(a, Traced) and not isinstance(b, Traced) and type(a) is type(b):
            if a == b and math.copysign(1.0, a) == math.copysign(1.0, b):
                return a
            if isinstance(a, bool):
                return condition if a else self.negation(condition)
        kinds = {_kind(a), _kind(b)}
        kind = kinds.pop() if len(kinds) == 1 else "float" if "float" in kinds else "int"
        return self.make("select", kind, condition, a, b)

    def negation(self, condition: Traced) -> Traced:
        """Not the condition."""
        return condition.operands[0] if condition.operation == "not" else self.make("not", "bool", condition)

    def mark(self, *what: Any) -> str:
        """Text that stands for what is known at run time only."""
        key = tuple(x.number if isinstance(x, Traced) else x for x in what)
        if key not in self._marks:
            self._marks[key] = len(self.texts)
            self.texts.append(what)
        return f"{_OPEN}{self._marks[key]}{_CLOSE}"

    def parts(self, text: str) -> Iterator[str | tuple]:
        """Split a text into plain pieces and entries of `texts`."""
        for piece in text.split(_OPEN):
            number, close, rest = piece.partition(_CLOSE)
            if close:
                yield self.texts[int(number)]
            else:
                rest = piece
            if rest:
                yield rest


class TracedText(str):
    """Text that is partly known only where the model runs; whether it is empty can be asked."""

    tape: Tape

    def __new__(cls, text: str, tape: Tape) -> TracedText:
        made = super().__new__(cls, text)
        made.tape = tape
        return made

    def __add__(self, other: str) -> TracedText:
        return TracedText(str.__add__(self, other), self.tape)

    def __radd__(self, other: str) -> TracedText:
        return TracedText(str.__add__(other, self), self.tape)

    def __bool__(self) -> bool:
        return bool(self._some(self))

    def _some(self, text: str) -> Any:
        """Whether a text is not empty: a truth value, traced where that depends on a choice."""
        some: Any = False
        for part in self.tape.parts(text):
            if isinstance(part, str) or part[0] != "choice":
                return True
            _, condition, a, b = part
            some = some | self.tape.select(condition, self._some(a), self._some(b))
        return some


def _undecided(condition: Traced) -> bool:
    raise TraceError("a truth value is needed outside of a traced call")


def _kind(value: Any) -> str:
    if isinstance(value, Traced):
        return value.kind
    return "bool" if isinstance(value, bool | np.bool_) else "int" if isinstance(value, int) else "float"


def _is_number(value: Any) -> bool:
    return isinstance(value, Traced | bool | int | float | np.number | np.bool_)


class Traced:
    """A number, or a truth value, that is known only where the model runs."""

    __hash__ = None  # type: ignore[assignment]  # a key of a dict would have to be known now
    _count = 0

    def __init__(self, tape: Tape, sx: ca.SX, kind: str, operation: str, operands: tuple) -> None:
        Traced._count += 1
        self.number = Traced._count
        self.tape, self.sx, self.kind, self.operation, self.operands = tape, sx, kind, operation, operands

    # Arithmetic. Sums with 0 and products with 0 and 1 are left out, as products of unit matrices have many.

    def _arithmetic(self, name: str, a: Any, b: Any) -> Any:
        if not (_is_number(a) and _is_number(b)):
            return NotImplemented
        whole = name != "div" and "float" not in (_kind(a), _kind(b))
        zero_a, zero_b = (not isinstance(x, Traced) and x == 0 for x in (a, b))
        one_a, one_b = (not isinstance(x, Traced) and x == 1 for x in (a, b))
        if name == "mul" and (zero_a or zero_b):
            return 0 if whole else 0.0
        if (zero_b and name in ("add", "sub")) or (one_b and name in ("mul", "div")):
            return a
        if (zero_a and name == "add") or (one_a and name == "mul"):
            return b
        return self.tape.make(name, "int" if whole else "float", a, b)

    def __add__(self, other: Any) -> Any:
        return self._arithmetic("add", self, other)

    def __radd__(self, other: Any) -> Any:
        return self._arithmetic("add", other, self)

    def __sub__(self, other: Any) -> Any:
        return self._arithmetic("sub", self, other)

    def __rsub__(self, other: Any) -> Any:
        return self._arithmetic("sub", other, self)

    def __mul__(self, other: Any) -> Any:
        return self._arithmetic("mul", self, other)

    def __rmul__(self, other: Any) -> Any:
        return self._arithmetic("mul", other, self)

    def __truediv__(self, other: Any) -> Any:
        return self._arithmetic("div", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._arithmetic("div", other, self)

    def __mod__(self, other: Any) -> Any:
        return _modulo(self.tape, self, other) if _is_number(other) else NotImplemented

    def __rmod__(self, other: Any) -> Any:
        return _modulo(self.tape, other, self) if _is_number(other) else NotImplemented

    def __floordiv__(self, other: Any) -> Any:
        return _floor_quotient(self.tape, self, other) if _is_number(other) else NotImplemented

    def __rfloordiv__(self, other: Any) -> Any:
        return _floor_quotient(self.tape, other, self) if _is_number(other) else NotImplemented

    def __pow__(self, other: Any) -> Any:
        # A square is rounded once, by pow() as well as by a product.
        return self * self if not isinstance(other, Traced) and other == 2 else self._power(self, other)

    def __rpow__(self, other: Any) -> Any:
        return self._power(other, self)

    def _power(self, a: Any, b: Any) -> Any:
        return self.tape.make("pow", "float", a, b) if _is_number(a) and _is_number(b) else NotImplemented

    def __neg__(self) -> Any:
        return self.tape.make("neg", _number_kind(self), self)

    def __pos__(self) -> Any:
        return self

    def __abs__(self) -> Any:
        return self.tape.make("abs", _number_kind(self), self)

    # Comparisons and logic.

    def _compare(self, name: str, a: Any, b: Any) -> Any:
        if not (_is_number(a) and _is_number(b)):
            return NotImplemented
        return self.tape.make(name, "bool", a, b)

    def __lt__(self, other: Any) -> Any:
        return self._compare("lt", self, other)

    def __le__(self, other: Any) -> Any:
        return self._compare("le", self, other)

    def __gt__(self, other: Any) -> Any:
        return self._compare("lt", other, self)

    def __ge__(self, other: Any) -> Any:
        return self._compare("le", other, self)

    def __eq__(self, other: Any) -> Any:
        return self._compare("eq", self, other)

    def __ne__(self, other: Any) -> Any:
        equal = self._compare("eq", self, other)
        return equal if equal is NotImplemented else self.tape.negation(equal)

    def __and__(self, other: Any) -> Any:
        if isinstance(other, bool):
            return self if other else False
        return self._compare("and", self, other)

    def __or__(self, other: Any) -> Any:
        if isinstance(other, bool):
            return True if other else self
        return self._compare("or", self, other)

    __rand__, __ror__ = __and__, __or__

    def __invert__(self) -> Any:
        return self.tape.negation(self) if self.kind == "bool" else -self - 1

    def __bool__(self) -> bool:
        condition = self if self.kind == "bool" else self.tape.make("eq", "bool", self, 0)
        if condition is not self:
            return not self.tape.decide(condition)
        if self.operation == "not":
            return not self.tape.decide(self.operands[0])
        return self.tape.decide(self)

    # Conversions.

    def __round__(self, digits: int | None = None) -> Any:
        if digits is not None:
            raise TraceError("round() of a number known at run time only: without digits")
        return _nearest(self.tape, self)

    def __floor__(self) -> Any:
        return self.tape.make("floor", "int", self)

    def __ceil__(self) -> Any:
        return self.tape.make("ceil", "int", self)

    def __trunc__(self) -> Any:
        if self.kind != "float":
            return self
        return self.tape.select(self < 0.0, self.__ceil__(), self.__floor__())

    def as_float(self) -> Traced:
        """The number as a float: float(x)."""
        return self if self.kind == "float" else self.tape.make("add", "float", self, 0.0)

    def __float__(self) -> float:
        raise TraceError("a number that is known only at run time is needed as a plain float")

    def __index__(self) -> int:
        raise TraceError("a number that is known only at run time is needed as an index or a count")

    def __deepcopy__(self, memo: dict) -> Traced:
        return self

    def __repr__(self) -> str:
        return self.tape.mark("number", self, "")

    def __format__(self, specification: str) -> str:
        return self.tape.mark("number", self, specification)


for _name in _UNARY:  # what numpy calls for each element of an array of objects

    def _method(self: Traced, name: str = _name) -> Traced:
        return self.tape.make(name, "float", self)

    setattr(Traced, _name, _method)


def _number_kind(value: Traced) -> str:
    return "float" if value.kind == "float" else "int"


def _nearest(tape: Tape, value: Traced) -> Any:
    """Round half to even; the difference to the floor is exact."""
    floor = tape.make("floor", "int", value)
    rest = value - floor
    odd = tape.make("fmod", "int", floor, 2) != 0
    up = (rest > 0.5) | ((rest == 0.5) & odd)
    return tape.select(up, floor + 1, floor)


def _modulo(tape: Tape, a: Any, b: Any) -> Any:
    kind = "float" if "float" in (_kind(a), _kind(b)) else "int"
    rest = tape.make("fmod", kind, a, b)
    zero = 0.0 if isinstance(b, Traced) else float(b)
    turned = (rest != 0) & (tape.make("lt", "bool", rest, 0) != (tape.make("lt", "bool", b, 0)
             if isinstance(b, Traced) else zero < 0))  # fmt: skip
    return tape.select(turned, rest + b, rest)


def _floor_quotient(tape: Tape, a: Any, b: Any) -> Any:
    kind = "float" if "float" in (_kind(a), _kind(b)) else "int"
    quotient = (a - _modulo(tape, a, b)) / b
    floor = tape.make("floor", kind, quotient)
    return tape.select(quotient - floor > 0.5, floor + 1, floor)
