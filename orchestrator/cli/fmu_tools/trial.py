"""An FMU on trial, within the process that runs it: made, driven by seeded inputs, and read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...fmi import (
    Array,
    CompiledFmu,
    Interface,
    Kind,
    ModelDescription,
    Point,
    RunOptions,
    StepStatus,
    load_fmu,
)
from .stimulus import stimulus

# Steps that make a trajectory.
_FEWEST = 4
_MOST_SIGNALS = 200
# Where an FMU proposes no step: that of control loops.
_USUAL_STEP = 1e-3
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Conditions:
    """Under which an FMU is tried.

    Attributes:
        steps: of a trajectory; fewer where the FMU ends the simulation before.
        step_size: [s]; None: what the FMU is made for or proposes, else 1 ms.
        seed: of the inputs.
        amplitude: of the inputs over their nominal values.
    """

    steps: int = 50
    step_size: float | None = None
    seed: int = 1
    amplitude: float = 1.0


class Ended(Exception):
    """A step that the FMU discarded, or at which it asked to end the simulation."""

    def __init__(self, status: StepStatus, steps: int) -> None:
        self.status, self.steps = status, steps
        super().__init__(f"step {steps + 1}: {status.name.lower()}")


def fmu_for_trial(path: Path, run_options: RunOptions = RunOptions()) -> CompiledFmu:  # noqa: B008 (it is frozen)
    """An FMU, with a tolerance where its integration needs one and it proposes none. Raises: FmuError."""
    fmu = load_fmu(path, run_options)
    if fmu.description.interface is Interface.MODEL_EXCHANGE and not fmu.description.tolerance:
        fmu = load_fmu(path, replace(run_options, tolerance=run_options.tolerance or _TOLERANCE))
    return fmu


def step_size_of(description: ModelDescription, wanted: float | None = None) -> float:
    """The step size [s] to try an FMU with."""
    return wanted or description.own_step or description.default_step or _USUAL_STEP


def signals_of(description: ModelDescription) -> list[str]:
    """What of an FMU is watched: its numeric outputs, or, where it has none, its other variables."""
    numeric = [one for one in description.variables.values() if one.kind.numeric and not one.shape]
    outputs = [one.name for one in description.outputs if one.kind.numeric and not one.shape]
    return (
        outputs
        or [one.name for one in numeric if one.causality.value in ("local", "parameter")][:_MOST_SIGNALS]
    )


class Trial:
    """An FMU under given conditions.

    Attributes:
        inputs, outputs: names of the numeric ports that are driven and watched.
        step: size of a step [s].
    """

    def __init__(
        self,
        fmu: CompiledFmu,
        conditions: Conditions,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
    ) -> None:
        """
        Args:
            inputs, outputs: what is driven and watched; None: all that is numeric.
        """
        self.fmu = fmu
        self.description = fmu.description
        self.conditions = conditions
        self.step = step_size_of(self.description, conditions.step_size)
        numeric = [one.name for one in self.description.inputs if one.kind.numeric and not one.shape]
        self.inputs = numeric if inputs is None else list(inputs)
        self.reals = [name for name in self.inputs if self.description.variables[name].kind is Kind.REAL]
        self.outputs = signals_of(self.description) if outputs is None else list(outputs)

    def point(self, index: int, divided: int = 1) -> Point:
        """A communication point, of steps that are divided."""
        return Point(index, index * self.step / divided, self.step / divided)

    @contextmanager
    def made(self, name: str = "one") -> Iterator[Any]:
        """A new instance with its ports bound; its memory is `u` and `y`. It is freed at the end."""
        instance = self.fmu.instantiate(name)
        try:
            self.bind(instance)
            yield instance
        finally:
            instance.free()

    def bind(self, instance: Any) -> None:
        """Tie the ports to memory, `instance.u` and `instance.y`."""
        instance.u, instance.y = np.zeros(len(self.inputs)), np.zeros(len(self.outputs))
        instance.bind(self.inputs, instance.u, self.outputs, instance.y)

    def initialise(self, instance: Any, rows: Array | None = None) -> Array:
        """From a new or reset instance to the first communication point; its outputs there.

        Args:
            rows: of inputs, the first of which is sent; None: the FMU keeps its own.
        """
        instance.enter_initialisation(0.0, {})
        if rows is not None:
            self.feed_start(instance, rows)
        instance.exit_initialisation()
        instance.read_outputs()
        return instance.y.copy()

    def feed_start(self, instance: Any, rows: Array) -> None:
        """Send the first row of inputs during initialisation."""
        variables = self.description.variables
        whole = {
            name: float(value) if variables[name].kind is Kind.REAL else round(float(value))
            for name, value in zip(self.inputs, rows[0], strict=True)
        }
        instance.u[:] = rows[0]
        instance.set_values(whole)

    def drive(
        self, instance: Any, rows: Array, first: int = 0, last: int | None = None, divided: int = 1
    ) -> Array:
        """Take steps; the outputs after each, shape (last - first, outputs).

        Args:
            rows: inputs per step, shape (steps, inputs), held within it.
            divided: steps that each of them is divided into.
        Raises: StepError; Ended.
        """
        last = len(rows) if last is None else last
        seen = np.empty((last - first, len(self.outputs)))
        for index in range(first, last):
            if self.inputs:
                instance.u[:] = rows[index]
                instance.write_inputs()
            for part in range(divided):
                status = instance.do_step(self.point(index * divided + part, divided))
                if status > StepStatus.WARNING:
                    raise Ended(status, index - first)
            instance.read_outputs()
            seen[index - first] = instance.y
        return seen

    def trajectory(self, rows: Array, divided: int = 1) -> Array:
        """Outputs of a new instance at every communication point, shape (steps + 1, outputs)."""
        with self.made("one") as instance:
            start = self.initialise(instance, rows)
            return np.vstack([start, self.drive(instance, rows, divided=divided)])

    def rows_of(self, amplitude: float, steps: int, seed: int = 0) -> Array:
        """Inputs, shape (steps, inputs)."""
        return stimulus(
            [self.description.variables[name] for name in self.inputs],
            steps,
            amplitude,
            self.conditions.seed + seed,
        )

    def steps_taken(self, rows: Array | None = None) -> int:
        """How many steps the FMU takes before it asks to end the simulation.

        Args:
            rows: of inputs; None: those of the conditions.

        Raises: StepError if it refuses one; Ended if it discards one, or ends after too few to judge it by.
        """
        try:
            self.trajectory(self.rows if rows is None else rows)
        except Ended as end:
            if end.steps >= _FEWEST and end.status is StepStatus.TERMINATED:
                return end.steps
            raise
        return self.conditions.steps

    @cached_property
    def rows(self) -> Array:
        """The inputs of every trajectory, shape (steps, inputs)."""
        return self.rows_of(self.conditions.amplitude, self.conditions.steps)

    @cached_property
    def base(self) -> Array:
        """The trajectory that others are compared with."""
        return self.trajectory(self.rows)

    def difference(self, one: Array, other: Array) -> tuple[str, int] | None:
        """The first output and row in which two trajectories differ in any bit; None if in none."""
        differs = ~((one == other) | (np.isnan(one) & np.isnan(other)))
        if not differs.any():
            return None
        row = int(np.argmax(differs.any(axis=1)))
        return self.outputs[int(np.argmax(differs[row]))], row
