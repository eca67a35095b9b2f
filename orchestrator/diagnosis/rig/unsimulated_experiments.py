"""The next experiment where no law can be simulated: random effects, unknown effects, doubtful tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .catalogue import catalogue
from .finding import Candidate, Finding, name_of
from .menu import Experiment
from .study import Role, Study

# Experiments in which a place acts without those around it, best first.
_ALONE = {
    "link": ("free-flight chirp",),
    "robot": ("free-flight chirp", "slow reversals"),
    "structure": ("dead weights with tip tracker", "tip tracker"),
    "sensor": ("dead weights", "hammer"),
    "contact": ("pressed chirp", "slow approach"),
    "dynamics": ("off-axis contact", "heavy satellite"),
    "controller": ("slow approach",),
}
# Calibrated numbers by what they are of; the rest are the contact's.
_OF = {
    "natural_frequency": "robot",
    "damping_ratio": "robot",
    "response_delay": "robot",
    "sensor_delay": "sensor",
    "sensor_cutoff": "sensor",
    "force_bias": "sensor",
}


def without_rival(study: Study, finding: Finding, among: Sequence[Experiment]) -> dict[str, Any] | None:
    """The experiment that would say more about an answer without a rival.

    - Of an effect that draws, evidence grows with the samples: the runs again give as much as they gave.
    - An effect outside the catalogue, or a doubtful calibration, has no law to simulate: an experiment in
      which the place acts by itself shows it, with evidence that nobody can foretell.

    Returns: as `experiments.next_experiment`; None where nothing is in doubt.
    """
    if not finding.candidates:
        return None
    first = finding.candidates[0]
    if any(name in catalogue() and catalogue()[name].statistic for name in first.effects):
        return _again(study, finding, first)
    if first.effects == ("outside",):
        return _alone(finding.outside_place, ["outside", "none"], among)
    if finding.doubtful_tolerances:
        return _alone(_place_of_largest_deviation(study, finding), ["none", "other tolerances"], among)
    return None


def _again(study: Study, finding: Finding, first: Candidate) -> dict[str, Any]:
    others = [one for one in finding.candidates[1:] if one.effects != ("outside",)]
    rival = max(others, key=lambda one: one.log_evidence, default=None)
    evidence = first.log_evidence - (rival.log_evidence if rival is not None else 0.0)
    name = name_of(rival.effects if rival is not None else ())
    ticks = sum(len(run) for run in study.of(Role.TRAIN))
    return {
        "name": "the same runs again",
        "description": f"{ticks} more ticks of the same kind: evidence of what draws grows with its samples",
        "expected_evidence": float(evidence),
        "between": [name_of(first.effects), name],
        "evidence": {name: float(evidence)},
        "menu": {},
        "leaves": [],
        "then": "",
    }


def _alone(place: str, between: list[str], among: Sequence[Experiment]) -> dict[str, Any] | None:
    offered = {one.name: one for one in among}
    chosen = [offered[name] for name in _ALONE.get(place, ()) if name in offered]
    if not chosen:
        return None
    return {
        "name": chosen[0].name,
        "description": f"{chosen[0].description}; it shows {place} by itself",
        "expected_evidence": None,
        "between": between,
        "evidence": {},
        "menu": {},
        "leaves": [],
        "then": chosen[1].name if len(chosen) > 1 else "",
    }


def _place_of_largest_deviation(study: Study, finding: Finding) -> str:
    """The place of the calibrated number that moved farthest, in tolerances."""
    moves = {
        name: abs(value - study.nominal[name].value) / study.nominal[name].tolerance
        for name, value in finding.recalibrated.calibrated.items()
        if name in study.nominal and study.nominal[name].tolerance > 0.0
    }
    return _OF.get(max(moves, key=moves.__getitem__), "contact") if moves else ""
