"""From evidence to probabilities: what was learned of how far evidence can be trusted."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from .study import Array

__all__ = ["Calibration", "Weighable", "calibration"]

_FILE = Path(__file__).parent / "calibration.json"


class Weighable(Protocol):
    """What a probability is made of: see `answers.Answer`."""

    effects: tuple[str, ...]
    gain: float
    left: float


@dataclass(frozen=True)
class Calibration:
    """How log evidences become probabilities.

    The score of an answer is its log evidence over T = temperature + growth (best log evidence)^`power`: a
    real effect's form is not quite the catalogue's, and what that costs grows with the effect. Effects have a
    price: the first of them `first`, the second `second`, each further one `further`. Something outside the
    catalogue scores what the best answer of its group has, less `outside`, plus `slope` times ln(1 + u), u
    the unexplained log likelihood over (1 + best log evidence)^`share`. A share `floor` of the probability
    is spread evenly.

    Attributes:
        roughness: of rigs that hide nothing, one standard deviation as a share of an effect's prior, by id.
    """

    temperature: float = 1.5
    growth: float = 0.05
    power: float = 0.5
    first: float = 4.0
    second: float = 5.0
    further: float = 8.0
    outside: float = 8.0
    slope: float = 1.5
    share: float = 0.3
    floor: float = 0.002
    roughness: Mapping[str, float] = field(default_factory=dict)

    def price(self, effects: int) -> float:
        """What so many effects cost, in all groups of logs together."""
        if effects == 0:
            return 0.0
        second = self.second if effects > 1 else 0.0
        return self.first + second + max(effects - 2, 0) * self.further

    def scores(self, answers: Sequence[Weighable], beside: float) -> Array:
        """Scores of a group's answers and, last, of something outside the catalogue.

        Args:
            answers: none first.
            beside: log evidence of something outside that no answer could explain [nats].
        Returns: the price of effects is taken off that of outside only, whose price is that of the answer
            that it stands beside, shape (answers + 1,).
        """
        gains = np.array([one.gain for one in answers])
        best = max(float(gains.max()), 0.0)
        scores = gains / (self.temperature + self.growth * best**self.power)
        priced = scores - [self.price(len(one.effects)) for one in answers]
        top = int(np.argmax(priced))
        # Much stays unexplained of a strong effect whose form is not quite the textbook's.
        u = (answers[top].left + beside) / (1.0 + best) ** self.share
        outside = priced[top] - self.outside + self.slope * math.log1p(u)
        return np.array([*scores, outside])

    def probabilities(self, answers: Sequence[Weighable], beside: float) -> Array:
        """Probabilities of the answers of a group that stands alone and, last, of something outside."""
        scores = self.scores(answers, beside)
        scores[:-1] -= [self.price(len(one.effects)) for one in answers]
        return self.spread(scores)

    def spread(self, scores: Array) -> Array:
        """Probabilities from scores, prices taken off."""
        p = np.exp(scores - scores.max())
        p /= p.sum()
        return (1.0 - self.floor) * p + self.floor / len(p)

    def save(self, path: Path = _FILE, **provenance: object) -> None:
        """Write what was learned, and how."""
        text = json.dumps({"format": "weigh/2", **asdict(self), "provenance": provenance}, indent=1)
        path.write_text(text + "\n", encoding="utf-8")


@lru_cache(maxsize=1)
def calibration() -> Calibration:
    """What comes with the product; `python -m orchestrator.diagnosis.calibrate` learns it anew."""
    data = json.loads(_FILE.read_text(encoding="utf-8"))
    return Calibration(**{name: data[name] for name in Calibration.__dataclass_fields__})
