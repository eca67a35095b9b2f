"""What an FMU costs: CPU time per step, per value, per instance; memory.

Each FMU is measured in a process of its own, in rounds; several take turns, so that what else the machine
does meets all of them alike.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ...base.errors import FmuError
from ...fmi import load_fmu
from .guarded_checks import Broken, Laboratory
from .search import Refused
from .trial import Conditions
from .validate import usable_conditions

_TIME_LIMIT = 120.0


def bench_fmus(paths: Sequence[Path], wanted: Conditions, rounds: int) -> dict[str, Any]:
    """Measure FMUs in turn.

    Returns: per FMU medians with their spread, and the ratios of the first to each other one, paired by
        rounds; see `bench_text` for what each figure is.
    Raises: FmuError if one cannot be read, does not run, or crashes.
    """
    with ExitStack() as stack:
        laboratories = []
        for path in paths:
            description = load_fmu(path).description
            laboratory = stack.enter_context(Laboratory(path, wanted, _TIME_LIMIT))
            try:
                usable_conditions(laboratory, description, wanted, [])
            except Refused as refusal:
                raise FmuError(f"{path}: cannot be measured, since it does not run: {refusal}") from refusal
            laboratories.append(laboratory)
        steps = [_asked(one, path, "calibrate") for one, path in zip(laboratories, paths, strict=True)]
        measured: list[list[dict[str, Any]]] = [[] for _ in paths]
        for _ in range(rounds):
            for index, laboratory in enumerate(laboratories):
                measured[index].append(_asked(laboratory, paths[index], "round", steps[index]))
        memory = [_asked(one, path, "memory") for one, path in zip(laboratories, paths, strict=True)]
    found = [
        {
            "file": str(path),
            "loop": series[0]["loop"],
            "step_size": series[0]["step_size"],
            "steps": taken,
            "rounds": rounds,
            "memory": used,
            **{name: _spread([one[name] for one in series]) for name in _FIGURES},
        }
        for path, series, taken, used in zip(paths, measured, steps, memory, strict=True)
    ]
    ratios = [
        {"of": str(paths[0]), "to": str(path), **_ratios(measured[0], series)}
        for path, series in zip(paths[1:], measured[1:], strict=True)
    ]
    return {"fmus": found, "ratios": ratios}


_FIGURES = ("instantiate", "initialise", "set", "get", "step", "whole")


def _ratios(ones: list[dict[str, Any]], others: list[dict[str, Any]]) -> dict[str, Any]:
    """Per figure, from successive rounds; a step that is too short to be measured has none."""
    return {
        name: _spread([one[name] / other[name] for one, other in zip(ones, others, strict=True)])
        for name in ("step", "whole", "instantiate")
        if all(other[name] > 0.0 for other in others)
    }


def _spread(values: Sequence[float]) -> dict[str, float]:
    return {"median": statistics.median(values), "least": min(values), "most": max(values)}


def _asked(laboratory: Laboratory, path: Path, name: str, *arguments: Any) -> Any:
    answer = laboratory.do(name, *arguments)
    if isinstance(answer, Broken | str):
        raise FmuError(f"{path}: cannot be measured: {answer}")
    return answer
