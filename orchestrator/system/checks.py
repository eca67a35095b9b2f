"""What a system is checked for, one check each, with its message."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path

from ..base.errors import Problem, listed, nearest
from ..base.quantities import Measure, quantity
from ..base.units import UnitError, convert
from ..config import Places, Scalar
from ..fmi import (
    DEFAULT_TOLERANCE,
    Causality,
    Fmu,
    Kind,
    ModelDescription,
    Value,
    Variable,
    integration_tolerance,
)
from .connection import Port
from .system import Instance


def connection(
    source: Port,
    source_description: ModelDescription,
    target: Port,
    target_description: ModelDescription,
    place: str,
) -> tuple[float, float, str] | list[Problem]:
    """Check a connection.

    Returns: gain, offset and a note (empty if there is nothing to note), or the problems.
    """
    problems = []
    for port, description, causality in (
        (source, source_description, Causality.OUTPUT),
        (target, target_description, Causality.INPUT),
    ):
        problem = end(port, description, causality, place)
        if problem is not None:
            problems.append(problem)
    if problems:
        return problems
    one = source_description.variables[source.variable]
    other = target_description.variables[target.variable]
    what = f"cannot connect {source.instance}.{one} to {target.instance}.{other}"
    inputs = f"{target.instance}'s inputs: {listed(map(str, target_description.inputs))}"
    if one.kind is not other.kind:
        fitting = [v.name for v in target_description.inputs if v.kind is one.kind]
        return [Problem(place, what, f"types differ; {inputs}", _suggest(fitting, target.instance))]
    if one.kind is Kind.ENUMERATION and one.items and other.items and one.items != other.items:
        allowed = f"items differ: {listed(one.items)} against {listed(other.items)}"
        return [Problem(place, what, allowed)]
    if one.unit is None or other.unit is None:
        if one.unit_name == other.unit_name:
            return 1.0, 0.0, ""
        if one.unit_name and other.unit_name:
            return [Problem(place, what, f"units differ, and not both are known; {inputs}")]
        return 1.0, 0.0, f"{source.instance}.{one} -> {target.instance}.{other}: units not checked"
    if not one.unit.same_dimension(other.unit):
        fitting = [
            v.name
            for v in target_description.inputs
            if v.unit is not None and v.unit.same_dimension(one.unit)
        ]
        return [Problem(place, what, f"units differ; {inputs}", _suggest(fitting, target.instance))]
    try:
        gain, offset = convert(one.unit, other.unit)
    except UnitError as error:
        return [Problem(place, what, str(error))]
    note = ""
    if (gain, offset) != (1.0, 0.0):
        shift = f" + {offset!r}" if offset else ""
        note = f"{source.instance}.{one} -> {target.instance}.{other}: converted, {gain!r} * value{shift}"
    return gain, offset, note


def _suggest(names: Sequence[str], instance: str) -> str:
    if not names:
        return ""
    return f"Did you mean {' or '.join(f'{instance}.{name}' for name in names[:3])}?"


def end(port: Port, description: ModelDescription, causality: Causality, place: str) -> Problem | None:
    """Check one end of a connection."""
    own = description.outputs if causality is Causality.OUTPUT else description.inputs
    offered = f"{port.instance}'s {causality}s: {listed(map(str, own))}"
    variable = description.variables.get(port.variable)
    if variable is None:
        what = f"{port.instance} has no variable {port.variable!r}"
        return Problem(
            place, what, offered, nearest(port.variable, [v.name for v in own], f"{port.instance}.")
        )
    if variable.causality is not causality:
        side = "source" if causality is Causality.OUTPUT else "target"
        what = f"{port} cannot be the {side} of a connection: its causality is {variable.causality}"
        return Problem(place, what, offered)
    if variable.shape:
        allowed = "only scalars can be connected"
        if variable.kind is Kind.BINARY:
            allowed = "of binary variables only scalars can be connected"
        return Problem(place, f"{port} is an array of shape {variable.shape}", allowed)
    if variable.clocks and causality is Causality.INPUT:
        what = f"{port} may be set only while its clock {listed(variable.clocks, 5)} ticks"
        return Problem(place, what, "it cannot be connected, since no master ticks clocks of FMUs")
    if not (variable.kind.numeric or variable.carried):
        return Problem(place, f"{port} is of type {variable.type}", "it cannot be connected")
    return None


def start_value(
    instance: str, description: ModelDescription, name: str, value: Scalar, place: str
) -> Value | Problem:
    """A start value as the FMU takes it, or what is wrong with it."""
    variable = description.variables.get(name)
    if variable is None:
        names = [v.name for v in sorted(description.variables.values(), key=_local) if v.settable]
        what = f"{instance} has no variable {name!r}"
        return Problem(
            place, what, f"variables that can be set: {listed(names)}", nearest(name, names, f"{instance}.")
        )
    if variable.kind is Kind.CLOCK:
        what = f"{instance}.{name} cannot be set: a clock has no value"
        return Problem(place, what, remedy="Leave it out.")
    if variable.kind is Kind.BINARY and variable.settable and not variable.shape:
        try:
            return bytes.fromhex(str(value))
        except ValueError:
            what = f"{instance}.{name} is binary, got {value!r}"
            return Problem(place, what, "hexadecimal digits in quotes are needed, as '00ff'")
    if not variable.settable or variable.shape:
        why = f"causality {variable.causality}, variability {variable.variability}"
        if variable.initial:
            why += f", initial {variable.initial}"
        if variable.shape:
            why = f"an array of shape {variable.shape}"
        return Problem(place, f"{instance}.{name} cannot be set: it is {why}")
    converted = _converted(instance, variable, value, place)
    if isinstance(converted, Problem):
        return converted
    return (
        in_range(instance, variable, converted, value, place)
        or _inexact(instance, variable, converted, place)
        or converted
    )


def _inexact(instance: str, variable: Variable, value: Value, place: str) -> Problem | None:
    """The problem of a whole number that an input or output, as a signal, does not hold; parameters do."""
    if variable.causality not in (Causality.INPUT, Causality.OUTPUT) or not variable.rounded(value):
        return None
    what = f"{instance}.{variable.name} = {value!r}: a signal would hold {variable.rounded(value)}"
    allowed = "signals are 64-bit floats, which hold whole numbers up to 2^53 = 9007199254740992 exactly"
    return Problem(place, what, allowed)


def _local(variable: Variable) -> bool:
    return variable.causality is Causality.LOCAL


def _converted(instance: str, variable: Variable, value: Scalar, place: str) -> Value | Problem:
    label = f"{instance}.{variable.name}"
    if variable.kind is Kind.REAL:
        # As YAML 1.2 and Python write them.
        if isinstance(value, str) and re.fullmatch(r"[-+]?\.?(inf|infinity|nan)", value, re.IGNORECASE):
            return _not_finite(f"{instance}.{variable}", value, place)
        measure = Measure(variable.unit_name, variable.unit, variable.display_units)
        return quantity(f"{instance}.{variable}", measure, value, place)
    if variable.kind is Kind.ENUMERATION:
        if isinstance(value, str) and value in variable.items:
            return variable.items[value]
        if type(value) is int and (value in variable.items.values() or not variable.items):
            return value
        allowed = f"allowed: {listed(variable.items)}"
        suggestion = nearest(value, variable.items) if isinstance(value, str) else ""
        return Problem(place, f"{label} has no item {value!r}", allowed, suggestion)
    wanted, word = {
        Kind.INTEGER: (int, "a whole number"),
        Kind.BOOLEAN: (bool, "true or false"),
        Kind.STRING: (str, "text"),
    }[variable.kind]
    if type(value) is wanted:
        return value
    remedy = f"Put it in quotes: '{value}'." if wanted is str else ""
    return Problem(place, f"{label} must be {word}, got {value!r}", remedy=remedy)


def in_range(instance: str, variable: Variable, value: Value, given: Scalar, place: str) -> Problem | None:
    """The problem of a value beyond the bounds of its variable or of its type; None within them.

    Args:
        value: in the variable's unit; given: as it was written.
    """
    if not isinstance(value, int | float) or variable.kind not in (Kind.REAL, Kind.INTEGER):
        return None
    if isinstance(value, float) and not math.isfinite(value):
        return _not_finite(f"{instance}.{variable}", given, place)
    low, high = variable.minimum, variable.maximum
    held = variable.held_range
    if held is not None:
        low = held[0] if low is None else max(low, held[0])
        high = held[1] if high is None else min(high, held[1])
    if (low is None or value >= low) and (high is None or value <= high):
        return None
    unit = f" {variable.unit_name}" if variable.unit_name not in ("", "1") else ""
    bounds = [f"at least {low!r}{unit}"] if low is not None else []
    bounds += [f"at most {high!r}{unit}"] if high is not None else []
    allowed = f"allowed: {' and '.join(bounds)}"
    if held is not None and not held[0] <= value <= held[1]:
        allowed += f"; its type is {variable.type}"
    return Problem(place, f"{instance}.{variable.name} = {given} is out of range", allowed)


def _not_finite(label: str, given: Scalar, place: str) -> Problem:
    return Problem(place, f"{label} must be a finite number, got {given}")


def dependencies(
    instance: str,
    description: ModelDescription,
    stated: Mapping[str, Sequence[str]],
    places: Places,
    problems: list[Problem],
) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]]:
    """Direct feedthrough when stepping and at initialisation: the FMU's, unless the config has it."""
    feedthrough = dict(description.feedthrough)
    initial = dict(description.initial_feedthrough)
    outputs, inputs = [v.name for v in description.outputs], [v.name for v in description.inputs]
    for output, sources in stated.items():
        place = places.text(("instances", instance, "feedthrough", output))
        wrong = [(output, outputs, "output")] if output not in outputs else []
        wrong += [(name, inputs, "input") for name in sources if name not in inputs]
        for name, names, kind in wrong:
            what = f"{instance} has no {kind} {name!r}"
            problems.append(Problem(place, what, f"{kind}s: {listed(names)}", nearest(name, names)))
        if not wrong:
            feedthrough[output] = initial[output] = tuple(sources)
    return feedthrough, initial


def recordable(
    instance: str,
    name: str,
    descriptions: Mapping[str, ModelDescription],
    place: str,
    names: Sequence[str] = (),
) -> Problem | None:
    """Check a signal that is to be recorded; `names`: of all instances, where not all are described."""
    if instance not in descriptions:
        what = f"no instance {instance!r} to record {instance}.{name} of"
        names = names or list(descriptions)
        return Problem(place, what, f"instances: {listed(names)}", nearest(instance, names))
    variables = descriptions[instance].variables
    variable = variables.get(name)
    names = [v.name for v in variables.values() if not v.unrecorded]
    if variable is None:
        what = f"{instance} has no variable {name!r} to record"
        return Problem(place, what, f"it has {listed(names)}", nearest(name, names, f"{instance}."))
    if variable.unrecorded:
        return Problem(place, f"{instance}.{name} cannot be recorded", f"it is {variable.unrecorded}")
    return None


def shared_process(fmus: Iterable[tuple[str, Fmu]], places: Places) -> list[Problem]:
    """FMUs that may stand in a process once only, and stand there twice; given by instance name."""
    problems = []
    counts: Counter[Path | int] = Counter()
    for name, fmu in fmus:
        if not fmu.description.capabilities.once_per_process:
            continue
        key = id(fmu) if fmu.path is None else fmu.path
        counts[key] += 1
        if counts[key] == 2:
            what = f"second instance of {fmu.description.name}"
            allowed = "the FMU declares canBeInstantiatedOnlyOncePerProcess"
            remedy = f"Give it a process of its own: instances.{name}.isolate: process."
            problems.append(Problem(places.text(("instances", name)), what, allowed, remedy))
    return problems


def integration(name: str, fmu: Fmu, places: Places) -> list[str]:
    """A note on a model-exchange FMU for which neither the config nor the FMU names a tolerance."""
    description, asked = fmu.description, getattr(getattr(fmu, "run_options", None), "tolerance", None)
    if asked or description.tolerance or not description.states or integration_tolerance(fmu) is None:
        return []
    return [
        f"{places.text(('instances', name))}: {name} is integrated with the relative tolerance "
        f"{DEFAULT_TOLERANCE:g}, since its FMU proposes none; instances.{name}.tolerance sets another"
    ]


def step_size(instances: Iterable[Instance], size: Fraction, places: Places) -> list[Problem]:
    """Instances that cannot take a step size.

    Args:
        size: of the communication step [s].
    """
    problems = []
    for one in instances:
        own = one.fmu.description.own_step
        if own is None:
            continue
        taken = size * one.ratio
        ratio = float(taken) / own
        nearest_ratio = max(1, round(ratio)) if one.fmu.description.own_step_divides else 1
        if abs(ratio - nearest_ratio) <= 1e-9 * nearest_ratio:
            continue
        multiples = " or a whole multiple of it" if one.fmu.description.own_step_divides else ""
        what = f"{one.name} cannot take a step size of {float(taken)!r} s: its own is {own!r} s"
        allowed = "the FMU does not declare canHandleVariableCommunicationStepSize"
        remedy = (
            f"Set run.step_size, or instances.{one.name}.step_size, to {own!r} s{multiples}; or, "
            f"if the FMU takes any constant step, say so: "
            f"instances.{one.name}.any_step: true."
        )
        problems.append(Problem(places.text(("instances", one.name)), what, allowed, remedy))
    return problems
