"""Scalar expressions of a hybrid model: shared nodes, simplification, derivatives, values.

Nodes are made by `make` alone, so that equal expressions are one object, and code computes each once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from orchestrator.base.errors import BuildError

from ..built_in import BUILT_IN


class NoDerivative(BuildError):
    """An expression whose derivative cannot be written."""


@dataclass(frozen=True, eq=False, slots=True)
class Expr:
    """A node: an operator and its operands.

    Attributes:
        op: "num", "sym", an arithmetic or logical operator, or "fn:NAME" of the C library.
        args: operands; of "num" the value, of "sym" what identifies the symbol.
        free: the symbols that the expression contains.
    """

    op: str
    args: tuple[Any, ...]
    free: frozenset[Expr]

    def __repr__(self) -> str:
        if self.op == "num":
            return repr(self.args[0])
        if self.op == "sym":
            return ".".join(map(str, self.args))
        return f"{self.op}({', '.join(map(repr, self.args))})"


@dataclass(frozen=True)
class Other:
    """A kind of operators that another module knows: those whose name begins with the kind and a colon.

    Attributes:
        derived: variation of a node from those of its operands.
        written: the node in C, from its operands in C.
    """

    derived: Callable[[Expr, Sequence[Expr]], Expr]
    written: Callable[[Expr, Sequence[str]], str]


OTHERS: dict[str, Other] = {}
_TABLE: dict[tuple[Any, ...], Expr] = {}
_EMPTY: frozenset[Expr] = frozenset()


def make(op: str, *args: Any) -> Expr:
    """The node of an operator and operands, as it stands."""
    key = (op, *(id(one) if isinstance(one, Expr) else one for one in args))
    found = _TABLE.get(key)
    if found is None:
        parts = [one.free for one in args if isinstance(one, Expr) and one.free]
        free = parts[0] if len(parts) == 1 else frozenset().union(*parts) if parts else _EMPTY
        found = _TABLE[key] = Expr(op, args, free)
    return found


def number(value: float) -> Expr:
    """A constant; -0.0 is 0.0."""
    return make("num", float(value) + 0.0)


def symbol(*what: Any) -> Expr:
    """A symbol that `what` identifies."""
    key = ("sym", *what)
    found = _TABLE.get(key)
    if found is None:
        # Its own free symbol: made in two steps.
        found = Expr("sym", what, _EMPTY)
        object.__setattr__(found, "free", frozenset((found,)))
        _TABLE[key] = found
    return found


def symbols(*expressions: Expr) -> frozenset[Expr]:
    """All symbols in expressions."""
    return frozenset().union(*(one.free for one in expressions)) if expressions else _EMPTY


ZERO, ONE, MINUS_ONE = number(0), number(1), number(-1)


def _value(one: Expr) -> float | None:
    return one.args[0] if one.op == "num" else None


def add(a: Expr, b: Expr) -> Expr:
    """a + b, simplified."""
    x, y = _value(a), _value(b)
    if x is not None and y is not None:
        return number(x + y)
    if x == 0:
        return b
    if y == 0:
        return a
    return sub(a, b.args[0]) if b.op == "neg" else make("add", a, b)


def sub(a: Expr, b: Expr) -> Expr:
    """a - b, simplified."""
    x, y = _value(a), _value(b)
    if x is not None and y is not None:
        return number(x - y)
    if y == 0:
        return a
    if x == 0:
        return neg(b)
    if a is b:
        return ZERO
    return add(a, b.args[0]) if b.op == "neg" else make("sub", a, b)


def neg(a: Expr) -> Expr:
    """-a, simplified."""
    x = _value(a)
    if x is not None:
        return number(-x)
    if a.op == "neg":
        return a.args[0]
    return make("sub", a.args[1], a.args[0]) if a.op == "sub" else make("neg", a)


def mul(a: Expr, b: Expr) -> Expr:
    """a b, simplified."""
    x, y = _value(a), _value(b)
    if x is not None and y is not None:
        return number(x * y)
    if x == 0 or y == 0:
        return ZERO
    if x == 1:
        return b
    if y == 1:
        return a
    if x == -1:
        return neg(b)
    if y == -1:
        return neg(a)
    return make("mul", a, b)


def div(a: Expr, b: Expr) -> Expr:
    """a / b, simplified."""
    x, y = _value(a), _value(b)
    if x == 0 and y != 0:
        return ZERO
    if x is not None and y:
        return number(x / y)
    if y in (1, -1):
        return a if y == 1 else neg(a)
    return make("div", a, b)


def power(a: Expr, b: Expr) -> Expr:
    """a to the power of b; small whole powers become products."""
    y = _value(b)
    if y == 0:
        return ONE
    if y == 1:
        return a
    if y == 2:
        return mul(a, a)
    if y == 3:
        return mul(a, mul(a, a))
    x = _value(a)
    if x is not None and y is not None and (x > 0 or y == int(y)):
        return number(x**y)
    return make("fn:pow", a, b)


def conditional(condition: Expr, a: Expr, b: Expr) -> Expr:
    """a where the condition holds, else b."""
    value = _value(condition)
    if value is not None:
        return a if value else b
    return a if a is b else make("if", condition, a, b)


def logical(op: str, a: Expr, b: Expr | None = None) -> Expr:
    """`and`, `or`, `not` and the relations, with constants evaluated."""
    x = _value(a)
    if b is None:
        return number(not x) if x is not None else a.args[0] if a.op == "not" else make("not", a)
    y = _value(b)
    if x is not None and y is not None:
        return number(_RELATIONS[op](x, y))
    if op == "and" and (x is not None or y is not None):
        rest, known = (b, x) if x is not None else (a, y)
        return rest if known else ZERO
    if op == "or" and (x is not None or y is not None):
        rest, known = (b, x) if x is not None else (a, y)
        return ONE if known else rest
    return make(op, a, b)


_RELATIONS: dict[str, Callable[[float, float], bool]] = {
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "and": lambda a, b: bool(a and b),
    "or": lambda a, b: bool(a or b),
}
RELATIONS = ("lt", "le", "gt", "ge", "eq", "ne")


def function(name: str, *args: Expr) -> Expr:
    """A function of the C library."""
    values = [_value(one) for one in args]
    if name in _VALUES and all(one is not None for one in values):
        try:
            return number(_VALUES[name](*values))
        except (ValueError, OverflowError, ZeroDivisionError):
            pass
    return make(f"fn:{name}", *args)


_VALUES: dict[str, Callable[..., float]] = {
    **{one.in_c: one.value for one in BUILT_IN.values() if one.value and one.in_c},
    "trunc": math.trunc, "fmin": min, "fmax": max, "pow": pow,
}  # fmt: skip


def rebuild(op: str, args: tuple[Any, ...]) -> Expr:
    """A node with other operands, simplified."""
    if op in _MAKERS:
        return _MAKERS[op](*args)
    if op.startswith("fn:"):
        return power(*args) if op == "fn:pow" else function(op[3:], *args)
    if op in ("and", "or", "not", *RELATIONS):
        return logical(op, *args)
    return make(op, *args)


_MAKERS: dict[str, Callable[..., Expr]] = {
    "add": add, "sub": sub, "neg": neg, "mul": mul, "div": div, "if": conditional,
}  # fmt: skip


def postorder(*expressions: Expr) -> Iterator[Expr]:
    """All nodes of expressions, operands first, each once."""
    done: set[int] = set()
    ahead: list[tuple[Expr, bool]] = [(one, False) for one in reversed(expressions)]
    while ahead:
        one, ready = ahead.pop()
        if id(one) in done:
            continue
        if ready or one.op in ("num", "sym"):
            done.add(id(one))
            yield one
            continue
        ahead.append((one, True))
        ahead += [(arg, False) for arg in reversed(one.args) if isinstance(arg, Expr)]


def substituted(expression: Expr, by: Mapping[Expr, Expr], known: dict[int, Expr] | None = None) -> Expr:
    """An expression with symbols replaced.

    Args:
        known: nodes replaced before by the same mapping, by identity; is added to.
    """
    if not expression.free & by.keys():
        return expression
    made = {} if known is None else known
    for one in postorder(expression):
        if id(one) in made:
            continue
        if one.op == "sym":
            made[id(one)] = by.get(one, one)
        elif one.op == "num" or not one.free & by.keys():
            made[id(one)] = one
        else:
            made[id(one)] = rebuild(
                one.op, tuple(made[id(a)] if isinstance(a, Expr) else a for a in one.args)
            )
    return made[id(expression)]


def derivative(expression: Expr, seeds: Callable[[Expr], Expr], known: dict[int, Expr] | None = None) -> Expr:
    """The variation of an expression.

    Args:
        seeds: variation of a symbol.
        known: variations of nodes by the same seeds, by identity; is added to.
    Raises: NoDerivative for a function whose derivative is not known.
    """
    made = {} if known is None else known
    for one in postorder(expression):
        if id(one) not in made:
            made[id(one)] = seeds(one) if one.op == "sym" else _varied(one, made)
    return made[id(expression)]


def _varied(one: Expr, made: dict[int, Expr]) -> Expr:
    op, args = one.op, one.args
    if op in ("num", "and", "or", "not", *RELATIONS):
        return ZERO
    d = [made[id(a)] if isinstance(a, Expr) else ZERO for a in args]
    if all(a is ZERO for a in d):
        return ZERO
    match op:
        case "add":
            return add(d[0], d[1])
        case "sub":
            return sub(d[0], d[1])
        case "neg":
            return neg(d[0])
        case "mul":
            return add(mul(d[0], args[1]), mul(args[0], d[1]))
        case "div":
            return div(sub(d[0], mul(one, d[1])), args[1])
        case "if":
            return conditional(args[0], d[1], d[2])
        case "fn:pow":
            by_base = mul(mul(args[1], power(args[0], sub(args[1], ONE))), d[0])
            return by_base if d[1] is ZERO else add(by_base, mul(mul(one, function("log", args[0])), d[1]))
        case "fn:atan2":
            size = add(mul(args[0], args[0]), mul(args[1], args[1]))
            return div(sub(mul(args[1], d[0]), mul(args[0], d[1])), size)
        case "fn:fmin" | "fn:fmax":
            first = make("le" if op == "fn:fmin" else "ge", args[0], args[1])
            return conditional(first, d[0], d[1])
        case "fn:floor" | "fn:ceil" | "fn:trunc" | "fn:sign":
            return ZERO
    if (other := OTHERS.get(op.partition(":")[0])) is not None:
        return other.derived(one, d)
    if op in _SLOPES:
        return mul(_SLOPES[op](args[0], one), d[0])
    raise NoDerivative(f"{op.partition(':')[2]} has no derivative that can be written")


_SLOPES: dict[str, Callable[[Expr, Expr], Expr]] = {
    "fn:sin": lambda a, e: function("cos", a),
    "fn:cos": lambda a, e: neg(function("sin", a)),
    "fn:tan": lambda a, e: add(ONE, mul(e, e)),
    "fn:asin": lambda a, e: div(ONE, function("sqrt", sub(ONE, mul(a, a)))),
    "fn:acos": lambda a, e: div(MINUS_ONE, function("sqrt", sub(ONE, mul(a, a)))),
    "fn:atan": lambda a, e: div(ONE, add(ONE, mul(a, a))),
    "fn:sinh": lambda a, e: function("cosh", a),
    "fn:cosh": lambda a, e: function("sinh", a),
    "fn:tanh": lambda a, e: sub(ONE, mul(e, e)),
    "fn:exp": lambda a, e: e,
    "fn:log": lambda a, e: div(ONE, a),
    "fn:log10": lambda a, e: div(number(1 / math.log(10)), a),
    "fn:sqrt": lambda a, e: div(number(0.5), e),
    "fn:fabs": lambda a, e: function("sign", a),
}


def linear(expression: Expr, unknown: Expr) -> tuple[Expr, Expr] | None:
    """Factor and rest of an expression that is linear in an unknown; None if it is not."""
    if unknown not in expression.free:
        return ZERO, expression
    try:
        factor = derivative(expression, lambda one: ONE if one is unknown else ZERO)
    except NoDerivative:
        return None
    if unknown in factor.free:
        return None
    return factor, substituted(expression, {unknown: ZERO})


def evaluate(expression: Expr, values: Mapping[Expr, float]) -> float:
    """The number that an expression comes to.

    Args:
        values: of its symbols.
    Raises: KeyError for a symbol without a value; NoDerivative never; ValueError for what has no number.
    """
    found = substituted(expression, {one: number(values[one]) for one in expression.free})
    if found.op != "num":
        raise ValueError(f"{expression!r} has no value")
    return float(found.args[0])
