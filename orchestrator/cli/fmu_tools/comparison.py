"""Two FMUs, or two versions or forms of one, compared: what they declare, and what they answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import FmuError, StepError
from ...fmi import Array, ModelDescription, RunOptions, Variable, load_fmu
from .search import Refused, usable
from .stimulus import stimulus
from .text import rows_text
from .trial import Conditions, Ended, Trial, fmu_for_trial

_ATTRIBUTES = ("causality", "variability", "kind", "unit_name", "start", "minimum", "maximum", "nominal")
_CALL_LIMIT = 60.0  # [s]


@dataclass(frozen=True)
class Difference:
    """Of an output that both FMUs have.

    Attributes:
        largest: absolute difference, in the output's unit; time: where [s].
        scale: the largest absolute value of the output, or, where that is less, 1e-9 of its nominal value.
    """

    output: str
    largest: float
    time: float
    scale: float

    @property
    def relative(self) -> float:
        """The difference over the scale."""
        return self.largest / self.scale


@dataclass(frozen=True)
class Comparison:
    """How two FMUs differ.

    Attributes:
        attributes: per attribute of the model description that differs, both values.
        removed, added: names of ports and parameters that only the first or the second has.
        changed: per variable, per attribute, both values.
        differences: of common outputs, the largest first; empty where nothing was run.
        conditions: under which they were run; None: there is no common output, or no way to run both.
        reason: why they were not run.
    """

    attributes: dict[str, tuple[Any, Any]]
    removed: tuple[str, ...]
    added: tuple[str, ...]
    changed: dict[str, dict[str, tuple[Any, Any]]]
    differences: tuple[Difference, ...] = ()
    conditions: Conditions | None = None
    reason: str = ""
    inputs: tuple[str, ...] = field(default=())

    @property
    def interface_differs(self) -> bool:
        """Whether one cannot stand for the other without a change of a config."""
        ports = {"causality", "kind", "unit_name"}
        return bool(self.removed) or any(ports & changes.keys() for changes in self.changed.values())

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "attributes": {name: list(pair) for name, pair in self.attributes.items()},
            "removed": list(self.removed),
            "added": list(self.added),
            "changed": {
                name: {key: list(pair) for key, pair in changes.items()}
                for name, changes in self.changed.items()
            },
            "behaviour": None if self.conditions is None else {
                "steps": self.conditions.steps,
                "step_size": self.conditions.step_size,
                "seed": self.conditions.seed,
                "amplitude": self.conditions.amplitude,
                "inputs": list(self.inputs),
                "outputs": [
                    {"output": one.output, "largest": one.largest, "time": one.time, "relative": one.relative}
                    for one in self.differences
                ],
            },
            "reason": self.reason,
        }  # fmt: skip


def compare_fmus(one: Path, other: Path, conditions: Conditions) -> Comparison:
    """Compare two FMUs; both run in processes of their own, on the same inputs.

    Args:
        conditions: a step size of None takes that of the first FMU, then of the second.
    Raises: FmuError if one cannot be read.
    """
    first, second = (load_fmu(path).description for path in (one, other))
    declared = _declared(first, second)
    outputs = [
        name
        for name in (v.name for v in first.outputs)
        if name in second.variables and _plain(first.variables[name]) and _plain(second.variables[name])
    ]
    if not outputs:
        return replace(declared, reason="They have no numeric output in common.")
    return _driven(declared, (one, other), (first, second), outputs, conditions)


def _plain(variable: Variable) -> bool:
    return variable.kind.numeric and not variable.shape


def _declared(first: ModelDescription, second: ModelDescription) -> Comparison:
    attributes = {
        name: (getattr(first, name), getattr(second, name))
        for name in ("name", "fmi_version", "interface", "tool", "default_step", "own_step")
        if getattr(first, name) != getattr(second, name)
    }
    shown = ("input", "output", "parameter", "structuralParameter")
    ports = [
        {name: v for name, v in description.variables.items() if v.causality in shown}
        for description in (first, second)
    ]
    changed = {}
    for name in ports[0].keys() & second.variables.keys() | ports[1].keys() & first.variables.keys():
        before, after = first.variables[name], second.variables[name]
        pairs = {key: (getattr(before, key), getattr(after, key)) for key in _ATTRIBUTES}
        differing = {key: pair for key, pair in pairs.items() if pair[0] != pair[1]}
        if differing:
            changed[name] = differing
    return Comparison(
        attributes,
        removed=tuple(name for name in ports[0] if name not in second.variables),
        added=tuple(name for name in ports[1] if name not in first.variables),
        changed=dict(sorted(changed.items())),
    )


def _driven(
    declared: Comparison,
    paths: tuple[Path, Path],
    descriptions: tuple[ModelDescription, ModelDescription],
    outputs: list[str],
    wanted: Conditions,
) -> Comparison:
    first, second = descriptions
    inputs = [
        v
        for v in first.inputs
        if _plain(v) and v.name in second.variables and _plain(second.variables[v.name])
    ]
    names = [v.name for v in inputs]
    run_options = RunOptions(isolated=True, time_limit=_CALL_LIMIT, any_step=True)
    fmus = [fmu_for_trial(path, run_options) for path in paths]

    def trials(conditions: Conditions) -> list[Trial]:
        return [Trial(fmu, conditions, names, outputs) for fmu in fmus]

    def rows(conditions: Conditions) -> Array:
        return stimulus(inputs, conditions.steps, conditions.amplitude, conditions.seed)

    def attempt(conditions: Conditions) -> int:
        return min(_steps(trial, rows(conditions)) for trial in trials(conditions))

    proposed = [one.own_step or one.default_step for one in descriptions]
    own = wanted.step_size or proposed[0] or proposed[1]
    try:
        conditions = usable(attempt, wanted, own, bool(inputs))
    except Refused as refusal:
        return replace(declared, reason=f"They were not run: {refusal}")
    runs = [trial.trajectory(rows(conditions)) for trial in trials(conditions)]
    differences = tuple(_differences(*runs, outputs, trials(conditions)[0].step, first))
    return replace(declared, differences=differences, conditions=conditions, inputs=tuple(names))


def _steps(trial: Trial, rows: Array) -> int:
    try:
        return trial.steps_taken(rows)
    except (StepError, FmuError, Ended) as error:
        raise Refused(f"{trial.fmu.path.name}: {' '.join(str(error).split())}") from error


def _differences(one: Array, other: Array, outputs: list[str], step: float, first: ModelDescription) -> Any:
    with np.errstate(invalid="ignore"):
        apart = np.abs(one - other)
    apart[np.isnan(one) & np.isnan(other)] = 0.0
    apart[np.isnan(apart)] = np.inf
    apart[one == other] = 0.0
    found = []
    for column, name in enumerate(outputs):
        row = int(np.argmax(apart[:, column]))
        finite = one[np.isfinite(one[:, column]), column]
        scale = max(np.abs(finite).max(initial=0.0), 1e-9 * first.variables[name].nominal)
        found.append(Difference(name, float(apart[row, column]), row * step, float(scale)))
    return sorted(found, key=lambda difference: -difference.relative)


def comparison_text(found: Comparison, paths: Sequence[Path]) -> str:
    """What they declare otherwise, and the largest difference of each output."""
    lines = [f"{paths[0]} against {paths[1]}"]
    lines += [f"  {name}: {_pair(pair)}" for name, pair in found.attributes.items()]
    for title, names in (("only in the first", found.removed), ("only in the second", found.added)):
        lines += [f"{title}: {', '.join(names)}"] if names else []
    rows = [
        {"variable": name, "attribute": key, "first": _shown(pair[0]), "second": _shown(pair[1])}
        for name, changes in found.changed.items()
        for key, pair in changes.items()
    ]
    lines += ["declared otherwise:", *rows_text(rows)] if rows else ["ports and parameters: the same"]
    if found.conditions is None:
        return "\n".join([*lines, found.reason])
    given = found.conditions
    size = f"up to {given.amplitude:g} of their nominal values" if given.amplitude else "at rest"
    lines.append(f"{given.steps} steps of {given.step_size:g} s, inputs {size}, seed {given.seed}:")
    differing = [one for one in found.differences if one.largest]
    same = len(found.differences) - len(differing)
    lines += rows_text(
        [
            {
                "output": one.output,
                "largest difference": one.largest,
                "over its largest value": one.relative,
                "at [s]": one.time,
            }
            for one in differing
        ]
    )
    lines.append(f"{same} of {len(found.differences)} outputs are the same to the bit")
    return "\n".join(lines)


def _shown(value: Any) -> str:
    return "-" if value is None or value == "" else str(value)


def _pair(pair: tuple[Any, Any]) -> str:
    return f"{_shown(pair[0])} -> {_shown(pair[1])}"
