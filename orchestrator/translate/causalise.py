"""Solve the equations of a model for its derivatives and algebraic variables, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter

import casadi as ca
import numpy as np

from orchestrator.base.errors import BuildError, listed

from .flat import (
    KINKED,
    RELATIONS,
    Delay,
    Derivative,
    Equation,
    If,
    Literal,
    Node,
    NoEvent,
    Operation,
    Reference,
    Type,
    walk,
)
from .symbolic import DelayOperator, Relation, SymbolicModel

_LINEAR = 1


@dataclass(frozen=True)
class SolvedModel:
    """A model whose every value is an expression in t, x, u, p, d and m.

    Attributes:
        symbols: the model's symbols and equations.
        derivatives, algebraics: name -> expression.
        delays: ordered so that entry j reads only earlier ones; operand and time as expressions.
        relations: with expressions.
        assertions: conditions, as expressions.
    """

    symbols: SymbolicModel
    derivatives: dict[str, ca.SX]
    algebraics: dict[str, ca.SX]
    delays: list[DelayOperator]
    relations: list[Relation]
    assertions: list[ca.SX]


def solve(model: SymbolicModel) -> SolvedModel:
    """Match equations to unknowns, sort them into blocks and solve each.

    Args:
        model: the symbols and equations.
    Returns: the solution; blocks of several equations are solved as linear systems.
    Raises: BuildError for a structurally singular model, a nonlinear loop or a delay that feeds its own
        operand, naming variables and lines.
    """
    unknowns = model.unknowns()
    names = list(unknowns)
    equations = model.flat.equations
    where = _incidence(equations, names)
    _check_count(model, names)
    matched = _match(model, names, where)
    solution: dict[str, ca.SX] = {}
    discrete = {one.name for one in model.flat.variables if one.type is not Type.REAL}
    named = {symbol.element_hash(): name for name, symbol in unknowns.items()}
    place: dict[str, int] = {}
    for block in _blocks(where, matched):
        targets = [names[matched[row]] for row in block]
        residuals = [model.residuals[row] for row in block]
        # Only what the equations hold: with all that is solved, the effort would grow with its square.
        held = {named.get(one.element_hash(), "") for one in ca.symvar(ca.vertcat(*residuals))}
        known = sorted(held & solution.keys(), key=place.__getitem__)
        if known:
            residuals = ca.substitute(
                residuals, [unknowns[name] for name in known], [solution[name] for name in known]
            )
        values = _solve_block(
            unknowns, discrete, [equations[row] for row in block], targets, residuals, solution
        )
        place.update((target, len(place) + number) for number, target in enumerate(targets))
        solution.update(zip(targets, values, strict=True))

    symbols, values = [unknowns[name] for name in solution], list(solution.values())

    def insert(expressions: Sequence[ca.SX]) -> list[ca.SX]:
        return ca.substitute(list(expressions), symbols, values) if expressions else []

    operands = insert([delay.operand for delay in model.delays])
    times = insert([delay.time for delay in model.delays])
    delays = [
        replace(delay, operand=operand, time=time)
        for delay, operand, time in zip(model.delays, operands, times, strict=True)
    ]
    expressions = insert([relation.expression for relation in model.relations])
    return SolvedModel(
        symbols=model,
        derivatives={name: solution[f"der({name})"] for name in model.derivatives},
        algebraics={name: solution[name] for name in model.algebraics},
        delays=_ordered(delays),
        relations=[
            replace(relation, expression=expression)
            for relation, expression in zip(model.relations, expressions, strict=True)
        ],
        assertions=insert(model.assertions),
    )


def _incidence(equations: Sequence[Equation], names: list[str]) -> list[list[int]]:
    """Per equation, the numbers of the unknowns that its value depends on at a fixed mode and past."""
    numbers = {name: i for i, name in enumerate(names)}
    result = []
    for equation in equations:
        found = {
            numbers[name]
            for side in (equation.left, equation.right)
            for name in _instant(side, True)
            if name in numbers
        }
        result.append(sorted(found))
    return result


def _instant(node: Node, events: bool) -> set[str]:
    """Printed names of the variables and derivatives that an expression reads, outside delays and modes."""
    match node:
        case Reference(name):
            return {name}
        case Derivative(name):
            return {f"der({name})"}
        case NoEvent(argument):
            return _instant(argument, False)
        case If(condition, value, otherwise):
            return _instant(condition, events) | _instant(value, events) | _instant(otherwise, events)
        case Operation(name, arguments) if not (events and (name in RELATIONS or name == "sign")):
            return set().union(*(_instant(argument, events) for argument in arguments))
        case _:
            return set()


def _check_count(model: SymbolicModel, names: list[str]) -> None:
    count = len(model.flat.equations)
    if count != len(names):
        held = {
            node.name
            for one in model.flat.equations
            for side in (one.left, one.right)
            for node in walk(side)
            if isinstance(node, Reference | Derivative)
        }
        unused = [one for one in model.flat.variables if one.name in names and one.name not in held]
        place = f"{unused[0].location}: " if unused else ""
        raise BuildError(
            f"{place}{model.flat.name}: {count} equations for {len(names)} unknowns; "
            + (
                f"no equation holds {listed(one.name for one in unused)}"
                if unused
                else f"unknowns: {listed(names)}"
            )
        )


def _match(model: SymbolicModel, names: list[str], incidence: list[list[int]]) -> np.ndarray:
    """For each equation, the number of the unknown it is solved for."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import maximum_bipartite_matching

    if not names:
        return np.zeros(0, dtype=int)
    rows = [row for row, columns in enumerate(incidence) for _ in columns]
    columns = [column for own in incidence for column in own]
    graph = coo_matrix(
        (np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(len(incidence), len(names))
    ).tocsr()
    matched = maximum_bipartite_matching(graph, perm_type="column")
    if (matched >= 0).all():
        return matched
    free = sorted(set(range(len(names))) - set(matched.tolist()))
    lost = [model.flat.equations[row].location for row in np.flatnonzero(matched < 0)]
    raise BuildError(
        f"{', '.join(map(str, lost))}: the model is structurally singular: no equation is left to determine "
        f"{listed(names[i] for i in free)}; an equation between states or inputs alone fixes no unknown "
        "(index reduction is not supported)"
    )


def _blocks(incidence: list[list[int]], matched: np.ndarray) -> list[list[int]]:
    """Strongly connected sets of equations, each after those it needs."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    owner = {int(column): row for row, column in enumerate(matched)}
    edges = [(row, owner[column]) for row, columns in enumerate(incidence) for column in columns]
    count = len(incidence)
    if not count:
        return []
    rows, columns = [a for a, _ in edges], [b for _, b in edges]
    graph = coo_matrix((np.ones(len(edges)), (rows, columns)), shape=(count, count))
    _, labels = connected_components(graph, directed=True, connection="strong")
    members: dict[int, list[int]] = {}
    for row, label in enumerate(labels.tolist()):
        members.setdefault(label, []).append(row)
    needs: dict[int, set[int]] = {label: set() for label in members}
    for row, other in edges:
        if labels[row] != labels[other]:
            needs[int(labels[row])].add(int(labels[other]))
    return [members[label] for label in TopologicalSorter(needs).static_order()]


def _solve_block(
    unknowns: dict[str, ca.SX],
    discrete: set[str],
    equations: Sequence[Equation],
    targets: list[str],
    residuals: list[ca.SX],
    solution: dict[str, ca.SX],
) -> list[ca.SX]:
    symbols = [unknowns[name] for name in targets]
    chosen = set(targets)
    if len(targets) == 1:
        explicit = _explicit(equations[0], targets[0])
        if explicit is not None:
            # residual = left - right with left = target: the right side, with known unknowns inserted.
            value = ca.substitute([residuals[0]], symbols, [ca.SX(0)])[0]
            return [value if explicit < 0 else -value]
    for equation in equations:
        if max(_degree(equation.left, chosen, True), _degree(equation.right, chosen, True)) > _LINEAR:
            raise BuildError(_nonlinear(equations, targets))
    if not chosen.isdisjoint(discrete):
        raise BuildError(
            f"{', '.join(str(equation.location) for equation in equations)}: cannot solve for "
            f"{listed(targets)}; "
            "write an equation of a Boolean or Integer as `variable = expression`, without loops"
        )
    matrix = ca.densify(ca.jacobian(ca.vertcat(*residuals), ca.vertcat(*symbols)))
    offset = ca.substitute(residuals, symbols, [ca.SX(0)] * len(symbols))
    if matrix.is_constant() and np.linalg.matrix_rank(ca.DM(matrix).full()) < len(targets):
        raise BuildError(
            f"{', '.join(str(equation.location) for equation in equations)}: the equations do not determine "
            f"{listed(targets)}: they say the same or contradict each other"
        )
    if len(symbols) == 1:
        return [-offset[0] / matrix]
    values = ca.solve(matrix, -ca.vertcat(*offset))
    return [values[i] for i in range(len(symbols))]


def _explicit(equation: Equation, target: str) -> int | None:
    """-1 if the right side, 1 if the left side is the target's value as it stands; else None."""
    for side, other, sign in ((equation.left, equation.right, 1), (equation.right, equation.left, -1)):
        named = {Reference(target)} if not target.startswith("der(") else {Derivative(target[4:-1])}
        if side in named and target not in _instant(other, True):
            return sign
    return None


def _degree(node: Node, unknowns: set[str], events: bool) -> int:
    """0: free of the unknowns, 1: linear in them, 2: nonlinear."""
    match node:
        case Literal() | Delay():
            return 0
        case Reference(name):
            return int(name in unknowns)
        case Derivative(name):
            return int(f"der({name})" in unknowns)
        case NoEvent(argument):
            return _degree(argument, unknowns, False)
        case If(condition, value, otherwise):
            if _degree(condition, unknowns, events):
                return 2
            return max(_degree(value, unknowns, events), _degree(otherwise, unknowns, events))
        case Operation(name, arguments):
            if events and name in RELATIONS | {"sign"}:
                return 0
            degrees = [_degree(argument, unknowns, events) for argument in arguments]
            if not any(degrees):
                return 0
            if name in ("+", "-", "negate") or (name in KINKED and events):
                return max(degrees)
            if name == "*":
                return min(2, sum(degrees))
            if name == "/" and not degrees[1]:
                return degrees[0]
            return 2
    return 2


def _nonlinear(equations: Sequence[Equation], targets: list[str]) -> str:
    if len(targets) == 1:
        return (
            f"{equations[0].location}: the equation is nonlinear in {targets[0]}, which is not supported; "
            f"write it as {targets[0]} = expression"
        )
    hops = []
    for equation, target in zip(equations, targets, strict=True):
        reads = (_instant(equation.left, True) | _instant(equation.right, True)) & set(targets) - {target}
        hops.append(f"  {equation.location}: {target} depends on {listed(sorted(reads))}")
    return (
        f"{equations[0].location}: nonlinear algebraic loop of {listed(targets)}, which is not supported\n"
        + "\n".join(hops)
        + "\n  Break it with a state (a small time constant) or a delay()."
    )


def _ordered(delays: list[DelayOperator]) -> list[DelayOperator]:
    numbers = {delay.symbol.element_hash(): i for i, delay in enumerate(delays)}
    needs = {
        i: {
            numbers[symbol.element_hash()]
            for symbol in ca.symvar(ca.vertcat(delay.operand, delay.time))
            if symbol.element_hash() in numbers
        }
        for i, delay in enumerate(delays)
    }
    try:
        return [delays[i] for i in TopologicalSorter(needs).static_order()]
    except CycleError as error:
        cycle = [delays[i].node.location for i in error.args[1]]
        raise BuildError(
            f"{cycle[0]}: the operand of this delay() depends on the delay's own value "
            f"({' <- '.join(dict.fromkeys(map(str, cycle)))}), a loop if the delay is zero; "
            "put a state between them"
        ) from None
