"""Which derivatives depend on which states: colours for differences, and the places of sparse factors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from . import expression as ex
from .structure import System

_SMALL = 16  # states; a dense matrix of less takes no longer
_FULL = 0.5  # share of entries from which a dense matrix takes no longer


@dataclass(frozen=True)
class Factors:
    """Entries of a matrix of the states and its factors by rows; see HybridFactors in hybrid.h."""

    order: list[int]
    starts: list[int]
    columns: list[int]
    diagonals: list[int]
    entries: list[int]


def columns_of(system: System) -> list[list[int]]:
    """For each state the derivatives that may depend on it."""
    sets = {state: 1 << number for number, state in enumerate(system.states)}
    for block in system.blocks:
        targets = [*block.unknowns, *(one for one, _ in block.inner)]
        values = [*block.residuals, *(value for _, value in block.inner)]
        if block.value is not None:
            values.append(block.value)
        reached = 0
        for one in ex.symbols(*values):
            reached |= sets.get(one, 0)
        sets |= dict.fromkeys(targets, reached)
    slopes = [sets[ex.symbol("der", state.args[1], 1)] for state in system.states]
    return [
        [row for row, reached in enumerate(slopes) if reached >> column & 1]
        for column in range(len(system.states))
    ]


def colours_of(columns: Sequence[Sequence[int]]) -> list[int]:
    """Numbers for columns, so that no two of one number have an entry in the same row."""
    colours = [0] * len(columns)
    taken: list[set[int]] = []  # rows of each colour
    for column in sorted(range(len(columns)), key=lambda one: -len(columns[one])):
        rows = set(columns[column])
        colour = next((n for n, one in enumerate(taken) if not one & rows), len(taken))
        if colour == len(taken):
            taken.append(set())
        taken[colour] |= rows
        colours[column] = colour
    return colours


def factors_of(columns: Sequence[Sequence[int]]) -> Factors | None:
    """Factors in the order of least degree; None where a dense matrix does as well."""
    n = len(columns)
    if n < _SMALL:
        return None
    near: list[set[int]] = [{k} for k in range(n)]
    for column, rows in enumerate(columns):
        for row in rows:
            near[row].add(column)
            near[column].add(row)
    left, order, reached, most = set(range(n)), [], {}, _FULL * n * n
    count = 0
    while left:
        pivot = min(left, key=lambda one: (len(near[one]), one))
        left.remove(pivot)
        rest = near[pivot] - {pivot}
        for one in rest:
            near[one] |= rest
            near[one].discard(pivot)
        order.append(pivot)
        reached[pivot] = rest
        count += 2 * len(rest) + 1
        if count > most:
            return None
    place = {state: number for number, state in enumerate(order)}
    rows_of: list[set[int]] = [{k} for k in range(n)]
    for state, rest in reached.items():
        for one in rest:
            rows_of[place[state]].add(place[one])
            rows_of[place[one]].add(place[state])
    starts, found, diagonals = [0], [], []
    where: dict[tuple[int, int], int] = {}
    for row in range(n):
        for column in sorted(rows_of[row]):
            where[row, column] = len(found)
            found.append(column)
        diagonals.append(where[row, row])
        starts.append(len(found))
    entries = [where[place[row], place[column]] for column, rows in enumerate(columns) for row in rows]
    return Factors(order, starts, found, diagonals, entries)
