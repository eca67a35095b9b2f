"""The page of a sweep: its points with what their runs gave, what failed, and what depends on what."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from ..plotting.figures import draw_points, svg
from ..plotting.page import SignalStore, details, document, heading, note, provenance, table

# A page shows so many points, and so many charts; beyond, the store itself answers.
_MOST_ROWS, _MOST_CHARTS = 5_000, 12
# Points that differ in the other values as well get a line each, up to so many.
_MOST_LINES = 12


@dataclass(frozen=True)
class SweepTable:
    """A study of a store.

    Attributes:
        study: its id.
        axes: unit by the path of each value that was varied; "" or None without one.
        derived: names of the quantities.
        rows: one per point: `point`, the axes, `status`, `kind` and `message` of a failure, the quantities,
            each with `NAME.change` by half the step size where that is known.
        about: of the study, as the store keeps it: `study`, `origin`, `packages`.
    """

    study: str
    title: str
    axes: Mapping[str, str | None]
    derived: Sequence[str]
    rows: Sequence[Mapping[str, Any]]
    about: Mapping[str, Any]


def page(folder: Path) -> str:
    """The page of a store, HTML. Raises: ConfigError, OrchestratorError if it cannot be read."""
    from ..campaign.database import Store

    studies = []
    with Store(folder) as store:
        for study, about in store.studies.items():
            rows = store.table(study).to_pylist()
            axes, derived = about["axes"], tuple(about["derived"])
            studies.append(SweepTable(study, about["title"] or about["system"], axes, derived, rows, about))
    return page_of_tables(folder.resolve().name, studies)


def page_of_tables(name: str, studies: Sequence[SweepTable]) -> str:
    """The page of studies, the latest first.

    Args:
        name: of the store.
        studies: in the order in which they were begun.
    """
    store = SignalStore(0)
    parts = []
    for index, one in enumerate(reversed(studies)):
        content = _study(one, store)
        parts += content if index == 0 else [details(f"Earlier study: {one.title}", "\n".join(content[1:]))]
    if not studies:
        parts = ["<p class=headline>The store holds no study yet.</p>"]
    title = studies[-1].title if studies else name
    return document(f"{title}: sweep in {name}", parts, store.data() if len(store) else None)


def _study(one: SweepTable, store: SignalStore) -> list[str]:
    counts = Counter(row["status"] for row in one.rows)
    done, failed = counts.get("done", 0), counts.get("failed", 0)
    rest = len(one.rows) - done - failed
    outcome = f"{len(one.rows)} points: {done} done, {failed} failed"
    outcome += f", {rest} not run yet." if rest else "."
    parts = [f"<p class=headline>{escape(outcome)}</p>"]
    kinds = Counter(row.get("kind") or "error" for row in one.rows if row["status"] == "failed")
    if kinds:
        examples = {
            row.get("kind") or "error": row.get("message") for row in one.rows if row["status"] == "failed"
        }
        rows = [
            [kind, count, str(examples[kind] or "").partition("\n")[0]] for kind, count in kinds.most_common()
        ]
        parts += [heading("Failures"), table(["kind", "runs", "for example"], rows)]
    if one.derived:
        parts += [heading("Quantities"), _ranges(one)]
    parts += [*_charts(one, store), heading("Points"), _points(one)]
    kept = {**(one.about.get("origin") or {}), "packages": one.about.get("packages") or {}}
    study = one.about.get("study")
    if study:
        import yaml

        text = yaml.safe_dump(dict(study), sort_keys=False, allow_unicode=True)
        parts.append(details("The study", f"<pre>{escape(text)}</pre>"))
    parts.append(provenance(kept, note(f"Study {one.study}")))
    return parts


def _ranges(one: SweepTable) -> str:
    """Range of each quantity, with the point at either end, and the largest change by half the step size."""
    rows = []
    for name in one.derived:
        found = [(row[name], row["point"]) for row in one.rows if isinstance(row.get(name), int | float)]
        changes = [abs(row[f"{name}.change"]) for row in one.rows if row.get(f"{name}.change") is not None]
        (low, at_low), (high, at_high) = (min(found), max(found)) if found else ((None, None), (None, None))
        rows.append([name, low, at_low, high, at_high, max(changes) if changes else None])
    columns = ["quantity", "smallest", "at point", "largest", "at point", "largest change at half the step"]
    return table(columns, rows, keys=[f"range.{name}" for name in one.derived])


def _points(one: SweepTable) -> str:
    there = {name for row in one.rows for name, value in row.items() if value not in (None, "")}
    names = [
        "point",
        *(["repeat"] if any(row.get("repeat") for row in one.rows) else []),
        *one.axes,
        "status",
    ]
    names += [name for name in ("kind", "message") if name in there]
    names += [name for base in one.derived for name in (base, f"{base}.change") if name in there]
    heads = [
        f"{name} [{one.axes[name]}]" if one.axes.get(name) not in (None, "", "1") else name for name in names
    ]
    rows = [[row.get(name) for name in names] for row in one.rows[:_MOST_ROWS]]
    text = table(
        heads, rows, keys=[f"point.{row['point']}.{row.get('repeat') or 0}" for row in one.rows[:_MOST_ROWS]]
    )
    left = len(one.rows) - len(rows)
    return text + (
        note(f"{left} more points; `orchestrator store export` writes them all.") if left > 0 else ""
    )


def _charts(one: SweepTable, store: SignalStore) -> list[str]:
    """Each quantity over each value that was varied, as long as both are numbers."""
    axes = [name for name in one.axes if len({row.get(name) for row in one.rows}) > 1 and _numeric(one, name)]
    parts: list[str] = []
    pairs = [(quantity, axis) for quantity in one.derived for axis in axes]
    for quantity, axis in pairs[:_MOST_CHARTS]:
        lines = _lines(one, quantity, axis)
        if not lines:
            continue
        unit = one.axes[axis] or ""
        label = f"{axis} [{unit}]" if unit not in ("", "1") else axis
        series = []
        for number, (name, (x, y)) in enumerate(lines.items()):
            key = f"{one.study}/{quantity}/{axis}/{number}"
            store.add_values(f"{key}/x", x)
            store.add_values(f"{key}/y", y)
            series.append({"label": name, "x": f"{key}/x", "y": f"{key}/y", "shown": True})
        static = svg(draw_points(lines, label, quantity), f"{one.study}-{quantity}-{axis}")
        parts.append(
            store.chart(f"{quantity} over {axis}", "", series, static, x=label, joined=len(lines) > 1)
        )
    return [heading("Quantities over what was varied"), *parts] if parts else []


def _numeric(one: SweepTable, name: str) -> bool:
    return all(
        isinstance(row.get(name), int | float) and not isinstance(row[name], bool)
        for row in one.rows
        if row.get(name) is not None
    )


def _lines(one: SweepTable, quantity: str, axis: str) -> dict[str, tuple[list[float], list[float]]]:
    """Points by what else was varied, in ascending order; all together where that is too much for lines."""
    others = [name for name in one.axes if name != axis and len({row.get(name) for row in one.rows}) > 1]
    groups: dict[str, list[tuple[float, float]]] = {}
    for row in one.rows:
        x, y = row.get(axis), row.get(quantity)
        if isinstance(x, int | float) and isinstance(y, int | float):
            name = ", ".join(f"{other} {_short(row.get(other))}" for other in others) or "runs"
            groups.setdefault(name, []).append((float(x), float(y)))
    if len(groups) > _MOST_LINES or all(len(members) == 1 for members in groups.values()):
        groups = {"runs": [pair for members in groups.values() for pair in members]} if groups else {}
    return {name: ([x for x, _ in sorted(p)], [y for _, y in sorted(p)]) for name, p in groups.items()}


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
