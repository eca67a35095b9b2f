"""How two FMUs differ, as text for terminals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .comparison import Comparison
from .text import rows_text


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
