"""The keys of a study of ports."""

from __future__ import annotations

from enum import Enum
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from .mapping import Column

FORMAT = "port-study/1"


class Role(Enum):
    """What a run is used for: fits see train and validation runs; held-out runs only measure the gap."""

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
        hold: whether the signal stays at each sample until the next one, as what a digital controller or a
            converter gives; else it goes along a curve through them. Matters where steps are shorter than
            samples are apart.
    """

    noise: float | None = None
    feed: bool | None = None
    start: bool = False
    hold: bool = False


class RunModel(BaseModel):
    """One of `runs`.

    Attributes:
        values: by parameter, or by output that takes a start value, where the run differs from the config.
    """

    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    file: str
    role: Role
    begin: Any = Field(None, alias="from")
    end: Any = Field(None, alias="to")
    without: list[str] = []
    repeats: str | None = None
    name: str | None = None
    values: dict[str, Any] = Field({}, alias="set")


class CalibratedModel(BaseModel):
    """One of `calibrated`."""

    model_config = ConfigDict(extra="forbid")

    tolerance: Any
    value: Any = None


class StudyModel(BaseModel):
    """A study.yaml; its parts are read one by one, so that what is wrong in one hides nothing in others."""

    model_config = ConfigDict(extra="forbid")

    format: Literal["port-study/1"]
    system: str
    overrides: list[str] = Field([], alias="set")
    columns: Any
    calibrated: dict[str, Any] = {}
    interval: Any = None
    settle: Any = None
    runs: list[Any]
    # Keys of an earlier search: accepted with a warning, without effect.
    candidates: Any = None
    motion: Any = None
    window: Any = None
    experiments: Any = None
    practice: Any = None


# Of a study, without effect.
UNUSED = ("candidates", "motion", "window", "experiments", "practice")
