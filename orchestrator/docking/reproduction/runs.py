"""Makes the runs of experiments, each once more with half the step, on all cores."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

from ...base.errors import OrchestratorError
from ...fmi.workers import Outcome, Work, cores, pool_of
from ...results.progress import counting
from ...results.recorders import Results
from ...simulation.run import prepare, run
from .experiment import Case, Recorded

_SIGNALS = (
    "satellite.velocity",
    "satellite.position",
    "satellite.kinetic_energy",
    "robot.position",
    "contact.force",
    "controller.stiffness_estimate",
    "controller.damping_estimate",
)


@dataclass(frozen=True)
class Pair:
    """A case at its step size, and at half of it."""

    whole: Recorded
    halved: Recorded


@dataclass(frozen=True)
class Failed:
    """A case that did not run to its end, and why."""

    message: str


def record(
    cases: Sequence[Case], jobs: int | None = None, progress: bool = False
) -> dict[Case, Pair | Failed]:
    """Run every case twice: as it is, and with half the communication step.

    Args:
        cases: equal ones run once.
        jobs: number of processes; as many as there are cores by default.
        progress: whether to show a bar on a terminal.
    Returns: what each case gave. A failed run does not keep the others from running, nor does one whose
        process dies.
    Raises: OrchestratorError if processes cannot begin.
    """
    wanted = list(dict.fromkeys(cases))
    tasks = [(case, halved) for case in wanted for halved in (False, True)]
    found: dict[tuple[Case, bool], Recorded | Failed] = {}
    pool = pool_of(jobs=min(jobs or cores(), max(len(tasks), 1)))
    with (
        counting(len(tasks), "reproduce", "run", progress) as report,
        closing(pool.outcomes(Work(_run_task), tasks)) as outcomes,  # type: ignore[type-var]
    ):
        for outcome in outcomes:
            found[outcome.task] = _made(outcome)
            report(len(found), len(tasks))
    made: dict[Case, Pair | Failed] = {}
    for case in wanted:
        whole, halved = found[case, False], found[case, True]
        if isinstance(whole, Failed):
            made[case] = whole
        elif isinstance(halved, Failed):
            made[case] = Failed(f"with half the step: {halved.message}")
        else:
            made[case] = Pair(whole, halved)
    return made


def _run_task(context: None, task: tuple[Case, bool]) -> Recorded | Failed:
    return run_once(*task)


def _made(outcome: Outcome) -> Recorded | Failed:
    """What a run gave, or how its process ended."""
    if outcome.failure is None:
        return outcome.value
    lines = "".join(f"\n    {line}" for line in outcome.failure.log)
    return Failed(f"{outcome.task[0].name}: {outcome.failure.message}{lines}")


def run_once(case: Case, halved: bool = False) -> Recorded | Failed:
    """One run; an error comes back as its text."""
    try:
        prepared = prepare(case.system, case.overrides)
        if halved:
            prepared = replace(prepared, grid=prepared.grid.halved())
        made = run(prepared, halving=False, figures=False)
    except OrchestratorError as error:
        return Failed(f"{case.name}: {error}")
    results = made.results
    signals = {name: results[name] for name in _SIGNALS if name in results.signals}
    (chosen,) = prepared.measures
    options: Any = chosen.options
    kept = Results(results.time, signals, results.units, results.parameters, results.provenance)
    return Recorded(kept, _measures(made.summary), options)


def _measures(summary: dict[str, Any]) -> dict[str, Any]:
    return {name: summary[name] for name in ("contacts", "ideal", "stiffness_estimate", "damping_estimate")}
