"""What the command line adds to a config: a file of signals for inputs, and further signals to record."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, Problem, listed, nearest
from ..config import Config, Draft, load_config
from ..config.models import SystemModel
from ..fmi import Causality
from .external import read_header
from .instance_models import Part, configured_instances

# The instance that plays a file back.
_NAME = "input"


def requested(
    source: str | Path | Config,
    overrides: Iterable[str] = (),
    *,
    inputs: str | Path | None = None,
    record: Sequence[str] = (),
) -> Config:
    """A config with what a command asks for.

    Args:
        source, overrides: see `load_config`.
        inputs: a CSV file whose columns feed the inputs of the same names, "instance.variable" or, where one
            instance alone has it, "variable".
        record: patterns of signals to record besides, as "h", "der(*)" or "robot.*".
    Returns: the config as it is where its FMUs have problems, which its check reports.
    Raises: ConfigError with all problems of the rest.
    """
    config = load_config(source, overrides)
    if inputs is None and not record:
        return config
    data, problems, made = config.model.to_data(), list[Problem](), configured_instances(Draft(config))
    if made.problems:
        # The check of the config reports them with all others.
        return config
    parts = made.parts
    if inputs is not None:
        _feed(data, parts, Path(inputs), problems)
    if record:
        data["run"]["record"] = _recorded(config, parts, record, problems)
    if problems:
        raise ConfigError(problems)
    return replace(config, model=SystemModel.model_validate(data))


def _feed(data: dict[str, Any], parts: Sequence[Part], path: Path, problems: list[Problem]) -> None:
    """Add an instance that plays a file back, and connections from its columns."""
    ports = [f"{part.name}.{one.name}" for part in parts for one in part.fmu.description.inputs]
    name, number = _NAME, 2
    while name in data["instances"] or name in data.get("external", ()):
        name, number = f"{_NAME}{number}", number + 1
    connections = []
    for column in read_header(path):
        found = [one for one in ports if column.name in (one, one.partition(".")[2])]
        if len(found) == 1:
            instance, _, variable = found[0].partition(".")
            data["instances"].get(instance, {}).get("start", {}).pop(variable, None)
            connections.append(f"{name}.{column.name} -> {found[0]}")
            continue
        what = f"column {column.name!r} names {'several inputs' if found else 'no input'}"
        known = found or (ports if len(parts) > 1 else [one.partition(".")[2] for one in ports])
        problems.append(Problem(path.name, what, f"inputs: {listed(known)}", nearest(column.name, known)))
    data["instances"] = {name: {"fmu": str(path.resolve())}, **data["instances"]}
    data["connections"] = [*data.get("connections", ()), *connections]


def _recorded(
    config: Config, parts: Sequence[Part], patterns: Sequence[str], problems: list[Problem]
) -> list[str]:
    """The signals that a config records, and those that patterns name."""
    every = {
        f"{part.name}.{one.name}": one for part in parts for one in part.fmu.description.variables.values()
    }
    numeric = {name: one for name, one in every.items() if not one.unrecorded}
    record = config.model.run.record
    outputs = [name for name, one in numeric.items() if one.causality is Causality.OUTPUT]
    found = dict.fromkeys(outputs if record == "all" else record)
    for pattern in patterns:
        # An index, as in x[1], is no set of characters.
        plain = pattern.replace("[", "[[]")
        named = [
            name for name in every if fnmatchcase(name, plain) or fnmatchcase(name.partition(".")[2], plain)
        ]
        matches, refused = ([name for name in named if (name in numeric) is held] for held in (True, False))
        if not matches and refused:
            what = f"{refused[0]} cannot be recorded"
            problems.append(Problem("--record", what, f"it is {every[refused[0]].unrecorded}"))
        elif not matches:
            near = nearest(pattern, [*numeric, *(name.partition(".")[2] for name in numeric)])
            problems.append(Problem("--record", f"no variable {pattern!r} of a number", "", near))
        found.update(dict.fromkeys(matches))
    return list(found)
