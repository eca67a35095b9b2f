"""Warn of whole numbers of 64 bits that a signal, a 64-bit float, rounds."""

from __future__ import annotations

import numpy as np

from ..fmi import Array, Point
from ..master.running_instances import Instances
from ..system.signal_vector import Signals

# Above this not every whole number is a float of 64 bits.
_FIRST = float(2**53)
_TYPES = ("Int64", "UInt64")


class WholeNumbers:
    """An observer (see BlockObserver) that warns once of each output of 64 bits that is rounded as a signal.

    Attributes:
        places: of those outputs among the signals, shape (n,).
    """

    def __init__(self, instances: Instances) -> None:
        self._instances = instances
        found = [
            (instances.layout.index[port], port)
            for port in instances.layout.index
            if instances.system.variable(port).type in _TYPES
        ]
        self.places = np.array([place for place, _ in found], np.intp)
        self._ports = [port for _, port in found]
        ranges = [instances.system.variable(port).held_range or (0, 0) for port in self._ports]
        # The ends of a type's range are held: results bring back the upper one.
        self._ends = np.array(ranges, float).reshape(-1, 2).T
        self._open = np.ones(len(found), np.bool_)

    def __call__(self, point: Point, signals: Signals) -> None:
        """See one point, at which the instances stand: what they hold is compared exactly."""
        for number in self._large(signals.values[self.places]):
            port = self._ports[number]
            running = self._instances.running[self._instances.system.position[port.instance]]
            value = running.get_values([port.variable])[port.variable]
            if held := running.description.variables[port.variable].rounded(value):
                self._warn(
                    number, f"is {value!r} at {point.time:g} s; as a signal, a 64-bit float, it is {held}"
                )

    def observe_block(self, first: int, times: Array, values: Array) -> None:
        """See consecutive points that the instances have left: what large numbers were is not known."""
        values = values[:, self.places]
        for number in self._large(np.abs(values).max(axis=0, initial=0.0)):
            column = values[:, number]
            rounded = (np.abs(column) >= _FIRST) & ~np.isin(column, self._ends[:, number])
            if rounded.any():
                row = int(np.argmax(rounded))
                self._warn(
                    number,
                    f"is near {int(column[row])} at {times[row]:g} s; as a signal, a 64-bit float, it may be "
                    "rounded from 2^53 on. Set run.loop to python to learn where.",
                )

    def _large(self, values: Array) -> list[int]:
        """Which outputs that were not warned of reach numbers that may be rounded."""
        return np.flatnonzero((np.abs(values) >= _FIRST) & self._open).tolist()

    def _warn(self, number: int, what: str) -> None:
        port = self._ports[number]
        self._open[number] = False
        self._instances.complain(port.instance, f"[warning] {port.variable} {what}")
