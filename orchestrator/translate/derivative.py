"""Forward derivatives of CasADi expressions in which a branch that is not taken stays without effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import casadi as ca

_BINARY = 2


def forward(expressions: Sequence[ca.SX], seeds: Mapping[str, tuple[ca.SX, ca.SX]]) -> list[ca.SX]:
    """Differentiate scalar expressions along a direction.

    CasADi's own derivative of `if c then a else b` multiplies c with the derivative of a. Where that is
    infinite or no number (a/resolution at resolution = 0), so is the product, although the branch is not
    taken. Here the condition selects the derivative as it selects the value.

    Args:
        expressions: scalars.
        seeds: name -> (symbol, its variation); symbols that are not named do not vary.
    Returns: the variation of each expression.
    """
    if not expressions:
        return []
    free = ca.symvar(ca.vertcat(*expressions))
    variation = {symbol.element_hash(): seed for symbol, seed in seeds.values()}
    starts = [variation.get(symbol.element_hash(), ca.SX(0)) for symbol in free]
    function = ca.Function("expressions", free, [ca.densify(ca.vertcat(*expressions))])
    values: dict[int, ca.SX] = {}
    dots: dict[int, ca.SX] = {}
    results = [ca.SX(0)] * len(expressions)
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        inputs, outputs = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_INPUT:
            values[outputs[0]], dots[outputs[0]] = free[inputs[0]], starts[inputs[0]]
        elif operation == ca.OP_CONST:
            values[outputs[0]], dots[outputs[0]] = ca.SX(function.instruction_constant(k)), ca.SX(0)
        elif operation == ca.OP_OUTPUT:
            results[outputs[1]] = dots[inputs[0]]
        else:
            arguments = [values[i] for i in inputs]
            slopes = [dots[i] for i in inputs]
            # The result may go where an argument is kept: both are read above.
            dots[outputs[0]] = _dot(operation, arguments, slopes)
            values[outputs[0]] = _apply(operation, arguments)
    return results


def _apply(operation: int, arguments: Sequence[ca.SX]) -> ca.SX:
    if len(arguments) == _BINARY:
        return ca.SX.binary(operation, *arguments)
    return ca.SX.unary(operation, *arguments)


def _dot(operation: int, arguments: Sequence[ca.SX], slopes: Sequence[ca.SX]) -> ca.SX:
    if all(slope.is_zero() for slope in slopes):
        return ca.SX(0)
    if operation == ca.OP_IF_ELSE_ZERO:
        return ca.SX.binary(ca.OP_IF_ELSE_ZERO, arguments[0], slopes[1])
    symbols, partials = _partials(operation, len(arguments))
    values = ca.substitute(list(partials), list(symbols), list(arguments))
    total = ca.SX(0)
    for value, slope in zip(values, slopes, strict=True):
        if not slope.is_zero() and not value.is_zero():
            total += value * slope
    return total


@cache
def _partials(operation: int, count: int) -> tuple[tuple[ca.SX, ...], tuple[ca.SX, ...]]:
    symbols = tuple(ca.SX.sym(f"a{i}") for i in range(count))
    result = _apply(operation, symbols)
    return symbols, tuple(ca.densify(ca.jacobian(result, symbol)) for symbol in symbols)
