"""The order in which a model's equations are solved: aliases, index reduction, matching, blocks.

Index reduction is Pantelides' (SIAM J. Sci. Stat. Comput. 9, 1988). All states that the model declares stay
states; what the differentiated equations leave over are constraints, on which the solver projects after each
step (Ascher and Petzold, Computer Methods for Ordinary Differential Equations, 1998, section 10.2). So no
choice of states can become singular on the way.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from orchestrator.base.errors import BuildError, listed

from ..faults import PlacedError
from . import expression as ex
from .expression import Expr
from .initial import Check, initial_system, parameter_values, places_of
from .matching import Block, augmented, blocks_of, matched
from .model import DaeModel, Scalar
from .vanished import without_vanished

_HIGHEST_ORDER = 12


@dataclass
class System:
    """A model in the order of its solution.

    Attributes:
        model: with aliases replaced.
        states: symbols of the continuous states.
        blocks: give algebraic variables and derivatives from time, states, inputs and held values.
        initial_blocks: give these, the states and free parameters at the start.
        checks: what has to hold at the start.
        constraints: of the states; zero on every solution.
        aliases: variable -> what it equals.
        unknowns: symbols of the algebraic variables and derivatives.
        notes: for the author of the model.
    """

    model: DaeModel
    states: list[Expr]
    blocks: list[Block]
    initial_blocks: list[Block]
    checks: list[Check]
    constraints: list[Expr]
    aliases: dict[Expr, Expr]
    unknowns: list[Expr]
    notes: list[str]


def solve_order(model: DaeModel) -> System:
    """Find how a model is solved.

    Raises: BuildError for too few or too many equations, or an equation that cannot be differentiated, with
        the names of the variables concerned.
    """
    model = without_vanished(model)
    by_symbol = {one.value: one for one in model.variables}
    model, aliases = _without_aliases(model, by_symbol)
    states = [one.value for one in model.variables if one.role == "state"]
    algebraics = [
        one.value for one in model.variables if one.role == "algebraic" and one.value not in aliases
    ]
    _check_count(model, states, algebraics)
    ordered = _reduced(model, states, algebraics)
    known = set(states)
    unknowns = sorted(
        {one for equation in ordered for one in equation.free if _continuous(one, by_symbol)} - known,
        key=lambda one: (one.args[0] != "der", one.args[1:]),
    )
    for one in algebraics:
        if one not in unknowns:
            raise model.refusal(
                f"no equation determines {by_symbol[one].name}; add one that holds it", model.place_of(one)
            )
    parameters = parameter_values(model)
    owner = matched(ordered, set(unknowns), parameters)
    if missing := [one for one in unknowns if one not in owner]:
        names = listed(model.name_of(one) for one in missing)
        raise model.refusal(
            f"the equations do not determine {names}: some say the same or contradict each other",
            model.place_of(missing[0]),
        )
    used = set(owner.values())
    known_nodes: dict[int, Expr] = {}
    actual = [ex.substituted(one, {ex.symbol("homotopy"): ex.ONE}, known_nodes) for one in ordered]
    constraints = [equation for number, equation in enumerate(actual) if number not in used]
    blocks = blocks_of(actual, owner, parameters)
    notes = (
        [f"without a value, 0 until the importer sets one: {', '.join(model.valueless)}"]
        if model.valueless
        else []
    )
    notes += model.remarks
    if model.built_in:
        notes.append(f"built in, since tables depend on them: {', '.join(model.built_in)}")
    initial, checks = initial_system(model, ordered, states, unknowns, aliases, parameters, notes)
    return System(model, states, blocks, initial, checks, constraints, aliases, unknowns, notes)


def _continuous(one: Expr, by_symbol: dict[Expr, Scalar]) -> bool:
    return one.args[0] == "der" or (one in by_symbol and by_symbol[one].role in ("state", "algebraic"))


def _check_count(model: DaeModel, states: list[Expr], algebraics: list[Expr]) -> None:
    count, wanted = len(model.equations), len(states) + len(algebraics)
    if count != wanted:
        raise unbalanced(model, states, algebraics)


def unbalanced(model: DaeModel, states: Sequence[Expr], algebraics: Sequence[Expr]) -> BuildError:
    """What to say of a model whose numbers of equations and unknowns differ, by variables and places.

    Unknowns that no equation is left for, and equations that no unknown is left for, are found by matching
    (Dulmage and Mendelsohn's decomposition).
    """
    slopes = {ex.symbol("der", one.args[1], 1) for one in states}
    unknowns = slopes | set(algebraics)
    count = f"{len(model.equations)} equations for {len(unknowns)} unknowns"
    by_state = {one: model.name_of(one) for one in states}
    owner: dict[Expr, int] = {}
    surplus: list[int] = []
    for number in range(len(model.equations)):
        if not augmented(number, model.equations, unknowns, owner, set(), set()):
            surplus.append(number)
    origins = places_of(model.origins, model.equations)
    refusals = []
    for number in surplus:
        reached: set[int] = set()
        augmented(number, model.equations, unknowns, owner, reached, set())
        others = [str(one) for one in dict.fromkeys(origins[n] for n in sorted(reached - {number})) if one]
        names = listed(
            sorted({model.name_of(u) for n in reached for u in model.equations[n].free & unknowns}), 5
        )
        what = f"too many equations ({count}): this one is one too many"
        if names != "none":
            what += f" for {names}"
        elif known := sorted(by_state[one] for one in model.equations[number].free if one in by_state):
            what += f": the derivative of {listed(known, 5)} determines it already"
        else:
            what += ": it holds parameters and constants only"
        what += f", which {listed(others, 3)} determine already" if others else ""
        refusals.append(str(model.refusal(f"{what}; drop one of them", origins[number])))
    for one in sorted(unknowns - owner.keys(), key=lambda one: one.args[1:]):
        what = (
            f"too few equations ({count}): none is left that determines {model.name_of(one)}; add one, or "
            "declare it a parameter or an input"
        )
        refusals.append(str(model.refusal(what, model.place_of(one))))
    return PlacedError("\n".join(refusals))


# Aliases


def _without_aliases(model: DaeModel, by_symbol: dict[Expr, Scalar]) -> tuple[DaeModel, dict[Expr, Expr]]:
    """Take equations a = b and a = -b out, and replace one by the other in all others."""
    aliases: dict[Expr, Expr] = {}
    holders: dict[Expr, set[Expr]] = {}  # symbol -> aliases whose values hold it
    rest, origins = [], []
    for equation, origin in zip(model.equations, places_of(model.origins, model.equations), strict=True):
        now = ex.substituted(equation, aliases)
        found = _alias(now, by_symbol)
        if found is None:
            rest.append(now)
            origins.append(origin)
            continue
        variable, value = found
        by = {variable: value}
        for one in holders.pop(variable, ()):
            aliases[one] = ex.substituted(aliases[one], by)
            for held in aliases[one].free:
                holders.setdefault(held, set()).add(one)
        aliases[variable] = value
        for held in value.free:
            holders.setdefault(held, set()).add(variable)
    known: dict[int, Expr] = {}

    def replaced(one: Expr) -> Expr:
        return ex.substituted(one, aliases, known)

    if not aliases:
        return replace(model, origins=origins), aliases
    return replace(
        model,
        equations=[replaced(one) for one in rest],
        origins=origins,
        initial_equations=[replaced(one) for one in model.initial_equations],
        initial_values=[(one, replaced(value)) for one, value in model.initial_values],
        discretes=[
            replace(one, branches=tuple(replace(b, value=replaced(b.value)) for b in one.branches))
            for one in model.discretes
        ],
        actions=[
            replace(one, value=None if one.value is None else replaced(one.value)) for one in model.actions
        ],
        conditions=[
            replace(one, operands=tuple(replaced(o) if isinstance(o, Expr) else o for o in one.operands))
            for one in model.conditions
        ],
        modes=[replaced(one) for one in model.modes],
        delays=[replace(one, operand=replaced(one.operand)) for one in model.delays],
    ), aliases


def _alias(equation: Expr, by_symbol: dict[Expr, Scalar]) -> tuple[Expr, Expr] | None:
    if equation.op == "sub":
        a, b, sign = *equation.args, 1
    elif equation.op == "add":
        a, b, sign = *equation.args, -1
    elif equation.op in ("sym", "neg"):
        a, b, sign = equation if equation.op == "sym" else equation.args[0], ex.ZERO, 1
    else:
        return None
    if a.op == "num":
        a, b = b, a
    if a.op != "sym" or b.op not in ("sym", "num"):
        return None
    for variable, other in ((a, b), (b, a)):
        if variable.op == "sym" and variable in by_symbol and by_symbol[variable].role == "algebraic":
            return variable, other if sign > 0 else ex.neg(other)
    return None


# Index reduction


def _reduced(model: DaeModel, states: list[Expr], algebraics: list[Expr]) -> list[Expr]:
    """The equations and the derivatives of them that determine all derivatives of the states."""
    by_symbol = {one.value: one for one in model.variables}
    equations = list(model.equations)
    higher: dict[int, int] = {}  # equation -> its derivative
    raised: dict[Expr, Expr] = {one: ex.symbol("der", one.args[1], 1) for one in states}
    variables: list[Expr] = [*states, *raised.values(), *algebraics]

    def seeds(one: Expr) -> Expr:
        kind = one.args[0]
        if kind == "t":
            return ex.ONE
        if kind == "u":
            raise ex.NoDerivative(f"the input {by_symbol[one].name} would have to be differentiated")
        if kind == "delayed":
            raise ex.NoDerivative(f"{model.delays[one.args[1]].shown} would have to be differentiated")
        if not _continuous(one, by_symbol):
            return ex.ZERO
        return ex.symbol("der", one.args[1], one.args[2] + 1 if kind == "der" else 1)

    owner: dict[Expr, int] = {}
    highest = set(variables) - raised.keys()
    for number in range(len(model.equations)):
        current = number
        for _ in range(_HIGHEST_ORDER * len(equations) + 1):
            seen_equations: set[int] = set()
            seen: set[Expr] = set()
            if augmented(current, equations, highest, owner, seen_equations, seen):
                break
            if not seen and not (equations[current].free & set(variables)):
                raise model.refusal(
                    "an equation holds no unknown; a component whose connectors are not connected is no "
                    "complete model: build a model that uses it",
                    places_of(model.origins, model.equations)[number],
                )
            for one in sorted(seen, key=lambda one: (one.args[0] == "der", one.args[1:])):
                order = one.args[2] + 1 if one.args[0] == "der" else 1
                if order > _HIGHEST_ORDER:
                    raise _singular(model, seen)
                raised[one] = ex.symbol("der", one.args[1], order)
                variables.append(raised[one])
                highest.discard(one)
                highest.add(raised[one])
            for place in sorted(seen_equations):
                try:
                    made = ex.derivative(equations[place], seeds)
                except ex.NoDerivative as error:
                    origin = places_of(model.origins, model.equations)[number]
                    raise model.refusal(
                        f"index reduction differentiates this equation, but {error}; give the derivative as "
                        "a further input, or a state in between",
                        origin,
                    ) from None
                higher[place] = len(equations)
                equations.append(made)
            for one in seen:
                if one in owner:
                    owner[raised[one]] = higher[owner[one]]
            current = higher[current]
        else:
            raise _singular(model, seen)
    # Of each chain the last derivative, then the equation itself, then those between: what is left unmatched
    # is then as low as can be, and constrains the states alone. Of each kind those come first that are solved
    # for their unknowns without division or roots: a length follows from its components, not they from it.
    lasts = [n for n in range(len(equations)) if n not in higher]
    firsts = [n for n in range(len(model.equations)) if n in higher]
    between = [n for n in range(len(model.equations), len(equations)) if n in higher]
    known = set(states)

    def hardness(number: int) -> int:
        found = [
            ex.linear(equations[number], one)
            for one in equations[number].free - known
            if _continuous(one, by_symbol)
        ]
        plain = [one is not None and one[0].op == "num" for one in found]
        return 0 if all(plain) else 1 if any(plain) else 2

    order = (*lasts, *sorted(firsts, key=hardness), *sorted(between, key=hardness))
    return [equations[n] for n in order]


def _singular(model: DaeModel, seen: Iterable[Expr]) -> BuildError:
    names = sorted({model.name_of(one) for one in seen})
    place = next((p for p in map(model.place_of, sorted(seen, key=lambda one: one.args[1:])) if p), None)
    return model.refusal(
        f"the equations are structurally singular in {listed(names)}: some say the same or contradict each "
        "other",
        place,
    )
