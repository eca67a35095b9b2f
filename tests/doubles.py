"""FMUs made of Python functions, for tests of everything that only sees the FmuInstance protocol."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from orchestrator.base.units import Unit, parse_unit
from orchestrator.fmi import (
    Array,
    Capabilities,
    Causality,
    Initial,
    Kind,
    ModelDescription,
    Point,
    StepStatus,
    Value,
    Variability,
    Variable,
)

State = dict[str, float]


def variable(name: str, causality: Causality, unit: str = "", **changes: Any) -> Variable:
    """A real variable; `changes` are further attributes."""
    made = Variable(
        name=name,
        reference=hash(name) & 0xFFFF,
        type="Float64",
        kind=Kind.REAL,
        causality=causality,
        variability=Variability.FIXED if causality is Causality.PARAMETER else Variability.CONTINUOUS,
        initial=Initial.EXACT if causality is not Causality.OUTPUT else Initial.CALCULATED,
        unit=parse_unit(unit) if unit else None,
        unit_name=unit,
        start=0.0,
    )
    return replace(made, **changes)


@dataclass(eq=False)
class FakeFmu:
    """An FMU whose behaviour is two functions of its values.

    Attributes:
        inputs, outputs, parameters: names and units.
        feedthrough: as in the model description; None: not declared.
        step: changes the values over a step, given (values, time, step size); may return a status.
        output: outputs as a function of the values.
        extra: further variables.
        reached: what instances give as their last successful time [s].
    """

    name: str = "Fake"
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, str] = field(default_factory=dict)
    display_units: Mapping[str, Mapping[str, Unit]] = field(default_factory=dict)
    feedthrough: Mapping[str, Sequence[str]] | None = field(default_factory=dict)
    step: Callable[[State, float, float], StepStatus | None] = lambda values, time, step_size: None
    output: Callable[[State], Mapping[str, float]] = lambda values: {}
    extra: Sequence[Variable] = ()
    capabilities: Capabilities = field(
        default_factory=lambda: Capabilities(save_state=True, variable_step_size=True)
    )
    path: None = None
    reached: float | None = None

    def __post_init__(self) -> None:
        made = [
            variable(name, causality, unit, display_units=self.display_units.get(name, {}))
            for causality, ports in (
                (Causality.INPUT, self.inputs),
                (Causality.OUTPUT, self.outputs),
                (Causality.PARAMETER, self.parameters),
            )
            for name, unit in ports.items()
        ]
        variables = {one.name: one for one in (*made, *self.extra)}
        every = tuple(one.name for one in variables.values() if one.causality is Causality.INPUT)
        outputs = [one.name for one in variables.values() if one.causality is Causality.OUTPUT]
        declared = self.feedthrough
        through = {name: every if declared is None else tuple(declared.get(name, ())) for name in outputs}
        self.description = ModelDescription(
            name=self.name,
            fmi_version="3.0",
            token="",
            model_identifier=self.name,
            variables=variables,
            feedthrough=through,
            initial_feedthrough=through,
            assumed=frozenset(outputs) if declared is None else frozenset(),
            capabilities=self.capabilities,
        )
        self.alive: list[str] = []
        self.calls: list[tuple[str, str]] = []

    def instantiate(self, name: str) -> FakeInstance:
        self.alive.append(name)
        return FakeInstance(name, self)

    def checksum(self) -> str:
        return f"fake:{self.name}"


class FakeInstance:
    """An instance of a FakeFmu; notes the calls it gets in `fmu.calls`."""

    def __init__(self, name: str, fmu: FakeFmu) -> None:
        self.name, self.fmu, self.description = name, fmu, fmu.description
        self.values: State = {one.name: one.start or 0.0 for one in fmu.description.variables.values()}
        self.log: list[str] = []
        self.bind((), np.zeros(0), (), np.zeros(0))

    def _note(self, call: str) -> None:
        self.fmu.calls.append((self.name, call))

    def bind(self, inputs: Sequence[str], u: Array, outputs: Sequence[str], y: Array) -> None:
        self.inputs, self.u, self.outputs, self.y = inputs, u, outputs, y

    def enter_initialisation(
        self, start_time: float, start_values: Mapping[str, Value], stop_time: float | None = None
    ) -> None:
        self.values.update(start_values)  # type: ignore[arg-type]

    def exit_initialisation(self) -> None:
        self._note("exit_initialisation")

    def set_values(self, values: Mapping[str, Value]) -> None:
        self._note(f"set {' '.join(values)}")
        self.values.update(values)  # type: ignore[arg-type]

    def get_values(self, names: Sequence[str]) -> dict[str, Value]:
        self._note(f"get {' '.join(names)}")
        self.values.update(self.fmu.output(self.values))
        return {name: self.values[name] for name in names}

    def write_inputs(self) -> None:
        self.values.update(zip(self.inputs, self.u.tolist(), strict=True))

    def do_step(self, point: Point) -> StepStatus:
        self._note("step")
        status = self.fmu.step(self.values, point.time, point.step_size)
        return StepStatus.OK if status is None else status

    def read_outputs(self) -> None:
        self.values.update(self.fmu.output(self.values))
        self.y[:] = [self.values[name] for name in self.outputs]

    def save_state(self) -> State:
        return dict(self.values)

    def restore_state(self, state: State) -> None:
        self.values = dict(state)

    def free_state(self, state: State) -> None:
        state.clear()

    def terminate(self) -> None:
        self._note("terminate")

    def free(self) -> None:
        if self.name in self.fmu.alive:
            self.fmu.alive.remove(self.name)

    def log_lines(self) -> tuple[str, ...]:
        return tuple(self.log)

    def last_successful_time(self) -> float | None:
        return self.fmu.reached


def gain(factor: float = 1.0, unit_in: str = "", unit_out: str = "", **changes: Any) -> FakeFmu:
    """Y = factor * u, without delay."""
    return FakeFmu(
        **{
            "name": "Gain",
            "inputs": {"u": unit_in},
            "outputs": {"y": unit_out},
            "feedthrough": {"y": ["u"]},
            "output": lambda values: {"y": factor * values["u"]},
            **changes,
        }
    )


def mass(value: float = 1.0, **changes: Any) -> FakeFmu:
    """A free mass under a held force, solved exactly; no feedthrough."""

    def step(values: State, time: float, h: float) -> None:
        acceleration = values["force"] / value
        values["position"] += h * values["velocity"] + 0.5 * h * h * acceleration
        values["velocity"] += h * acceleration

    states = [
        variable(name, Causality.OUTPUT, unit, initial=Initial.EXACT)
        for name, unit in (("position", "m"), ("velocity", "m/s"))
    ]
    return FakeFmu(**{"name": "Mass", "inputs": {"force": "N"}, "extra": states, "step": step, **changes})


def spring(stiffness: float = 1.0) -> FakeFmu:
    """Force = -stiffness * position, without delay."""
    return FakeFmu(
        name="Spring",
        inputs={"position": "m"},
        outputs={"force": "N"},
        feedthrough={"force": ["position"]},
        output=lambda values: {"force": -stiffness * values["position"]},
    )
