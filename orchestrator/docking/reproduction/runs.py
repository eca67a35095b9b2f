"""Makes the runs of experiments, each once more with half the step, on all cores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from ...errors import OrchestratorError
from ...results import Results
from ...run import prepare, run
from ...workers import LocalPool, Work, cores
from .experiment import Case, Recorded

__all__ = ["Failed", "Pair", "record", "run_once"]

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
    Returns: what each case gave. A failed run, or a process that dies, does not keep the others from running.
    """
    from tqdm import tqdm

    wanted = list(dict.fromkeys(cases))
    tasks = [(case, halved) for case in wanted for halved in (False, True)]
    found: dict[tuple[Case, bool], Recorded | Failed] = {}
    # None: a bar where there is a terminal, none elsewhere.
    bar = tqdm(
        total=len(tasks), desc="reproduce", unit="run", leave=False, disable=None if progress else True
    )
    pool = LocalPool(min(jobs or cores(), max(len(tasks), 1)))
    with bar:
        for one in pool.outcomes(Work(_run_task), tasks):
            case, _ = one.task
            lost = one.failure
            found[one.task] = one.value if lost is None else Failed(f"{case.name}: {lost.message}")
            bar.update()
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


def _run_task(_: None, task: tuple[Case, bool]) -> Recorded | Failed:
    return run_once(*task)


def run_once(case: Case, halved: bool = False) -> Recorded | Failed:
    """One run. Errors come back as text: not every exception can be sent from process to process."""
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
