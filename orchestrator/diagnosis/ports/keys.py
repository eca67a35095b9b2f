"""The keys of a study of ports."""

from __future__ import annotations

from enum import Enum
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from ..mapping import Column

__all__ = ["FORMAT", "SPEEDS", "Logged", "Role", "StudyModel"]

FORMAT = "port-study/1"
# Units by which motion is told: that of the speed that goes with each.
SPEEDS = {"m": "m/s", "m/s": "m/s", "rad": "rad/s", "rad/s": "rad/s"}


class Role(Enum):
    """What a run is used for: fits see train, choices validation, too; held-out runs only tell the gap."""

    TRAIN = "train"
    VALIDATION = "validation"
    HELDOUT = "held-out"
    REPEAT = "repeat"


class Logged(Column):
    """Where the signal of a port is found in the logs, and what it is for; see `Column` for the other keys.

    Attributes:
        noise: of the log [the port's unit], one standard deviation; outputs that have it are compared.
        feed: whether the log takes the place of the system's own signal wherever that goes. By default so,
            but for outputs that are compared.
        start: whether the first sample is the start value of this output in each run.
    """

    noise: float | None = Field(None, gt=0)
    feed: bool | None = None
    start: bool = False


class _RunModel(BaseModel):
    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    file: str
    role: Role
    begin: str | None = Field(None, alias="from")
    end: str | None = Field(None, alias="to")
    without: list[str] = []
    repeats: str | None = None
    name: str | None = None


class _Calibrated(BaseModel):
    model_config = ConfigDict(extra="forbid")

    tolerance: Any
    value: Any = None


class _Candidates(BaseModel):
    model_config = ConfigDict(extra="forbid")

    only: list[str] = []
    without: list[str] = []
    parameters: dict[str, Any] = {}


class _Motion(BaseModel):
    model_config = ConfigDict(extra="forbid")

    port: str
    rest: Any = None


class _Experiment(BaseModel):
    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    name: str
    description: str = ""
    overrides: list[str] = Field([], alias="set")


class StudyModel(BaseModel):
    """A study.yaml."""

    model_config = ConfigDict(extra="forbid")

    format: Literal["port-study/1"]
    system: str
    overrides: list[str] = Field([], alias="set")
    columns: Any
    calibrated: dict[str, _Calibrated] = {}
    settle: str | None = None
    runs: list[_RunModel] = Field(min_length=1)
    candidates: _Candidates = _Candidates()
    motion: _Motion | None = None
    window: str | None = None
    experiments: list[_Experiment] = []
    practice: str | None = None
