"""The form of a study file, checked by pydantic; `study` checks what depends on the system."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    StringConstraints,
    Tag,
    field_validator,
    model_validator,
)

from ..base.units import ONE, UnitError, parse_quantity, parse_unit
from ..config import Scalar

Ends = Annotated[list[Scalar], Field(min_length=2, max_length=2)]

# Points along one axis, far above any study.
_MOST = 10_000_000


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    def to_data(self) -> dict[str, Any]:
        """Plain values, as they stand in a file."""
        return self.model_dump(mode="python", by_alias=True, exclude_unset=True)

    def _one_of(self, names: tuple[str, ...]) -> str:
        given = [name for name in names if getattr(self, name) is not None]
        if len(given) != 1:
            spelt = ", ".join(type(self).model_fields[name].alias or name for name in names)
            raise ValueError(f"exactly one of {spelt} is needed, got {len(given)}")
        return given[0]


class RangeModel(_Model):
    """Values at equal distances, or at equal ratios."""

    low: Scalar = Field(alias="from", description="First value, with its unit.")
    high: Scalar = Field(alias="to", description="Last value, with its unit.")
    count: int = Field(ge=2, le=_MOST, strict=True, description="Number of values, both ends included.")
    spacing: Literal["linear", "log"] = Field(
        "linear", description="Whether differences or ratios of neighbours are equal."
    )


def _form(value: Any) -> str:
    return "[range]" if isinstance(value, RangeModel | Mapping) else "[list]"


# Problems are reported for the intended form only, not for both.
Values = Annotated[
    Annotated[list[Scalar], Field(min_length=1), Tag("[list]")] | Annotated[RangeModel, Tag("[range]")],
    Discriminator(_form),
]


class NormalModel(_Model):
    """A normal distribution, truncated if ends are given."""

    mean: Scalar = Field(description="Mean, with its unit.")
    std: Scalar = Field(description="Standard deviation, with its unit.")
    low: Scalar | None = Field(None, description="Lower end; no value below it is drawn.")
    high: Scalar | None = Field(None, description="Upper end; no value above it is drawn.")


class DrawnModel(_Model):
    """The distribution of a value: exactly one of these."""

    uniform: Ends | None = Field(None, description="Lower and upper end.")
    log_uniform: Ends | None = Field(
        None, alias="log-uniform", description="Lower and upper end; the logarithm is distributed uniformly."
    )
    normal: NormalModel | None = Field(None, description="A normal distribution.")
    choice: Annotated[list[Scalar], Field(min_length=1)] | None = Field(
        None, description="Values of equal probability."
    )

    @model_validator(mode="after")
    def _is_one(self) -> DrawnModel:
        self._one_of(("uniform", "log_uniform", "normal", "choice"))
        return self


class SampleModel(_Model):
    """Points that are drawn, all values of a point together."""

    count: int = Field(ge=1, le=_MOST, strict=True, description="Number of points.")
    seed: int = Field(ge=0, strict=True, description="The same one draws the same points.")
    over: dict[str, DrawnModel] = Field(min_length=1, description="Distribution by the config's path.")


class BlockModel(_Model):
    """Points of the design: one kind of block, or several blocks that multiply or follow each other."""

    grid: dict[str, Values] | None = Field(
        None, min_length=1, description="All combinations of the values given by path."
    )
    list_: list[Annotated[dict[str, Scalar], Field(min_length=1)]] | None = Field(
        None, min_length=1, alias="list", description="Points one by one, each its values by path."
    )
    random: SampleModel | None = Field(None, description="Points drawn independently.")
    latin_hypercube: SampleModel | None = Field(
        None, alias="latin-hypercube", description="Points drawn by Latin hypercube sampling."
    )
    sobol: SampleModel | None = Field(None, description="Points of a scrambled Sobol sequence.")
    multiply: list[BlockModel] | None = Field(
        None, min_length=1, description="Every point of each block with every one of the others."
    )
    add: list[BlockModel] | None = Field(None, min_length=1, description="The points of each block.")

    @model_validator(mode="after")
    def _is_one(self) -> BlockModel:
        self._one_of(("grid", "list_", "random", "latin_hypercube", "sobol", "multiply", "add"))
        return self


class RepeatsModel(_Model):
    """Every point several times, with seeds that differ; they are the same at every point."""

    count: int = Field(ge=1, le=_MOST, strict=True, description="Runs of each point.")
    seed: int = Field(ge=0, strict=True, description="Of the seeds that the runs receive.")
    into: Annotated[list[str], Field(min_length=1)] = Field(
        description="Paths of the config that take a seed, a whole number."
    )


class RecordModel(_Model):
    """Which part of the signals to keep."""

    every: int = Field(1, ge=1, strict=True, description="Every n-th recorded instant.")
    signals: Annotated[list[str], Field(min_length=1)] | None = Field(None, description="All by default.")


class RetryModel(_Model):
    """What to do about runs that fail."""

    attempts: int = Field(ge=1, le=20, strict=True, description="Attempts at most, the first included.")
    kinds: list[Literal["crash", "time limit", "error", "killed"]] = Field(
        ["crash", "time limit"],
        alias="on",
        min_length=1,
        description="Kinds of failure that are tried again.",
    )


class StudyModel(_Model):
    """A study: a system, the points at which it is run, and what is kept of each run."""

    format: Literal["sweep/1"] = Field(description="Format of the file.")
    title: str = Field("", description="What the study is, for reports.")
    system: str | dict[str, Any] = Field(
        description="A bundled system, a path relative to the study, or a config."
    )
    set_: dict[str, Scalar] = Field(
        default_factory=dict, alias="set", description="Changes of the config that hold in every run."
    )
    design: BlockModel = Field(description="The points at which the system is run.")
    repeats: RepeatsModel | None = Field(None, description="Repetition of every point with other seeds.")
    derived: dict[Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")], str] = Field(
        default_factory=dict, description="Quantities of each run by name, as expressions."
    )
    record: Literal["none", "decimated", "all"] | RecordModel = Field(
        "none", description="Signals that the store keeps of each run."
    )
    retry: RetryModel | None = Field(None, description="Which failed runs are tried again, and how often.")
    time_limit: str | None = Field(None, description="How long a run may take, with its unit.")
    step_halving: bool = Field(
        True, strict=True, description="Whether every run is made with half the step, too."
    )

    @field_validator("time_limit", mode="before")
    @classmethod
    def _is_time(cls, value: Any) -> Any:
        if value is None:
            return None
        try:
            quantity = parse_quantity(str(value))
            if quantity.unit == ONE:
                raise ValueError(f"{value!r} has no unit; write it as in '60 s'")
            seconds = quantity.exactly(parse_unit("s"))
        except UnitError as error:
            raise ValueError(f"{error}; write it as in '60 s'") from None
        if seconds <= 0 or not math.isfinite(float(seconds)):
            raise ValueError(f"{value!r} is not positive")
        return str(value)

    def seconds(self) -> float | None:
        """The time limit [s]."""
        if self.time_limit is None:
            return None
        return float(Fraction(parse_quantity(self.time_limit).exactly(parse_unit("s"))))
