"""Check a solved model against the flat equations: substitute the solution, require residuals of zero."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import casadi as ca

from orchestrator.base.errors import BuildError

from .flat import FlatModel, Literal, Node, Role, Type, Variable, render
from .interpreter import Value, derivative_key, evaluate
from .program import Program
from .sources import Location

TOLERANCE = 1e-9
"""Largest residual, relative to the largest number that its evaluation meets."""
POINTS = 40
_ATTEMPTS = 2000
_LEAST = 10
_MODE_ROUNDS = 20


@dataclass(frozen=True)
class CheckReport:
    """What the self-check looked at.

    Attributes:
        points: random points at which every equation was evaluated.
        largest_residual: relative, over all points and equations.
    """

    points: int
    largest_residual: float


class _Unusable(Exception):
    """The point lies where the model has no value, or no consistent set of modes."""


def check(program: Program, seed: int = 1) -> CheckReport:
    """Substitute the solution into every flat equation at random points.

    The yardstick knows nothing of CasADi: it evaluates the flat expressions by the names of variables,
    decides relations by their operands, and takes only the branch that applies.

    Args:
        program: the functions that C is generated from.
        seed: of the random numbers.
    Returns: the number of points and the largest residual.
    Raises: BuildError naming the equation whose residual is not zero, or if the model has values at too
        few points to compare.
    """
    flat = program.model.symbols.flat
    source = random.Random(seed)
    points = 0
    largest = 0.0
    worst: tuple[Location, Node, Node] | None = None
    for attempt in range(_ATTEMPTS):
        if points == POINTS:
            break
        try:
            values, delays, claims = _point(program, flat, source, attempt)
            residuals = [
                (_relative(left, right, values, delays), where, left, right) for left, right, where in claims
            ]
        except (_Unusable, ArithmeticError, ValueError):
            continue
        points += 1
        for residual, *claim in residuals:
            if residual > largest:
                largest, worst = residual, (claim[0], claim[1], claim[2])
    if points < _LEAST:
        raise BuildError(
            f"{flat.name}: the solution could be checked at {points} of {_ATTEMPTS} random points only: "
            "elsewhere a "
            "value is not finite (a division by zero, a singular set of equations); give start values and "
            "parameters at which the equations can be solved"
        )
    if worst is not None and largest > TOLERANCE:
        raise BuildError(
            f"{worst[0]}: self-check: the solution does not satisfy {render(worst[1])} = "
            f"{render(worst[2])}: relative residual "
            f"{largest:.3g}, "
            f"allowed {TOLERANCE:g}; this is an error of the translator"
        )
    return CheckReport(points, largest)


_Claim = tuple[Node, Node, Location]


def _point(
    program: Program, flat: FlatModel, source: random.Random, attempt: int
) -> tuple[dict[str, Value], dict, list[_Claim]]:
    """Values of every variable at a random point, and what has to be equal there."""
    model = program.model
    variables = {variable.name: variable for variable in flat.variables}
    values: dict[str, Value] = {"time": abs(_draw(source, 1.0, attempt))}
    for name in (*program.inputs, *program.states):
        values[name] = _random(variables[name], source, attempt)
    for name in program.parameters:
        if name not in program.dependent:
            values[name] = _parameter(variables[name], source, attempt, program)
    p = [float(values.get(name, 0.0)) for name in program.parameters]
    dependent = _vector(program.dependent_parameters(p))
    claims: list[_Claim] = []
    for name, value in zip(program.dependent, dependent, strict=True):
        values[name] = value
        p[program.parameters.index(name)] = value
        claims.append((Literal(value), variables[name].binding or Literal(0.0), variables[name].location))
    for name, value in zip(program.started, _vector(program.dependent_starts(p)), strict=True):
        claims.append((Literal(value), variables[name].start or Literal(0.0), variables[name].location))

    x, u = [float(values[name]) for name in program.states], [float(values[name]) for name in program.inputs]
    d = [_draw(source, 1.0, attempt) for _ in model.delays]
    modes = _modes(program, values["time"], x, u, p, d)
    point = (values["time"], x, u, p, d, modes)
    for name, value in zip(program.states, _vector(program.derivatives(*point)), strict=True):
        values[derivative_key(name)] = value
    for name, value in zip(program.algebraics, _vector(program.algebraic(*point)), strict=True):
        values[name] = value
    operands, times = (_vector(result) for result in program.delays(*point))
    delays = {delay.node: value for delay, value in zip(model.delays, d, strict=True)}
    for delay, operand, time in zip(model.delays, operands, times, strict=True):
        claims.append((Literal(operand), delay.node.operand, delay.node.location))
        claims.append((Literal(time), delay.node.time, delay.node.location))
    for assertion, value in zip(flat.assertions, _vector(program.assertions(*point)), strict=True):
        claims.append((Literal(value != 0), assertion.condition, assertion.location))
    claims.extend((equation.left, equation.right, equation.location) for equation in flat.equations)
    return values, delays, claims


def _relative(left: Node, right: Node, values: dict[str, Value], delays: dict) -> float:
    magnitude = [0.0]
    one = float(evaluate(left, values, delays, magnitude))
    other = float(evaluate(right, values, delays, magnitude))
    return 0.0 if one == other else abs(one - other) / magnitude[0]


def _modes(
    program: Program, time: Value, x: list[float], u: list[float], p: list[float], d: list[float]
) -> list[float]:
    relations = program.model.relations
    modes = [0.0] * len(relations)
    for _ in range(_MODE_ROUNDS):
        values = _vector(program.relations(time, x, u, p, d, modes))
        found = [
            float(value > 0 or (value == 0 and not relation.strict))
            for value, relation in zip(values, relations, strict=True)
        ]
        if found == modes:
            return modes
        modes = found
    raise _Unusable


def _vector(result: ca.DM) -> list[float]:
    values = result.full().ravel().tolist()
    if not all(map(math.isfinite, values)):
        raise _Unusable
    return values


def _parameter(variable: Variable, source: random.Random, attempt: int, program: Program) -> Value:
    constants = program.model.symbols.constants
    own = float(evaluate(variable.binding or Literal(0.0), constants))
    if variable.role is Role.CONSTANT:
        return own
    if variable.type is Type.REAL and own and source.random() < 0.7:
        return _within(variable, own * source.uniform(0.5, 2.0))
    return _random(variable, source, attempt)


def _random(variable: Variable, source: random.Random, attempt: int) -> Value:
    if variable.type is Type.BOOLEAN:
        return float(source.random() < 0.5)
    if variable.type is Type.INTEGER:
        return _within(variable, float(source.randint(-4, 4)))
    return _within(variable, _draw(source, variable.nominal or 1.0, attempt))


def _draw(source: random.Random, scale: float, attempt: int) -> float:
    """A number of either sign; its size changes from point to point, so that all branches are met."""
    return source.gauss(0.0, abs(scale) * (1.0, 1e-2, 1e2)[attempt % 3])


def _within(variable: Variable, value: float) -> float:
    low = -math.inf if variable.minimum is None else variable.minimum
    high = math.inf if variable.maximum is None else variable.maximum
    if low <= value <= high:
        return value
    # Mirrored at the limit, so that half of the points do not end up on it.
    mirrored = 2 * low - value if value < low else 2 * high - value
    return mirrored if low <= mirrored <= high else min(max(value, low), high)
