"""From a study of a system's ports to the content of diagnosis.json and the page."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from ...base.errors import ConfigError
from ...config.text import compose
from ...results.file_formats import strict
from ...simulation.run import instance_fmus
from ...system.connection import Port
from ..content import AnalysisResults, content, named_files, provenance
from ..effect import by_effect
from ..finding import NOMINAL, Augmented, Finding
from ..search_progress import SearchProgress, progress_reported
from ..verdict import AUGMENTED, EXPORTABLE, PAGE, Diagnosis, Runnable, Warned
from .apart import components
from .augmented import augmented_config, parameter_values
from .closure import how_far
from .energy import energy, unclear
from .experiments import next_experiment, no_experiment
from .given import check_logs
from .native import in_native_form
from .numerics import doubts, doubts_of_answer, numerics
from .practice import Practise, parts_of, practise
from .reader import load_port_study
from .replay import candidates_of
from .steps import told_of_step, weighed_without_step
from .study import PortStudy, Role, study_file
from .tempering import Tempering, read_practice
from .weigh import Weighed
from .where import lasting, ledger, no_shares, where

__all__ = ["PRACTICE", "PortDiagnosed", "diagnose_ports"]

PRACTICE = "practice.json"


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
        progress: is reported each stage as it begins, and how far weighing is: see `SearchProgress`.
        report: whether to make the page.
        practice: cases to practise on first, if any.
    Raises: ConfigError with all problems of study and logs; OrchestratorError if an analysis fails.
    """
    begin = perf_counter()
    progress("read")
    study = load_port_study(path, practising=practice is not None)
    progress("check")
    study, slow = in_native_form(study)
    refused, warned = check_logs(study)
    if study.only or study.without:
        try:
            candidates_of(study)
        except ConfigError as error:  # told together with what is wrong with the logs
            refused = [*refused, *error.problems]
    if refused:
        raise ConfigError(refused)
    # A gap that the step makes is none of the system's: told before anything is blamed.
    own = numerics(study, {"nominal": NOMINAL})
    progress("weigh")
    taught, tempering = _taught(path, study, practice)
    configured = study
    with progress_reported(SearchProgress(len(candidates_of(study)), progress)):
        stepped = weighed_without_step(study, tempering)
    study, weighed = stepped.study, stepped.weighed
    if study.parts > configured.parts:
        own = numerics(study, {"nominal": NOMINAL})
    of_step = told_of_step(stepped, configured)
    if of_step is None or study.parts > configured.parts:
        of_step = [*(of_step or []), *doubts(own)]
    finding = weighed.finding
    study, forgetful = lasting(study, finding)
    told = _told(study, weighed, progress)
    if finding.answer.effects and (not of_step or study.parts > configured.parts):
        curved = [str(port) for port in study.fed if port not in study.held]
        of_step = [*of_step, *doubts_of_answer(told.numerics, curved)]
    finding = _placed(study, finding, told.ledger)
    config, missing = augmented_config(study, finding)
    changed = _changed(study, finding.answer, missing)
    augmented = Runnable(file=AUGMENTED, run="", changed=changed, left_out=missing)
    origins = provenance(
        _files(path, study),
        effects=len(weighed.effects),
        seconds=round(perf_counter() - begin, 3),
        fmus=instance_fmus(study.prepared.system),
    )
    exportable, kept = augmented_config(study, finding, fmus=True)
    known = [*warned, *slow, *weighed.warned, *of_step, *forgetful, *_as_effects(kept, missing)]
    diagnosis = content(study.name, finding, study.nominal, told, known, augmented, origins)
    files = {AUGMENTED: config}
    if exportable != config:
        files[EXPORTABLE] = exportable
    if practice is not None:
        files[PRACTICE] = json.dumps(strict(dict(taught)), indent=1, allow_nan=False) + "\n"
    if report:
        # matplotlib takes a third of a second to import.
        from .page import page

        files[PAGE] = page(study, diagnosis, weighed, taught)
    return PortDiagnosed(study, finding, diagnosis, files)


def _placed(study: PortStudy, finding: Finding, rows: Iterable[Mapping[str, Any]]) -> Finding:
    """A finding, something outside the list placed where components driven by what was measured stray most.

    What the best answer explains least, which tells its place otherwise, may be downstream of what acts.

    Args:
        rows: of the ledger.
    """
    energies: dict[str, float] = {}
    for row in rows:
        energies[row["component"]] = energies.get(row["component"], 0.0) + row["share"]
    chains = {one.name: one.places for one in components(study)}
    first = max(energies, key=lambda name: energies[name], default="")
    if finding.effects != ("outside",) or first not in chains:
        return finding
    return replace(finding, places=tuple(sorted(chains[first])), outside_place=first)


def _as_effects(kept: Mapping[str, str], missing: Collection[str]) -> list[Warned]:
    """Laws of friction that are no FMUs in the augmented systems.

    Args:
        missing: what these do not hold at all, of which that is reported.
    """
    return [
        Warned(
            place=EXPORTABLE,
            what=f"{name} stands as an effect, not as an FMU: {reason}",
            remedy=f"Run {AUGMENTED}; a system with this effect cannot be exported.",
        )
        for name, reason in kept.items()
        if name not in missing
    ]


def _told(study: PortStudy, weighed: Weighed, progress: Callable[[str], None]) -> AnalysisResults:
    """What follows from the answer."""
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
    if reason := unclear(study):
        left_out["energy"] = reason
    elif not worked:
        left_out["energy"] = "at no interface were a force and the velocity along it both logged"
    rows = ledger(study, finding)
    if not rows:
        left_out["ledger"] = "residuals of components apart hold no more energy than noise leaves by chance"
    progress("how far")
    heldout = bool(study.of(Role.HELDOUT))
    if not heldout:
        left_out["how_far"] = "no run has the role held-out"
    far = how_far(study, finding) if heldout else None
    progress("what next")
    proposed = None
    if reason := no_experiment(study, finding):
        left_out["next_experiment"] = reason
    else:
        proposed = next_experiment(study, finding, weighed.weights, weighed.effects, weighed.answers)
    progress("numerics")
    both = numerics(study, {"nominal": NOMINAL, "answer": finding.answer})
    return AnalysisResults(shares, rows, worked, far, proposed or None, both, left_out)


def _taught(path: Path, study: PortStudy, practice: Practise | None) -> tuple[Mapping[str, Any], Tempering]:
    """What practice taught, now or before, and the map that it gave; the one that comes along without any."""
    if practice is not None:
        taught = practise(path, practice)
        return taught, Tempering(**taught["tempering"])
    if study.practice is not None:
        effects = candidates_of(study)
        tempering, data = read_practice(study.practice, [one.id for one in effects], parts_of(study))
        return data, tempering
    return {}, Tempering()


def _changed(study: PortStudy, answer: Augmented, missing: Collection[str]) -> list[str]:
    """What differs from the configured system, in words; parameters as values, not as changes alone."""
    found, told = [], {}
    for name, value in parameter_values(study, answer).items():
        port = Port.of(name)
        nominal = study.nominal.get(name)
        believed = study.prepared.system.start(port) if nominal is None else nominal.value
        if value != believed:
            unit = "" if study.unit(port) == "1" else f" {study.unit(port)}"
            told[name] = f"{name}: {value:.6g}{unit}, not {believed:.6g}{unit}"
    for effect, own in by_effect(answer.effects, answer.theta):
        if effect.id not in missing:
            numbers = ", ".join(
                f"{one.name} {value:.4g} {one.unit}".removesuffix(" 1")
                for one, value in zip(effect.parameters, own.tolist(), strict=True)
            )
            if effect.changes:
                found += [f"{told.pop(name)} ({numbers})" for name in effect.changes if name in told]
            else:
                found.append(f"{effect.id}: {numbers}" if numbers else effect.id)
    return [*found, *told.values()]


def _files(path: Path, study: PortStudy) -> dict[str, Path]:
    """The study's file, the user's own configs, and the logs, by name."""
    file = study_file(path)
    logs = (run.file for run in study.runs if run.file is not None)
    return named_files(file.parent, [file, *_configs(file), *logs])


def _configs(file: Path, key: str = "system") -> list[Path]:
    """The config that a file names, and those which that extends; bundled ones come with the product."""
    if file.suffix.lower() in (".ssp", ".ssd"):
        return []  # these extend nothing
    name = compose(file.read_text(encoding="utf-8"), file.name)[0].get(key)
    options = [] if name is None else [file.parent / name, *([Path(name)] if key == "system" else [])]
    found = [one for one in options if one.is_file()][:1]
    return [*found, *(base for one in found for base in _configs(one, "extends"))]
