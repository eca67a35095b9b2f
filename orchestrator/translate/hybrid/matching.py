"""Which equation determines which unknown, and the blocks of equations that are solved together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from orchestrator.base.graph import strong_components

from . import expression as ex
from .expression import Expr


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


def augmented(
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


def matched(
    equations: Sequence[Expr], unknowns: set[Expr], parameters: Mapping[Expr, Expr]
) -> dict[Expr, int]:
    """The number of the equation that determines each unknown, of as many as can be.

    Where it can be done, no equation determines what one of its parameters multiplies that is 0, as two of
    the three components of an axis are. Earlier equations come first.

    Args:
        parameters: their numbers, by symbols.
    """
    zeros = {one: value for one, value in parameters.items() if value is ex.ZERO}
    known: dict[int, Expr] = {}
    owner: dict[Expr, int] = {}
    for tried in ([ex.substituted(one, zeros, known) for one in equations], equations):
        owner = {}
        for number in range(len(equations)):
            augmented(number, tried, unknowns, owner, set(), set())
        if len(owner) == len(unknowns):
            break
    return owner


# Blocks


def blocks_of(
    equations: Sequence[Expr], owner: dict[Expr, int], parameters: Mapping[Expr, Expr]
) -> list[Block]:
    """The blocks in the order of their solution.

    Args:
        owner: as of `matched`.
        parameters: their numbers, by symbols: no equation is solved for what one multiplies that is 0.
    """
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
        made.append(_block([equations[n] for n in chosen], [unknown_of[n] for n in chosen], parameters))
    return made


def _block(residuals: list[Expr], unknowns: list[Expr], parameters: Mapping[Expr, Expr]) -> Block:
    if len(unknowns) == 1:
        found = ex.linear(residuals[0], unknowns[0])
        if found is not None and found[0] is not ex.ZERO:
            factor, rest = found
            if factor.op == "num" or not _may_vanish(factor, parameters):
                return Block(tuple(unknowns), tuple(residuals), value=ex.neg(ex.div(rest, factor)))
    torn = _block_of(*_torn(residuals, unknowns, parameters))
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
    residuals: list[Expr], unknowns: list[Expr], parameters: Mapping[Expr, Expr]
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
                if not _may_vanish(solved[0], parameters):
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


def _may_vanish(factor: Expr, parameters: Mapping[Expr, Expr]) -> bool:
    """Whether a factor may be zero for more than single values: by a condition or its parameters."""
    value = ex.substituted(factor, parameters)
    if value.op == "num" and abs(value.args[0]) < 1e-12:
        return True
    return any(one.op == "if" for one in ex.postorder(factor))
