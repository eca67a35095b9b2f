"""How well a paced run kept to the clock, and what its datagrams met with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..plotting.figures import draw_punctuality, svg
from ..plotting.page import details, figure, heading, note, table

_TIMES = {"latency": "from deadline to begin of step", "busy": "from begin to end of step"}
_COUNTS = {
    "steps": "steps that had a deadline",
    "missed": "deadlines missed",
    "longest_row_of_misses": "most of them in a row",
}
_QUANTILES = {"median": "median", "p99": "99 %", "p999": "99.9 %", "max": "largest"}


def punctuality(statistics: Mapping[str, Any], title: str) -> list[str]:
    """Sections of a page; none for a run that was not paced and had no peer.

    Args:
        statistics: the part `run` of a summary.
        title: of the run.
    """
    parts = []
    if realtime := statistics.get("realtime"):
        parts += _paced(realtime, float(statistics["step_size"]), title)
    if external := statistics.get("external"):
        parts += [heading("Other programs", "external"), *(_peer(*one) for one in external.items())]
    return parts


def _paced(realtime: Mapping[str, Any], step_size: float, title: str) -> list[str]:
    counts = [[text, realtime[key], ""] for key, text in _COUNTS.items()]
    counts += [
        ["worst miss", _milliseconds(realtime["worst_miss"]), "ms"],
        ["deadlines moved by, in all", _milliseconds(realtime["shifted"]), "ms"],
        ["time per step", _milliseconds(step_size / realtime["speed"]), "ms"],
    ]
    keys = [*_COUNTS, "worst_miss", "shifted", "time_per_step"]
    drawn = svg(draw_punctuality(realtime, step_size, title), "realtime")
    shown = figure(drawn, "Steps by how late they began, and by how long they took.", "figure-realtime")
    scheduler = f"Paced at {realtime['speed']:g} times real time, {realtime['scheduler']}"
    return [
        heading("Real time", "realtime"),
        note(f"{scheduler}; a missed deadline: {realtime['on_miss']}."),
        table(["", "value", "unit"], counts, keys=[f"realtime.{key}" for key in keys]),
        _quantiles({text: realtime[key] for key, text in _TIMES.items()}, "realtime."),
        shown,
        details(
            "Counts of the figure", "".join(_classes(realtime[key], text) for key, text in _TIMES.items())
        ),
    ]


def _peer(name: str, link: Mapping[str, Any]) -> str:
    """The datagrams of an external instance."""
    counts = [[name, value] for name, value in link.items() if isinstance(value, int)]
    times = {key.replace("_", " "): value for key, value in link.items() if isinstance(value, Mapping)}
    keys = [f"external.{name}.{key}" for key, _ in counts]
    return table([f"datagrams of {name}", "number"], counts, keys=keys) + _quantiles(
        times, f"external.{name}."
    )


def _quantiles(times: Mapping[str, Mapping[str, Any]], key: str) -> str:
    rows = [[text, *(_milliseconds(one[name]) for name in _QUANTILES)] for text, one in times.items()]
    heads = ["[ms]", *_QUANTILES.values()]
    return table(heads, rows, keys=[f"{key}{text}" for text in times]) if rows else ""


def _classes(times: Mapping[str, Any], text: str) -> str:
    edges, counts = times["histogram"]["edges"], times["histogram"]["counts"]
    rows = [
        [_milliseconds(low), _milliseconds(high), count]
        for low, high, count in zip(edges, edges[1:], counts, strict=False)
        if count
    ]
    return table([f"{text}, above [ms]", "to [ms]", "steps"], rows) if rows else ""


def _milliseconds(seconds: float) -> float:
    """A time to four digits, which are more than a clock's readings are worth."""
    return float(f"{1e3 * seconds:.4g}")
