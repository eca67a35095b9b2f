"""Runs of one FMU on its own, from its start or from where a run has brought it.

Two runs side by side that differ in an input show by how much the FMU's variables answer it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from ..base.arrays import Array
from ..base.errors import OrchestratorError
from ..fmi import FmuInstance, Point, StepStatus, Variable
from ..simulation.grid import Grid
from ..simulation.run import Prepared
from ..system.system import Instance

# Height of a step, relative to the input's value or its nominal one.
_HEIGHT = 1e-3
# Shares of it that are tried in turn, as long as the FMU refuses the step.
_SMALLER = (1.0, 0.1, 0.01)
_ROUNDING = 1e-13


def usual_size(value: float, variable: Variable) -> float:
    """The size of a variable's values, its unit: of its value, or its nominal one where that is about 0."""
    nominal = float(variable.nominal or 1.0)
    return abs(value) if abs(value) > 1e-12 * nominal else nominal


def step_all(instances: Sequence[FmuInstance], point: Point) -> bool:
    """Write the bound inputs of instances and step them; whether all of them took the step."""
    status = StepStatus.OK
    for instance in instances:
        instance.write_inputs()
        status = max(status, instance.do_step(point))
    return status <= StepStatus.WARNING


@dataclass(frozen=True)
class Alone:
    """An instance that runs on its own from the operating point.

    Attributes:
        one: the instance.
        prepared: the system; its grid begins at the operating point.
        inputs: that a connection feeds.
        read: real outputs that a connection reads.
        values: of states and inputs at the operating point, FMU's units.
    """

    one: Instance
    prepared: Prepared
    inputs: tuple[str, ...]
    read: tuple[str, ...]
    values: Mapping[str, Any]

    @property
    def begin(self) -> float:
        """Time of the operating point [s]."""
        return float(self.prepared.grid.start)

    @property
    def step(self) -> float:
        """The communication step [s]."""
        return float(self.prepared.grid.step_size)

    def resumed(self, running: Any, time: float) -> Alone | None:
        """The same, whose runs go on from a time of the run.

        Args:
            running: the instance as the run has brought it to this time [s].
        Returns: None if its FMU cannot save its state.
        """
        if not self.one.fmu.description.capabilities.serialise_state:
            return None
        state = running.save_state()
        try:
            data = running.serialise_state(state)
        finally:
            running.free_state(state)
        grid = Grid(Fraction(time), self.prepared.grid.step_size, self.prepared.grid.steps)
        prepared = replace(self.prepared, grid=grid)
        return replace(self, one=replace(self.one, fmu=_Resumed(self.one, data)), prepared=prepared)

    def started(
        self, begin: float, changes: Mapping[str, float], inputs: Array, stop: float | None = None
    ) -> FmuInstance:
        """An initialised instance whose connected inputs are bound to an array.

        Args: begin, stop: [s]; changes: start values beside those of the system, FMU's units.
        """
        instance = self.one.fmu.instantiate(f"{self.one.name} linearised")
        try:
            instance.bind(list(self.inputs), inputs, [], np.zeros(0))
            instance.enter_initialisation(begin, {**self.one.start, **changes}, stop)
            instance.exit_initialisation()
        except BaseException:
            instance.free()
            raise
        return instance

    def held(self) -> dict[str, float]:
        """Values of the connected inputs at the operating point, FMU's units."""
        return {name: float(self.values[name]) for name in self.inputs}

    def height(self, name: str) -> float:
        """Height of a step of an input, FMU's unit."""
        return _HEIGHT * usual_size(float(self.values[name]), self.one.variable(name))

    def answer(
        self,
        name: str,
        watched: Sequence[str],
        steps: int,
        moves: int,
        share: float = 1.0,
        settle: int = 0,
        fine: int = 1,
    ) -> Array:
        """By how much variables of two runs differ that differ in a step of an input.

        Args:
            name: the input.
            steps: most steps; moves: how many are taken after the first difference.
            share: of the usual height of the step, which becomes smaller if the FMU refuses it.
            settle: steps before it, which the result leaves out.
            fine: steps in a communication step.
        Returns: shape (steps + 1, watched), relative to the height.
        Raises: StepError if the FMU refuses to run on its own.
        """
        for smaller in _SMALLER:
            height = share * smaller * self.height(name)
            courses = [np.array([height if index >= settle else 0.0]) for index in range(settle + steps)]
            found: list[Array] = []
            moved = 0
            try:
                runs = self.differences([name], watched, courses, fine)
                for index, one_difference in enumerate(runs):
                    if index < settle:
                        continue
                    found.append(one_difference / height)
                    moved += bool(index > settle and np.max(abs(found[-1]), initial=0.0) > 0.0)
                    if moved > moves:
                        break
                break
            except OrchestratorError:
                if smaller == _SMALLER[-1]:
                    raise
        made = np.array(found or [np.zeros(len(watched))])
        size = np.max(abs(made), axis=0)
        made[:, size < 1e-12 * np.max(size, initial=0.0)] = 0.0
        return made

    def differences(
        self, names: Sequence[str], watched: Sequence[str], deviations: Iterable[Array], fine: float = 1
    ) -> Iterator[Array]:
        """By how much variables of two runs differ, at the start and after each step.

        Args:
            names: inputs that differ.
            deviations: by how much they differ over each step, shape (names,).
            fine: steps in a communication step.
        Yields: shape (watched,); fewer than there are deviations if the FMU ends.
        Raises: StepError if the FMU refuses to run on its own.
        """
        begin, step = self.begin, self.step / fine
        held = self.held()
        columns = [self.inputs.index(name) for name in names]
        inputs = [np.array(list(held.values())) for _ in range(2)]
        instances: list[FmuInstance] = []
        courses = list(deviations)
        try:
            for u in inputs:
                # On its own it may run longer than the system.
                stop = begin + (len(courses) + 1) * step
                instances.append(self.started(begin, held, u, stop))

            def difference() -> Array:
                fixed, changed = (
                    np.array([float(value) for value in instance.get_values(watched).values()])
                    for instance in instances
                )
                moved = changed - fixed
                # What rounding makes is no answer.
                return np.where(abs(moved) > _ROUNDING * abs(fixed), moved, 0.0)

            yield difference()
            for index, more in enumerate(courses):
                inputs[1][columns] = inputs[0][columns] + more
                if not step_all(instances, Point(index, begin + index * step, step)):
                    return
                yield difference()
        finally:
            for instance in instances:
                instance.free()

    def passage(self, name: str, output: str, low: float) -> float:
        """When a step of an input reaches an output, known to lie within a step after `low` [s]."""
        begin, step, held = self.begin, self.step, self.held()
        height, column = self.height(name), self.inputs.index(name)

        def reached(time: float) -> bool:
            ends = []
            for more in (0.0, height):
                inputs = np.array(list(held.values()))
                inputs[column] += more
                instance = self.started(begin, held, inputs)
                try:
                    instance.write_inputs()
                    whole = int(low / step + 0.5)
                    for index in range(whole):
                        instance.do_step(Point(index, begin + index * step, step))
                    instance.do_step(Point(whole, begin + whole * step, time - whole * step))
                    ends.append(float(instance.get_values([output])[output]))
                finally:
                    instance.free()
            return ends[0] != ends[1]

        early, late = low, low + step
        while late - early > 1e-7 * step:
            middle = 0.5 * (early + late)
            early, late = (early, middle) if reached(middle) else (middle, late)
        return late


class _Resumed:
    """An FMU whose instances go on from a saved state when they are initialised."""

    def __init__(self, one: Instance, state: bytes) -> None:
        self._fmu, self._start, self._state = one.fmu, one.start, state

    def __getattr__(self, name: str) -> Any:
        return getattr(self._fmu, name)

    def instantiate(self, name: str) -> FmuInstance:
        """See Fmu.instantiate."""
        instance: Any = self._fmu.instantiate(name)
        entered, initialised = instance.enter_initialisation, instance.exit_initialisation

        def enter_initialisation(begin: float, start: Any, stop: Any) -> None:
            # Values of a later time may be none that it can start from: they come with the state.
            entered(begin, self._start, stop)

        def exit_initialisation() -> None:
            initialised()
            state = instance.deserialise_state(self._state)
            instance.restore_state(state)
            instance.free_state(state)

        instance.enter_initialisation = enter_initialisation
        instance.exit_initialisation = exit_initialisation
        return instance
