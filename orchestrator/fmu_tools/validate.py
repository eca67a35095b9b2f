"""All checks of an FMU: what it declares, and how it behaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..fmi import Interface, ModelDescription, load_fmu
from ..fmi.handling import Handling
from .declared import declared_checks, library_can_run
from .finding import Finding, Level, Verdict, failed
from .laboratory import CHECKS, Laboratory
from .trial import Conditions

__all__ = ["TIME_LIMIT", "has_errors", "validate_fmu"]

TIME_LIMIT = 60.0
# Where an FMU names no step size: that of control loops, then a sampled component's likely ones [s].
_STEPS = (1e-3, 5e-4, 1e-4, 1e-2, 0.1, 1.0)
# An FMU may refuse inputs far from its start values: smaller ones are tried, and at last none.
_AMPLITUDES = (1.0, 0.1, 0.01, 0.0)


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
    description = load_fmu(path, Handling(interface=interface)).description
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
        usable: Conditions | None = None
        if not reason:
            usable, refusal, crashes = _usable(laboratory, description, conditions)
            for crash in crashes:
                add(failed("run", Level.ERROR, crash, "Have the FMU refuse what it cannot take."))
            if usable is None:
                add(failed("run", Level.ERROR, refusal, "Without this nothing else can be tried."))
                reason = "The FMU does not run."
        for name in CHECKS:
            if usable is not None:
                add(laboratory.check(name))
            elif name != "run" or not found or found[-1].check != "run":
                add(Finding(name, Verdict.NOT_TRIED, reason))
    return found


def _usable(
    laboratory: Laboratory, description: ModelDescription, wanted: Conditions
) -> tuple[Conditions | None, str, list[str]]:
    """Conditions under which an FMU takes its steps; the laboratory is left under them.

    Returns: the conditions, None if there are none; why it refused the last others; how it crashed or hung.
    """
    own = wanted.step_size or description.own_step or description.default_step
    refusal, crashes = "", []
    driven = any(one.kind.numeric and not one.shape for one in description.inputs)
    # The step size is found with inputs at rest; then their size.
    tried = [(step, 0.0) for step in ((own,) if own else _STEPS)]
    step_size: float | None = None
    while tried:
        step, amplitude = tried.pop(0)
        conditions = replace(wanted, step_size=step, amplitude=amplitude)
        laboratory.change(conditions)
        taken = laboratory.steps_taken(amplitude)
        if isinstance(taken, str):
            refusal = taken
            if not taken.startswith("one"):
                size = (
                    f"inputs up to {amplitude:g} of their nominal values" if amplitude else "inputs at rest"
                )
                crashes.append(f"With steps of {step:g} s and {size} {taken}.")
            continue
        conditions = replace(conditions, steps=taken)
        if step_size is not None or not driven:
            laboratory.change(conditions)
            return conditions, refusal, crashes
        step_size = step
        tried = [(step, amplitude) for amplitude in _AMPLITUDES]
    return None, refusal, crashes


def has_errors(findings: list[Finding]) -> bool:
    """Whether a finding is of level error."""
    return any(finding.level is Level.ERROR for finding in findings)
