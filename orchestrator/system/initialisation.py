"""Solve the initial values of all connections, algebraic loops included.

FMI lets inputs be set and outputs be read as often as it takes in initialisation mode, and only there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from ..base.errors import StepError, listed
from ..base.fixed_point import Newton, Solution, solve
from ..fmi import Array, FmuInstance, Value
from .connection import Connection, Port
from .system import System

# Of the relative residuals of loops: what rounding leaves of a loop gain of some thousands.
_TOLERANCE = 1e-12
_ITERATIONS = 50
# Through loops that are only assumed. What passes on nothing at once agrees after as many as there are hops.
_PASSES = 10
_UNSOLVED = "not converged"


EffectEvaluator = Callable[[Connection, Mapping[Port, Value], float], float]


def settle(
    system: System,
    running: Sequence[FmuInstance],
    time: float,
    check: Callable[[Port, float], None],
    made: EffectEvaluator,
) -> list[StepError]:
    """Set every connected input to what its source gives.

    Args:
        running: the instances, in initialisation mode.
        time: start time [s].
        check: called with each real value before it is passed on; may raise.
        made: gives the signal of a connection with effects, of values of its sources at a time.
    Returns: what was not solved and need not be, see `System.held`.
    Raises: StepError if another loop cannot be solved.
    """
    exchange = _Exchange(system, running, check, made, time)
    unsolved = []
    for loops, connections in zip(system.initial_loops, system.initial_levels, strict=True):
        for loop in loops:
            if not all(one.target in system.held for one in loop):
                _solve(exchange, loop, time)
                continue
            begun = exchange.fetch(loop)
            try:
                _settle_assumed_loop(exchange, loop, begun, time)
            except StepError as error:
                if error.status != _UNSOLVED:
                    raise
                unsolved.append(error)
                exchange.pass_on(loop, begun)
        exchange.pass_on(connections, exchange.fetch(connections))
    return unsolved


class _Exchange:
    """Reads sources and sets targets of connections."""

    def __init__(
        self,
        system: System,
        running: Sequence[FmuInstance],
        check: Callable[[Port, float], None],
        made: EffectEvaluator,
        time: float,
    ) -> None:
        self.system, self._running, self._check, self._made = system, running, check, made
        self._time = time

    def fetch(self, connections: Iterable[Connection]) -> dict[Port, Value]:
        """Values of the connections' sources."""
        names: dict[int, dict[str, None]] = {}
        for connection in connections:
            for port in connection.sources:
                names.setdefault(self.system.position[port.instance], {})[port.variable] = None
        values: dict[Port, Value] = {}
        for position, wanted in names.items():
            own = self._running[position].get_values(list(wanted))
            values |= {Port(self.system.instances[position].name, name): own[name] for name in wanted}
        return values

    def pass_on(self, connections: Iterable[Connection], values: Mapping[Port, Value]) -> None:
        """Set the connections' targets."""
        targets: dict[int, dict[str, Value]] = {}
        for connection in connections:
            value = values[connection.source]
            if isinstance(value, float):
                for port in connection.sources:
                    self._check(port, float(values[port]))
                if connection.wire is not None:
                    value = self._made(connection, values, self._time)
                if connection.gain != 1.0 or connection.offset != 0.0:
                    value = connection.gain * value + connection.offset
            position = self.system.position[connection.target.instance]
            targets.setdefault(position, {})[connection.target.variable] = value
        for position, inputs in targets.items():
            self._running[position].set_values(inputs)


def _settle_assumed_loop(
    exchange: _Exchange, loop: tuple[Connection, ...], begun: Mapping[Port, Value], time: float
) -> None:
    """Set the inputs of an assumed loop: if it has no feedthrough, the second pass changes nothing."""
    values = begun
    for _ in range(_PASSES):
        exchange.pass_on(loop, values)
        before, values = values, exchange.fetch(loop)
        if before == values:
            return
    if all(isinstance(value, float) for value in values.values()):
        exchange.pass_on(loop, begun)
        _solve(exchange, loop, time)
        return
    changing = [port for port, value in values.items() if value != before[port]]
    raise StepError(
        f"algebraic loop at initialisation: {listed(map(str, changing))} still change after {_PASSES} passes",
        instance=changing[0].instance,
        time=time,
        status=_UNSOLVED,
    )


def _solve(exchange: _Exchange, loop: tuple[Connection, ...], time: float) -> None:
    """Set the inputs of an algebraic loop so that they agree with the outputs that they lead to."""
    sources = list(dict.fromkeys(port for connection in loop for port in connection.sources))
    nominal = np.array([exchange.system.variable(port).nominal for port in sources])

    def read() -> Array:
        values = exchange.fetch(loop)
        return np.array([float(values[port]) for port in sources])

    def around(x: Array) -> Array:
        exchange.pass_on(loop, dict(zip(sources, x.tolist(), strict=True)))
        return read()

    solution = solve(
        around, read(), nominal, Newton(nominal), tolerance=_TOLERANCE, max_iterations=_ITERATIONS
    )
    if not solution.converged:
        what, remedy = "algebraic loop at initialisation", "Check its start values and what it consists of."
        raise not_converged(what, exchange.system, sources, solution, _TOLERANCE, time, remedy)


def not_converged(
    what: str,
    system: System,
    ports: Sequence[Port],
    solution: Solution,
    tolerance: float,
    time: float,
    remedy: str,
) -> StepError:
    """The error for an iteration over the values of `ports` that did not converge."""
    worst = np.argsort(-solution.residual, kind="stable")[:5]
    lines = []
    for n in worst:
        unit = system.variable(ports[n]).unit_name
        given = f"{solution.x[n]:.9g} gives {solution.value[n]:.9g}{f' {unit}' if unit else ''}"
        lines.append(f"{ports[n]}: residual {solution.residual[n]:.3g}, {given}")
    if len(ports) > len(worst):
        lines.append(f"and {len(ports) - len(worst)} signals more")
    why = f" ({solution.why})" if solution.why else ""
    count = f"{solution.iterations} iteration{'' if solution.iterations == 1 else 's'}"
    listing = "\n".join(f"    {line}" for line in lines)
    return StepError(
        f"{what}: no convergence after {count}{why}; tolerance {tolerance:g}\n{listing}",
        instance=ports[worst[0]].instance,
        time=time,
        status=_UNSOLVED,
        remedy=remedy,
    )
