"""The linear equations of an FMU that samples its inputs and holds its outputs, as a digital controller does.

Two runs in short steps that differ in a step of an input give the sample period: wherever the step falls
within a period, the answer begins at the same instant. The answer from sample to sample is a sequence of
Markov parameters. Behind the sampled law are its states; in the limit of short samples its first numbers act
after whole periods, and states stand for the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..base.arrays import Array
from ..base.errors import OrchestratorError
from .alone import Alone
from .measured_part import FIT, continuous, realised, scaled
from .statespace import LateInput, Law, StateSpace

# Short steps in a communication step, and the most communication steps in a sample period.
_FINE, _LONGEST = 4, 20
# Samples of the answer; before the step of the input; and the most numbers that act after whole periods.
_SAMPLES, _SETTLE, _TAPS = 64, 16, 9


@dataclass(frozen=True)
class Sampling:
    """When an FMU samples.

    Attributes:
        period: [s].
        begins: whether a sample at a communication point takes the inputs that are set there, for the step
            that begins.
        ends: whether it takes those of the step that ends there. Where both hold, the second sample takes
            the place of the first.
    """

    period: float
    begins: bool
    ends: bool


def sampling(at: Alone) -> Sampling | str | None:
    """When an FMU samples its inputs.

    Returns: None if it does not, or does faster than can be seen; or why its samples are of no use here.
    """
    first = _first_answers(at)
    if first is None:
        return None
    # By where a step of the input begins, the short step at whose end it is answered.
    found = [0, *(first(offset) for offset in range(1, 4))]
    if found[1] is None or (found[1] != found[2] and found[2] != found[3]):
        return None
    edges, ends = [], False
    for offset in range(2, _FINE * _LONGEST * 2 + 2):
        if offset >= len(found):
            found.append(first(offset))
        if found[offset] == offset + 1 and found[offset - 1] == offset:
            ends = True  # the sample that the step before ends with is taken once more
        elif found[offset] != found[offset - 1]:
            edges.append(offset)
            if len(edges) == 2:
                break
    if len(edges) < 2:
        return f"its sample period is longer than {_LONGEST} communication steps"
    period = edges[1] - edges[0]
    if period > _FINE and period % _FINE:
        return f"its sample period is {period / _FINE:g} communication steps, no whole number"
    # A step of the input at the instant of a sample comes in time for it, or for the next one.
    begins = edges[0] % period == 1
    if edges[0] % period > 1:
        return "its samples do not begin with the run"
    return Sampling(at.step * period / _FINE, begins, ends or not begins)


def _first_answers(at: Alone) -> Callable[[int], int | None] | None:
    """The first short step at whose end an output answers a step of an input, by where the step begins."""
    for name in at.inputs:

        def first(offset: int, name: str = name) -> int | None:
            begin = _FINE * _LONGEST + offset
            steps = _FINE * _LONGEST * 2
            moved = at.answer(name, at.read, steps, 0, settle=begin, fine=_FINE)
            places = np.flatnonzero(np.any(moved != 0.0, axis=1))
            return offset + int(places[0]) if places.size else None

        try:
            if first(0) is not None:
                return first
        except OrchestratorError:  # it takes no short steps, or does not run on its own
            return None
    return None


def sampled_law(at: Alone, when: Sampling) -> tuple[Law, float] | str:
    """The law of an FMU that samples, by its answers to steps of its inputs.

    Args: when: what `sampling` found.
    Returns: the law and the relative error of its step responses; or why there is none.
    """
    step = at.step / _FINE
    # Samples within a communication step see its one value of the input.
    every = max(round(when.period / step), _FINE)
    try:
        whole, half = (
            [at.answer(name, at.read, every * _SAMPLES, every * _SAMPLES, *more) for name in at.inputs]
            for more in ((1.0, every * _SETTLE, _FINE), (0.5, 2 * every * _SETTLE, _FINE))
        )
    except OrchestratorError as refused:
        return f"it cannot be run on its own to measure its response: {str(refused).splitlines()[0]}"
    # What a sample gives is seen at its instant, or a short step later.
    places = np.arange(0 if when.begins else every, min(map(len, (*whole, *half))) - 1, every) + when.begins
    if len(places) < 12:
        return "it ends before its response is measured"
    # Shape (samples, outputs, inputs).
    response, other = (
        np.moveaxis(np.array([[0.0 * found[0], *found[places]] for found in one_size]), 0, 2)
        for one_size in (whole, half)
    )
    markov = np.diff(response, axis=0)
    law = _law(markov, every * step, at.inputs, at.read)
    if isinstance(law, str):
        return law
    size = abs(response).max(axis=0)
    size = np.where(size > 0.0, size, 1.0)
    made = _answers(law.sampled, len(response))
    error = max(float(np.max(abs(made - found) / size)) for found in (response, other))
    if not error <= FIT:
        return (
            f"its measured response differs by {100 * error:.2g} % from that of any linear law of its samples"
        )
    return replace(law, begins=when.begins, ends=when.ends), error


def _law(markov: Array, period: float, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> Law | str:
    """A law from Markov parameters from sample to sample, shape (samples, outputs, inputs)."""
    numbers, rows, columns = scaled(markov)
    scale = float(np.max(abs(numbers), initial=0.0))
    found = realised(numbers[1:], scale)
    if found is None:
        return "its response from sample to sample has no finite number of states"
    shift, reached, seen = found
    names = tuple(f"sampled[{index + 1}]" for index in range(len(shift)))
    sampled = StateSpace(shift, reached * columns, rows[:, None] * seen, markov[0], names, inputs, outputs)
    # In the limit of short samples, what is held acts half a period late, and of states
    # (exp(s T) - exp(a T))^-1 is exp(-a T) (1/(s T - a T) - 1/2 + (s T - a T)/12) to the second order of s T.
    for taps in range(_TAPS):
        found = realised(numbers[taps + 1 :], scale)
        made = "" if found is None else continuous(*found[:2], period)
        if not isinstance(made, str):
            break
    if found is None or isinstance(made, str):
        return "its response from sample to sample has no continuous states behind it"
    a, _, held = made
    c, held = rows[:, None] * found[2], held * columns
    direct = np.concatenate([markov[: taps + 1], np.zeros_like(markov[:1])])
    direct[taps] -= c @ (0.5 * held + period * a @ held / 12.0 - held / 12.0)
    direct[taps + 1] -= c @ held / 12.0
    late = {}
    for column, name in enumerate(inputs):
        paths = [
            LateInput((lag + 0.5) * period, np.zeros(len(a)), direct[lag, :, column])
            for lag in range(taps + 2)
            if np.any(abs(direct[lag, :, column]) > 1e-9 * abs(markov[:, :, column]).max(initial=0.0))
        ]
        if len(a) and np.any(held[:, column]):
            paths.append(LateInput((taps + 0.5) * period, held[:, column] / period, np.zeros(len(outputs))))
        late[name] = tuple(paths)
    empty = np.zeros((len(a), len(inputs))), np.zeros((len(outputs), len(inputs)))
    space = StateSpace(
        a, empty[0], c, empty[1], tuple(f"measured[{index + 1}]" for index in range(len(a))), inputs, outputs
    )
    return Law(space, 0.0, sampled, period, late=late)


def _answers(law: StateSpace | None, length: int) -> Array:
    """Step responses of a sampled law, shape (length, outputs, inputs); nothing at the first instant."""
    assert law is not None
    x = np.zeros_like(law.b)
    found = np.zeros((length, len(law.outputs), len(law.inputs)))
    for index in range(1, length):
        found[index] = law.c @ x + law.d
        x = law.a @ x + law.b
    return found
