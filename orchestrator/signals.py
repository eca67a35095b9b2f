"""All signals of a system in one flat vector, and where each port stands in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .fmi import Array, Kind
from .system import Port, System

__all__ = ["Layout", "Signals"]

_DOUBLES = ("Real", "Float64")


class Signals(NamedTuple):
    """Values of all read ports at one instant.

    Attributes:
        values: numeric ports, shape (layout.size,), in the FMUs' units; Boolean 0 or 1.
        texts: String outputs that are connected.
    """

    values: Array
    texts: Mapping[Port, str] = {}


@dataclass(frozen=True)
class Inputs:
    """What an instance's numeric inputs are fed from: value = gain * signals[source] + offset.

    Attributes:
        names: of the inputs.
        source: indices into the signal vector.
        gain, offset: None where no connection converts, so that values pass bit-identical.
    """

    names: tuple[str, ...]
    source: NDArray[np.intp]
    gain: Array | None
    offset: Array | None


@dataclass(frozen=True)
class Layout:
    """Where every port stands.

    Attributes:
        size: length of the signal vector.
        index: place of each read port.
        outputs: per instance, the names of the ports that are read, in the vector's order.
        spans: per instance, its slice of the vector.
        inputs: per instance, its numeric inputs.
        text_inputs: per instance, its String inputs and their sources.
        text_outputs: per instance, its connected String outputs.
    """

    size: int
    index: Mapping[Port, int]
    outputs: tuple[tuple[str, ...], ...]
    spans: tuple[slice, ...]
    inputs: tuple[Inputs, ...]
    text_inputs: tuple[tuple[tuple[str, Port], ...], ...]
    text_outputs: tuple[tuple[str, ...], ...]
    recorded: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))

    @staticmethod
    def of(system: System) -> Layout:
        """The layout of a system: recorded ports and the sources of connections are read, others are not."""
        read: list[dict[str, None]] = [{} for _ in system.instances]
        for port in (*system.recorded, *(connection.source for connection in system.connections)):
            read[system.position[port.instance]][port.variable] = None
        outputs, spans, text_outputs = [], [], []
        index: dict[Port, int] = {}
        for instance, names in zip(system.instances, read, strict=True):
            variables = [instance.variable(name) for name in names]
            numeric = [variable for variable in variables if variable.kind.numeric]
            # Doubles first: what lies side by side is read straight into the vector.
            numeric.sort(key=lambda variable: variable.type not in _DOUBLES)
            start = len(index)
            index.update({Port(instance.name, one.name): start + n for n, one in enumerate(numeric)})
            outputs.append(tuple(variable.name for variable in numeric))
            spans.append(slice(start, len(index)))
            text_outputs.append(tuple(one.name for one in variables if one.kind is Kind.STRING))
        numeric_inputs, text_inputs = _inputs(system, index)
        return Layout(
            size=len(index),
            index=index,
            outputs=tuple(outputs),
            spans=tuple(spans),
            inputs=numeric_inputs,
            text_inputs=text_inputs,
            text_outputs=tuple(text_outputs),
            recorded=np.array([index[port] for port in system.recorded], np.intp),
        )


def _inputs(
    system: System, index: Mapping[Port, int]
) -> tuple[tuple[Inputs, ...], tuple[tuple[tuple[str, Port], ...], ...]]:
    numeric: list[list[tuple[str, int, float, float, bool]]] = [[] for _ in system.instances]
    texts: list[list[tuple[str, Port]]] = [[] for _ in system.instances]
    for connection in system.connections:
        position = system.position[connection.target.instance]
        variable = system.variable(connection.target)
        if variable.kind is Kind.STRING:
            texts[position].append((variable.name, connection.source))
        else:
            other = variable.type not in _DOUBLES
            feed = (variable.name, index[connection.source], connection.gain, connection.offset, other)
            numeric[position].append(feed)
    made = []
    for feeds in numeric:
        feeds.sort(key=lambda feed: feed[4])
        plain = all(gain == 1.0 and offset == 0.0 for _, _, gain, offset, _ in feeds)
        made.append(
            Inputs(
                names=tuple(feed[0] for feed in feeds),
                source=np.array([feed[1] for feed in feeds], np.intp),
                gain=None if plain else np.array([feed[2] for feed in feeds]),
                offset=None if plain else np.array([feed[3] for feed in feeds]),
            )
        )
    return tuple(made), tuple(tuple(one) for one in texts)
