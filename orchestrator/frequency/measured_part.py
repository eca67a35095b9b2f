"""The linear equations of an FMU without directional derivatives, from how it answers steps of its inputs.

Two runs that differ in a step of one input differ by its step response. Their differences from sample to
sample are Markov parameters, and Ho and Kalman's method (Kung, Asilomar Conf. 12, 1978) gives the states
behind them.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from ..base.arrays import Array
from ..base.errors import OrchestratorError
from .alone import Alone
from .statespace import StateSpace

_SAMPLES = 48
# Steps before the input's; the check by half its height takes twice as many, to see what depends on time.
_SETTLE = 16
# Singular values below this share of the largest are no states; the model has to fit this well.
_RANK = 1e-7
FIT = 1e-2


def measured_part(at: Alone) -> tuple[StateSpace, dict[str, float], float] | str:
    """The state space of an FMU from its step responses, sampled at the communication step.

    A delay is found in whole steps. FMUs that are not linear or depend on time answer half the step, given
    later, differently: that is in the error.

    Returns: the state space, delay of inputs by name [s], and the relative error of its step responses; or
        why there is none.
    """
    step, inputs, outputs = at.step, at.inputs, at.read
    try:
        # What initialises itself at the first step would take the input's step for its start value.
        common = (outputs, _SAMPLES, _SAMPLES)
        steps = [at.answer(name, *common, settle=_SETTLE) for name in inputs]
        halves = [at.answer(name, *common, 0.5, 2 * _SETTLE) for name in inputs]
    except OrchestratorError as refused:
        return f"it cannot be run on its own to measure its response: {str(refused).splitlines()[0]}"
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
    """Markov parameters, shape (samples, outputs, inputs), in units that make channels comparable; the units
    of rows and columns.
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
    held = np.asarray(np.linalg.solve(shift, reached), np.float64)
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
