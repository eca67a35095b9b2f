"""Turn configured instances into checked ones: every input is connected or has a start value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..base.errors import Problem, close, listed
from ..config import Gaps, Places, Scalar
from ..config.text import flow
from ..fmi import Causality, Kind, Value, Variable
from . import checks
from .connection import Port
from .instance_models import Part
from .system import Instance


def inputs_with_unreadable_start(part: Part, gaps: Gaps) -> set[str]:
    """Inputs of an instance whose start value cannot be read, or is probably given under a misspelt name."""
    inputs = [variable.name for variable in part.fmu.description.inputs]
    path = ("instances", part.name, "start")
    if gaps.further(*path):
        return {f"{part.name}.{one}" for one in inputs}
    unread = [
        one for one in inputs if not all(gaps.knows(*path, key) for key in (one, one.partition("[")[0]))
    ]
    unknown = [one for one in part.start if one not in part.fmu.description.variables]
    like = [one for name in unknown for one in close(name, inputs)]
    # Of a list that does not fit its array.
    whole = [one.name for name in unknown for one in part.fmu.description.elements(name)]
    return {f"{part.name}.{one}" for one in (*unread, *like, *whole)}


def remarks(part: Part, places: Places) -> list[str]:
    """Notes for the user on an accepted FMU."""
    description, place = part.fmu.description, places.text(("instances", part.name))
    notes = []
    if description.deviations:
        first, *more = description.deviations
        further = f" and {len(more)} more" if more else ""
        notes.append(f"{place}: breaks a rule of FMI: {first}{further}")
    clocks = [one for one in description.variables.values() if one.kind is Kind.CLOCK]
    if clocks:
        ticked = [one.name for one in clocks if one.causality is Causality.INPUT]
        never = f"; {listed(ticked, 5)} never ticks, since no master ticks clocks of FMUs" if ticked else ""
        notes.append(
            f"{place}: clocks {listed((one.name for one in clocks), 5)}: the FMU ticks its own within its "
            f"steps, and ticks are not passed on between instances{never}"
        )
    tool = description.tool or "which it does not name"
    # pythonfmu declares a need that is met wherever this runs: Python.
    if description.capabilities.execution_tool and not tool.startswith("PythonFMU"):
        notes.append(f"{place}: runs only where the tool that made it is installed, {tool}")
    return notes


def resolve_start_values(
    part: Part,
    given: Mapping[str, Scalar],
    wired: Mapping[Port, tuple[int, Port]],
    fed: set[str],
    places: Places,
    problems: list[Problem],
    notes: list[str],
    unsure: set[str],
    keep: bool = True,
) -> Instance:
    """A checked instance: start values, dependencies, and a value for each input without a connection.

    Inputs in `fed` that are not in `wired` have a connection, or a start value, with a problem of its own.
    Instances whose stated dependencies are wrong are added to `unsure`. `keep`: whether inputs that nothing
    feeds keep the start value that their FMU declares.
    """
    path = ("instances", part.name)
    description = part.fmu.description
    start: dict[str, Value] = {}
    for name, value in given.items():
        result = checks.start_value(part.name, description, name, value, places.text((*path, "start", name)))
        if isinstance(result, Problem):
            problems.append(result)
        else:
            start[name] = result
    unfed = _without_value(part, given, wired, fed, places, problems, notes)
    kept = {one.name: one.start for one in unfed if keep and one.start is not None}
    if wanting := [one for one in unfed if one.name not in kept]:
        problems.append(_unfed(part.name, wanting, places.text(path)))
    before = len(problems)
    feedthrough, initial = checks.dependencies(part.name, description, part.feedthrough, places, problems)
    if len(problems) > before:
        unsure.add(part.name)
    assumed = description.assumed - part.feedthrough.keys()
    return Instance(
        part.name, part.fmu, {**start, **kept}, feedthrough, initial, part.ratio, assumed, frozenset(kept)
    )


def _without_value(
    part: Part,
    given: Mapping[str, Scalar],
    wired: Mapping[Port, tuple[int, Port]],
    fed: set[str],
    places: Places,
    problems: list[Problem],
    notes: list[str],
) -> list[Variable]:
    """Inputs that need a value and have none; problems of those with two, notes of those that keep it."""
    path = ("instances", part.name)
    inputs = part.fmu.description.inputs
    used = {
        variable.reference
        for variable in inputs
        if variable.name in given or f"{part.name}.{variable.name}" in fed
    }
    unfed: list[Variable] = []
    for variable in inputs:
        if variable.kind is Kind.CLOCK:
            continue  # see `remarks`
        if variable.elements > 1 and variable.reference not in used:
            if variable.element == 0:
                array = variable.name.rpartition("[")[0]
                notes.append(f"{places.text(path)}: input array {part.name}.{array} keeps its values")
            continue
        feed = wired.get(Port(part.name, variable.name))
        place = places.text((*path, "start", variable.name) if variable.name in given else path)
        if feed is not None and variable.name in given:
            what = f"{part.name}.{variable.name} has two sources, {feed[1]} and a start value"
            problems.append(
                Problem(place, what, f"connections[{feed[0]}] feeds it", "Remove one of the two.")
            )
        elif feed is None and variable.name not in given and f"{part.name}.{variable.name}" not in fed:
            if variable.shape or not variable.settable or variable.kind is Kind.BINARY or variable.clocks:
                what = f"input {part.name}.{variable.name} ({variable.type}) keeps its value"
                if variable.clocks:
                    what += f": it may be set only while its clock {listed(variable.clocks, 5)} ticks"
                notes.append(f"{place}: {what}")
                continue
            unfed.append(variable)
    return unfed


def _unfed(name: str, inputs: Sequence[Variable], place: str) -> Problem:
    """Inputs of an instance that get no value."""
    one = len(inputs) == 1
    labels = listed(f"{name}.{variable}" for variable in inputs)
    what = f"input{'' if one else 's'} {labels} {'is' if one else 'are'} not connected and "
    what += "has no start value" if one else "have no start values"
    remedy = f"Connect {'it, or give it a constant value' if one else 'them, or give them constant values'}"
    remedy += f" under instances.{name}.start"
    own = {one.name: one.written(one.start) for one in inputs if one.start is not None}
    return Problem(place, what, remedy=f"{remedy}, as the FMU's own: {flow(own)}" if own else f"{remedy}.")
