"""Results that the parts of a diagnosis exchange."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .effect import Effect
from .study import Array, Nominal

# Tolerances from which a calibration is no longer believed.
_BENT = 5.0


@dataclass(frozen=True)
class Augmented:
    """The model with effects added and its calibration refitted.

    Attributes:
        calibrated: parameters by name, SI, those of the calibration that moved.
        effects, theta: what was added, and all parameters one after the other.
    """

    calibrated: Mapping[str, float]
    effects: tuple[Effect, ...]
    theta: Array


# The model as its lab believes it to be.
NOMINAL = Augmented({}, (), np.zeros(0))


@dataclass(frozen=True)
class Candidate:
    """One answer to which effects cause the gap.

    Attributes:
        effects: ids; none for "no effect", ("outside",) for one that the catalogue does not hold.
        parameters: fitted, by "effect-id.parameter", SI.
        ties: effects that the data cannot distinguish from these.
        log_evidence: over that of no effect [nats].
        model: what it was fitted as; None for "outside".
    """

    effects: tuple[str, ...]
    probability: float
    parameters: Mapping[str, float]
    ties: tuple[str, ...]
    log_evidence: float
    model: Augmented | None = None


@dataclass(frozen=True)
class Finding:
    """Which effects cause the gap.

    Attributes:
        candidates: most probable first; probabilities add up to 1.
        effects, places: the answer given.
        outside_place: where an effect outside the catalogue acts; "" if there is none.
        answer_set: names of the most probable answers that hold enough together, see `Calibration.enough`.
        recalibrated: the model without effects, its calibration refitted.
        doubtful_tolerances: whether calibrated parameters moved farther than their tolerances allow: while
            no effect explains it.
        misfit: mean square of what the answer leaves, normalised by the noise, by place.
        unjudged: why runs that no fit saw do not say what answers leave; "" if they do, or there are none.
    """

    candidates: tuple[Candidate, ...]
    effects: tuple[str, ...]
    places: tuple[str, ...]
    outside_place: str
    answer_set: tuple[str, ...]
    recalibrated: Augmented
    doubtful_tolerances: bool = False
    misfit: Mapping[str, float] = field(default_factory=dict)
    unjudged: str = ""

    @property
    def answer(self) -> Augmented:
        """The model of the answer; the recalibrated one if the answer names no effect."""
        for one in self.candidates:
            if set(one.effects) == set(self.effects) and one.model is not None:
                return one.model
        return self.recalibrated

    def faultless(self, nominal: Mapping[str, Nominal]) -> Augmented:
        """The answer's calibration without its effects: its gap is the one caused by the effects.

        The nominal one where the answer's lies far beyond its tolerances: it was bent to fit what it cannot
        explain, and residuals of such a model contain little information.
        """
        calibrated = self.answer.calibrated
        for name, value in calibrated.items():
            if abs(value - nominal[name].value) > _BENT * nominal[name].tolerance:
                return NOMINAL
        return Augmented(calibrated, (), np.zeros(0))


def name_of(effects: Sequence[str]) -> str:
    """A candidate by its effects."""
    return " + ".join(effects) or "none"


def most_probable(candidates: Sequence[Candidate], enough: float) -> tuple[str, ...]:
    """Names of the most probable candidates, until they hold as much probability.

    Args:
        candidates: most probable first.
    """
    found, held = [], 0.0
    for one in candidates:
        found.append(name_of(one.effects))
        held += one.probability
        if held >= enough:
            break
    return tuple(found)
