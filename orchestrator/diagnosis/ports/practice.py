"""Practice on simulated cases of a study's own system: what evidence is worth, and how far that is true."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from ...base.digests import file_digest
from ...base.errors import ConfigError, OrchestratorError, Problem
from ...base.provenance import origin, versions
from ...fmi.workers import Work, pool_of
from ...results.file_formats import strict
from ...simulation.run import instance_fmus
from ...simulation.run_folder import folder_at
from ..calibration import SET
from ..challenge.verdict import names
from ..content import named_files
from ..effect import Effect
from ..study import Array
from .native import in_native_form
from .reader import load_port_study
from .replay import candidates_of
from .simulated import simulated
from .study import PortStudy, study_file
from .tempering import FORMAT, Tempering, digest, sealed
from .weigh import Weighed, weigh_ports

__all__ = ["Case", "Practise", "coverage", "learn", "parts_of", "practise"]

_PACKAGES = ("orchestrator", "numpy", "numba", "scipy")

# How far the logarithm of each learned number may stray from where it begins, one standard deviation: cases
# are few, and simulated.
_STRAY = 0.5
_LEARNED = ("temperature", "growth", "price", "left", "sharpness", "floor")
_FOLDS, _FEWEST = 5, 10
# To be raised when cases are simulated or weighed in another way: kept ones of before are then made anew.
_WAY = 5


@dataclass(frozen=True)
class Practise:
    """How to practise.

    Attributes:
        cases: to simulate; seed: of their draws.
        jobs: processes; as many as there are cores by default.
        kept: file that weighed cases are kept in, one a line, and that an interrupted practice goes on from.
        progress: is reported how many are weighed.
    """

    cases: int
    seed: int = 1
    jobs: int | None = None
    kept: Path | None = None
    progress: Callable[[int], None] = lambda done: None


@dataclass(frozen=True)
class _Answer:
    effects: tuple[str, ...]
    gain: float
    ties: tuple[str, ...]


@dataclass(frozen=True)
class Case:
    """What weighing gave for a simulated case.

    Attributes:
        truth: ids; ("outside",); or none.
        evidence: what the logs say about it over the calibration alone [nats].
        answers: none first; candidates: how many there were; share: see `Weighed.share`.
    """

    truth: tuple[str, ...]
    evidence: float
    answers: tuple[_Answer, ...]
    candidates: int
    share: float

    def right(self) -> list[bool]:
        """Whether each answer, and last outside, is right, ties as declared."""
        outside = self.truth == ("outside",)
        found = [not outside and names(one.effects, one.ties, self.truth) for one in self.answers]
        return [*found, outside]


def practise(path: Path, order: Practise) -> dict[str, Any]:
    """Weigh simulated cases of a study, and learn how evidence becomes probabilities.

    Args:
        path: the study's file or folder.
    Returns: content of practice.json: `tempering`; `coverage` as shipped and as learned, the latter of cases
        that the learning did not see, five times over; `cases`; `seed`; `effects`, ids of the candidates;
        `system`, see `parts_of`; `sha256` of all that.
    Raises: ConfigError for less than ten cases: they teach nothing; OrchestratorError if a case fails.
    """
    if order.cases < _FEWEST:
        raise ConfigError([Problem("practice", f"got {order.cases} cases", f"at least {_FEWEST}")])
    if order.jobs is not None and order.jobs < 1:
        raise ConfigError([Problem("--jobs", f"got {order.jobs}", "at least 1")])
    study = load_port_study(path, practising=True)
    effects = candidates_of(study)
    if len(effects) < 2:
        raise ConfigError([Problem("practice", f"got {len(effects)} candidates", "at least 2")])
    cases = _weighed(path, study, order, [one.id for one in effects])
    start = Tempering()
    unseen: list[tuple[Case, Tempering]] = []
    for fold in range(_FOLDS):
        others = [one for place, one in enumerate(cases) if place % _FOLDS != fold]
        learned = learn(others, start)
        unseen += [(one, learned) for place, one in enumerate(cases) if place % _FOLDS == fold]
    return sealed({
        "format": FORMAT,
        "tempering": learn(cases, start).data(),
        "coverage": {
            "as shipped": coverage([(one, start) for one in cases]),
            "as learned, on unseen cases": coverage(unseen),
        },
        "cases": [
            {name: value for name, value in _written(one).items() if name != "candidates"} for one in cases
        ],
        "seed": order.seed,
        "effects": [one.id for one in effects],
        "system": parts_of(study),
        "provenance": origin(),
    })  # fmt: skip


def parts_of(study: PortStudy) -> dict[str, str]:
    """Digests of what makes a study's system what it is, by name; what was logged of it is none of them."""
    config = study.prepared.config.model.to_data()
    # A file of an FMU may stand elsewhere: its checksum says which it is.
    own = {name: {**one, "fmu": None} for name, one in config["instances"].items()}
    fmus = {name: one["checksum"] for name, one in instance_fmus(study.prepared.system).items()}
    parts = {
        "config": {**config, "instances": own},
        "FMUs": fmus,
        "calibrated": {name: [one.value, one.tolerance] for name, one in study.nominal.items()},
        "columns": {
            str(port): [one.noise, one.hold, one.start, port in study.fed, port in study.compared]
            for port, one in study.columns.items()
        },
        "priors": study.priors,
        "interval, settle": [study.parts, study.settled],
    }
    return {name: digest(one) for name, one in parts.items()}


def _weighed(path: Path, study: PortStudy, order: Practise, ids: Sequence[str]) -> list[Case]:
    """The cases in the order of their numbers; each is kept as soon as it is weighed."""
    own = study_file(path)
    logs = (run.file for run in study.runs if run.file is not None)
    made_of = [
        _WAY,
        order.seed,
        list(ids),
        versions(_PACKAGES),
        parts_of(study),
        [file_digest(one) for one in named_files(own.parent, [own, *logs]).values()],
    ]
    key = digest(made_of)[:16]
    done = {number: case for number, case in _kept(order.kept, key).items() if number < order.cases}
    order.progress(len(done))
    missing = [number for number in range(order.cases) if number not in done]
    pool = pool_of(None, order.jobs)
    for outcome in pool.outcomes(Work(_one, _prepared, (path.resolve(), order.seed)), missing):
        if outcome.failure is not None:
            raise OrchestratorError(f"simulated case {outcome.task}: {outcome.failure.message}")
        done[outcome.task] = outcome.value
        if order.kept is not None:
            line = {"key": key, "number": outcome.task, **_written(outcome.value)}
            folder_at(order.kept.parent)  # not before: what is refused leaves no folder
            # A line that was broken off before is not gone on with; empty ones are none.
            with order.kept.open("a", encoding="utf-8") as file:
                file.write(f"\n{json.dumps(strict(line))}\n")
        order.progress(len(done))
    return [done[number] for number in range(order.cases)]


def _prepared(payload: tuple[Path, int], folder: Path) -> tuple[PortStudy, Sequence[Effect], int]:
    path, seed = payload
    study, _ = in_native_form(load_port_study(path, practising=True))
    return study, candidates_of(study), seed


def _one(context: tuple[PortStudy, Sequence[Effect], int], number: int) -> Case:
    study, effects, seed = context
    made, truth, evidence = simulated(
        study, effects, np.random.default_rng(np.random.SeedSequence([seed, number]))
    )
    return _case(weigh_ports(made, workers=1), truth, evidence)  # cases are worked at side by side


def _written(case: Case) -> dict[str, Any]:
    return {
        "truth": list(case.truth),
        "evidence": case.evidence,
        "share": case.share,
        "answers": [[list(one.effects), one.gain, list(one.ties)] for one in case.answers],
        "candidates": case.candidates,
    }


def _kept(file: Path | None, key: str) -> dict[int, Case]:
    """Cases that an earlier practice of the same study weighed, by number; a line broken off is none."""
    if file is None or not file.is_file():
        return {}
    found = {}
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            data = json.loads(line)
        except ValueError:
            continue
        if data["key"] == key:
            answers = tuple(_Answer(tuple(names), gain, tuple(ties)) for names, gain, ties in data["answers"])
            found[data["number"]] = Case(
                tuple(data["truth"]), data["evidence"], answers, data["candidates"], data["share"]
            )
    return found


def _case(weighed: Weighed, truth: tuple[str, ...], evidence: float) -> Case:
    answers = tuple(_Answer(one.effects, float(one.gain), one.ties) for one in weighed.answers)
    return Case(truth, evidence, answers, len(weighed.effects), weighed.share)


def _loss(tempering: Tempering, cases: Sequence[Case]) -> float:
    """Sum of negative log probabilities of the truth."""
    total = 0.0
    for case in cases:
        p = tempering.probabilities(case.answers, case.candidates, case.share)
        right = float(p[np.array(case.right())].sum()) if any(case.right()) else 0.0
        # What no answer held is not the map's fault, and the same for all maps.
        total -= np.log(max(right, 1e-4))
    return total


def learn(cases: Sequence[Case], start: Tempering) -> Tempering:
    """The numbers under which the truth of simulated cases is most probable, near those that come along."""

    def learned(x: Array) -> Tempering:
        stray = {name: getattr(start, name) * float(np.exp(v)) for name, v in zip(_LEARNED, x, strict=True)}
        return replace(start, **stray)

    def cost(x: Array) -> float:
        return _loss(learned(x), cases) + 0.5 * float(np.sum((x / _STRAY) ** 2))

    size = len(_LEARNED)
    found = minimize(
        cost, np.zeros(size), method="Powell", bounds=[(-2.0, 2.0)] * size, options={"maxiter": 10}
    )
    return learned(np.atleast_1d(found.x))


def coverage(told: Sequence[tuple[Case, Tempering]]) -> dict[str, float]:
    """How true probabilities are.

    Returns: `cases`; `covered`, the share of them whose 95 % set of answers holds the truth; `right`, of
        those whose first answer is; `claimed`, the mean probability of the first answers; `false_alarms`,
        the share of cases without anything hidden whose first answer is something.
    """
    covered, right, claimed, alarms, empty = 0, 0, 0.0, 0, 0
    for case, tempering in told:
        p = tempering.probabilities(case.answers, case.candidates, case.share)
        order = np.argsort(-p, kind="stable")
        size = int(np.searchsorted(np.cumsum(p[order]), SET)) + 1
        is_right = np.array(case.right())
        covered += bool(is_right[order[:size]].any())
        right += bool(is_right[order[0]])
        claimed += float(p[order[0]])
        if case.truth == ():
            empty += 1
            alarms += int(order[0]) != 0
    n = max(len(told), 1)
    return {
        "cases": float(len(told)),
        "covered": covered / n,
        "right": right / n,
        "claimed": claimed / n,
        "false_alarms": alarms / max(empty, 1),
    }
