"""Places inside components: inputs in the equations of their models; see `translate.opened`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.units import known_unit
from .evaluation import NU, NX, NY, Kinds, Place, U, Y, answer_at, put_at
from .start_values import evaluate_at_start

Array = NDArray[np.float64]
# Parts by which states are moved to see whether an input acts the same elsewhere, and inputs to see how. A
# small step would show the rounding of large derivatives.
_MOVED, _STEP = 0.1, 1e-2
# Sine of the angle between two columns up to which they are parallel.
_PARALLEL = 1e-5


def inner_places(model: Any) -> list[Place]:
    """Inputs inside components that act as nothing else does: neither one derivative nor another input.

    Args:
        model: a `StateModel`, which asks for them.
    """
    if not model.study.openings:
        return []
    found = []
    evaluate_at_start(model)
    for c, row in enumerate(model.rows):
        shown = set(model.outputs_of(row))
        seen = [*range(row[NX]), *(row[NX] + k for k in range(row[NY]) if row[Y] + k in shown)]
        inputs = range(row[U], row[U] + row[NU])
        columns = dict(zip(inputs, _columns(row, seen), strict=True))
        taken = model.inputs_of(row)
        for i in inputs:
            if model.inputs[i] not in model.study.openings or _as_derivative(columns[i], row[NX]):
                continue
            same = [k for k in taken if _same_unit(model, i, k)]
            if not any(_parallel(columns[i].ravel(), columns[k].ravel()) for k in same):
                taken.append(i)
                found.append(Place(str(model.inputs[i]), Kinds.INPUT, c, i))
    return found


def _columns(row: Any, seen: list[int]) -> Array:
    """What each input of a component does to derivatives and outputs, at the start and beside it.

    Returns: shape (inputs, 2, seen).
    """
    here = _slopes(row, seen)
    before = [put_at(row, k, _MOVED, True) for k in range(row[NX])]
    beside = _slopes(row, seen)
    for k, value in enumerate(before):
        put_at(row, k, value, False)
    return np.stack([here, beside if np.isfinite(beside).all() else here], axis=1)


def _slopes(row: Any, seen: list[int]) -> Array:
    def answers() -> Array:
        return np.array([answer_at(row, one) for one in seen])

    first, found = answers(), []
    for i in range(row[NU]):
        value = put_at(row, row[NX] + i, _STEP, True)
        found.append((answers() - first) / (_STEP * max(1.0, abs(value))))
        put_at(row, row[NX] + i, value, False)
    return np.array(found).reshape(row[NU], len(seen))


def _as_derivative(column: Array, states: int) -> bool:
    """Whether an input acts on one derivative alone, by the same factor everywhere, or on none."""
    acts = np.abs(column).max(axis=0) > 0.0
    if not acts.any():
        return True
    same = np.allclose(column[0], column[1], rtol=1e-4, atol=0.0)
    return bool(acts[:states].sum() == 1 and not acts[states:].any() and same)


def _same_unit(model: Any, first: int, second: int) -> bool:
    units = (known_unit(model.study.unit(model.inputs[k])) for k in (first, second))
    one, other = units
    return one is None or other is None or one.same_dimension(other)


def _parallel(one: Array, other: Array) -> bool:
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    if size == 0.0:
        return False
    return bool(1.0 - (one @ other / size) ** 2 < _PARALLEL**2)
