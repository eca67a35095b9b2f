"""From evidence to probabilities: what was learned of how far evidence can be trusted."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from .study import Array

__all__ = ["Calibration", "Weighable", "calibration"]

_FILE = Path(__file__).parent / "calibration.json"


class Weighable(Protocol):
    """What a probability is made of: see `weigh.Answer`."""

    effects: tuple[str, ...]
    gain: float
    left: float


@dataclass(frozen=True)
class Calibration:
    """How log evidences become probabilities.

    The score of an answer with n effects is gain/T - first - (n - 1) further, T = temperature + growth
    sqrt(best gain); none scores zero. Outside scores what the best answer has, less `outside` plus `slope`
    times ln(1 + u), u the unexplained log likelihood over (1 + best gain)^`share`. A share `floor` of
    the probability is spread evenly over all answers.
    """

    temperature: float = 1.5
    growth: float = 0.05
    first: float = 4.0
    further: float = 4.0
    outside: float = 12.0
    slope: float = 2.0
    share: float = 0.3
    floor: float = 0.002

    def probabilities(self, answers: Sequence[Weighable], beside: float) -> Array:
        """Probabilities of the answers and, last, of an effect outside the catalogue.

        Args:
            answers: none first.
            beside: log evidence of something outside that no answer could explain [nats].
        """
        best = max(max(one.gain for one in answers), 0.0)
        temperature = self.temperature + self.growth * math.sqrt(best)
        scores = [answers[0].gain / temperature]
        for one in answers[1:]:
            scores.append(one.gain / temperature - self.first - (len(one.effects) - 1) * self.further)
        top = int(np.argmax(scores))
        # Much stays unexplained of a strong effect whose form is not quite the textbook's.
        u = answers[top].left / (1.0 + best) ** self.share
        outside = scores[top] - self.outside + self.slope * math.log1p(u)
        outside = max(outside, scores[top] - self.outside + beside)
        every = np.array([*scores, outside])
        every = np.exp(every - every.max())
        p = every / every.sum()
        return (1.0 - self.floor) * p + self.floor / len(p)

    def save(self, path: Path = _FILE, **provenance: object) -> None:
        """Write what was learned, and how."""
        text = json.dumps({"format": "weigh/1", **asdict(self), "provenance": provenance}, indent=1)
        path.write_text(text + "\n", encoding="utf-8")


@lru_cache(maxsize=1)
def calibration() -> Calibration:
    """What comes with the product; `python -m orchestrator.diagnosis.calibrate` learns it anew."""
    data = json.loads(_FILE.read_text(encoding="utf-8"))
    return Calibration(**{name: data[name] for name in Calibration.__dataclass_fields__})
