"""The shape of a study file, checked by pydantic; what only the system can tell is checked in `study`."""

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

__all__ = ["BlockModel", "DrawnModel", "RangeModel", "RepeatsModel", "SampleModel", "StudyModel"]

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

    low: Scalar = Field(alias="from")
    high: Scalar = Field(alias="to")
    count: int = Field(ge=2, le=_MOST, strict=True)
    spacing: Literal["linear", "log"] = "linear"


def _form(value: Any) -> str:
    return "[range]" if isinstance(value, RangeModel | Mapping) else "[list]"


# What is wrong is told of the form that was meant, not of both.
Values = Annotated[
    Annotated[list[Scalar], Field(min_length=1), Tag("[list]")] | Annotated[RangeModel, Tag("[range]")],
    Discriminator(_form),
]


class NormalModel(_Model):
    """A normal distribution, cut off if wanted."""

    mean: Scalar
    std: Scalar
    low: Scalar | None = None
    high: Scalar | None = None


class DrawnModel(_Model):
    """What a value is drawn from."""

    uniform: Ends | None = None
    log_uniform: Ends | None = Field(None, alias="log-uniform")
    normal: NormalModel | None = None
    choice: Annotated[list[Scalar], Field(min_length=1)] | None = None

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
    random: SampleModel | None = None
    latin_hypercube: SampleModel | None = Field(None, alias="latin-hypercube")
    sobol: SampleModel | None = None
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

    count: int = Field(ge=1, le=_MOST, strict=True)
    seed: int = Field(ge=0, strict=True)
    into: Annotated[list[str], Field(min_length=1)] = Field(
        description="Paths of the config that take a seed, a whole number."
    )


class RecordModel(_Model):
    """Which part of the signals to keep."""

    every: int = Field(1, ge=1, strict=True, description="Every n-th recorded instant.")
    signals: Annotated[list[str], Field(min_length=1)] | None = Field(None, description="All by default.")


class RetryModel(_Model):
    """What to do about runs that fail."""

    attempts: int = Field(ge=1, le=20, strict=True)
    kinds: list[Literal["crash", "time limit", "error", "killed"]] = Field(
        ["crash", "time limit"], alias="on", min_length=1
    )


class StudyModel(_Model):
    """A study: a system, the points at which it is run, and what is kept of each run."""

    format: Literal["sweep/1"]
    title: str = ""
    system: str | dict[str, Any] = Field(
        description="A bundled system, a path relative to the study, or a config."
    )
    set_: dict[str, Scalar] = Field(
        default_factory=dict, alias="set", description="Changes of the config that hold in every run."
    )
    design: BlockModel
    repeats: RepeatsModel | None = None
    derived: dict[Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")], str] = Field(
        default_factory=dict, description="Quantities of each run by name, as expressions."
    )
    record: Literal["none", "decimated", "all"] | RecordModel = "none"
    retry: RetryModel | None = None
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
