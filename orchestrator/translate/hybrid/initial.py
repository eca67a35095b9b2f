"""The system of equations that gives a model its start, and what it must agree with.

More equations than unknowns are no fault where they agree. The first that determine all unknowns are solved.
The rest are checked when the model is built, as far as their values are known then, and when the FMU starts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np

from orchestrator.base.errors import BuildError, listed

from ..faults import PlacedError
from ..sources import Location
from . import expression as ex
from .expression import Expr
from .matching import Block, blocks_of, matched
from .model import DaeModel

# How far a redundant equation may be off: start values are written with a few digits.
_RELATIVE, _ABSOLUTE, _ABSOLUTE_OF_SLOPES = 1e-4, 1e-9, 1e-6


@dataclass(frozen=True)
class Check:
    """What has to hold at the start: `holds` is not 0; `shown` names it."""

    holds: Expr
    shown: str


def places_of(origins: Sequence[Location | None], equations: Sequence[Expr]) -> list[Location | None]:
    """The places of equations; None for each where they are not known."""
    return list(origins) if len(origins) == len(equations) else [None] * len(equations)


def initial_system(
    model: DaeModel,
    ordered: list[Expr],
    states: list[Expr],
    unknowns: list[Expr],
    aliases: Mapping[Expr, Expr],
    parameters: Mapping[Expr, Expr],
    notes: list[str],
) -> tuple[list[Block], list[Check]]:
    """The blocks that give states, unknowns and free parameters at the start, and what then has to hold.

    Args:
        ordered: the model's equations and the derivatives that index reduction adds.
        parameters: as of `blocks_of`.
        notes: is added to.
    Raises: BuildError by variable for what is not determined, and for equations that contradict each other.
    """
    free = [one.value for one in model.variables if one.role == "free"]
    sought = {*states, *unknowns, *free}
    follow = []
    for one in model.variables:  # dependent parameters of free ones
        if one.role == "dependent" and one.binding is not None and one.binding.free & sought:
            sought.add(one.value)
            follow.append(ex.sub(one.value, one.binding))
    given = {target: value for target, value in model.initial_values if target in sought}
    # Of an alias the start value holds for what it equals.
    fixed = [one for one in model.variables if one.role in ("state", "algebraic") and one.fixed]
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
    owner = matched(equations, sought, parameters)
    used = set(owner.values())
    surplus = [n for n in range(begins, len(required) + len(starts)) if n not in used]
    if missing := [one for one in sorted(sought, key=lambda one: one.args[1:]) if one not in owner]:
        names = listed(model.name_of(one) for one in missing)
        what = f"initialisation does not determine {names}; give start values with fixed=true"
        raise model.refusal(what, model.place_of(missing[0]))
    blocks = blocks_of(equations, owner, parameters)
    values = _values(model, blocks, sought) if surplus else {}
    origins = places_of(model.initial_origins, model.initial_equations)
    origins += [model.place_of(one) for one in given]
    faults: list[str] = []
    checks: list[Check] = []
    for number in surplus:
        agrees = _agrees(equations[number])
        holds, gap = (ex.substituted(one, values) for one in (agrees, equations[number]))
        off = f"{abs(gap.args[0]):.6g}" if gap.op == "num" else "some amount"
        if is_start := number >= len(required):
            one = fixed[number - len(required)]
            place, shown = model.place_of(one.value), f"the start value of {one.name}"
            what = f"with them {shown} must not have fixed=true, since it is off by {off}; drop it"
        else:
            names = _shown(equations[number], model)
            place = origins[number - begins]
            at = f" of line {place.line}" if place else ""
            shown = f"the initial equation{at}{names}"
            what = (
                f"this one{names} is one too many, and the others leave it off by {off}; drop it or a "
                "fixed=true"
            )
        if holds is ex.ZERO:
            faults.append(str(model.refusal(f"too many initial equations: {what}", place)))
        elif holds is ex.ONE and is_start:
            notes.append(f"{shown} is not used, since others determine it")
        else:
            notes.append(f"{shown} is redundant: the FMU checks that it agrees with the others")
            checks.append(Check(agrees, shown))
    if faults:
        raise (PlacedError if any(model.declared) else BuildError)("\n".join(faults))
    taken = [one.name for k, one in enumerate(weak) if len(required) + len(starts) + k in used]
    if taken:
        notes.append(f"started at their start values, though not fixed: {', '.join(taken)}")
    return blocks, checks


def _agrees(equation: Expr) -> Expr:
    """Whether a redundant equation holds, but for rounding and for the digits of start values."""
    sides = equation.args if equation.op == "sub" else (equation,)
    largest = ex.ZERO
    for one in sides if len(sides) > 1 else ():
        largest = ex.function("fmax", largest, ex.function("fabs", one))
    size, slack = ex.ONE, _ABSOLUTE
    for one in sorted(equation.free, key=lambda one: (one.args[0], str(one.args[1:]))):
        if one.args[0] in ("v", "der"):
            size = ex.function("fmax", size, ex.function("fabs", one))
        if one.args[0] == "der":
            slack = _ABSOLUTE_OF_SLOPES
    allowed = ex.add(ex.mul(ex.number(_RELATIVE), largest), ex.mul(ex.number(slack), size))
    return ex.logical("le", ex.function("fabs", equation), allowed)


def parameter_values(model: DaeModel, sought: Set[Expr] = frozenset()) -> dict[Expr, Expr]:
    """Numbers of the parameters and start values as declared, by their symbols.

    Args:
        sought: dependent parameters that the start of the model gives.
    """
    found: dict[Expr, Expr] = {}
    pending: dict[Expr, Expr] = {}
    for one in model.variables:
        if one.type == "string" or one.role == "input":
            continue
        if one.role == "parameter":
            pending[one.value] = one.start
        elif one.role == "dependent" and one.binding is not None and one.value not in sought:
            pending[one.value] = one.binding
        pending[ex.symbol("start", one.value.args[1])] = one.start
    while pending:
        known = {key: ex.substituted(one, found) for key, one in pending.items()}
        known = {key: value for key, value in known.items() if value.op == "num"}
        if not known:
            break
        found |= known
        pending = {key: one for key, one in pending.items() if key not in known}
    return found


def _values(model: DaeModel, blocks: Sequence[Block], sought: set[Expr]) -> dict[Expr, Expr]:
    """What is known of the start when the model is built: its numbers by their symbols.

    Time, nonlinear systems, inputs and what events hold are not known then.
    """
    found = parameter_values(model, sought) | {ex.symbol("homotopy"): ex.ONE}
    for block in blocks:
        if block.value is not None:
            value = ex.substituted(block.value, found)
            if value.op == "num":
                found[block.unknowns[0]] = value
            continue
        found |= _linear_values(block, found)
    return found


def _linear_values(block: Block, known: Mapping[Expr, Expr]) -> dict[Expr, Expr]:
    """The solution of a linear block; empty where it is not known or not the only one."""
    if not block.linear or block.jacobian is None:
        return {}
    zero = dict.fromkeys(block.unknowns, ex.ZERO)
    rows = [[ex.substituted(one, known) for one in row] for row in block.jacobian]
    inner: dict[Expr, Expr] = {}
    for one, value in block.inner:
        inner[one] = ex.substituted(value, {**known, **inner})
    rest = [ex.substituted(one, {**known, **inner}) for one in block.residuals]
    rest = [ex.substituted(one, zero) for one in rest]
    if any(one.op != "num" for row in (*rows, rest) for one in row):
        return {}
    matrix = np.array([[one.args[0] for one in row] for row in rows])
    right = np.array([-one.args[0] for one in rest])
    if np.linalg.matrix_rank(matrix) < len(right):
        return {}
    solution = np.linalg.solve(matrix, right)
    found = {one: ex.number(value) for one, value in zip(block.unknowns, solution, strict=True)}
    for one, value in inner.items():
        found[one] = ex.substituted(value, found)
    return {one: value for one, value in found.items() if value.op == "num"}


def _shown(equation: Expr, model: DaeModel) -> str:
    of_model = {one.value for one in model.variables}
    names = sorted({model.name_of(one) for one in equation.free if one in of_model or one.args[0] == "der"})
    return f" for {listed(names, 5)}" if names else ""
