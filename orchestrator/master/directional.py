"""How a sweep over instances answers to its unknowns, from the directional derivatives that FMUs offer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..fmi import Array, Kind
from ..instances import Instances
from ..system import Connection, Port

__all__ = ["sweep_slope"]


def sweep_slope(
    instances: Instances, order: tuple[int, ...], torn: tuple[Port, ...]
) -> Callable[[], Array] | None:
    """What gives the slope of a Gauss-Seidel sweep, shape (torn, torn), at the instant that was reached.

    It holds what passes through outputs at once, and leaves out what inputs do to states within the step,
    which vanishes with the step size.

    Args:
        order: indices of the instances, in the order of stepping.
        torn: signals that are supposed before the sweep.
    Returns: None if an instance does not offer directional derivatives, or effects lie between instances.
    """
    system, members = instances.system, set(order)
    capabilities = [system.instances[index].fmu.description.capabilities for index in order]
    if not all(one.directional_derivatives for one in capabilities):
        return None
    entering: dict[int, list[Connection]] = {index: [] for index in order}
    leaving: dict[int, dict[str, None]] = {index: {} for index in order}
    for connection in system.connections:
        source = system.position[connection.source.instance]
        target = system.position[connection.target.instance]
        if connection.wire is not None and target in members:
            return None
        if source in members and target in members and system.variable(connection.source).kind is Kind.REAL:
            entering[target].append(connection)
            leaving[source][connection.source.variable] = None

    def slope() -> Array:
        rows = dict(zip(torn, np.eye(len(torn)), strict=True))
        for index in order:
            inputs = [connection.target.variable for connection in entering[index]]
            outputs = list(leaving[index])
            own = instances.running[index].output_derivatives(outputs, inputs)
            fed = np.array([one.gain * rows[one.source] for one in entering[index]])
            answer = own @ fed.reshape(len(inputs), len(torn))
            name = system.instances[index].name
            rows |= {Port(name, output): row for output, row in zip(outputs, answer, strict=True)}
        return np.array([rows[port] for port in torn])

    return slope
