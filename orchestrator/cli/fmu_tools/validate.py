"""All checks of an FMU: what it declares, and how it behaves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ...fmi import Interface, ModelDescription, load_fmu
from ...fmi.run_options import RunOptions
from .declared import declared_checks, library_can_run
from .finding import Finding, Level, Verdict, failed
from .guarded_checks import CHECKS, Broken, Laboratory
from .search import Refused, usable
from .trial import Conditions

TIME_LIMIT = 60.0


def validate_fmu(
    path: Path,
    conditions: Conditions = Conditions(),  # noqa: B008 (it is frozen)
    *,
    interface: Interface | None = None,
    time_limit: float = TIME_LIMIT,
    seen: Callable[[Finding], None] = lambda finding: None,
) -> list[Finding]:
    """Check an FMU. What may crash or hang runs in a process of its own.

    Args:
        interface: None: co-simulation where it is offered.
        time_limit: of each check of behaviour [s].
        seen: called with each finding as it is made.
    Raises: FmuError if it cannot be read.
    """
    description = load_fmu(path, RunOptions(interface=interface)).description
    found: list[Finding] = []

    def add(finding: Finding) -> None:
        found.append(finding)
        seen(finding)

    for finding in declared_checks(path, description):
        add(finding)
    reason = ""
    if not library_can_run(path, description):
        reason = "There is no library for this platform."
    with Laboratory(path, conditions, time_limit, interface) as laboratory:
        found_conditions: Conditions | None = None
        if not reason:
            crashes: list[str] = []
            try:
                found_conditions = usable_conditions(laboratory, description, conditions, crashes)
            except Refused as refusal:
                reason = "The FMU does not run."
                crashes = crashes or [str(refusal)]
            for crash in crashes:
                add(failed("run", Level.ERROR, crash, "Have the FMU refuse what it cannot take."))
        for name in CHECKS:
            if found_conditions is not None:
                add(laboratory.check(name))
            elif name != "run" or not found or found[-1].check != "run":
                add(Finding(name, Verdict.NOT_TRIED, reason))
    return found


def usable_conditions(
    laboratory: Laboratory, description: ModelDescription, wanted: Conditions, crashes: list[str]
) -> Conditions:
    """Conditions under which an FMU takes its steps; the laboratory is left under them.

    Args:
        crashes: gets a sentence for each way in which it crashed or hung.
    Raises: Refused.
    """

    def attempt(conditions: Conditions) -> int:
        laboratory.change(conditions)
        taken = laboratory.steps_taken()
        if isinstance(taken, Broken):
            part = conditions.amplitude
            size = f"up to {part:g} of their nominal values" if part else "at rest"
            crashes.append(f"With steps of {conditions.step_size:g} s and inputs {size} {taken}.")
        if isinstance(taken, str):
            raise Refused(taken)
        return taken

    own = wanted.step_size or description.own_step or description.default_step
    driven = any(one.kind.numeric and not one.shape for one in description.inputs)
    found = usable(attempt, wanted, own, driven)
    laboratory.change(found)
    return found


def has_errors(findings: list[Finding]) -> bool:
    """Whether a finding is of level error."""
    return any(finding.level is Level.ERROR for finding in findings)
