"""Scores verdicts against what the cases hid."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scipy.stats import binomtest

from ....base.errors import ConfigError, Problem
from ..verdict import NAME, SUSPECTED, chance_outside
from .cases import check_record
from .evidence import CLEAR
from .seal import note_opening, open_truth, truth_digest
from .verdict import Answer, Verdict, names, read_verdict

# By magnitude: name and lower bound.
BANDS = (("strong", 0.5), ("medium", 0.2), ("weak", 0.08), ("faint", 0.0))
_BINS = 10
# Of what is right, to see what calibration error chance alone makes.
_DRAWS = 2000
# Width of the titles of figures.
_TITLE = 35


@dataclass(frozen=True)
class Marked:
    """A case with its truth and its verdict."""

    name: str
    truth: Mapping[str, Any]
    verdict: Verdict

    @property
    def kind(self) -> str:
        """Kind of the hidden effects: none, single, pair or outside."""
        return self.truth["kind"]

    @property
    def clear(self) -> bool:
        """Whether the logs hold enough evidence."""
        return self.truth["evidence"] >= CLEAR

    def separable(self, key: str) -> bool:
        """Whether the logs can separate the hidden effects from any effect of the catalogue.

        Args:
            key: "beyond": from any single effect; "beyond_two": from any two.
        """
        return self.truth.get(key, self.truth["evidence"]) >= CLEAR

    def named_by(self, answers: Iterable[Answer]) -> bool:
        """Whether one of these answers names the hidden effects, with declared ties."""
        return any(names(one.effects, one.ties, self.truth["effects"]) for one in answers)

    @property
    def effect_right(self) -> bool:
        """Whether the verdict names the hidden effects, with declared ties."""
        return names(self.verdict.effects, self.verdict.ties, self.truth["effects"])

    @property
    def place_right(self) -> bool:
        """Whether the verdict names the places; the place of an effect named through a tie counts."""
        if self.verdict.places == set(self.truth["places"]):
            return True
        return self.kind in ("single", "pair") and self.effect_right

    @property
    def suspects(self) -> bool:
        """Whether the verdict names something outside the catalogue, or mentions it beside its answer."""
        return "outside" in self.verdict.effects or chance_outside(self.verdict.answers) >= SUSPECTED

    @property
    def confidence(self) -> float:
        """Probability of the first candidate with those that it cannot be distinguished from."""
        first = self.verdict.answers[0]
        return min(
            sum(
                one.probability
                for one in self.verdict.answers
                if one is first or names(first.effects, first.ties, one.effects)
            ),
            1.0,
        )

    @property
    def first_right(self) -> bool:
        """Whether the first candidate names the hidden effects, with declared ties."""
        return self.named_by(self.verdict.answers[:1])

    @property
    def first_itself(self) -> tuple[float, bool]:
        """Probability of the first candidate alone, and whether it is the hidden one, without ties."""
        first = self.verdict.answers[0]
        return first.probability, sorted(first.effects) == self.truth["effects"]


def _across(one: Marked) -> bool:
    return one.kind == "pair" and one.clear and len(one.truth["places"]) > 1


def _within(one: Marked) -> bool:
    return one.kind == "pair" and one.clear and len(one.truth["places"]) == 1


def _outside(one: Marked) -> bool:
    return "outside" in one.verdict.effects


# Cases that rates are of; the logs of those called own separate what is hidden from the catalogue.
_GROUPS: dict[str, Callable[[Marked], bool]] = {
    "all": lambda one: True,
    "single": lambda one: one.kind == "single" and one.clear,
    "pair": lambda one: one.kind == "pair" and one.clear,
    "across": _across,
    "across_own": lambda one: _across(one) and one.separable("beyond"),
    "within": _within,
    "within_own": lambda one: _within(one) and one.separable("beyond"),
    "none": lambda one: one.kind == "none",
    "outside": lambda one: one.kind == "outside" and one.clear,
    "outside_own": lambda one: one.kind == "outside" and one.separable("beyond"),
    "outside_no_two": lambda one: one.kind == "outside" and one.separable("beyond_two"),
    "inside": lambda one: one.kind != "outside",
    "tight": lambda one: one.truth["tight"] > 1.0,
    "sound": lambda one: one.truth["tight"] == 1.0,
}
# Name of a rate, its title, the cases that it is of, and what is counted.
_RATES: tuple[tuple[str, str, str, Callable[[Marked], bool]], ...] = (
    ("place_right", "place right (single, clear)", "single", lambda one: one.place_right),
    ("effect_right", "effect right (single, clear)", "single", lambda one: one.effect_right),
    ("top_two", "among the first two", "single", lambda one: one.named_by(one.verdict.answers[:2])),
    ("pairs_across", "both of a pair, two places", "across", lambda one: one.effect_right),
    ("pairs_across_own", "the same, where none imitates both", "across_own", lambda one: one.effect_right),
    ("pairs_within", "both of a pair, one place", "within", lambda one: one.effect_right),
    ("pairs_within_own", "the same, where none imitates both", "within_own", lambda one: one.effect_right),
    ("pairs_one_named", "at least one of a pair", "pair",
     lambda one: bool(one.verdict.effects & set(one.truth["effects"]))),
    ("false_alarms", "false alarms (nothing hidden)", "none", lambda one: bool(one.verdict.effects)),
    ("outside_flagged", "outside flagged", "outside", _outside),
    ("outside_flagged_own", "the same, where none imitates it", "outside_own", _outside),
    ("outside_flagged_no_two", "the same, nor two together", "outside_no_two", _outside),
    ("outside_suspected", "outside flagged or suspected", "outside", lambda one: one.suspects),
    ("outside_place_right", "place of outside right", "outside", lambda one: one.place_right),
    ("outside_false", "outside, though in the catalogue", "inside", _outside),
    ("suspected_false", "the same, or suspected", "inside", lambda one: one.suspects),
    ("doubtful_tight", "tight tolerances doubted", "tight", lambda one: one.verdict.doubtful),
    ("doubtful_false", "sound tolerances doubted", "sound", lambda one: one.verdict.doubtful),
    ("coverage", "95 % sets name the truth", "all", lambda one: one.named_by(one.verdict.answer_set)),
    ("coverage_without_ties", "the same, ties not counted", "all",
     lambda one: any(one.truth["effects"] == sorted(each.effects) for each in one.verdict.answer_set)),
)  # fmt: skip


def score(folder: Path, verdicts: Path) -> dict[str, Any]:
    """Score the verdicts on a folder of cases; the truth is opened after their digests are in the ledger.

    Args:
        verdicts: holds <case>/diagnosis.json for every case.
    Raises: ConfigError with every verdict that is missing, cannot be read or is of another case; the truth
        then stays sealed.
    """
    sealed = truth_digest(folder)
    cases = sorted(path.parent.name for path in folder.glob("*/case.yaml"))
    problems: list[Problem] = []
    if not cases:
        problems.append(Problem(str(folder), "holds no cases"))
    found: dict[str, Verdict] = {}
    missing = []
    for case in cases:
        path = verdicts / case / NAME
        if not path.is_file():
            missing.append(case)
            continue
        try:
            found[case] = read_verdict(path)
        except ConfigError as error:
            problems += error.problems
    if missing:
        shown = ", ".join(missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
        problems.append(
            Problem(
                str(verdicts),
                f"{len(missing)} of {len(cases)} verdicts are missing: {shown}",
                "the truth is opened after all verdicts are written",
                "Run `orchestrator challenge run` first.",
            )
        )
    try:
        check_record([folder / case for case in cases], verdicts)
    except ConfigError as error:
        problems += error.problems
    if problems:
        raise ConfigError(problems)
    blind = note_opening(folder, {case: verdict.digest for case, verdict in found.items()})
    truth = open_truth(folder)["cases"]
    if set(truth) != set(cases):
        differ = ", ".join(sorted(set(truth) ^ set(cases))[:5])
        raise ConfigError(
            [Problem(str(folder), f"cases and truth differ: {differ}", "cases as they were made")]
        )
    marked = [Marked(case, truth[case], found[case]) for case in cases]
    return {"truth": sealed, "blind": blind, **figures(marked), "each": [_line(one) for one in marked]}


def figures(marked: Sequence[Marked]) -> dict[str, Any]:
    """All figures of a score: rates with their counts and 95 % Wilson intervals."""
    right = [one for one in marked if one.kind in ("single", "pair") and one.effect_right]
    closed = [one.verdict for one in right if one.verdict.closure is not None]
    recalibrated = [one.recalibration for one in closed if one.recalibration is not None]
    sizes = [len(one.verdict.answer_set) for one in marked]
    return {
        "cases": {kind: sum(one.kind == kind for one in marked) for kind in _kinds(marked)},
        **{
            name: _rate([one for one in marked if _GROUPS[group](one)], test)
            for name, _, group, test in _RATES
        },
        "ece": _ece([(one.confidence, one.first_right) for one in marked]),
        "ece_exact": _ece_exact([one.confidence for one in marked]),
        "calibration_rms": _rms_debiased([(one.confidence, one.first_right) for one in marked]),
        "ece_without_ties": _ece([one.first_itself for one in marked]),
        "set_size": sum(sizes) / len(marked),
        "set_size_median": median(sizes),
        "closure_median": median(one.closure for one in closed) if closed else None,
        "recalibration_median": median(recalibrated) if recalibrated else None,
        "bands": {name: _band(marked, name) for name, _ in BANDS},
    }


def _band(marked: Sequence[Marked], name: str) -> dict[str, Any]:
    here = [one for one in marked if one.kind != "none" and band(one.truth["magnitude"]) == name]
    single = [one for one in here if one.kind == "single"]
    return {
        "cases": len(here),
        "clear": sum(one.clear for one in here),
        "effect_right": _rate([one for one in single if one.clear], lambda one: one.effect_right),
        "wrongly_named": _rate(single, lambda one: bool(one.verdict.effects) and not one.effect_right),
        "coverage": _rate(here, lambda one: one.named_by(one.verdict.answer_set)),
        "ece": _ece([(one.confidence, one.first_right) for one in here]),
        "claimed": sum(one.confidence for one in here) / len(here) if here else None,
        "first_right": _rate(here, lambda one: one.first_right),
    }


def band(magnitude: float) -> str:
    """Name of the band of a magnitude."""
    return next(name for name, low in BANDS if magnitude >= low)


def _kinds(marked: Iterable[Marked]) -> list[str]:
    return sorted({one.kind for one in marked})


def _rate(group: Sequence[Marked], test: Callable[[Marked], bool]) -> dict[str, Any] | None:
    if not group:
        return None
    count = sum(test(one) for one in group)
    interval = binomtest(count, len(group)).proportion_ci(method="wilson")
    return {
        "rate": count / len(group),
        "count": count,
        "of": len(group),
        "interval": [round(float(interval.low), 4), round(float(interval.high), 4)],
    }


def _ece(group: Sequence[tuple[float, bool]]) -> float | None:
    """Expected calibration error of confidences, in ten bins of equal width (Naeini et al., 2015)."""
    if not group:
        return None
    total = 0.0
    for index in range(_BINS):
        here = [one for one in group if min(int(one[0] * _BINS), _BINS - 1) == index]
        total += abs(sum(confidence for confidence, _ in here) - sum(right for _, right in here))
    return total / len(group)


def _ece_exact(confidences: Sequence[float]) -> dict[str, float] | None:
    """Calibration error of exactly calibrated confidences on as many cases.

    Returns: its mean over draws of what is right, and what 95 % of the draws stay below.
    """
    if not confidences:
        return None
    p = np.array(confidences)
    right = np.random.default_rng(0).random((_DRAWS, len(p))) < p
    index = np.minimum((p * _BINS).astype(int), _BINS - 1)
    # By bin: how far the number of right ones is from what was stated.
    deviations = np.abs((right - p) @ np.eye(_BINS)[index]).sum(axis=1) / len(p)
    return {"mean": float(deviations.mean()), "most": float(np.quantile(deviations, 0.95))}


def _rms_debiased(group: Sequence[tuple[float, bool]]) -> float | None:
    """Root mean square calibration error without its bias by chance (Kumar, Liang and Ma, 2019).

    In the bins of `_ece` the square of what was stated too much, less the variance that the share of right
    ones has by chance; 0 where chance makes more. Bins of a single case say nothing.
    """
    if not group:
        return None
    p, right = (np.array(one, float) for one in zip(*group, strict=True))
    bins = np.eye(_BINS)[np.minimum((p * _BINS).astype(int), _BINS - 1)]
    bins = bins[:, bins.sum(axis=0) > 1.0]
    count = bins.sum(axis=0)
    share = right @ bins / count
    beyond = (p @ bins / count - share) ** 2 - share * (1.0 - share) / (count - 1.0)
    return math.sqrt(max(float(count @ beyond) / len(p), 0.0))


def _line(one: Marked) -> dict[str, Any]:
    return {
        "case": one.name,
        "kind": one.kind,
        "hides": one.truth["hides"],
        "magnitude": one.truth["magnitude"],
        "evidence": one.truth["evidence"],
        "beyond": one.truth.get("beyond"),
        "like": one.truth.get("like"),
        "beyond_two": one.truth.get("beyond_two"),
        "like_two": one.truth.get("like_two"),
        "answer": sorted(one.verdict.effects),
        "ties": sorted(one.verdict.ties),
        "confidence": one.confidence,
        "place_right": one.place_right,
        "effect_right": one.effect_right,
        "covered": one.named_by(one.verdict.answer_set),
        "verdict": one.verdict.digest,
    }


def score_text(found: Mapping[str, Any]) -> str:
    """The figures as a table."""
    kinds = ", ".join(f"{count} {kind}" for kind, count in found["cases"].items())
    blind = "" if found["blind"] else "; NOT blind: the truth had been opened before for other verdicts"
    lines = [f"{kinds}{blind}"]
    lines += [f"{title:<{_TITLE}} {_shown(found[name])}" for name, title, _, _ in _RATES]
    sizes = f"{found['set_size']:.2f}, median {found['set_size_median']:g}"
    lines.append(f"{'mean size of those sets':<{_TITLE}} {sizes}")
    lines.append(f"{'expected calibration error':<{_TITLE}} {found['ece']:.3f}")
    exact = found["ece_exact"]
    lines.append(
        f"{'of exact ones, as many cases':<{_TITLE}} {exact['mean']:.3f}, 95 % below {exact['most']:.3f}"
    )
    lines.append(f"{'the same, ties not counted':<{_TITLE}} {found['ece_without_ties']:.3f}")
    lines.append(f"{'its root mean square beyond chance':<{_TITLE}} {found['calibration_rms']:.3f}")
    for name, title in (
        ("closure_median", "closure, median where right"),
        ("recalibration_median", "recalibration alone"),
    ):
        lines.append(f"{title:<{_TITLE}} {'-' if found[name] is None else format(found[name], '.3f')}")
    lines.append("")
    lines.append(
        f"{'magnitude':<9} {'cases':>5} {'clear':>5}  {'effect right':<16} {'wrongly named':<16} "
        f"{'95 % sets':<16} first answer: claimed, right"
    )
    for name, low in BANDS:
        one = found["bands"][name]
        keys = ("effect_right", "wrongly_named", "coverage", "first_right")
        shown = [_shown(one[key], short=True) for key in keys]
        claimed = "-" if one["claimed"] is None else format(one["claimed"], ".2f")
        lines.append(
            f"{name:<9} {one['cases']:>5} {one['clear']:>5}  {shown[0]:<16} {shown[1]:<16} {shown[2]:<16} "
            f"{claimed}, {shown[3]}   (from {low:g})"
        )
    lines.append(f"clear: the logs hold at least {CLEAR:g} nats for who knew the effect")
    lines.append(
        "imitated: they do not hold as much over the likest effect of the catalogue, alone or with another"
    )
    return "\n".join(lines)


def _shown(rate: Mapping[str, Any] | None, short: bool = False) -> str:
    if rate is None:
        return "-"
    text = f"{rate['rate']:.3f} ({rate['count']}/{rate['of']})"
    low, high = rate["interval"]
    return text if short else f"{text}  [{low:.3f}, {high:.3f}]"


def write_score(path: Path, found: Mapping[str, Any]) -> None:
    """Write score.json."""
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
