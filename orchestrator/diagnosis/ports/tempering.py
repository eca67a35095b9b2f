"""From the evidence of a system's logs to probabilities; what practice on simulated cases taught of it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ...base.digests import digest_of
from ...base.errors import ConfigError, Problem, listed
from ...results.file_formats import strict
from ..study import Array

__all__ = ["FORMAT", "Tempering", "digest", "read_practice", "sealed"]

FORMAT = "port-practice/3"
_AGAIN = "Practise again: `orchestrator diagnose STUDY --practice N --out DIR`."


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


def digest(data: Any) -> str:
    """Digest of plain values, whatever the order of their keys."""
    return digest_of(json.dumps(strict(data), sort_keys=True).encode())


def sealed(data: Mapping[str, Any]) -> dict[str, Any]:
    """Content of practice.json with the checksum of all else in it, as `sha256`."""
    return {**strict(data), "sha256": digest(data)}


def read_practice(
    path: Path, effects: Sequence[str], system: Mapping[str, str]
) -> tuple[Tempering, Mapping[str, Any]]:
    """What practice taught, and the file's whole content.

    Args:
        effects: ids of the study's candidates; system: digests of its parts, see `practice.parts_of`. The
            file must be of the same ones.
    Raises: ConfigError if the file is of another kind, was changed, or is of other candidates or another
        system.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise ConfigError([Problem(f"{path}: format", f"got {data['format']!r}", FORMAT, _AGAIN)])
        made = Tempering(**{name: float(value) for name, value in data["tempering"].items()})
        practised, parts = set(data["effects"]), dict(data["system"])
        whole = digest({name: value for name, value in data.items() if name != "sha256"}) == data["sha256"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            [Problem(str(path), f"is no result of practice ({error})", FORMAT, _AGAIN)]
        ) from None
    other = practised ^ set(effects)
    changed = [name for name in system if parts.get(name) != system[name]]
    what = ""
    if not whole:
        what = "was changed after it was written"
    elif other:
        what = f"was practised with other candidates: {listed(sorted(other), 10)}"
    elif changed:
        what = f"was practised on another system, which differs in: {listed(changed)}"
    if what:
        raise ConfigError([Problem(str(path), what, remedy=_AGAIN)])
    return made, data
