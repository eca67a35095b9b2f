"""Derivatives that only built-in parameters of value 0 multiply, as those of a capacitor of 0 F.

Such a variable is no state: what the derivative leaves behind is an algebraic equation for it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from . import expression as ex
from .expression import Expr
from .initial import parameter_values
from .model import DaeModel


def without_vanished(model: DaeModel) -> DaeModel:
    """The model with such parameters as numbers; their variables become algebraic (changed in place)."""
    dependent = [one for one in model.variables if one.role == "dependent"]
    built_in = parameter_values(replace(model, variables=dependent))
    zeros = {one: ex.ZERO for one, value in built_in.items() if one.args[0] == "p" and value is ex.ZERO}
    if not zeros:
        return model
    gone = _slopes(model.equations) - _left(model, zeros)
    if not gone or gone & _slopes(model.initial_equations):
        return model
    for one in model.variables:
        if one.role == "state" and ex.symbol("der", one.value.args[1], 1) in gone:
            one.role = "algebraic"
    return replace(model, equations=[ex.substituted(one, zeros) for one in model.equations])


def _slopes(equations: Iterable[Expr]) -> set[Expr]:
    return {symbol for one in equations for symbol in one.free if symbol.args[0] == "der"}


def _left(model: DaeModel, zeros: dict[Expr, Expr]) -> set[Expr]:
    """The derivatives that stand in the equations where these are 0, and with them what equals 0 then."""
    algebraic = {one.value for one in model.variables if one.role == "algebraic"}
    equations, now = model.equations, zeros
    while now:
        equations = [ex.substituted(one, now) for one in equations]
        bare = (one.args[0] if one.op == "neg" else one for one in equations)
        now = {one: ex.ZERO for one in bare if one in algebraic}
    return _slopes(equations)
