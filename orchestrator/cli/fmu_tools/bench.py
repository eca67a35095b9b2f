"""What an FMU costs: CPU time per step, per value, per instance; memory.

Each FMU is measured in a process of its own, in rounds; several take turns, so that what else the machine
does meets all of them alike.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ...base.errors import FmuError
from ...fmi import load_fmu
from .guarded_checks import Broken, Laboratory
from .search import Refused
from .text import rows_text
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


def bench_text(found: Mapping[str, Any]) -> str:
    """Medians with their spread; ratios of the first FMU to the others."""
    rows = [
        {
            "FMU": Path(one["file"]).stem,
            "step [us]": _shown(one["step"], 1e6),
            "set [us]": _shown(one["set"], 1e6),
            "get [us]": _shown(one["get"], 1e6),
            "instantiate [ms]": _shown(one["instantiate"], 1e3),
            "initialise [ms]": _shown(one["initialise"], 1e3),
            "memory [KiB]": None if one["memory"] is None else round(one["memory"] / 1024),
            "steps": one["steps"],
            "of [s]": one["step_size"],
            "loop": one["loop"],
        }
        for one in found["fmus"]
    ]
    first = found["fmus"][0]
    lines = [
        f"CPU time, median (least .. most) of {first['rounds']} rounds; a step without set and get; memory "
        "per further instance:",
        *rows_text(rows),
    ]
    if any(one["loop"] == "python" for one in found["fmus"]):
        lines.append("  loop python: each call from Python adds about a microsecond")
    for one in found["ratios"]:
        figures = [name for name in ("step", "whole", "instantiate") if name in one]
        ratios = ", ".join(f"{name} {_shown(one[name], 1.0)}" for name in figures)
        lines.append(f"{Path(one['of']).stem} over {Path(one['to']).stem}, paired: {ratios}")
    return "\n".join(lines)


def _shown(figures: Mapping[str, float], scale: float) -> str:
    median, least, most = (scale * figures[name] for name in ("median", "least", "most"))
    return f"{median:.3g} ({least:.3g} .. {most:.3g})"
