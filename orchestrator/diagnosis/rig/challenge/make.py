"""Makes a folder of cases and their sealed truth."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ....base.errors import ConfigError, OrchestratorError, Problem, listed
from ....fmi.workers import LocalPool, Work
from ....simulation.run_folder import folder_at
from .draw import RUNS, Case, Plan, draw_case, make_run, plan_cases
from .evidence import CLEAR, imitated, visibility
from .hidden import HARDWARE, HIDDEN, SOFTWARE
from .outside import OUTSIDE
from .outside_fresh import FRESH
from .rig import Array
from .seal import seal_truth
from .write import write_case

# With how many effects together what is hidden is compared, by kind of case; and evidence for the fainter of
# a pair that no single effect imitates [nats].
_RIVALS, _SURE = {"pair": 1, "outside": 2}, 300.0

# Kinds outside the catalogue, by which may be drawn.
KINDS = {"known": OUTSIDE, "fresh": FRESH, "all": {**OUTSIDE, **FRESH}}


@dataclass(frozen=True)
class Order:
    """Arguments of `make`.

    Attributes:
        seed: None draws a secret one, which is kept in the sealed truth alone.
        magnitude: of every effect; None draws one per case.
        pairs: whether two effects are hidden in some cases.
        outside: which of `KINDS` are hidden in some, "all", "known" or "fresh"; None hides none of them.
        tight: by how much the lab's tolerances are smaller than the errors of its calibration.
    """

    cases: int
    seed: int | None
    magnitude: float | None = None
    pairs: bool = False
    outside: str | None = None
    tight: float = 1.0

    def __post_init__(self) -> None:
        problems = []
        if self.cases < 1:
            problems.append(Problem("--cases", f"got {self.cases}", "at least 1"))
        if self.seed is not None and self.seed < 0:
            problems.append(Problem("--seed", f"got {self.seed}", "a whole number from 0, or `secret`"))
        if self.magnitude is not None and not 0.0 < self.magnitude <= 2.0:
            problems.append(
                Problem("--magnitude", f"got {self.magnitude:g}", "above 0 (absent) up to 2; 1 is strong")
            )
        if self.outside is not None and self.outside not in KINDS:
            problems.append(Problem("--outside", f"got {self.outside!r}", listed(sorted(KINDS), len(KINDS))))
        if not 1.0 <= self.tight <= 5.0:
            problems.append(Problem("--tight", f"got {self.tight:g}", "from 1 (tolerances as they are) to 5"))
        if problems:
            raise ConfigError(problems)


def make(
    folder: Path, order: Order, jobs: int = 1, progress: Callable[[str], None] = lambda name: None
) -> str:
    """Write case folders and the sealed truth into a folder.

    Args:
        progress: called with the name of each case when it stands.
    Returns: the digest of the sealed truth.
    Raises: ConfigError if the folder is not empty, or cannot be made.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError([Problem(str(folder), "is not empty", remedy="Name a new folder.")])
    folder_at(folder)
    seed = secrets.randbits(63) if order.seed is None else order.seed
    outside = tuple(KINDS[order.outside].values()) if order.outside else ()
    plans = plan_cases(order.cases, seed, tuple(HIDDEN.values()), outside, order.pairs, order.magnitude)
    tasks = [(folder, plan, seed, number, order.tight) for number, plan in enumerate(plans, start=1)]
    cases = {}
    for outcome in LocalPool(min(jobs, len(tasks))).outcomes(Work(_make_one), tasks):
        if outcome.failure is not None:
            raise OrchestratorError(f"a case cannot be made: {outcome.failure.message}")
        name, truth = outcome.value
        cases[name] = truth
        progress(name)
    cases = dict(sorted(cases.items()))
    key = hashlib.sha256(f"challenge {seed}".encode()).digest()  # the same seed gives the same bytes
    return seal_truth(folder, {"format": "gap-truth/1", "seed": seed, "cases": cases}, key)


def _make_one(context: None, task: tuple[Path, Plan, int, int, float]) -> tuple[str, dict[str, Any]]:
    folder, plan, seed, number, tight = task
    case = draw_case(plan, seed, number, tight=tight)
    logs = [make_run(case, index) for index in range(len(RUNS))]
    name = f"case-{number:04d}"
    write_case(folder / name, case, logs)
    outside = plan.kind == "outside"
    evidence = _evidence(case, logs, tight)
    alone, two = _beyond(case, logs, evidence)
    return name, {
        "kind": plan.kind,
        "effects": ["outside"] if outside else [one.id for one in plan.effects],
        "hides": [one.id for one in plan.effects],
        "places": sorted({one.place for one in plan.effects}),
        "magnitude": plan.magnitude,
        "tight": tight,
        "parameters": {name: dict(values) for name, values in case.hidden.items()},
        "evidence": evidence,
        "beyond": alone[0],
        "like": alone[1],
        "beyond_two": two[0],
        "like_two": two[1],
        "rows": [log.shape[1] for log in logs],
    }


def _evidence(case: Case, logs: list[Array], tight: float) -> float:
    """Evidence for the faintest effect, beside the others."""
    found = []
    for one in case.plan.effects:
        others = tuple(other for other in case.plan.effects if other is not one)
        rest = draw_case(replace(case.plan, effects=others), case.seed, case.number, tight=tight)
        found.append(visibility(case, logs, rest, one.chance))
    return min(found, default=0.0)


def _beyond(case: Case, logs: list[Array], evidence: float) -> list[tuple[float, str]]:
    """Evidence over the catalogue effect that imitates the hidden one best, and its id.

    What is outside the catalogue is compared with two effects together, too, of a pair both with one alone.
    Software replays to its last digit, where nothing imitates anything; nor are draws of chance compared,
    nor is a single effect of the catalogue, for which the verdict states its ties, nor what is not clear
    anyway, or a pair whose fainter effect is beyond doubt.

    Returns: that of one, and that of two together; just the evidence where nothing is compared.
    """
    effects, most = case.plan.effects, _RIVALS.get(case.plan.kind, 0)
    open_ = CLEAR <= evidence and (case.plan.kind != "pair" or evidence < _SURE)
    if not most or not open_ or any(one.chance or one.place in SOFTWARE for one in effects):
        return [(evidence, "")] * 2
    rivals = [other for other in HARDWARE if not other.chance]
    found = [
        (min(one.beyond, evidence), " + ".join(one.like)) for one in imitated(case, logs, rivals, most=most)
    ]
    return [*found, (evidence, "")][:2]
