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
from orchestrator.base.graph import strong_components

from ..faults import PlacedError
from ..sources import Location
from . import expression as ex
from .dae import DaeModel, Scalar
from .expression import Expr

__all__ = ["Block", "System", "solve_order", "unbalanced"]

_HIGHEST_ORDER = 12


@dataclass(frozen=True)
class Block:
    """Equations that are solved together.

    Attributes:
        unknowns: symbols that are iterated; of one with `value` set, the equation is solved for it already.
        residuals: zero at the solution.
        inner: further unknowns in the order in which they follow from those that are iterated.
        jacobian: rows of derivatives of the residuals; None where they have to be found by differences.
        linear: whether the Jacobian holds no unknown.
    """

    unknowns: tuple[Expr, ...]
    residuals: tuple[Expr, ...]
    jacobian: tuple[tuple[Expr, ...], ...] | None = None
    linear: bool = False
    value: Expr | None = None
    inner: tuple[tuple[Expr, Expr], ...] = ()


@dataclass
class System:
    """A model in the order of its solution.

    Attributes:
        model: with aliases replaced.
        states: symbols of the continuous states.
        blocks: give algebraic variables and derivatives from time, states, inputs and held values.
        initial_blocks: give these, the states and free parameters at the start.
        constraints: of the states; zero on every solution.
        aliases: variable -> what it equals.
        unknowns: symbols of the algebraic variables and derivatives.
        notes: for the author of the model.
    """

    model: DaeModel
    states: list[Expr]
    blocks: list[Block]
    initial_blocks: list[Block]
    constraints: list[Expr]
    aliases: dict[Expr, Expr]
    unknowns: list[Expr]
    notes: list[str]


def solve_order(model: DaeModel) -> System:
    """Find how a model is solved.

    Raises: BuildError for too few or too many equations, or an equation that cannot be differentiated, with
        the names of the variables concerned.
    """
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
    owner = _matched(ordered, set(unknowns))
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
    blocks = _blocks(actual, owner)
    notes = (
        [f"without a value, 0 until the importer sets one: {', '.join(model.valueless)}"]
        if model.valueless
        else []
    )
    notes += model.remarks
    if model.built_in:
        notes.append(f"built in, since tables depend on them: {', '.join(model.built_in)}")
    initial = _initial(model, ordered, states, unknowns, by_symbol, aliases, notes)
    return System(model, states, blocks, initial, constraints, aliases, unknowns, notes)


def _continuous(one: Expr, by_symbol: dict[Expr, Scalar]) -> bool:
    return one.args[0] == "der" or (one in by_symbol and by_symbol[one].role in ("state", "algebraic"))


def _places(origins: Sequence[Location | None], equations: Sequence[Expr]) -> list[Location | None]:
    """The places of equations; None for each where they are not known."""
    return list(origins) if len(origins) == len(equations) else [None] * len(equations)


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
        if not _augment(number, model.equations, unknowns, owner, set(), set()):
            surplus.append(number)
    origins = _places(model.origins, model.equations)
    told = []
    for number in surplus:
        reached: set[int] = set()
        _augment(number, model.equations, unknowns, owner, reached, set())
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
        told.append(str(model.refusal(f"{what}; drop one of them", origins[number])))
    for one in sorted(unknowns - owner.keys(), key=lambda one: one.args[1:]):
        what = (
            f"too few equations ({count}): none is left that determines {model.name_of(one)}; add one, or "
            "declare it a parameter or an input"
        )
        told.append(str(model.refusal(what, model.place_of(one))))
    return PlacedError("\n".join(told))


# Aliases


def _without_aliases(model: DaeModel, by_symbol: dict[Expr, Scalar]) -> tuple[DaeModel, dict[Expr, Expr]]:
    """Take equations a = b and a = -b out, and replace one by the other in all others."""
    aliases: dict[Expr, Expr] = {}
    holders: dict[Expr, set[Expr]] = {}  # symbol -> aliases whose values hold it
    rest, origins = [], []
    for equation, origin in zip(model.equations, _places(model.origins, model.equations), strict=True):
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
            if _augment(current, equations, highest, owner, seen_equations, seen):
                break
            if not seen and not (equations[current].free & set(variables)):
                raise model.refusal(
                    "an equation holds no unknown; a component whose connectors are not connected is no "
                    "complete model: build a model that uses it",
                    _places(model.origins, model.equations)[number],
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
                    origin = _places(model.origins, model.equations)[number]
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
    # is then as low as can be, and constrains the states alone.
    lasts = [n for n in range(len(equations)) if n not in higher]
    firsts = [n for n in range(len(model.equations)) if n in higher]
    between = [n for n in range(len(model.equations), len(equations)) if n in higher]
    return [equations[n] for n in (*lasts, *firsts, *between)]


def _singular(model: DaeModel, seen: Iterable[Expr]) -> BuildError:
    names = sorted({model.name_of(one) for one in seen})
    place = next((p for p in map(model.place_of, sorted(seen, key=lambda one: one.args[1:])) if p), None)
    return model.refusal(
        f"the equations are structurally singular in {listed(names)}: some say the same or contradict each "
        "other",
        place,
    )


def _augment(
    start: int,
    equations: Sequence[Expr],
    allowed: set[Expr],
    owner: dict[Expr, int],
    seen_equations: set[int],
    seen: set[Expr],
) -> bool:
    """Match one more equation; False leaves in `seen` what was reached. Depth first, without recursion."""
    path: list[tuple[int, list[Expr], Expr | None]] = [(start, _ordered(equations[start], allowed), None)]
    seen_equations.add(start)
    while path:
        _, ahead, _ = path[-1]
        free = next((one for one in ahead if one not in owner and one not in seen), None)
        if free is not None:
            choice = free
            for number, _, came in reversed(path):
                owner[choice] = number
                if came is None:
                    return True
                choice = came
        while ahead:
            one = ahead.pop()
            if one not in seen:
                seen.add(one)
                other = owner[one]
                seen_equations.add(other)
                path.append((other, _ordered(equations[other], allowed), one))
                break
        else:
            path.pop()
    return False


def _ordered(equation: Expr, allowed: set[Expr]) -> list[Expr]:
    return sorted(equation.free & allowed, key=lambda one: (one.args[0] != "der", one.args[1:]))


def _matched(equations: Sequence[Expr], unknowns: set[Expr]) -> dict[Expr, int]:
    owner: dict[Expr, int] = {}
    for number in range(len(equations)):
        _augment(number, equations, unknowns, owner, set(), set())
    return owner


# Blocks


def _blocks(equations: Sequence[Expr], owner: dict[Expr, int]) -> list[Block]:
    unknown_of = {number: one for one, number in owner.items()}
    numbers = sorted(unknown_of)
    place = {number: position for position, number in enumerate(numbers)}
    needs = [
        sorted(place[owner[one]] for one in equations[number].free if one in owner and owner[one] != number)
        for number in numbers
    ]
    made = []
    for component in strong_components(needs):
        chosen = [numbers[one] for one in component]
        made.append(_block([equations[n] for n in chosen], [unknown_of[n] for n in chosen]))
    return made


def _block(residuals: list[Expr], unknowns: list[Expr]) -> Block:
    if len(unknowns) == 1:
        found = ex.linear(residuals[0], unknowns[0])
        if found is not None and found[0] is not ex.ZERO:
            factor, rest = found
            if factor.op == "num" or not _may_vanish(factor):
                return Block(tuple(unknowns), tuple(residuals), value=ex.neg(ex.div(rest, factor)))
    torn = _block_of(*_torn(residuals, unknowns))
    # Chains of nonlinear equations amplify what is wrong in a guess: there all unknowns are iterated.
    return torn if torn.linear or not torn.inner else _block_of(residuals, unknowns, ())


def _block_of(residuals: list[Expr], unknowns: list[Expr], inner: tuple[tuple[Expr, Expr], ...]) -> Block:
    """A block with its Jacobian."""
    try:
        rows: list[list[Expr]] = [[] for _ in residuals]
        for unknown in unknowns:
            known: dict[int, Expr] = {}
            by = {unknown: ex.ONE}
            for one, value in inner:
                by[one] = ex.derivative(value, lambda other, by=by: by.get(other, ex.ZERO), known)
            for row, residual in zip(rows, residuals, strict=True):
                row.append(ex.derivative(residual, lambda other, by=by: by.get(other, ex.ZERO), known))
    except ex.NoDerivative:
        return Block(tuple(unknowns), tuple(residuals), inner=inner)
    sought = {*unknowns, *(one for one, _ in inner)}
    linear = not any(one.free & sought for row in rows for one in row)
    return Block(tuple(unknowns), tuple(residuals), tuple(map(tuple, rows)), linear, inner=inner)


def _torn(
    residuals: list[Expr], unknowns: list[Expr]
) -> tuple[list[Expr], list[Expr], tuple[tuple[Expr, Expr], ...]]:
    """Split a block: residuals and unknowns that are iterated, and those that follow from them (tearing).

    An unknown follows from an equation that is linear in it, with a factor of numbers and parameters.
    """
    if len(unknowns) < 3:
        return residuals, unknowns, ()
    left = dict(enumerate(residuals))
    holds = {number: set(one.free) & set(unknowns) for number, one in left.items()}
    where: dict[Expr, set[int]] = {one: {n for n, found in holds.items() if one in found} for one in unknowns}
    open_unknowns, iterated = set(unknowns), []
    inner: list[tuple[Expr, Expr]] = []
    ready = sorted(n for n, found in holds.items() if len(found) == 1)

    def settle(one: Expr) -> None:
        open_unknowns.discard(one)
        for number in sorted(where[one]):
            if number in left:
                holds[number].discard(one)
                if len(holds[number]) == 1:
                    ready.append(number)

    while open_unknowns:
        found = None
        while ready and found is None:
            number = ready.pop(0)
            if number not in left or len(holds[number]) != 1:
                continue
            (one,) = holds[number]
            solved = ex.linear(left[number], one)
            if solved and solved[0] is not ex.ZERO and all(f.args[0] == "p" for f in solved[0].free):
                if not _may_vanish(solved[0]):
                    found = one, ex.neg(ex.div(solved[1], solved[0]))
        if found:
            del left[number]
            inner.append(found)
            settle(found[0])
            continue
        one = max(
            sorted(open_unknowns, key=lambda one: (one.args[0], one.args[1:])),
            key=lambda one: sum(n in left for n in where[one]),
        )
        iterated.append(one)
        settle(one)
    return list(left.values()), iterated, tuple(inner)


def _may_vanish(factor: Expr) -> bool:
    """Whether a factor may be zero for more than single values: by a condition."""
    return any(one.op == "if" for one in ex.postorder(factor))


# Initialisation


def _initial(
    model: DaeModel,
    ordered: list[Expr],
    states: list[Expr],
    unknowns: list[Expr],
    by_symbol: dict[Expr, Scalar],
    aliases: dict[Expr, Expr],
    notes: list[str],
) -> list[Block]:
    free = [one.value for one in model.variables if one.role == "free"]
    sought = {*states, *unknowns, *free}
    follow = []
    for one in model.variables:  # dependent parameters of free ones
        if one.role == "dependent" and one.binding is not None and one.binding.free & sought:
            sought.add(one.value)
            follow.append(ex.sub(one.value, one.binding))
    given = {target: value for target, value in model.initial_values if target in sought}
    # Of an alias the start value holds for what it equals.
    fixed = [
        one
        for one in model.variables
        if one.role in ("state", "algebraic")
        and one.fixed
        and {one.value, *aliases.get(one.value, one.value).free} & sought
    ]
    starts = [
        ex.sub(aliases.get(one.value, one.value), ex.symbol("start", one.value.args[1])) for one in fixed
    ]
    weak = [one for one in model.variables if one.role == "state" and not one.fixed]
    weak += [one for one in model.variables if one.role == "free"]
    required = [*ordered, *follow, *model.initial_equations, *(ex.sub(a, b) for a, b in given.items())]
    begins = len(ordered) + len(follow)
    equations = [
        *required,
        *starts,
        *(ex.sub(one.value, ex.symbol("start", one.value.args[1])) for one in weak),
    ]
    # At the start a delayed value is the present one.
    now = {ex.symbol("delayed", k): one.operand for k, one in enumerate(model.delays)}
    for _ in now:  # one may delay another
        equations = [ex.substituted(one, now) for one in equations]
    owner: dict[Expr, int] = {}
    told: list[str] = []
    origins = [*_places(model.initial_origins, model.initial_equations), *(model.place_of(a) for a in given)]
    for number, equation in enumerate(equations):
        if _augment(number, equations, sought, owner, set(), set()) or number < begins:
            continue
        if number < len(required):
            names = _shown(equation, by_symbol, model)
            what = f"too many initial equations: this one{names} is one too many; drop it or a fixed=true"
            told.append(str(model.refusal(what, origins[number - begins])))
        elif number < len(required) + len(starts):
            one = fixed[number - len(required)]
            if model.initial_equations:
                what = (
                    f"too many initial equations: with them the start value of {one.name} must not have "
                    "fixed=true; drop it"
                )
                told.append(str(model.refusal(what, model.place_of(one.value))))
                continue
            notes.append(f"the start value of {one.name} is not used, since others determine {one.name}")
    if missing := [one for one in sorted(sought, key=lambda one: one.args[1:]) if one not in owner]:
        names = listed(model.name_of(one) for one in missing)
        what = f"initialisation does not determine {names}; give start values with fixed=true"
        told.append(str(model.refusal(what, model.place_of(missing[0]))))
    if told:
        raise (PlacedError if any(model.declared) else BuildError)("\n".join(told))
    used = set(owner.values())
    taken = [one.name for k, one in enumerate(weak) if len(required) + len(starts) + k in used]
    if taken:
        notes.append(f"started at their start values, though not fixed: {', '.join(taken)}")
    return _blocks(equations, owner)


def _shown(equation: Expr, by_symbol: dict[Expr, Scalar], model: DaeModel) -> str:
    names = sorted({model.name_of(one) for one in equation.free if one in by_symbol or one.args[0] == "der"})
    return f" for {listed(names, 5)}" if names else ""
