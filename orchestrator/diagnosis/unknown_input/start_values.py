"""Evaluate components at their start values and beside them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...base.units import measures
from .evaluation import NU, NX, X, acts_of, answer_at, evaluate, past_of, put_at

# Change of the first variable, of the second one twice as much, and so on.
_CHANGE = 1e-3
_TRAVELS = ("m", "rad")


def evaluate_at_start(model: Any) -> None:
    """Evaluate all components at their start values, which then stand where `slope` reads them."""
    acts, signals = acts_of((), None, model.study.interval)
    ext = np.array([float(model.study.prepared.system.start(one)) for one in model.fed])
    none, rate = np.zeros(0), np.zeros(len(model.states))
    u, y = np.zeros(len(model.inputs)), np.zeros(len(model.outputs))
    evaluate(
        model.rows, model.wiring, model.start, ext, model.nominal, 0.0, acts, 0.0, signals, none, none, u, y,
        rate, none, *past_of(acts, 0),
    )  # fmt: skip


def speeds_by_definition(model: Any) -> dict[int, int]:
    """States that are positions, each with the state of its component that its derivative is, its speed.

    No physics can be missing there, as in der(angle) = speed.

    Args:
        model: a `StateModel`, which asks for them.
    """
    evaluate_at_start(model)
    found = dict[int, int]()
    for row in model.rows:
        moved = range(row[NX] + row[NU])
        before = [put_at(row, k, _CHANGE * (k + 1), True) for k in moved]
        for k in range(row[NX]):
            for other in range(row[NX]):
                position, speed = (model.study.unit(model.states[row[X] + j]) for j in (k, other))
                moves = any(measures(position, [one]) and measures(speed, [f"{one}/s"]) for one in _TRAVELS)
                if moves and answer_at(row, k) == put_at(row, other, 0.0, True):
                    found[int(row[X] + k)] = int(row[X] + other)
        for k, value in zip(moved, before, strict=True):
            put_at(row, k, value, False)
    return found
