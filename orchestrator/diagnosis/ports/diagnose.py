"""From a study of a system's ports to the content of diagnosis.json and the page."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from ...digests import file_digest
from ...errors import ConfigError
from ...formats import strict
from ...provenance import origin, versions
from ...system import Port
from ..effect import by_effect
from ..finding import NOMINAL, Augmented, Finding
from ..verdict import Diagnosis, Runnable, Share, Verdict, Which
from .augmented import FMUS, augmented_config
from .augmented import NAME as AUGMENTED
from .closure import how_far
from .energy import energy
from .experiments import next_experiment, no_experiment
from .given import check_logs
from .numerics import doubts, numerics
from .practice import Practise, practise
from .reader import load_port_study
from .replay import candidates_of
from .study import PortStudy, Role, study_file
from .tempering import Tempering, read_practice
from .weigh import Weighed, weigh_ports
from .where import ledger, no_shares, where

__all__ = ["PRACTICE", "PortDiagnosed", "diagnose_ports"]

PRACTICE = "practice.json"

_PACKAGES = ("orchestrator", "numpy", "numba", "scipy", "pydantic")
_SHOWN = 1e-6


@dataclass(frozen=True)
class PortDiagnosed:
    """A diagnosis, what it was made of, and the further files to write: name -> text."""

    study: PortStudy
    finding: Finding
    diagnosis: Diagnosis
    files: dict[str, str] = field(default_factory=dict)


def diagnose_ports(
    path: Path, progress: Callable[[str], None], report: bool, practice: Practise | None = None
) -> PortDiagnosed:
    """Diagnose a system of FMUs.

    Args:
        path: the study's file or folder.
        progress: is told each stage as it begins.
        report: whether to make the page.
        practice: cases to practise on first, if any.
    Raises: ConfigError with all problems of study and logs; OrchestratorError if an analysis fails.
    """
    begin = perf_counter()
    progress("read")
    study = load_port_study(path)
    progress("check")
    refused, warned = check_logs(study)
    if refused:
        raise ConfigError(refused)
    # A gap that the step makes is none of the system's: told before anything is blamed.
    own = numerics(study, {"nominal": NOMINAL})
    progress("weigh")
    taught, tempering = _taught(path, study, practice)
    weighed = weigh_ports(study, tempering)
    finding = weighed.finding
    analysed = _analysed(study, weighed, progress)
    config, missing = augmented_config(study, finding)
    diagnosis = Diagnosis.model_validate(
        {
            "case": study.name,
            "verdict": Verdict(effects=list(finding.effects), places=list(finding.places)),
            "which": _which(finding),
            "outside_place": finding.outside_place,
            "answer_set": list(finding.answer_set),
            "doubtful_tolerances": finding.doubtful_tolerances,
            "augmented": Runnable(
                file=AUGMENTED, run="", changed=_changed(study, finding.answer, missing), left_out=missing
            ),
            "misfit": strict(dict(finding.misfit)),
            "calibration": strict(_calibration(study, finding)),
            "data": [*warned, *doubts(own)],
            "provenance": _provenance(path, study, weighed, begin),
            **analysed,
        }
    )
    files = {AUGMENTED: config}
    exportable, _ = augmented_config(study, finding, fmus=True)
    if exportable != config:
        files[FMUS] = exportable
    if practice is not None:
        files[PRACTICE] = json.dumps(strict(dict(taught)), indent=1, allow_nan=False) + "\n"
    if report:
        # matplotlib takes a third of a second to import.
        from .page import page

        files["report.html"] = page(study, diagnosis, weighed, taught)
    return PortDiagnosed(study, finding, diagnosis, files)


def _analysed(study: PortStudy, weighed: Weighed, progress: Callable[[str], None]) -> dict[str, Any]:
    """What follows from the answer: fields of a diagnosis, and in `left_out` why others have nothing."""
    finding, left_out = weighed.finding, {}
    progress("where")
    shares: dict[str, float] = {}
    if reason := no_shares(study):
        left_out["where"] = reason
    else:
        shares = where(study, finding)
        if not shares:
            left_out["where"] = "the model runs away in every window"
    worked = energy(study, finding)
    if not worked:
        left_out["energy"] = "at no interface were a force and the velocity along it both logged"
    rows = ledger(study, finding)
    progress("how far")
    heldout = bool(study.of(Role.HELDOUT))
    if not heldout:
        left_out["how_far"] = "no run has the role held-out"
    far = strict(how_far(study, finding)) if heldout else None
    progress("what next")
    proposed = None
    if reason := no_experiment(study, finding):
        left_out["next_experiment"] = reason
    else:
        proposed = next_experiment(study, finding, weighed.weights, weighed.effects)
    progress("numerics")
    both = numerics(study, {"nominal": NOMINAL, "answer": finding.answer})
    return {
        "where": [
            Share(place=place, share=share)
            for place, share in sorted(shares.items(), key=lambda item: -item[1])
        ],
        "ledger": strict(rows),
        "energy": strict(worked),
        "how_far": far,
        "next_experiment": strict(proposed) if proposed else None,
        "numerics": strict(both),
        "left_out": left_out,
    }


def _taught(path: Path, study: PortStudy, practice: Practise | None) -> tuple[Mapping[str, Any], Tempering]:
    """What practice taught, now or before, and the map that it gave; the one that comes along without any."""
    if practice is not None:
        taught = practise(path, practice)
        return taught, Tempering(**taught["tempering"])
    if study.practice is not None:
        effects = candidates_of(study)
        tempering, data = read_practice(study.practice, [one.id for one in effects])
        return data, tempering
    return {}, Tempering()


def _which(finding: Finding) -> list[Which]:
    shown = [one for one in finding.candidates if one.probability >= _SHOWN]
    total = sum(one.probability for one in shown)
    return [
        Which(
            effects=list(one.effects),
            probability=one.probability / total,
            parameters=dict(one.parameters),
            ties=list(one.ties),
        )
        for one in shown
    ]


def _calibration(study: PortStudy, finding: Finding) -> dict[str, dict[str, float]]:
    return {
        name: {
            "nominal": one.value,
            "tolerance": one.tolerance,
            "fitted": float(finding.answer.calibrated.get(name, one.value)),
            "recalibrated": float(finding.recalibrated.calibrated.get(name, one.value)),
        }
        for name, one in study.nominal.items()
    }


def _changed(study: PortStudy, answer: Augmented, missing: Collection[str]) -> list[str]:
    """What differs from the configured system, in words."""
    found = []
    for effect, own in by_effect(answer.effects, answer.theta):
        if effect.id not in missing:
            numbers = [
                f"{one.name} {value:.4g} {one.unit}".removesuffix(" 1")
                for one, value in zip(effect.parameters, own.tolist(), strict=True)
            ]
            found.append(f"{effect.id}: {', '.join(numbers)}" if numbers else effect.id)
    for name, one in study.nominal.items():
        value = answer.calibrated.get(name, one.value)
        if value != one.value:
            instance, _, variable = name.partition(".")
            found.append(f"{name}: {value:.6g} {study.unit(Port(instance, variable))}, not {one.value:g}")
    return found


def _provenance(path: Path, study: PortStudy, weighed: Weighed, begin: float) -> dict[str, Any]:
    folder = path if path.is_dir() else path.parent
    file = study_file(path)
    files = [file, *dict.fromkeys(run.file for run in study.runs if run.file and run.file.is_file())]
    digests = {
        (one.relative_to(folder) if one.is_relative_to(folder) else one).as_posix(): file_digest(one)
        for one in files
    }
    return {
        **origin(),
        "packages": versions(_PACKAGES),
        "effects": len(weighed.effects),
        "sha256": digests,
        "seconds": round(perf_counter() - begin, 3),
    }
