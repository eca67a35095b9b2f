"""Content of diagnosis.json, checked when it is made and when it is read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from ...base.errors import Problem
from ...results.file_formats import strict
from ..study.mistakes import Warned

FORMAT = "gap-diagnosis/1"
# What is written, by name.
NAME, PAGE, AUGMENTED = "diagnosis.json", "report.html", "augmented.yaml"
# Least probability of something outside the catalogue that is mentioned beside another answer: one in thirty
# rigs without such an effect reaches it.
SUSPECTED = 0.2
# A gap smaller than this many times the noise floor is within the noise: it cannot be asked to shrink.
WITHIN = 1.5
# Probabilities are sums of floating-point numbers.
_ADDS_UP = 1e-9


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError(f"got {value}; a finite number is needed")
    return value


Number = Annotated[float, AfterValidator(_finite)]
Probability = Annotated[float, AfterValidator(_finite), Field(ge=0, le=1 + _ADDS_UP)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _Open(BaseModel):
    """A model that keeps further keys of an analysis."""

    model_config = ConfigDict(extra="allow")


class Share(_Part):
    """Share of the held-out closed-loop gap that a place causes; negative where it hides another's part."""

    place: str
    share: Number


class Which(_Part):
    """An answer to which effects cause the gap; none, or "outside" for one outside the catalogue."""

    effects: list[str]
    probability: Probability
    parameters: dict[str, Number]
    ties: list[str]


class Verdict(_Part):
    """The answer that the diagnosis names."""

    effects: list[str]
    places: list[str]


class Gap(_Open):
    """How far the gap shrinks.

    Attributes:
        before, after: of the model as calibrated, and with the effects added.
        noise_floor: of what does not repeat.
        noise_floor_from: its origin: repeats, the noise as specified, for some runs the one and for some
            the other, or nothing; "" where nothing was held out.
        closure: (before - after)/(before - noise_floor); None where the gap is within the noise.
        interval: 95 % of it.
        recalibration_only: closure by other calibrated numbers alone.
    """

    before: Number | None
    after: Number | None
    noise_floor: Number | None
    noise_floor_from: Literal["repeats", "specified", "both", "none", ""] = ""
    closure: Number | None
    interval: tuple[Number, Number] | None
    recalibration_only: Number | None
    within_floor: bool = False


class HowFar(Gap):
    """One contact ahead; and over complete runs."""

    full_run: Gap | None = None


class Experiment(_Open):
    """What to run next, and the evidence that it is expected to give between the tied candidates [nats].

    Attributes:
        leaves: pairs of them that it does not distinguish.
        then: the experiment for these, "" if there is none.
    """

    name: str
    description: str
    expected_evidence: Number | None
    between: list[str]
    leaves: list[list[str]] = []
    then: str = ""


class Numerics(_Open):
    """The co-simulation's own error, by step halving, as a fraction of the gap.

    Attributes:
        replay_change, replay_noise: that of a position over whole replays, and its noise [m], where known.
    """

    fraction: Number | None
    replay_change: Number | None = None
    replay_noise: Number | None = None


class LedgerRow(_Part):
    """Excess residual energy of a component in a phase of motion and a band, as a fraction of all of it."""

    component: str
    phase: str
    band: str
    share: Number


class Runnable(_Part):
    """The system with the effects added, as a config that runs.

    Attributes:
        file: beside diagnosis.json; run: whose mass, approach speed and duration it has.
        changed: what differs from the rig as its lab believes it to be, in words.
        left_out: what it does not hold, and why.
    """

    file: str
    run: str
    changed: list[str] = []
    left_out: dict[str, str] = {}


class Diagnosis(_Part):
    """diagnosis.json: its keys are these."""

    format: Literal["gap-diagnosis/1"] = FORMAT
    case: str
    verdict: Verdict
    where: list[Share]
    which: Annotated[list[Which], Field(min_length=1)]
    outside_place: str = ""
    answer_set: list[str]
    doubtful_tolerances: bool
    how_far: HowFar | None
    augmented: Runnable | None = None
    next_experiment: Experiment | None
    numerics: Numerics | None
    ledger: list[LedgerRow] = []
    energy: dict[str, Any] = {}
    misfit: dict[str, Number]
    calibration: dict[str, dict[str, Number]]
    data: list[Warned]
    left_out: dict[str, str] = {}
    provenance: dict[str, Any]

    def data_of(self) -> dict[str, Any]:
        """Plain values, as written to JSON."""
        return strict(self.model_dump(mode="json"))


def chance_outside(answers: Iterable[Any]) -> float:
    """Probability of something outside the catalogue, whatever acts beside it."""
    return sum(one.probability for one in answers if "outside" in one.effects)


def problems_of(error: ValidationError, place: str) -> list[Problem]:
    """Problems of data that pydantic rejected, each with its place."""
    found = []
    for one in error.errors():
        where: Mapping[str, Any] | tuple[Any, ...] = one["loc"]
        path = ".".join(str(part) for part in where)
        what = {"extra_forbidden": "unknown", "missing": "is missing"}.get(one["type"], one["msg"])
        found.append(Problem(f"{place}: {path}" if path else place, what))
    return found
