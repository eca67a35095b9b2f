"""Inputs along curves in machine code: the same as master.extrapolation and `Instances.transfer`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import addressof
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from ...fmi.binary_instance import NativeCalls
from ...master.extrapolation import weights
from ...master.running_instances import Instances
from .foreign_calls import call_fmi2_derivatives, load, store
from .plain_steps import word
from .table_columns import Ahead, Bend, Given, Step

# numba takes plain whole numbers for constants.
_ORDER, _SIZE, _PAST, _MIDDLE, _END, _WEIGHTS, _SMOOTH, _GIVEN, _SPANS, _BENDS, _BOUNDS, _PLACES = map(
    int, Ahead
)
_FUNCTION, _COMPONENT, _REFERENCES, _COUNT, _ORDERS, _VALUES, _FIRST_PLACE = map(int, Bend)
_FIRST_INPUT, _END_INPUT, _CONVERTS = int(Step.FIRST_INPUT), int(Step.END_INPUT), int(Step.CONVERTS)
_AT_END, _COURSE = int(Given.END), int(Given.COURSE)
_BEND_ROW = 8 * len(Bend)  # bytes
# Weights of at most so many points, for so many instants.
_POINTS, _INSTANTS = 3, 3


@register_jitable
def _double(address, index):
    return load(address + 8 * index, np.float64(0))


@register_jitable
def _mixed(weights_at, newest, past, index, size, order):
    """A weighted sum of a signal at several points, summed as `master.extrapolation` does."""
    total = _double(weights_at, 0) * newest
    for point in range(order):
        total += _double(weights_at, 1 + point) * _double(past, point * size + index)
    return total


@register_jitable
def predict(ahead, point, values):
    """Begin the step from a point: how the signals are supposed to run over it.

    Args:
        ahead: address of the tables of `Curves`.
        point: index of the point; from 0 on, one after the other.
        values: address of the signals.
    Returns: the order of the curves; 0 where inputs hold.
    """
    past, size = word(ahead, _PAST), word(ahead, _SIZE)
    for one in range(word(ahead, _ORDER), 0, -1):
        for index in range(size):
            store(past + 8 * (one * size + index), _double(past, (one - 1) * size + index))
    for index in range(size):
        store(past + 8 * index, _double(values, index))
    order = min(word(ahead, _ORDER), point)
    if order == 0:
        return order
    middle, end, smooth = word(ahead, _MIDDLE), word(ahead, _END), word(ahead, _SMOOTH)
    of_middle = word(ahead, _WEIGHTS) + 8 * _POINTS * _INSTANTS * order
    of_end = of_middle + 8 * _POINTS
    for index in range(size):
        newest = _double(past, index)
        if word(smooth, index) != 0:
            earlier = past + 8 * size
            store(middle + 8 * index, _mixed(of_middle, newest, earlier, index, size, order))
            store(end + 8 * index, _mixed(of_end, newest, earlier, index, size, order))
        else:
            store(middle + 8 * index, newest)
            store(end + 8 * index, newest)
    return order


@register_jitable
def settle(ahead, order, index, known):
    """A signal at the end of the step is known."""
    past, size = word(ahead, _PAST), word(ahead, _SIZE)
    within = known
    if word(word(ahead, _SMOOTH), index) != 0:
        of_known = word(ahead, _WEIGHTS) + 8 * _POINTS * (_INSTANTS * order + 2)
        within = _mixed(of_known, known, past, index, size, order)
    store(word(ahead, _END) + 8 * index, known)
    store(word(ahead, _MIDDLE) + 8 * index, within)


@register_jitable
def settle_all(ahead, order, who, values):
    """All signals of an instance that has stepped are known."""
    spans = word(ahead, _SPANS)
    for index in range(word(spans, who), word(spans, who + 1)):
        settle(ahead, order, index, _double(values, index))


@register_jitable
def feed(row, ahead, source, gain, offset, inputs):
    """Feed an instance's inputs along the curves; see `Instances.transfer`.

    Args:
        row: address of the instance's row of the table of steps.
        source, gain, offset, inputs: addresses, as `kernel.run_steps` has them.
    """
    given, converts = word(ahead, _GIVEN), word(row, _CONVERTS) != 0
    for index in range(word(row, _FIRST_INPUT), word(row, _END_INPUT)):
        kind = word(given, index)
        from_ = word(ahead, _MIDDLE)
        if kind == _COURSE:
            from_ = word(ahead, _PAST)
        elif kind == _AT_END:
            from_ = word(ahead, _END)
        value = _double(from_, word(source, index))
        if converts:
            value = value * _double(gain, index) + _double(offset, index)
        store(inputs + 8 * index, value)


@register_jitable
def bends(ahead, who):
    """Whether an instance is reported derivatives of its inputs."""
    bounds = word(ahead, _BOUNDS)
    return word(bounds, who + 1) > word(bounds, who)


@register_jitable
def _slope(row, ahead, derivative, source, gain, place, step_size, square):
    """A derivative of an input at the begin of the step, by its place; see `Instances.transfer`."""
    if word(word(ahead, _GIVEN), place) != _COURSE:
        return 0.0
    signal = word(source, place)
    first, last = _double(word(ahead, _PAST), signal), _double(word(ahead, _END), signal)
    bow = 2.0 * (first + last - 2.0 * _double(word(ahead, _MIDDLE), signal))
    slope = (last - first - bow) / step_size if derivative == 1 else 2.0 * bow / square
    if word(row, _CONVERTS) != 0:
        slope = _double(gain, place) * slope
    return slope


@register_jitable
def bend_on(row, ahead, order, who, source, gain, offset, inputs, step_size, square, passed):
    """Feed an instance's inputs as they are within the step; see `Instances.advance`.

    Args:
        row, source, gain, offset, inputs: as of `feed`.
        step_size: [s]; square: of it.
        passed: since the begin of the step [s].
    """
    past, bounds = word(ahead, _PAST), word(ahead, _BOUNDS)
    for one in range(word(bounds, who), word(bounds, who + 1)):
        call = word(ahead, _BENDS) + _BEND_ROW * one
        places = word(ahead, _PLACES) + 8 * word(call, _FIRST_PLACE)
        for index in range(word(call, _COUNT)):
            place = word(places, index)
            if word(word(ahead, _GIVEN), place) != _COURSE:
                continue
            value = _double(past, word(source, place))
            if word(row, _CONVERTS) != 0:
                value = value * _double(gain, place) + _double(offset, place)
            value = value + passed * _slope(row, ahead, 1, source, gain, place, step_size, square)
            if order > 1:
                bow = _slope(row, ahead, 2, source, gain, place, step_size, square)
                value = value + 0.5 * passed * passed * bow
            store(inputs + 8 * place, value)


@register_jitable
def bend(row, ahead, order, who, source, gain, step_size, square, passed):
    """Pass an instance the derivatives of its inputs at the begin of one of its own steps.

    Args:
        row, source, gain: as of `feed`.
        step_size: of the communication step [s]; square: of it.
        passed: from the begin of that to the begin of the own one [s].
    Returns: the status of the call that failed; 0.
    """
    bounds = word(ahead, _BOUNDS)
    for derivative in range(1, order + 1):
        for one in range(word(bounds, who), word(bounds, who + 1)):
            call = word(ahead, _BENDS) + _BEND_ROW * one
            count = word(call, _COUNT)
            places = word(ahead, _PLACES) + 8 * word(call, _FIRST_PLACE)
            for index in range(count):
                place = word(places, index)
                slope = _slope(row, ahead, derivative, source, gain, place, step_size, square)
                if derivative == 1 and order > 1 and passed > 0.0:
                    bow = _slope(row, ahead, 2, source, gain, place, step_size, square)
                    slope = slope + passed * bow
                store(word(call, _VALUES) + 8 * index, slope)
            orders = word(call, _ORDERS) + 4 * count * (derivative - 1)
            status = call_fmi2_derivatives(
                word(call, _FUNCTION), word(call, _COMPONENT), word(call, _REFERENCES), count, orders,
                word(call, _VALUES),
            )  # fmt: skip
            if status > 1:
                return status
    return 0


@dataclass(frozen=True)
class Curves:
    """Numbers by which the native loop extrapolates.

    Attributes:
        order: of the polynomial; 0 where inputs hold.
        table: one of `codes.Ahead`, shape (len(Ahead),).
        kept: what is there by address.
    """

    order: int
    table: NDArray[np.int64]
    kept: tuple[Any, ...]

    @staticmethod
    def of(
        instances: Instances,
        native: Sequence[NativeCalls],
        order: int,
        steps: Sequence[Sequence[int]],
    ) -> Curves:
        """The numbers of instances that are bound.

        Args:
            native: what each instance calls.
            steps: rows of the table of steps.
        """
        if not order:
            return Curves(0, np.zeros(len(Ahead), np.int64), ())
        layout = instances.layout
        past, middle, end = np.zeros((_POINTS, layout.size)), np.zeros(layout.size), np.zeros(layout.size)
        mixing = np.zeros((_POINTS, _INSTANTS, _POINTS))
        for own in range(1, order + 1):
            nodes = tuple(-float(point) for point in range(own + 1))
            for row, (at, among) in enumerate(((0.5, nodes), (1.0, nodes), (0.5, (1.0, *nodes[:own])))):
                mixing[own, row, : own + 1] = weights(at, among)
        given: list[int] = []
        bends, places, bounds, kept = [], [], [0], []
        for position, one in enumerate(native):
            follows, through = instances.courses(position)
            otherwise = np.where(through, Given.END, Given.MIDDLE)
            given += np.where(follows, Given.COURSE, otherwise).tolist()
            for block in one.inputs if follows.any() else ():
                if not block.real:
                    continue
                count = len(block.references)
                orders = (ctypes.c_int * (2 * count))(*[1] * count, *[2] * count)
                values = (ctypes.c_double * count)()
                kept += [orders, values]
                references = addressof(block.references)
                arguments = (references, count, addressof(orders), addressof(values))
                bends.append([one.bend, one.component, *arguments, len(places)])
                places += [steps[position][Step.FIRST_INPUT] + place for place in block.positions]
            bounds.append(len(bends))
        smooth, spans = layout.smooth, [*(span.start for span in layout.spans), layout.spans[-1].stop]
        whole = [
            np.array(numbers, np.int64).ravel() for numbers in (smooth, given, spans, bends, bounds, places)
        ]
        of_smooth, *others = (one.ctypes.data for one in whole)
        arrays = (past, middle, end, mixing)
        table = [order, layout.size, *(one.ctypes.data for one in arrays), of_smooth, *others]
        return Curves(order, np.array(table, np.int64), (*arrays, *whole, *kept))
