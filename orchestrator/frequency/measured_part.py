"""The linear equations of an FMU without directional derivatives, from how it answers steps of its inputs.

Two runs that differ in a step of one input differ by its step response. Their differences from sample to
sample are Markov parameters, and Ho and Kalman's method (Kung, Asilomar Conf. 12, 1978) gives the states
behind them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ..base.errors import OrchestratorError
from ..fmi import FmuInstance, Point
from ..simulation.run import Prepared
from ..system.system import Instance
from .statespace import StateSpace
from .twin_runs import step_all

__all__ = [
    "FIT",
    "answer",
    "continuous",
    "differences",
    "height_of",
    "measured_part",
    "passage",
    "realised",
    "scaled",
]

Array = NDArray[np.float64]

# Height of a step, relative to the input's value or its nominal one.
_HEIGHT = 1e-3
# Shares of it that are tried in turn, as long as the FMU refuses the step.
_SMALLER = (1.0, 0.1, 0.01)
_SAMPLES = 48
# Steps before the input's; the check by half its height takes twice as many, to see what depends on time.
_SETTLE = 16
# Singular values below this share of the largest are no states; the model has to fit this well.
_RANK = 1e-7
FIT = 1e-2
_ROUNDING = 1e-13


def height_of(one: Instance, name: str, values: Mapping[str, Any]) -> float:
    """Height of a step of an input, FMU's unit."""
    return _HEIGHT * (abs(float(values[name])) or float(one.variable(name).nominal or 1.0))


def answer(
    one: Instance,
    name: str,
    values: Mapping[str, Any],
    watched: Sequence[str],
    prepared: Prepared,
    steps: int,
    moves: int,
    share: float = 1.0,
    settle: int = 0,
    fine: int = 1,
) -> Array:
    """By how much variables of two runs of one FMU differ that differ in a step of an input.

    Args:
        name: the input; values: of all connected inputs at the operating point, FMU's units.
        steps: most steps; moves: how many are taken after the first difference.
        share: of the usual height of the step, which becomes smaller if the FMU refuses it.
        settle: steps before it, which the result leaves out.
        fine: steps in a communication step.
    Returns: shape (steps + 1, watched), relative to the height.
    Raises: StepError if the FMU refuses to run on its own.
    """
    for smaller in _SMALLER:
        height = share * smaller * height_of(one, name, values)
        courses = [np.array([height if index >= settle else 0.0]) for index in range(settle + steps)]
        found: list[Array] = []
        moved = 0
        try:
            runs = differences(one, [name], values, watched, prepared, courses, fine)
            for index, one_difference in enumerate(runs):
                if index < settle:
                    continue
                found.append(one_difference / height)
                moved += bool(index > settle and np.max(abs(found[-1]), initial=0.0) > 0.0)
                if moved > moves:
                    break
            break
        except OrchestratorError:
            if smaller == _SMALLER[-1]:
                raise
    made = np.array(found or [np.zeros(len(watched))])
    size = np.max(abs(made), axis=0)
    made[:, size < 1e-12 * np.max(size, initial=0.0)] = 0.0
    return made


def differences(
    one: Instance,
    names: Sequence[str],
    values: Mapping[str, Any],
    watched: Sequence[str],
    prepared: Prepared,
    deviations: Iterable[Array],
    fine: float = 1,
) -> Iterator[Array]:
    """By how much variables of two runs of one FMU differ, at the start and after each step.

    Args:
        names: inputs that differ; values: of all connected inputs at the operating point, FMU's units.
        deviations: by how much they differ over each step, shape (names,).
        fine: steps in a communication step.
    Yields: shape (watched,); fewer than there are deviations if the FMU ends.
    Raises: StepError if the FMU refuses to run on its own.
    """
    begin, step = float(prepared.grid.start), float(prepared.grid.step_size) / fine
    still = np.array([float(values[name]) for name in names])
    inputs = [still.copy() for _ in range(2)]
    instances: list[FmuInstance] = []
    courses = list(deviations)
    try:
        for u in inputs:
            instance = one.fmu.instantiate(f"{one.name} linearised")
            instances.append(instance)
            instance.bind(list(names), u, [], np.zeros(0))
            # On its own it may run longer than the system.
            instance.enter_initialisation(begin, {**one.start, **values}, begin + (len(courses) + 1) * step)
            instance.exit_initialisation()

        def difference() -> Array:
            fixed, changed = (
                np.array([float(value) for value in instance.get_values(watched).values()])
                for instance in instances
            )
            moved = changed - fixed
            # What rounding makes is no answer.
            return np.where(abs(moved) > _ROUNDING * abs(fixed), moved, 0.0)

        yield difference()
        for index, more in enumerate(courses):
            inputs[1][:] = still + more
            if not step_all(instances, Point(index, begin + index * step, step)):
                return
            yield difference()
    finally:
        for instance in instances:
            instance.free()


def passage(
    one: Instance, name: str, values: Mapping[str, Any], output: str, prepared: Prepared, low: float
) -> float:
    """When a step of an input reaches an output, known to lie within a step after `low` [s]."""
    begin, step = float(prepared.grid.start), float(prepared.grid.step_size)
    height = height_of(one, name, values)

    def reached(time: float) -> bool:
        ends = []
        for more in (0.0, height):
            instance = one.fmu.instantiate(f"{one.name} linearised")
            try:
                instance.bind([name], np.array([float(values[name]) + more]), [], np.zeros(0))
                instance.enter_initialisation(begin, {**one.start, **values}, None)
                instance.exit_initialisation()
                instance.write_inputs()
                whole = int(low / step + 0.5)
                for index in range(whole):
                    instance.do_step(Point(index, begin + index * step, step))
                instance.do_step(Point(whole, begin + whole * step, time - whole * step))
                ends.append(float(instance.get_values([output])[output]))
            finally:
                instance.free()
        return ends[0] != ends[1]

    early, late = low, low + step
    while late - early > 1e-7 * step:
        middle = 0.5 * (early + late)
        early, late = (early, middle) if reached(middle) else (middle, late)
    return late


def measured_part(
    one: Instance,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    values: Mapping[str, Any],
    prepared: Prepared,
) -> tuple[StateSpace, dict[str, float], float] | str:
    """The state space of an FMU from its step responses, sampled at the communication step.

    A delay is found in whole steps. FMUs that are not linear or depend on time answer half the step, given
    later, differently: that is in the error.

    Args: inputs, outputs: connected ones; values: of the inputs at the operating point, FMU's units.
    Returns: the state space, delay of inputs by name [s], and the relative error of its step responses; or
        why
        there is none.
    """
    step = float(prepared.grid.step_size)
    try:
        # What initialises itself at the first step would take the input's step for its start value.
        common = (values, outputs, prepared, _SAMPLES, _SAMPLES)
        steps = [answer(one, name, *common, settle=_SETTLE) for name in inputs]
        halves = [answer(one, name, *common, 0.5, 2 * _SETTLE) for name in inputs]
    except OrchestratorError as error:
        return f"it cannot be run on its own to measure its response: {str(error).splitlines()[0]}"
    length = min((len(found) for found in (*steps, *halves)), default=_SAMPLES + 1)
    if length < 12:
        return "it ends before its response is measured"
    # Shape (samples, outputs, inputs).
    response = np.moveaxis(np.array([found[:length] for found in steps]), 0, 2) if inputs else np.zeros(0)
    other = np.moveaxis(np.array([found[:length] for found in halves]), 0, 2) if inputs else np.zeros(0)
    size = abs(response).max(axis=0, initial=0.0) if inputs else np.zeros((len(outputs), 0))
    late, shifted = {}, np.zeros_like(response)
    for column, name in enumerate(inputs):
        moved = np.flatnonzero((abs(response[:, :, column]) > 1e-9 * size[:, column]).any(axis=1))
        whole = int(moved[0]) - 1 if moved.size else 0
        whole = max(whole, 0) if whole < length - 12 else 0
        if whole:
            late[name] = whole * step
        shifted[: length - whole, :, column] = response[whole:, :, column]
        shifted[length - whole :, :, column] = response[-1, :, column]
    length -= max((round(delay / step) for delay in late.values()), default=0)
    space = _realised(shifted[:length], step, inputs, outputs)
    if isinstance(space, str):
        return space
    scale = np.where(size > 0.0, size, 1.0)
    made = _steps(space, length, step)
    shifted_other = np.zeros_like(other)
    for column, name in enumerate(inputs):
        whole = round(late.get(name, 0.0) / step)
        shifted_other[: len(other) - whole, :, column] = other[whole:, :, column]
    error = max(
        (float(np.max(abs(made - one[:length]) / scale)) for one in (shifted, shifted_other) if one.size),
        default=0.0,
    )
    if not error <= FIT:
        return f"its measured response differs by {100 * error:.2g} % from any linear one without samples"
    return space, late, error


def scaled(markov: Array) -> tuple[Array, Array, Array]:
    """Markov parameters, shape (samples, outputs, inputs), in units that make all channels alike; rows' and
    columns' units.
    """
    rows, columns = np.max(abs(markov), axis=(0, 2)), np.max(abs(markov), axis=(0, 1))
    rows, columns = np.where(rows > 0.0, rows, 1.0), np.where(columns > 0.0, columns, 1.0)
    return markov / rows[:, None] / columns, rows, columns


def realised(markov: Array, scale: float) -> tuple[Array, Array, Array] | None:
    """A, B and C with C A^k B the Markov parameter k; None if there are as many states as samples allow.

    Args: markov: shape (samples, outputs, inputs); scale: what they are small against.
    """
    half, (p, m) = len(markov) // 2, markov.shape[1:]
    hankel = np.block([[markov[i + j] for j in range(half)] for i in range(half)])
    left, values, right = np.linalg.svd(hankel)
    order = int(np.sum(values > _RANK * max(values[0], scale))) if values[0] > 1e-9 * scale else 0
    if order >= half - 1:
        return None
    root = np.sqrt(values[:order])
    seen, reached = left[:, :order] * root, root[:, None] * right[:order]
    shift, *_ = np.linalg.lstsq(seen[:-p], seen[p:], rcond=None)
    return shift, reached[:, :m], seen[:p]


def continuous(shift: Array, reached: Array, step: float) -> tuple[Array, Array, Array] | str:
    """x' = A x + B u behind x+ = shift x + reached u for inputs that are held from sample to sample.

    Returns: A, B, and what an input adds to the states over the sample at whose end it is first seen; or why
        there are none.
    """
    order, m = reached.shape
    if not order:
        return shift, reached, reached
    poles = np.linalg.eigvals(shift)
    if min(abs(poles)) < 1e-3:
        return "it samples, or its response is no linear one: it has no continuous states"
    if np.any((abs(poles.imag) < 1e-9) & (poles.real < 0.0)):
        return "it alternates from step to step: it has no continuous states"
    held = np.linalg.solve(shift, reached)
    whole = np.eye(order + m)
    whole[:order, :order], whole[:order, order:] = shift, held
    made = np.real(scipy.linalg.logm(whole)) / step
    return made[:order, :order], made[:order, order:], held


def _realised(
    response: Array, step: float, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> StateSpace | str:
    """States behind step responses, shape (samples, outputs, inputs)."""
    p, m = len(outputs), len(inputs)
    if not p or not m:
        empty = (np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0)))
        return StateSpace(*empty, np.zeros((p, m)), (), inputs, outputs)
    markov = np.diff(response, axis=0)
    numbers, rows, columns = scaled(markov)
    found = realised(numbers[1:], np.max(abs(numbers), initial=0.0))
    if found is None:
        return "it samples, or its response is no linear one: it has no continuous states"
    shift, reached, seen = found
    made = continuous(shift, reached, step)
    if isinstance(made, str):
        return made
    a, b, held = made
    c, d = rows[:, None] * seen, markov[0]
    if len(a):
        d = d - c @ (held * columns)
        d = np.where(abs(d) > 1e-9 * np.max(abs(response), axis=0), d, 0.0)
    names = tuple(f"measured[{index + 1}]" for index in range(len(a)))
    return StateSpace(a, b * columns, c, d, names, inputs, outputs)


def _steps(space: StateSpace, length: int, step: float) -> Array:
    """Step responses at the ends of steps, shape (length, outputs, inputs); nothing at the first instant."""
    n, m = space.b.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = space.a, space.b
    made = scipy.linalg.expm(whole * step) if n + m else whole
    x, found = np.zeros((n, m)), np.zeros((length, len(space.outputs), m))
    for index in range(1, length):
        x = made[:n, :n] @ x + made[:n, n:]
        found[index] = space.c @ x + space.d
    return found
