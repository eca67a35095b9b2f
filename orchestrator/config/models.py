"""The form of configs, checked by pydantic; `orchestrator.system` checks what depends on FMUs."""

from __future__ import annotations

from collections.abc import Container, Iterable
from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, StringConstraints, field_validator, model_validator

from .base import Model, Time, checked_time, exact_time
from .external import ExternalModel, RealtimeModel

Scalar = bool | int | float | str
# Of an array; that of two dimensions row by row.
StartValue = Scalar | list[Scalar | list[Scalar]]


class RunModel(Model):
    """How to run: no master and no step size is right for every system, so none is the default."""

    master: str | dict[str, Any] = Field(
        description="Master algorithm: its name, or its name and options.",
        examples=["gauss-seidel", {"name": "iterative", "tolerance": 1e-8}],
    )
    step_size: Time = Field(description="Communication step size with its unit.")
    stop_time: Time = Field(
        description="Stop time with its unit; an integer number of steps after the start."
    )
    start_time: Time = Field("0 s", description="Start time with its unit.")
    record: Literal["all"] | list[str] = Field(
        "all", description="Signals to record, as instance.variable; all outputs by default."
    )
    record_every: int = Field(1, ge=1, strict=True, description="Record every n-th communication point.")
    loop: Literal["auto", "python", "native"] = Field(
        "auto",
        description="What runs the steps: the interpreter, or machine code, which only compiled FMUs and the "
        "masters jacobi and gauss-seidel can use; results are the same. auto: whichever is faster.",
    )

    unconnected: Literal["keep", "error"] = Field(
        "keep",
        description="Inputs without a connection and without a value under `start` keep the start value that "
        "their FMU declares, or are errors.",
    )
    realtime: RealtimeModel | None = Field(
        None, description="Pace the run by the clock; as fast as it goes if not given."
    )

    @field_validator("step_size", "stop_time", "start_time", mode="before")
    @classmethod
    def _is_time(cls, value: Any) -> str:
        return checked_time(value)

    @field_validator("master", mode="before")
    @classmethod
    def _is_master(cls, value: Any) -> Any:
        if isinstance(value, str) or (isinstance(value, dict) and isinstance(value.get("name"), str)):
            return value
        raise ValueError(f"a name, or {{name: ..., and options}} is needed, got {value!r}")

    @property
    def master_name(self) -> str:
        """The name of the master algorithm."""
        return self.master if isinstance(self.master, str) else self.master["name"]

    def times(self) -> tuple[Fraction, Fraction, Fraction]:
        """Start time, stop time and step size [s], exact as written."""
        return exact_time(self.start_time), exact_time(self.stop_time), exact_time(self.step_size)


class InstanceModel(Model):
    """One running FMU."""

    fmu: str = Field(
        description="Name of a bundled FMU, or path of a .fmu file relative to the config, or of a .csv "
        "file, whose columns are outputs over time."
    )
    form: Literal["python", "native"] | None = Field(
        None,
        description="Form of a bundled FMU that was written in Python: python runs its source, native is "
        "compiled from it and much faster; python unless said otherwise.",
    )
    start: dict[str, StartValue] = Field(
        default_factory=dict,
        description="Start values, with units, of parameters, of inputs that stay constant and of states; "
        "of an array as a list.",
        examples=[{"omega_n": "75 Hz", "xi_n": 0.8, "tau_m": "2 ms"}],
    )
    step_size: Time | None = Field(
        None,
        description="The instance's own step size with its unit: a multiple of the communication step "
        "size, or an integer fraction of it; the communication step size if not given.",
    )
    feedthrough: dict[str, list[str]] = Field(
        default_factory=dict,
        description="Per output, the inputs on which it depends within one instant, where the FMU does not "
        "say so or says it wrongly.",
        examples=[{"force": []}],
    )

    @field_validator("step_size", mode="before")
    @classmethod
    def _is_time(cls, value: Any) -> str | None:
        return None if value is None else checked_time(value)

    def own_step(self) -> Fraction | None:
        """The instance's own step size [s], exact as written."""
        return None if self.step_size is None else exact_time(self.step_size)

    interface: Literal["co-simulation", "model-exchange"] | None = Field(
        None, description="Which of the FMU's interfaces to run; by default co-simulation if there is one."
    )
    tolerance: float | None = Field(
        None,
        gt=0,
        lt=1,
        description="Relative tolerance of the integration of a model-exchange FMU; by default that of "
        "the FMU's default experiment, else 1e-6.",
    )
    event_mode: bool = Field(
        False,
        strict=True,
        description="Whether an FMI 3.0 co-simulation FMU returns at its events to have them handled; "
        "otherwise it handles them within its steps.",
    )
    any_step: bool = Field(
        False,
        strict=True,
        description="Whether the FMU takes any constant step size, although it does not declare so.",
    )
    isolate: Literal["process"] | None = Field(
        None, description="Run the FMU in a process of its own, so that its crash or hang ends only the run."
    )
    time_limit: Time | None = Field(
        None, description="How long a call to an isolated FMU may take, with its unit.", examples=["2 s"]
    )

    @field_validator("time_limit", mode="before")
    @classmethod
    def _is_limit(cls, value: Any) -> Any:
        if value is None:
            return None
        text = checked_time(value)
        if exact_time(text) <= 0:
            raise ValueError(f"{value!r} is not positive")
        return text

    @model_validator(mode="after")
    def _is_consistent(self) -> InstanceModel:
        if self.time_limit is not None and self.isolate is None:
            raise ValueError("time_limit needs isolate: process; only another process can be stopped")
        return self

    def seconds(self) -> float | None:
        """The time limit [s]."""
        return None if self.time_limit is None else float(exact_time(self.time_limit))


class SourceModel(Model):
    """One of several sources of a connection, which are added."""

    port: str = Field(description="instance.output")
    gain: int | float | str = Field(
        1, description="What it is multiplied by, with a unit or without.", examples=[-1, "2 N/m"]
    )


class ConnectionModel(Model):
    """One connection, in long form."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    source: str | Annotated[list[str | SourceModel], Field(min_length=1)] = Field(
        alias="from", description="instance.output, or several, which are added."
    )
    target: str = Field(alias="to", description="instance.input")
    through: list[Any] = Field(
        default_factory=list,
        description="Effects on the values, in the order in which they work.",
        examples=[[{"delay": "1 ms"}, {"low-pass": "200 Hz"}]],
    )


Arrow = Annotated[
    str, StringConstraints(pattern=r"^[^>]+->[^>]+$"), Field(description="instance.output -> instance.input")
]


class BondModel(Model):
    """A power bond: connections on which an effort and the motion that it works on go round."""

    name: str = Field("", description="Of the bond; by default source-receiver.")
    effort: Arrow | Annotated[list[Arrow], Field(min_length=1)] = Field(
        description="The connection of the effort, or the connections that lead it from source to receiver."
    )
    flow: str | list[Arrow] = Field(
        min_length=1,
        description="The connections of the receiver's flow or displacement back to the source, or an "
        "output of the receiver, instance.variable, that the source does not read.",
    )
    sign: Literal[1, -1] = Field(
        1, description="-1 where a positive effort along the flow takes energy from the receiver."
    )
    displacement: bool | None = Field(
        None, description="If units are ambiguous: whether `flow` is a displacement, whose rate is the flow."
    )

    def effort_legs(self) -> list[str]:
        """The connections of the effort."""
        return [self.effort] if isinstance(self.effort, str) else self.effort

    def flow_legs(self) -> list[str]:
        """The connections of the motion; none if it is a port."""
        if isinstance(self.flow, str):
            return [self.flow] if "->" in self.flow else []
        return self.flow

    def flow_port(self) -> str | None:
        """The motion, where it is a port."""
        return self.flow.strip() if isinstance(self.flow, str) and "->" not in self.flow else None


class SystemModel(Model):
    """A system of connected FMUs, how to run it and what to measure."""

    title: str = Field("", description="What the system is, for figures and reports.")
    run: RunModel = Field(description="Step size, stop time, master and recording.")
    instances: dict[
        Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$")], InstanceModel
    ] = Field(min_length=1, description="Running FMUs by name; Gauss-Seidel masters keep to this order.")
    external: dict[Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$")], ExternalModel] = (
        Field(
            default_factory=dict,
            description="Other programs and rigs, reached over UDP; connected as instances are.",
        )
    )
    connections: list[Arrow | ConnectionModel] = Field(
        default_factory=list,
        description="What passes values between instances: `a.y -> b.u`, or in long form with effects.",
        examples=[["a.y -> b.u", {"from": "b.y", "to": "a.u", "through": [{"delay": "1 ms"}]}]],
    )
    bonds: Literal["auto"] | list[BondModel] = Field(
        "auto",
        description="Connections that carry energy, for the coupling ledger; by default those that units "
        "and connections determine.",
    )
    measures: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="Post-processing by name, each with its options."
    )

    @model_validator(mode="after")
    def _is_named_once(self) -> SystemModel:
        named_twice(self.instances, self.external)
        return self

    def to_data(self) -> dict[str, Any]:
        """Plain values, as they stand in a file: what was not given is not filled in; of a draft, too."""
        return self.model_dump(mode="python", by_alias=True, exclude_unset=True, warnings=False)


def named_twice(instances: Container[str], external: Iterable[str]) -> None:
    """Raises: ValueError if an instance and an external one have the same name."""
    both = [name for name in external if name in instances]
    if both:
        raise ValueError(f"{both[0]} names an instance and an external one; each needs a name of its own")
