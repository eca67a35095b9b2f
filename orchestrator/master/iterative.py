"""Iterative: steps are repeated until every input agrees with the output that feeds it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..base import graph
from ..base.errors import Problem
from ..base.fixed_point import Anderson, FixedPoint, Newton, Solver, solve
from ..config import Places
from ..fmi import Array, Kind, Point, StepStatus
from ..system.connection import Port
from ..system.initialisation import not_converged
from ..system.signal_vector import Layout, Signals, Wired
from ..system.system import System
from .base import Master, StepInfo, failure, need_rollback
from .directional import sweep_slope
from .rates import slow
from .running_instances import Curve, Instances


@dataclass(frozen=True)
class Block:
    """Instances that act on one another, in the order of stepping.

    Attributes:
        order: indices of the instances.
        torn: signals that an instance needs before the one that gives them has stepped: the unknowns.
        places: of `torn` in the signal vector.
        nominal: of `torn`.
        discrete: which of `torn` are no real numbers.
        wired: connections that make a signal of `torn`.
        supposed: places of `torn` and of these signals.
    """

    order: tuple[int, ...]
    torn: tuple[Port, ...]
    places: NDArray[np.intp]
    nominal: Array
    discrete: NDArray[np.bool_]
    wired: tuple[Wired, ...]
    supposed: NDArray[np.intp]


def cycles(system: System) -> list[tuple[int, ...]]:
    """Instances in an order in which each comes after those that feed it; those in one cycle together."""
    fed: list[set[int]] = [set() for _ in system.instances]
    for connection in system.connections:
        for port in connection.sources:
            fed[system.position[port.instance]].add(system.position[connection.target.instance])
    rank = {index: place for place, index in enumerate(system.order)}
    components = reversed(graph.strong_components([sorted(below) for below in fed]))
    return [tuple(sorted(component, key=rank.__getitem__)) for component in components]


def blocks(system: System, layout: Layout) -> tuple[Block, ...]:
    """The blocks of a system, in the order of stepping."""
    made = []
    entering: dict[int, list[tuple[Port, int]]] = {}
    for connection in system.connections:
        target = system.position[connection.target.instance]
        if not system.variable(connection.target).carried:
            for port in connection.sources:
                entering.setdefault(target, []).append((port, system.position[port.instance]))
    for order in cycles(system):
        rank = {index: place for place, index in enumerate(order)}
        torn = tuple(
            dict.fromkeys(
                port
                for index in order
                for port, source in entering.get(index, ())
                if source in rank and rank[source] >= rank[index]
            )
        )
        variables = [system.variable(port) for port in torn]
        places = np.array([layout.index[port] for port in torn], np.intp)
        wired = layout.wired_to(places.tolist())
        made.append(
            Block(
                order=order,
                torn=torn,
                places=places,
                nominal=np.array([one.nominal for one in variables]),
                discrete=np.array([one.kind is not Kind.REAL for one in variables], np.bool_),
                wired=wired,
                supposed=np.concatenate([places, [one.place for one in wired]]).astype(np.intp),
            )
        )
    return tuple(made)


class Iterative(Master):
    """Every input holds its source's value from the end of the step, which is found by iteration.

    Instances that form a cycle are stepped back and stepped again, in Gauss-Seidel's order, until what they
    were given agrees with what they gave; the others step once. FMI 2 forbids further rounds of set and get
    at a communication point, so that only a repeated step says what an input does. Algebraic loops are
    solved with all other couplings. The first iterate is Gauss-Seidel's: where the tolerance takes it, the
    result is the same to the bit.
    """

    solves_loops: ClassVar[bool] = True

    tolerance: float = Field(
        gt=0, description="Of the difference of input and source, relative to max(|value|, nominal)."
    )
    method: Literal["newton", "anderson", "fixed-point"] = Field(
        "newton",
        description="newton: with directional derivatives or differences; anderson: interface quasi-Newton.",
    )
    max_iterations: int = Field(50, ge=1, strict=True, description="After these the run fails.")
    relaxation: float = Field(1.0, gt=0, le=1, description="Of fixed-point and anderson.")
    depth: int = Field(5, ge=1, strict=True, description="How many iterates anderson looks back on.")
    interpolation: Literal[0, 1] = Field(
        0,
        description="0: inputs hold the value from the end of the step; 1: they run straight to it from the "
        "value at the beginning, which is of second order.",
    )
    derivatives: Literal["offered", "differences"] = Field(
        "offered",
        description="Whether newton begins with the directional derivatives that the FMUs offer; where one "
        "does not, and where they do not do, it takes differences.",
    )

    @property
    def order(self) -> int:
        """See MasterAlgorithm.order."""
        return self.interpolation + 1

    def check(self, system: System, places: Places | None = None) -> list[Problem]:
        """See MasterAlgorithm.check."""
        needed = [block.order for block in blocks(system, Layout.of(system)) if block.torn]
        why = "which its place in a cycle of connections demands"
        return need_rollback(
            system, (index for order in needed for index in order), "iterative", why, places
        ) + slow(system, "repeats communication steps", places)

    def step(
        self, system: System, instances: Instances, point: Point, signals: Signals
    ) -> tuple[Signals, StepInfo]:
        """See MasterAlgorithm.step."""
        instances.load(signals)
        if "blocks" not in instances.memory:
            instances.memory["blocks"] = blocks(system, instances.layout)
        curve = None
        if self.interpolation:
            begin = signals.values
            curve = Curve(begin, begin.copy(), begin.copy(), 1, point.step_size)
        done = StepInfo()
        for number, block in enumerate(instances.memory["blocks"]):
            if block.torn:
                info = self._solve(system, instances, point, signals, number, block, curve)
            else:
                info = self._sweep(instances, point, block, curve)
            if info.status > StepStatus.WARNING:
                return signals, info
            residuals = [one for one in (done.residual, info.residual) if one is not None]
            done = StepInfo(
                iterations=max(done.iterations, info.iterations), residual=max(residuals, default=None)
            )
        return instances.signals(point.time + point.step_size), done

    @staticmethod
    def _sweep(instances: Instances, point: Point, block: Block, curve: Curve | None) -> StepInfo:
        """Step the instances of a block, from the vector as it stands."""
        for index in block.order:
            instances.transfer(index, curve)
            status = instances.advance(index, point)
            if status > StepStatus.WARNING:
                return failure(instances, index, status)
            if curve is not None:
                _straighten(curve, instances.layout.within[index], instances)
        return StepInfo()

    def _solve(
        self,
        system: System,
        instances: Instances,
        point: Point,
        signals: Signals,
        number: int,
        block: Block,
        curve: Curve | None,
    ) -> StepInfo:
        if number not in instances.memory:
            instances.memory[number] = self._solver(instances, block)
        texts = dict(instances.texts)
        fresh = True
        with instances.checkpoint(block.order) as back:

            def once(x: Array) -> Array:
                nonlocal fresh
                if not fresh:
                    back()
                    instances.texts = dict(texts)
                fresh = False
                instances.put(block.places, x, point.time + point.step_size, block.wired)
                if curve is not None:
                    _straighten(curve, block.supposed, instances)
                info = self._sweep(instances, point, block, curve)
                if info.status > StepStatus.WARNING:
                    raise _Refused(info)
                return instances.values[block.places]

            try:
                solution = solve(
                    once,
                    signals.values[block.places],
                    block.nominal,
                    instances.memory[number],
                    tolerance=self.tolerance,
                    max_iterations=self.max_iterations,
                    discrete=block.discrete,
                )
            except _Refused as refused:
                return refused.info
            if not solution.converged:
                if not np.isfinite(solution.value).all():
                    instances.signals(point.time + point.step_size)  # names the signal
                what = f"master iterative, {self.method}"
                remedy = "Take a smaller step size, or check what the loop consists of."
                raise not_converged(what, system, block.torn, solution, self.tolerance, point.time, remedy)
        return StepInfo(iterations=solution.iterations, residual=float(solution.residual.max()))

    def _solver(self, instances: Instances, block: Block) -> Solver:
        nominal = block.nominal[~block.discrete]
        if self.method == "fixed-point":
            return FixedPoint(self.relaxation)
        if self.method == "anderson":
            return Anderson(nominal, self.depth, self.relaxation)
        slope = None
        if self.derivatives == "offered" and not block.discrete.any():
            slope = sweep_slope(instances, block.order, block.torn)
        return Newton(nominal, slope)


class _Refused(Exception):
    """An instance did not finish its step."""

    def __init__(self, info: StepInfo) -> None:
        super().__init__()
        self.info = info


def _straighten(curve: Curve, places: NDArray[np.intp], instances: Instances) -> None:
    """Let signals run straight to the values that they have now; what is no real number jumps at once."""
    end = instances.values[places]
    curve.end[places] = end
    smooth = instances.layout.smooth[places]
    curve.middle[places] = np.where(smooth, 0.5 * (curve.begin[places] + end), end)
