"""How a sweep over instances answers to its unknowns, from the directional derivatives that FMUs offer."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ..fmi import Array, Kind
from ..system.connection import Connection, Port
from .running_instances import Instances


def sweep_slope(
    instances: Instances, order: tuple[int, ...], torn: tuple[Port, ...]
) -> Callable[[], Array] | None:
    """What gives the slope of a Gauss-Seidel sweep, shape (torn, torn), at the instant that was reached.

    It holds what passes through outputs at once, and omits what inputs do to states within the step,
    which vanishes with the step size.

    Args:
        order: indices of the instances, in the order of stepping.
        torn: signals that are supposed before the sweep.
    Returns: None if an instance does not offer directional derivatives.
    """
    system, members = instances.system, set(order)
    capabilities = [system.instances[index].fmu.description.capabilities for index in order]
    if not all(one.directional_derivatives for one in capabilities):
        return None
    entering: dict[int, list[Connection]] = {index: [] for index in order}
    within: dict[Connection, list[Port]] = {}
    leaving: dict[int, dict[str, None]] = {index: {} for index in order}
    for connection in system.connections:
        target = system.position[connection.target.instance]
        if target not in members or system.variable(connection.source).kind is not Kind.REAL:
            continue
        sources = [port for port in connection.sources if system.position[port.instance] in members]
        for port in sources:
            leaving[system.position[port.instance]][port.variable] = None
        if sources:
            entering[target].append(connection)
            within[connection] = sources

    def fed_by(connection: Connection, rows: Mapping[Port, Array]) -> Array:
        if connection.wire is None or instances.connections is None:
            return connection.gain * rows[connection.source]
        slopes = instances.connections.slopes(connection, within[connection], instances.values)
        parts = [connection.gain * slope * rows[port] for port, slope in slopes.items()]
        return sum(parts[1:], parts[0])

    def slope() -> Array:
        rows = dict(zip(torn, np.eye(len(torn)), strict=True))
        for index in order:
            inputs = [connection.target.variable for connection in entering[index]]
            outputs = list(leaving[index])
            own = instances.running[index].output_derivatives(outputs, inputs)
            fed = np.array([fed_by(one, rows) for one in entering[index]])
            answer = own @ fed.reshape(len(inputs), len(torn))
            name = system.instances[index].name
            rows |= {Port(name, output): row for output, row in zip(outputs, answer, strict=True)}
        return np.array([rows[port] for port in torn])

    return slope
