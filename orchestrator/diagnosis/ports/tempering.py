"""From the evidence of a system's logs to probabilities; what practice on simulated cases taught of it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ...errors import ConfigError, Problem, listed
from ..study import Array

__all__ = ["FORMAT", "Tempering", "read_practice"]

FORMAT = "port-practice/1"


class _Weighable(Protocol):
    @property
    def effects(self) -> tuple[str, ...]: ...

    @property
    def gain(self) -> float: ...


@dataclass(frozen=True)
class Tempering:
    """How log evidences become probabilities.

    The score of an answer is its log evidence over T = temperature + growth times the root of the best one,
    since a real effect's form is not quite a candidate's, less `price` times the logarithm of the number of
    candidates for each effect. Something outside the candidates scores what the best answer has, and
    `sharpness` times what that leaves of the excess over the noise beyond the share `left`. A share `floor`
    of the probability is spread evenly.
    """

    temperature: float = 1.5
    growth: float = 0.05
    price: float = 1.0
    left: float = 0.3
    sharpness: float = 40.0
    floor: float = 0.002

    def scores(self, answers: Sequence[_Weighable], candidates: int) -> Array:
        """Scores of answers, shape (answers,)."""
        gains = np.array([one.gain for one in answers])
        temperature = self.temperature + self.growth * math.sqrt(max(float(gains.max()), 0.0))
        price = self.price * math.log(max(candidates, 2))
        return gains / temperature - price * np.array([len(one.effects) for one in answers])

    def probabilities(self, answers: Sequence[_Weighable], candidates: int, share: float) -> Array:
        """Probabilities of answers and, last, of something outside, shape (answers + 1,).

        Args:
            answers: none first.
            candidates: how many effects there are to choose from.
            share: of the excess over the noise that the best answer leaves.
        """
        scores = self.scores(answers, candidates)
        outside = scores.max() + self.sharpness * (share - self.left)
        p = np.exp(np.array([*scores, outside]) - max(scores.max(), outside))
        p /= p.sum()
        return (1.0 - self.floor) * p + self.floor / len(p)

    def data(self) -> dict[str, float]:
        """Its numbers, by name."""
        return asdict(self)


def read_practice(path: Path, effects: Sequence[str]) -> tuple[Tempering, Mapping[str, Any]]:
    """What practice taught, and the file's whole content.

    Args:
        effects: ids of the study's candidates; the file must be of the same ones.
    Raises: ConfigError if the file is of another kind, or of other candidates.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise ConfigError([Problem(f"{path}: format", f"got {data['format']!r}", FORMAT)])
        made = Tempering(**{name: float(value) for name, value in data["tempering"].items()})
        practised = set(data["effects"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        remedy = "`orchestrator diagnose STUDY --practice N --out DIR` writes one."
        raise ConfigError(
            [Problem(str(path), f"is no result of practice ({error})", FORMAT, remedy)]
        ) from None
    other = practised ^ set(effects)
    if other:
        what = f"was practised with other candidates: {listed(sorted(other), 10)}"
        raise ConfigError([Problem(str(path), what, remedy="Practise again.")])
    return made, data
