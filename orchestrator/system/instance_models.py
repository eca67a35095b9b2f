"""Find and read the FMUs of a config's instances, and each instance's own step size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, FmuError, Problem, listed, nearest
from ..config import Absent, Config, Draft, InstanceModel, Scalar
from ..config.base import exact_time
from ..fmi import Causality, CompiledFmu, Fmu, Interface, RunOptions, Variability, bundled, load_fmu
from .connections import Ends
from .external import SUFFIX, ExternalFmu, SignalFmu, targets_of


@dataclass(frozen=True)
class Part:
    """An instance as configured, before it is checked.

    Attributes:
        name: of the instance.
        fmu: what it is made from.
        start: start values with units, as in a config.
        feedthrough: dependencies that replace the FMU's own, per output.
        ratio: its own step size over the communication step size, n or 1/n.
    """

    name: str
    fmu: Fmu
    start: Mapping[str, Scalar | list[Any]] = field(default_factory=dict)
    feedthrough: Mapping[str, Sequence[str]] = field(default_factory=dict)
    ratio: Fraction = Fraction(1)


@dataclass(frozen=True)
class ConfiguredInstances:
    """Configured instances of a config.

    Attributes:
        parts: in the config's order.
        absent: those that do not exist.
        unsettled: names of instances whose own step size is unknown.
        problems: what is wrong with the others' FMUs and step sizes.
    """

    parts: list[Part]
    absent: Absent
    unsettled: frozenset[str]
    problems: tuple[Problem, ...]


def configured_instances(draft: Draft) -> ConfiguredInstances:
    """The configured instances, as far as they are known."""
    config, gaps = draft.config, draft.gaps
    assert config is not None
    model = config.model
    parts: list[Part] = []
    problems: list[Problem] = []
    unsettled: set[str] = set()
    ratios: dict[str, Fraction] = {}  # of files of signals
    known: dict[tuple[str, str | None, RunOptions], Fmu | None] = {}
    for name, instance in model.instances.items():
        if not gaps.knows("instances", name):
            continue
        ratio = _ratio(name, draft, problems)
        if ratio is None:
            unsettled.add(name)
        if Path(instance.fmu).suffix.lower() == SUFFIX:
            ratios[name] = ratio or Fraction(1)
            continue
        choice = instance.fmu, instance.form, _run_options(instance)
        if choice not in known:
            known[choice] = _find_fmu(*choice, config, ("instances", name), problems)
        fmu, start = known[choice], instance.start
        if fmu is not None and (sizes := _structural(fmu, start)):
            fmu = _resized(fmu, name, sizes, config, problems)
            start = {key: value for key, value in start.items() if key not in sizes}
        if fmu is not None:
            parts.append(Part(name, fmu, start, instance.feedthrough, ratio or Fraction(1)))
    _add_signals(parts, ratios, config, problems)
    for name, one in model.external.items():
        if gaps.knows("external", name):
            parts.append(Part(name, ExternalFmu(name, one)))
    there = {part.name for part in parts}
    names = {*model.instances, *gaps.beneath("instances"), *gaps.beneath("external")} - there
    # A name with a dot, which none may have: a port of it is read as one of what stands before the dot.
    absent = Absent(frozenset({*names, *(name.partition(".")[0] for name in names)} - there))
    if gaps.further("instances") or gaps.further("external"):
        absent = absent.but(there)
    return ConfiguredInstances(parts, absent, frozenset(unsettled), tuple(problems))


def _structural(fmu: Fmu, start: Mapping[str, Any]) -> dict[str, Any]:
    """The start values that are given for structural parameters."""
    variables = fmu.description.variables
    return {
        name: value
        for name, value in start.items()
        if name in variables and variables[name].causality is Causality.STRUCTURAL_PARAMETER
    }


def _resized(
    fmu: Fmu, name: str, sizes: Mapping[str, Any], config: Config, problems: list[Problem]
) -> Fmu | None:
    """The FMU with values of its structural parameters; None if there is a problem, which is reported."""
    wrong = len(problems)
    for key, value in sizes.items():
        variable, place = (
            fmu.description.variables[key],
            config.places.text(("instances", name, "start", key)),
        )
        low, high = variable.minimum, variable.maximum
        if type(value) is not int or value < 0:
            what = f"structural parameter {name}.{key} = {value!r}"
            problems.append(Problem(place, what, "a whole number of 0 or more is needed"))
        elif variable.variability not in (Variability.FIXED, Variability.TUNABLE):
            problems.append(Problem(place, f"structural parameter {name}.{key} is {variable.variability}"))
        elif (low is not None and value < low) or (high is not None and value > high):
            what = f"structural parameter {name}.{key} = {value!r}"
            problems.append(Problem(place, what, f"between {low:g} and {high:g}"))
    if len(problems) > wrong or not isinstance(fmu, CompiledFmu):
        return None
    run_options = replace(fmu.run_options, structure=tuple(sorted(sizes.items())))
    try:
        return load_fmu(fmu.path, run_options)
    except FmuError as error:
        place = config.places.text(("instances", name, "start"))
        problems.append(Problem(place, " ".join(str(error).split())))
        return None


def _add_signals(
    parts: list[Part], ratios: Mapping[str, Fraction], config: Config, problems: list[Problem]
) -> None:
    """Add the instances that play files of signals back, where the config has them.

    Args:
        ratios: their own step sizes over the communication step size, by name.
    """
    if not ratios:
        return
    variables = {
        f"{part.name}.{one.name}": one for part in parts for one in part.fmu.description.variables.values()
    }
    links = [Ends.of(0, one) for one in config.model.connections if one is not None]
    ends = [(source, link.target) for link in links for source, _ in link.sources]
    for name, ratio in ratios.items():
        place, file = config.places.text(("instances", name, "fmu")), config.model.instances[name].fmu
        path = config.folder / file
        if not path.is_file():
            problems.append(Problem(place, f"no file {path}", "a CSV file of signals over time"))
            continue
        try:
            fmu = SignalFmu(path, targets_of(name, ends, variables))
        except ConfigError as error:
            problems += error.problems
            continue
        parts.append(Part(name, fmu, ratio=ratio))
    order = {name: n for n, name in enumerate(config.model.instances)}
    parts.sort(key=lambda part: order[part.name])


def _ratio(name: str, draft: Draft, problems: list[Problem]) -> Fraction | None:
    """An instance's own step size over the communication step size; None if it is not known."""
    assert draft.config is not None
    instance, run = draft.config.model.instances[name], draft.config.model.run
    if not draft.gaps.knows("instances", name, "step_size"):
        return None
    own = instance.own_step()
    if own is None:
        return Fraction(1)
    if not draft.gaps.knows("run", "step_size"):
        return None
    step = exact_time(run.step_size)
    if step <= 0:
        return None
    ratio = own / step
    place = draft.config.places.text(("instances", name, "step_size"))
    what = f"cannot step {name} by {instance.step_size}"
    if ratio <= 0 or 1 not in (ratio.numerator, ratio.denominator):
        what = f"{what}: it is {float(ratio):.6g} communication steps of {run.step_size}"
        allowed = "a whole multiple, or a whole part of one, is needed"
        problems.append(Problem(place, what, allowed))
        return None
    if ratio > 1 and all(draft.gaps.knows("run", key) for key in ("start_time", "stop_time")):
        begin, end, _ = run.times()
        if ((end - begin) / own).denominator != 1:
            of = f"a run of {float(end - begin)!r} s is {float((end - begin) / own):.6g} steps of it"
            problems.append(Problem(place, f"{what}: {of}", "a whole number is needed"))
            return None
    return ratio


def _run_options(instance: InstanceModel) -> RunOptions:
    return RunOptions(
        any_step=instance.any_step,
        interface=None if instance.interface is None else Interface(instance.interface),
        tolerance=instance.tolerance,
        event_mode=instance.event_mode,
        isolated=instance.isolate is not None,
        time_limit=instance.seconds(),
    )


def _find_fmu(
    text: str,
    form: str | None,
    run_options: RunOptions,
    config: Config,
    path: tuple[str, ...],
    problems: list[Problem],
) -> Fmu | None:
    """The FMU of an instance; None if there is a problem, which is reported."""
    place = config.places.text((*path, "fmu"))
    file = config.folder / text
    found = file if file.is_file() else bundled.find_fmu(text)
    if found is None:
        names = bundled.fmu_names()
        is_path = "/" in text or "\\" in text or text.endswith(".fmu")
        what = f"no file {file}" if is_path else f"no FMU {text!r}"
        allowed = "" if is_path else f"no file {file}; "
        allowed += f"bundled FMUs: {listed(names)}"
        problems.append(Problem(place, what, allowed, nearest(Path(text).stem, names)))
        return None
    if form is not None:
        forms = {} if file.is_file() else bundled.fmu_forms(text)
        if form not in forms:
            what = f"{text!r} comes in one form only, there is no form to choose"
            two = [name for name in bundled.fmu_names() if bundled.fmu_forms(name)]
            allowed = f"bundled FMUs in the forms python and native: {listed(two)}"
            problems.append(Problem(config.places.text((*path, "form")), what, allowed, "Leave form out."))
            return None
        found = forms[form]
    try:
        fmu = load_fmu(found, run_options)
        fmu.check()
        return fmu
    except FmuError as error:
        first, _, rest = str(error).partition("\n")
        problems.append(Problem(place, first, "\n".join(line.strip() for line in rest.splitlines())))
        return None
