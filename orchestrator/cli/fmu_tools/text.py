"""What the tools found, as text for terminals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from ...base.errors import listed
from .finding import Finding, Level, Verdict

_MOST_ROWS = 60
_MOST_NAMES = 6
_MARKS = {
    Verdict.PASSED: "passed",
    Verdict.NOT_APPLICABLE: "n/a",
    Verdict.NOT_TRIED: "not tried",
}


def rows_text(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """A table, two spaces between columns; the count of rows beyond `_MOST_ROWS`."""
    if not rows:
        return []
    names = list(rows[0])
    cells = [names, *([_cell(row[name]) for name in names] for row in rows[:_MOST_ROWS])]
    widths = [max(len(line[column]) for line in cells) for column in range(len(names))]
    lines = [
        "  " + "  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    ]
    return lines + ([f"  and {len(rows) - _MOST_ROWS} more"] if len(rows) > _MOST_ROWS else [])


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        rest = f" and {len(value) - _MOST_NAMES} more" if len(value) > _MOST_NAMES else ""
        return (", ".join(map(str, value[:_MOST_NAMES])) + rest) or "none"
    return str(value)


def inspection_text(found: Mapping[str, Any]) -> str:
    """What is in an FMU."""
    experiment = found["experiment"]
    able = [name for name, value in found["capabilities"].items() if value not in (False, None, 0)]
    lines = [
        f"{found['name']}: {found['description']}".rstrip(": "),
        f"  file          {found['file']}, {found['size']} bytes, {found['checksum']}",
        f"  FMI           {found['fmi_version']}, {' and '.join(found['interfaces'])}",
        f"  made with     {found['tool'] or 'not stated'}",
        f"  token         {found['token']}",
        f"  step size     {_cell(experiment['fixed_step_size'] or experiment['step_size'])}"
        f"{' s, no other' if experiment['fixed_step_size'] else ' s' if experiment['step_size'] else ''}",
        f"  can           {', '.join(able) or 'nothing beyond stepping'}",
        f"  holds         {', '.join(f'{part} {size} bytes' for part, size in found['sizes'].items())}",
        f"  variables     {', '.join(f'{count} {name}' for name, count in found['counts'].items())}",
    ]
    if found["states"] or found["event_indicators"]:
        lines.append(f"  states        {found['states']}, event indicators {found['event_indicators']}")
    for name in ("sources", "documentation", "resources"):
        lines.append(f"  {name:13} {_cell(found[name])}")
    lines += [f"  deviation     {one}" for one in found["deviations"]]
    lines.append(f"binaries (this platform is {found['this_platform']}):")
    lines += rows_text([_binary_row(name, one) for name, one in found["binaries"].items()]) or ["  none"]
    for platform, files in found["platforms_without_library"].items():
        lines.append(f"  {platform}: no library {found['model_identifier']}; it holds {listed(files)}")
    for title, causalities in (
        ("inputs", ("input",)),
        ("outputs", ("output",)),
        ("parameters", ("parameter", "calculatedParameter")),
    ):
        rows = [_variable_row(one) for one in found["variables"] if one["causality"] in causalities]
        if rows:
            lines += [f"{title}:", *rows_text(rows)]
    return "\n".join(lines)


def _binary_row(platform: str, one: Mapping[str, Any]) -> dict[str, Any]:
    kinds = [f"{image['kind']} {image['architecture']}" for image in one["images"]]
    return {
        "platform": platform,
        "in FMI 2.0": one["fmi2_platform"] or "-",
        "in FMI 3.0": ", ".join(one["fmi3_platforms"]) or "-",
        "image": one["problem"] or " + ".join(kinds),
        "bytes": one["size"],
        "functions": one["functions_exported"],
        "missing": one["functions_missing"],
        "needs beyond the system": one["needs_beyond_the_system"],
    }


def _variable_row(one: Mapping[str, Any]) -> dict[str, Any]:
    row = {
        "name": one["name"] + (str(one["shape"]) if one["shape"] else ""),
        "type": one["type"],
        "unit": one["unit"] or "-",
        "start": one["start"],
        "range": _range(one["minimum"], one["maximum"]),
        "nominal": one["nominal"],
    }
    if "depends_on" in one:
        row["depends at once on"] = "not declared" if one["depends_on"] is None else one["depends_on"]
    return row


def _range(low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return "-"
    return f"{'' if low is None else f'{low:g}'}..{'' if high is None else f'{high:g}'}"


def finding_line(finding: Finding) -> str:
    """A finding on a line, the remedy on the next."""
    mark = _MARKS.get(finding.verdict) or finding.level.upper()
    line = f"  {mark:9}  {finding.check}: {finding.reason}"
    return f"{line}\n             {finding.remedy}" if finding.remedy else line


def verdicts_line(findings: Sequence[Finding]) -> str:
    """How many checks ended how."""
    counts = Counter(
        f"{finding.level}s" if finding.level is not Level.NONE else str(finding.verdict)
        for finding in findings
    )
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))
