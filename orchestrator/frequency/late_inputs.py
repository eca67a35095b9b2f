"""Inputs that act after a delay within an FMU, from two runs that differ in a step of the input."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from ..base.arrays import Array
from ..base.errors import ConfigError, OrchestratorError, Problem
from .alone import Alone
from .statespace import LateInput, StateSpace

_MOST_STEPS = 5_000
# Samples after the first answer that the delay and the gains are fitted to.
_SAMPLES = 24
# Of the fit, relative to the answer: a delay is one only if nothing else remains.
_LEFT = 2e-3
# An answer below this share of a variable's value is its solver's, which takes other steps.
_SOLVED = 1e-10
# An answer that falls with the step's height by more than this has no linear part.
_BENT = 0.6

MEASURE = "Measure the loop with orchestrator.frequency.sweep_system."


def acts(part: StateSpace, name: str) -> bool:
    """Whether an input acts on a state's derivative or an output at once."""
    column = part.inputs.index(name)
    return bool(part.b[:, column].any() or part.d[:, column].any())


def idle_together(at: Alone, part: StateSpace, names: Sequence[str]) -> bool:
    """Whether nothing answers a step of all these inputs at once: two long runs in place of two for each."""
    watched = list(dict.fromkeys([*part.states, *part.outputs]))
    # Shares that differ do not cancel.
    step = np.array([at.height(name) * (1.0 - 0.07 * k) for k, name in enumerate(names)])
    try:
        runs = at.differences(names, watched, [step] * _MOST_STEPS)
        return not any(found.any() for found in runs)
    except OrchestratorError:
        return False


def find_late_input(at: Alone, part: StateSpace, name: str) -> LateInput | None:
    """The delay behind which an input stands that acts on nothing at once; None if it acts on nothing later.

    Raises: ConfigError if what it acts on later is no pure delay.
    """
    found = _measured(at, part, name)
    if isinstance(found, str):
        what = f"at the operating point input {name} changes no output and no state's derivative at once"
        between = "an inactive part of the model, as an open contact, a delay or a sample lies between"
        raise ConfigError([Problem(at.one.name, f"{what}: {between}; {found}", "", MEASURE)])
    return found


def _measured(at: Alone, part: StateSpace, name: str) -> LateInput | str | None:
    """The delay between an input and the states, from two runs that differ in a step of it.

    Returns: None if nothing answers a small step, else why what answers is no delay before the states.
    """
    step = at.step
    watched = [*part.states, *(key for key in part.outputs if key not in part.states)]
    height = at.height(name)
    floor = np.array([_SOLVED * abs(float(at.values.get(key, 0.0))) for key in watched]) / height
    try:
        found = at.answer(name, watched, _MOST_STEPS, 4 * _SAMPLES)
    except OrchestratorError as error:
        return f"it cannot be run on its own to look for a delay: {str(error).splitlines()[0]}"
    size = np.max(abs(found), axis=0)
    unlike = "what answers a step of it later is no pure delay"
    scale = np.where(size > 0.0, size, 1.0)
    moved = np.flatnonzero(np.max(abs(found) / scale, axis=1) > 1e-9)
    if not moved.size:
        return None
    half = at.answer(name, watched, len(found) - 1, len(found), 0.5)
    count = min(len(half), len(found))
    # What half the step answers by another share is of higher order.
    other = np.max(abs(half[:count] - found[:count]), axis=0)
    none = (other >= (1.0 - _BENT) * size) | (size < floor)
    if np.all(none):
        return None
    found[:, none], size = 0.0, np.where(none, 0.0, size)
    scale = np.where(size > 0.0, size, 1.0)
    states = len(part.states)
    onset = int(moved[0])
    rows = np.arange(onset, min(onset + _SAMPLES, len(found)))
    if len(rows) < 4:
        return unlike
    outputs = np.array([watched.index(key) for key in part.outputs], np.intp)
    through = np.zeros(len(part.outputs))
    if not size[:states].any():
        # Nothing but the delay lies between input and outputs: they jump when it is over.
        jump = found[rows[-1]]
        if np.max(abs(found[rows] - jump) / scale) > _LEFT:
            return unlike
        which = int(np.argmax(size))
        delay = at.passage(name, watched[which], step * max(onset - 1, 0))
        return LateInput(delay, np.zeros(states), jump[outputs])
    wanted = found[rows, :states] / scale[:states]
    transition, whole = scipy.linalg.expm(part.a * step), _integral(part.a, step)

    def fitted(delay: float) -> tuple[float, Array]:
        since = step * rows - delay
        parts = [_integral(part.a, max(since[0], 0.0)), _integral(part.a, max(since[1], 0.0))]
        while len(parts) < len(rows):
            parts.append(whole + transition @ parts[-1])
        design = np.concatenate([one / scale[:states, None] for one in parts])
        gains, *_ = np.linalg.lstsq(design, wanted.ravel(), rcond=None)
        return float(np.linalg.norm(design @ gains - wanted.ravel())), gains

    from scipy.optimize import minimize_scalar

    low, high = step * max(onset - 1, 0), step * onset
    best = minimize_scalar(
        lambda delay: fitted(delay)[0], bounds=(low, high), method="bounded", options={"xatol": 1e-12}
    )
    delays = [float(best.x), low, high]
    misfits = [fitted(delay)[0] for delay in delays]
    delay = delays[int(np.argmin(misfits))]
    misfit, gains = fitted(delay)
    if misfit > _LEFT * np.linalg.norm(wanted):
        return unlike
    if states < len(watched):
        left = found[rows][:, outputs] - found[rows, :states] @ part.c.T
        through = left[-1] if np.max(abs(left[-1]) / scale[outputs]) > 1e-6 else through
    return LateInput(delay, gains, through)


def _integral(a: Array, time: float) -> Array:
    """Integral of exp(A t) from 0 to `time`, shape of A."""
    n = len(a)
    whole = np.zeros((2 * n, 2 * n))
    whole[:n, :n], whole[:n, n:] = a, np.eye(n)
    return scipy.linalg.expm(whole * time)[:n, n:]
