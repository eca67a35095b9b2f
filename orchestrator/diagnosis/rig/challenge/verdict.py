"""Reads verdicts (diagnosis.json), and says whether an answer names what a case hides."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

from ....base.digests import digest_of
from ....base.errors import ConfigError, Problem

_SET = 0.95


@dataclass(frozen=True)
class Answer:
    """One candidate: effects, its probability, and its ties, which the data cannot separate."""

    effects: frozenset[str]
    probability: float
    ties: frozenset[str]


@dataclass(frozen=True)
class Verdict:
    """Answer of a diagnosis for a case.

    Attributes:
        effects, places: the answer given; ties: those of the candidate that it is.
        answers: all candidates, most probable first.
        closure, recalibration: share of the gap closed one contact ahead, by the answer and by recalibration
            alone; None where it could not be reported.
        doubtful: whether it doubts the tolerances of the calibration.
        answer_set: the answers that it cannot exclude; where it names none, the most probable ones that hold
            95 % of the probability.
    """

    effects: frozenset[str]
    places: frozenset[str]
    ties: frozenset[str]
    answers: tuple[Answer, ...]
    closure: float | None
    recalibration: float | None
    doubtful: bool
    answer_set: tuple[Answer, ...]
    digest: str


def names(answer: Collection[str], ties: Collection[str], truth: Collection[str]) -> bool:
    """Whether an answer names the truth: the same effects, or as many, with missing ones declared as ties."""
    missing = set(truth) - set(answer)
    return len(set(answer)) == len(set(truth)) and missing <= set(ties)


def read_verdict(path: Path) -> Verdict:
    """Read a diagnosis.json.

    Raises: ConfigError that names what is missing or wrong.
    """
    data = path.read_bytes()
    try:
        content = json.loads(data)
    except ValueError as error:
        raise ConfigError([Problem(str(path), f"is no JSON: {error}")]) from None
    place = str(path)
    try:
        place = f"{path}: verdict"
        given = content["verdict"]
        effects, places = frozenset(given["effects"]), frozenset(given["places"])
        doubtful = bool(content.get("doubtful_tolerances", False))
        place = f"{path}: which"
        answers = tuple(
            Answer(frozenset(one["effects"]), float(one["probability"]), frozenset(one["ties"]))
            for one in content["which"]
        )
        place = f"{path}: how_far"
        far = content.get("how_far")
        declared = [str(one) for one in content.get("answer_set", ())]
        closure, recalibration = _number(far, "closure"), _number(far, "recalibration_only")
    except (KeyError, TypeError, ValueError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise ConfigError([Problem(place, what, "the keys that `orchestrator diagnose` writes")]) from None
    problems = []
    total = sum(one.probability for one in answers)
    if not answers or not abs(total - 1.0) <= 1e-3 or min(one.probability for one in answers) < 0.0:
        problems.append(
            Problem(f"{path}: which", f"probabilities add up to {total:.6g}", "1, none of them negative")
        )
    if [one.probability for one in answers] != sorted((one.probability for one in answers), reverse=True):
        problems.append(
            Problem(f"{path}: which", "is not in the order of probability", "most probable first")
        )
    if problems:
        raise ConfigError(problems)
    ties = next((one.ties for one in answers if one.effects == effects), frozenset())
    chosen = answer_set(answers, declared)
    return Verdict(effects, places, ties, answers, closure, recalibration, doubtful, chosen, digest_of(data))


def answer_set(answers: Sequence[Answer], declared: Sequence[str] = ()) -> tuple[Answer, ...]:
    """See `Verdict.answer_set`.

    Args:
        answers: most probable first.
        declared: names of answers, as "none" or "sensor.bias + sensor.gain".
    """
    if declared:
        of = {frozenset() if one == "none" else frozenset(one.split(" + ")) for one in declared}
        return tuple(one for one in answers if one.effects in of)
    held = list(accumulate(one.probability for one in answers))
    enough = next((place for place, total in enumerate(held) if total >= _SET - 1e-9), len(answers) - 1)
    return answers[: enough + 1]


def _number(far: object, name: str) -> float | None:
    if far is not None and not isinstance(far, Mapping):
        raise TypeError(f"got {far!r}")
    value = (far or {}).get(name)
    if isinstance(value, Mapping):
        value = value.get("closure")
    return None if value is None else float(value)
