"""Content of diagnosis.json, from a finding and the results of the analyses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ...base.digests import file_digest
from ...base.errors import OrchestratorError
from ...base.provenance import origin, versions
from ...results.file_formats import strict
from ..study.mistakes import Warned
from .finding import Finding
from .study import Nominal
from .verdict import Diagnosis, Runnable, Share, Verdict, Which, problems_of

_PACKAGES = ("orchestrator", "numpy", "numba", "scipy", "pydantic")
# Answers less probable than this are not reported.
_SHOWN = 1e-6


def content(
    case: str,
    finding: Finding,
    nominal: Mapping[str, Nominal],
    results: Mapping[str, Any],
    left_out: Mapping[str, str],
    warned: list[Warned],
    augmented: Runnable,
    origins: Mapping[str, Any],
) -> Diagnosis:
    """A diagnosis as it is written.

    Args:
        results: of the analyses by name, see `verdict.Diagnosis`; left_out: why others have none.
        nominal: all that is calibrated; what has no tolerance is left out.
        warned: what a reader should know of the logs; origins: see `provenance`.
    Raises: OrchestratorError if parts of it contradict each other.
    """
    which = _which(finding)
    others = {name: one for name, one in results.items() if name != "where"}
    shares = sorted(results.get("where", {}).items(), key=lambda item: -item[1])
    plain = strict(
        {
            "how_far": None,
            "next_experiment": None,
            "numerics": None,
            **others,
            "left_out": left_out,
            "answer_set": finding.answer_set,
            "misfit": finding.misfit,
            "calibration": _calibration(finding, nominal),
            "provenance": origins,
        }
    )
    try:
        return Diagnosis(
            case=case,
            verdict=Verdict(effects=list(finding.effects), places=list(finding.places)),
            where=[Share(place=place, share=share) for place, share in shares],
            which=which,
            outside_place=finding.outside_place,
            doubtful_tolerances=finding.doubtful_tolerances,
            augmented=augmented,
            data=warned,
            **plain,
        )
    except ValidationError as error:
        problems = problems_of(error, f"{case}: the diagnosis contradicts itself")
        raise OrchestratorError("\n".join(str(one) for one in problems)) from error


def named_files(folder: Path, paths: Iterable[Path]) -> dict[str, Path]:
    """Paths of files, relative to a folder if they are in it; of ROS bags, which are folders, all files."""
    inner = [file for path in paths for file in ([path] if path.is_file() else sorted(path.rglob("*")))]
    files = [file for file in inner if file.is_file()]
    return {(one.relative_to(folder) if one.is_relative_to(folder) else one).as_posix(): one for one in files}


def provenance(files: Mapping[str, Path]) -> dict[str, Any]:
    """Software of a diagnosis, and digests of the files that were read, by the names that stand for them."""
    digests = {name: file_digest(path) for name, path in files.items()}
    return {**origin(), "packages": versions(_PACKAGES), "sha256": digests}


def _which(finding: Finding) -> list[Which]:
    """Answers, most probable first, less the least probable ones; the others' probabilities add up to 1."""
    ranked = sorted(finding.candidates, key=lambda one: -one.probability)
    shown = [one for one in ranked if one.probability >= _SHOWN] or ranked[:1]
    total = sum(one.probability for one in shown)
    return [
        Which(
            effects=list(one.effects),
            probability=one.probability / total if total > 0 else 1.0 / len(shown),
            parameters={name: float(value) for name, value in one.parameters.items()},
            ties=list(one.ties),
        )
        for one in shown
    ]


def _calibration(finding: Finding, nominal: Mapping[str, Nominal]) -> dict[str, dict[str, float]]:
    """Calibrated numbers: as believed, tolerance, with the answer and without effects."""
    values = {}
    for name, one in nominal.items():
        if one.tolerance > 0:
            alone = finding.recalibrated.calibrated.get(name, one.value)
            values[name] = {
                "nominal": one.value,
                "tolerance": one.tolerance,
                "fitted": float(finding.answer.calibrated.get(name, alone)),
                "recalibrated": float(alone),
            }
    return values
