"""Checks of what an FMU says of its outputs: which inputs they depend on, and how strongly."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...fmi import Array, Interface, Kind
from .finding import Finding, Level, Verdict, failed, passed
from .trial import Trial

_MOST_INPUTS = 100
# Of the nominal value: a change to see dependencies by, and one for differences.
_NUDGE, _DIFFERENCE = 0.1, 1e-5
# Differences lose half the digits of a double; a wrong derivative is off by far more.
_AGREE = 1e-3


def _scalars(trial: Trial) -> list[str]:
    variables = trial.description.variables
    return [name for name in trial.reals if variables[name].elements == 1][:_MOST_INPUTS]


def _outputs(trial: Trial) -> list[str]:
    variables = trial.description.variables
    return [
        one.name
        for one in trial.description.outputs
        if one.kind is Kind.REAL and variables[one.name].elements == 1 and not one.shape
    ]


def _nudge(trial: Trial, name: str, base: float, part: float) -> float:
    """A value near `base` within the input's range."""
    one = trial.description.variables[name]
    step = part * max(one.nominal, abs(base))
    if one.maximum is not None and base + step > one.maximum:
        step = -step
    return base + step


def _read(instance: Any, outputs: list[str]) -> Array:
    got = instance.get_values(outputs)
    return np.array([got[name] for name in outputs], float)


def dependencies(trial: Trial) -> Finding:
    """Outputs do not answer at once to inputs on which they declare not to depend."""
    check, found = "dependencies", trial.description
    inputs, outputs = _scalars(trial), _outputs(trial)
    if not inputs or not outputs:
        return Finding(check, Verdict.NOT_APPLICABLE, "There are no real inputs, or no real outputs.")
    declared = [name for name in outputs if name not in found.assumed]
    if not declared:
        return failed(
            check,
            Level.WARNING,
            "No output declares what it depends on, so that masters have to assume every input.",
            "Declare dependencies in ModelStructure: masters order FMUs and find algebraic loops by them.",
        )
    violations = set()
    with trial.made() as instance:
        if found.fmi_version != "1.0" and found.interface is Interface.CO_SIMULATION:
            instance.enter_initialisation(0.0, {})
            trial.feed_start(instance, trial.rows)
            violations |= _violations(trial, instance, inputs, outputs, found.initial_feedthrough)
            instance.exit_initialisation()
            instance.read_outputs()
        else:
            trial.initialise(instance, trial.rows)
        trial.drive(instance, trial.rows, 0, max(1, len(trial.rows) // 2))
        violations |= _violations(trial, instance, inputs, outputs, found.feedthrough)
    violations = {(output, name) for output, name in violations if output not in found.assumed}
    if violations:
        shown = ", ".join(f"{output} on {name}" for output, name in sorted(violations)[:5])
        return failed(
            check,
            Level.ERROR,
            f"{len(violations)} dependencies are seen and not declared: {shown}.",
            "Declare them in ModelStructure: masters rely on it to order FMUs.",
            violations=sorted(violations),
        )
    rest = len(outputs) - len(declared)
    more = f"; {rest} others declare nothing" if rest else ""
    return passed(check, f"{len(declared)} outputs answer at once to declared inputs only{more}.")


def _violations(
    trial: Trial, instance: Any, inputs: list[str], outputs: list[str], declared: Any
) -> set[tuple[str, str]]:
    found: set[tuple[str, str]] = set()
    before = _read(instance, outputs)
    for name in inputs:
        base = float(instance.u[trial.inputs.index(name)])
        instance.set_values({name: _nudge(trial, name, base, _NUDGE)})
        after = _read(instance, outputs)
        instance.set_values({name: base})
        # Set back, everything must be as before: otherwise it is no dependency but memory.
        restored = _read(instance, outputs)
        changed = (after != before) & ~(np.isnan(after) & np.isnan(before)) & (restored == before)
        found |= {
            (output, name)
            for output, one in zip(outputs, changed, strict=True)
            if one and name not in declared[output]
        }
        before = restored
    return found


def derivatives(trial: Trial) -> Finding:
    """Directional derivatives of outputs agree with differences, at initialisation."""
    check, found = "directional derivatives", trial.description
    if not found.capabilities.directional_derivatives:
        reason = "The FMU does not declare that it gives directional derivatives of scalars."
        return Finding(check, Verdict.NOT_APPLICABLE, reason)
    inputs, outputs = _scalars(trial), _outputs(trial)
    if not inputs or not outputs:
        return Finding(check, Verdict.NOT_APPLICABLE, "There are no real inputs, or no real outputs.")
    if found.interface is not Interface.CO_SIMULATION:
        return Finding(check, Verdict.NOT_APPLICABLE, "They are tried with co-simulation only.")
    worst, where = 0.0, ("", "", 0.0, 0.0)
    compared = 0
    with trial.made() as instance:
        instance.enter_initialisation(0.0, {})
        trial.feed_start(instance, trial.rows)
        given = instance.output_derivatives(outputs, inputs)
        middle = _read(instance, outputs)
        for column, name in enumerate(inputs):
            base = float(instance.u[trial.inputs.index(name)])
            slopes = []
            for part in (_DIFFERENCE, -_DIFFERENCE):
                moved = _nudge(trial, name, base, part)
                instance.set_values({name: moved})
                slopes.append((_read(instance, outputs) - middle) / (moved - base))
            instance.set_values({name: base})
            for row, output in enumerate(outputs):
                right, left = float(slopes[0][row]), float(slopes[1][row])
                # At a corner either side will do.
                candidates = (right, left, 0.5 * (right + left))
                nominal = found.variables[output].nominal / found.variables[name].nominal
                size = max(abs(right), abs(left), abs(given[row, column]), 1e-6 * nominal)
                off = min(abs(given[row, column] - one) for one in candidates) / size
                compared += 1
                if not off <= worst:
                    worst, where = off, (output, name, float(given[row, column]), right)
        instance.exit_initialisation()
    if not worst <= _AGREE:
        output, name, got, expected = where
        return failed(
            check,
            Level.ERROR,
            f"The derivative of {output} by {name} is given as {got!r}; differences give {expected!r}.",
            "Correct it, or do not declare directional derivatives: masters solve loops with them.",
        )
    return passed(check, f"{compared} derivatives agree with differences to {worst:.1g}.", worst=worst)
