"""What FMUs cost, as text for terminals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .text import rows_text


def bench_text(found: Mapping[str, Any]) -> str:
    """Medians with their spread; ratios of the first FMU to the others."""
    rows = [
        {
            "FMU": Path(one["file"]).stem,
            "step [us]": _spread(one["step"], 1e6),
            "set [us]": _spread(one["set"], 1e6),
            "get [us]": _spread(one["get"], 1e6),
            "instantiate [ms]": _spread(one["instantiate"], 1e3),
            "initialise [ms]": _spread(one["initialise"], 1e3),
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
        ratios = ", ".join(f"{name} {_spread(one[name], 1.0)}" for name in figures)
        lines.append(f"{Path(one['of']).stem} over {Path(one['to']).stem}, paired: {ratios}")
    return "\n".join(lines)


def _spread(figures: Mapping[str, float], scale: float) -> str:
    median, least, most = (scale * figures[name] for name in ("median", "least", "most"))
    return f"{median:.3g} ({least:.3g} .. {most:.3g})"
