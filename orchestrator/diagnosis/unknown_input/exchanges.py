"""Places where something may pass from one state of a component to another.

What leaves one state enters the other, over the capacity of each. The model's own derivatives show the
capacities, since what passes between two parts acts on both: pressures of a cylinder on the piston, which
displaces the oil of both; one body's heat on the other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.units import BASE_NAMES, UnitError, parse_unit
from .evaluation import NX, Kinds, Place, U, X, Y, capacities, put_at, slope
from .start_values import evaluate_at_start

Array = NDArray[np.float64]


def exchanges(model: Any) -> list[Place]:
    """Pairs of states of one component between which something may pass, by their unit and capacities.

    Args:
        model: a `StateModel`, which asks for them.
    """
    found = []
    evaluate_at_start(model)
    for c, row in enumerate(model.rows):
        units = [model.study.unit(model.states[k]) for k in model.states_of(row)]
        for first, second in combinations(range(len(units)), 2):
            if units[first] != units[second] or _moves(model, row, units[first]):
                continue
            # The second state itself, where the first one acts on it, or another variable that both act on.
            others = [(k, k) for k in range(row[NX]) if k not in (first, second)]
            for via in ((second, second), *others, *_ports(model, row)):
                size, ratio = _shares(row, first, second, via)
                if size > 0.0:
                    i, j = int(row[X]) + first, int(row[X]) + second
                    name = f"{model.states[i]} to {model.states[j]}"
                    found.append(Place(name, Kinds.EXCHANGE, c, i, j, via, size, ratio))
                    break
    return found


def _exponents(unit: str) -> Array:
    """Of base units; without radians, which a torque times a rotational speed has, and a power not.

    Raises: UnitError.
    """
    return np.array(
        [k for k, name in zip(parse_unit(unit).exponents, BASE_NAMES, strict=True) if name != "rad"], float
    )


def _moves(model: Any, row: Any, unit: str) -> bool:
    """Whether quantities of a unit are positions of a component, which has their speeds, too.

    Between positions nothing passes. Units that cannot be read count as such.
    """
    ports = [model.states[k] for k in model.states_of(row)]
    ports += [model.inputs[k] for k in model.inputs_of(row)]
    ports += [model.outputs[k] for k in model.outputs_of(row)]
    try:
        speed = _exponents(unit) - _exponents("s")
        return any(np.array_equal(speed, _exponents(model.study.unit(one))) for one in ports)
    except UnitError:
        return True


def _ports(model: Any, row: Any) -> Iterator[tuple[int, int]]:
    """Positions of inputs and outputs whose product is a power, as of a speed and a force."""
    for i in model.inputs_of(row):
        for k in model.outputs_of(row):
            units = [model.study.unit(one) for one in (model.inputs[i], model.outputs[k])]
            try:
                power = _exponents(units[0]) + _exponents(units[1])
            except UnitError:
                continue
            if np.array_equal(power, _exponents("W")):
                yield int(row[NX] + i - row[U]), int(row[NX] + k - row[Y])


def _shares(row: Any, first: int, second: int, via: tuple[int, int]) -> tuple[float, float]:
    """The first state's share of what passes, and the second one's over it, NaN if that changes with states.

    Returns: 0 for the share where `via` does not show the capacities.
    """
    moved, seen = via
    products = [slope(row, moved, k) * slope(row, k, seen) for k in (first, second)]
    if not products[0] * products[1] > 0.0:
        return 0.0, math.nan
    begin, end = capacities(row, first, second, moved, seen)
    elsewhere = []
    for k in range(row[NX]):
        value = put_at(row, k, 0.1, True)
        elsewhere.append(capacities(row, first, second, moved, seen))
        put_at(row, k, value, False)
    same = np.allclose(elsewhere, (begin, end), rtol=1e-5, atol=0.0)
    return float(begin), float(end / begin) if same else math.nan
