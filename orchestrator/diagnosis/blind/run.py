"""Make cases, search them, score the verdicts: resumable, each case a folder."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import OrchestratorError
from ...fmi.workers import Work, pool_of
from .cases import drawn, make, write_study, write_system
from .parts import PARTS
from .plant import Drawn, Lost
from .score import Scored, scored, summary, summary_text

_TRUTH, _VERDICT, _SCORE = "truth.json", "verdict.json", "score.json"


@dataclass(frozen=True)
class Order:
    """What to check.

    Attributes:
        folder: of the cases. seeds: of them. system: a config or a study; None: random systems.
        kind: what all cases hide, as in `cases.make`; None: drawn.
    """

    folder: Path
    seeds: Sequence[int]
    system: Path | None = None
    kind: str | None = None


def check(order: Order, jobs: int, progress: Callable[[str], None] = lambda _: None) -> dict[str, Any]:
    """Make and search the cases that are not there yet, and score all of them.

    Returns: the summary, which `summary.json` and `summary.md` in the folder hold as well.
    Raises: BuildError if FMUs cannot be built; ConfigError if the system cannot hide laws.
    """
    order.folder.mkdir(parents=True, exist_ok=True)
    if order.system is None:
        from ...translate.build import need_casadi

        need_casadi()
    else:
        from .given import given

        given(order.system).close()
    done: list[dict[str, Any]] = []
    found = summary(done)
    work = Work(_one, payload=order, threads=1)
    for outcome in pool_of(None, min(jobs, len(order.seeds))).outcomes(work, list(order.seeds)):
        if outcome.failure is None:
            done.append(outcome.value)
        else:
            done.append({"seed": outcome.task, "error": outcome.failure.message})
        done.sort(key=lambda one: one["seed"])
        found = summary(done)
        (order.folder / "summary.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        (order.folder / "summary.md").write_text(summary_text(found), encoding="utf-8")
        progress(f"seed {outcome.task}")
    return found


def _one(order: Order, seed: int) -> dict[str, Any]:
    """Make, search and score one case."""
    folder = order.folder / f"case-{seed}"
    folder.mkdir(exist_ok=True)
    held = None
    if order.system is not None:
        from .given import given

        held = given(order.system)
    try:
        draft = drawn if held is None else held.draft
        case = None
        if not (folder / _TRUTH).is_file() or not (folder / _VERDICT).is_file():
            try:
                case = make(seed, draft, order.kind)
            except Lost as error:
                return {"seed": seed, "error": str(error)}
            if isinstance(case.draft.plant, Drawn):
                _build(case.draft.plant, order.folder / "fmus")
                write_system(case, folder, "../fmus")
            else:
                assert held is not None
                held.write_system(folder)
            write_study(case, folder)
            _write(folder / _TRUTH, case.truth)
        if not (folder / _VERDICT).is_file():
            _write(folder / _VERDICT, _searched(folder))
        truth, verdict = _read(folder / _TRUTH), _read(folder / _VERDICT)
        made: Scored = scored(truth, verdict, case or (lambda: make(seed, draft, order.kind)))
    finally:
        if held is not None:
            held.close()
    data = {
        "seed": seed,
        "title": truth["title"],
        "kind": truth["kind"],
        "clear": truth["clear"],
        **made.data_of(),
    }
    _write(folder / _SCORE, data)
    return data


def _build(plant: Drawn, folder: Path) -> None:
    """FMUs of a system's parts that are not there yet."""
    from ...translate.build import build
    from ...translate.package import this_platform

    folder.mkdir(exist_ok=True)
    for name in sorted({part.name for part in plant.drawing.parts.values()}):
        if not (folder / f"{name}.fmu").is_file():
            source = folder / f"{name}.mo"
            source.write_text(PARTS[name].modelica(), encoding="utf-8")
            build(source, folder / f"{name}.fmu", platforms=(this_platform(),))


def _searched(folder: Path) -> dict[str, Any]:
    """What the search says of a case."""
    from ..study.native import in_native_form
    from ..study.reader import load_port_study
    from ..unknown_input.inquiry import answer
    from ..unknown_input.report import data_of

    begin = _processor_seconds()
    try:
        study, _ = in_native_form(load_port_study(folder / "study.yaml"))
        found = answer(study)
    except (OrchestratorError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        return {"error": f"{type(error).__name__}: {error}"}
    # Of all rivals, for calibration.
    evidence = [[one.nats, one.weight] for one in found.rivals]
    spent = round(_processor_seconds() - begin, 1)
    return {**data_of(found), "evidence": evidence, "processor_seconds": spent}


def _processor_seconds() -> float:
    """Of this process and the copies that it has waited for."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def _write(path: Path, data: Any) -> None:
    part = path.with_suffix(".part")
    part.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    part.replace(path)


def _read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))
