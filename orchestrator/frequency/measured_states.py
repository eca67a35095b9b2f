"""The linear equations of an FMU whose outputs are its state, from runs that start from changed values.

An FMU may declare no states, but let its outputs be set before initialisation, as positions and velocities.
Runs over one communication step that differ in one of them, or in one input, give the transition from sample
to sample, and its matrix logarithm the continuous equations. Runs that start later check that nothing else is
kept from step to step.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.linalg

from ..base.arrays import Array
from ..base.errors import OrchestratorError
from ..fmi import Initial, Kind, Point
from ..system.system import Instance
from .alone import Alone, step_all
from .measured_part import FIT
from .statespace import StateSpace

# Change of a start value or an input, relative to its value or nominal one.
_CHANGE = 1e-4
# Steps of the runs that compare a later start, and of those that compare half the change.
_STEPS, _PREDICTED = 8, 2
# Differences below this share of the value are rounding.
_ROUNDING = 1e-14


def start_outputs(one: Instance) -> tuple[str, ...]:
    """Real outputs of an instance that can be set before initialisation, exactly."""
    return tuple(
        each.name
        for each in one.fmu.description.outputs
        if each.kind is Kind.REAL and each.initial is Initial.EXACT and each.settable
    )


def from_start_values(at: Alone) -> tuple[StateSpace, float] | str:
    """The state space of an FMU whose outputs with start values are its state.

    Args: at: with values of `start_outputs`, too.
    Returns: the state space, and the largest relative error with which it predicts runs of two steps from
        half the changes; or why there is none.
    """
    runs = _Runs(at, start_outputs(at.one))
    try:
        # An effort has a start value, too, but each step calculates it.
        runs.keep([column for column in range(len(runs.states)) if runs.difference(column, 1.0, 1).any()])
        if not runs.goes_on():
            return "its outputs with start values do not determine how it goes on"
        states = runs.states
        n, m = len(states), len(at.inputs)
        whole = np.array([runs.difference(column, 1.0, 1)[0] for column in range(n + m)]).T
        longer = np.array([runs.difference(column, 0.5, _PREDICTED)[-1] for column in range(n + m)]).T
    except OrchestratorError as refused:
        return f"it cannot be started from changed values: {str(refused).splitlines()[0]}"
    transition, seen = whole[:n], whole[n:]
    if np.linalg.cond(transition[:, :n]) > 1e12:
        return "a step takes several start values to the same one: it has no continuous states"
    # Outputs are read at the end of the step, where the states have moved on.
    c = np.linalg.solve(transition[:, :n].T, seen[:, :n].T).T
    d = seen[:, n:] - c @ transition[:, n:]
    held = np.vstack([transition, np.eye(m, n + m, n)])
    made = scipy.linalg.logm(held)
    if np.max(abs(np.imag(made)), initial=0.0) > 1e-9 * np.max(abs(made), initial=0.0):
        return "it alternates from step to step: it has no continuous states"
    a_b = np.real(made)[:n] / at.step
    power = np.linalg.matrix_power(held, _PREDICTED)
    predicted = np.vstack([power[:n], c @ power[:n] + np.hstack([np.zeros_like(c), d])])
    error = runs.largest(predicted - longer, longer)
    if not error <= FIT:
        return f"runs from its start values differ by {100 * error:.2g} % from those of linear equations"
    return StateSpace(a_b[:, :n], a_b[:, n:], c, d, states, at.inputs, at.read), error


class _Runs:
    """Runs of one FMU on its own from changed start values and inputs."""

    def __init__(self, at: Alone, states: tuple[str, ...]) -> None:
        self.at, self.states = at, states
        self.keep(range(len(states)))

    def keep(self, columns: Iterable[int]) -> None:
        """Take some of the states only."""
        self.states = tuple(self.states[column] for column in columns)
        names = (*self.states, *self.at.inputs)
        self.point = np.array([float(self.at.values[name]) for name in names])
        nominal = [float(self.at.one.variable(name).nominal or 1.0) for name in names]
        self.heights = _CHANGE * np.maximum(abs(self.point), nominal)

    def course(self, at: Array, steps: int, begin: int = 0) -> Array:
        """States and outputs after each step from a point, shape (steps, n + p)."""
        n, found, step = len(self.states), [], self.at.step
        start = dict(zip((*self.states, *self.at.inputs), map(float, at), strict=True))
        names = (*self.states, *self.at.read)
        instance = self.at.started(self.at.begin + begin * step, start, at[n:].copy())
        try:
            for index in range(begin, begin + steps):
                if not step_all([instance], Point(index, self.at.begin + index * step, step)):
                    break
                known = instance.get_values([*dict.fromkeys(names)])
                found.append([float(known[name]) for name in names])
        finally:
            instance.free()
        return np.array(found)

    def goes_on(self) -> bool:
        """Whether a run that starts from what another has reached goes on as that does."""
        n = len(self.states)
        moved = self.point + self.heights
        whole = self.course(moved, _STEPS)
        rest = self.course(np.concatenate([whole[2, :n], moved[n:]]), _STEPS - 3, 3)
        size = np.maximum(np.max(abs(whole - whole[0]), axis=0), 1e-9 * np.max(abs(whole), axis=0))
        return bool(np.all(abs(rest - whole[3:]) <= FIT * size + _ROUNDING))

    def difference(self, column: int, share: float, steps: int) -> Array:
        """By how much states and outputs differ after each step per change of one state or input, shape
        (steps, n + p).
        """
        change = np.zeros(len(self.point))
        change[column] = share * self.heights[column]
        up, down = self.course(self.point + change, steps), self.course(self.point - change, steps)
        moved = up - down
        moved[abs(moved) < _ROUNDING * np.maximum(abs(up), abs(down))] = 0.0
        return moved / (2.0 * change[column])

    def largest(self, errors: Array, of: Array) -> float:
        """The largest error of a state or output, relative to what all changes make of it."""
        size = np.max(abs(of) * self.heights, axis=1, initial=0.0)
        size = np.where(size > 0.0, size, 1.0)
        return float(np.max(abs(errors) * self.heights / size[:, None], initial=0.0))
