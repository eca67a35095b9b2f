"""Runs the chosen experiments, and puts what they gave beside the paper."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any

from ...base.provenance import origin
from ...results.file_formats import strict
from .catalogue import chosen_figures, experiments
from .experiment import Case, Experiment, Quantity, Recorded
from .runs import Failed, Pair, record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SOURCE = (
    'He, Shen, Gao, Zhang: "Active Compliance Control of a Position-Controlled Industrial Robot for '
    'Simulating Space Operations"'
)


@dataclass(frozen=True)
class Reproduction:
    """What `reproduce` made.

    Attributes:
        summary: as in reproduction.json.
        figures: by name, in the paper's order.
    """

    summary: dict[str, Any]
    figures: dict[str, Figure]

    @property
    def failed(self) -> list[str]:
        """Messages of the runs that failed."""
        return [message for one in self.summary["experiments"] for message in one["errors"]]


def reproduce(only: Iterable[str] = (), *, jobs: int | None = None, progress: bool = False) -> Reproduction:
    """Make the paper's figures and numbers again, by co-simulation.

    Runs are made in processes of their own.

    Args:
        only: figures, groups of them or experiments, for example ("fig6", "fig3"); everything if empty.
        jobs: number of processes; as many as there are cores by default.
        progress: whether to show a bar on a terminal.
    Returns: numbers beside the paper's, and figures. Runs that failed are reported in the summary.
    Raises: ConfigError for an unknown name.
    """
    begin = perf_counter()
    figures = chosen_figures(only)
    parts = {
        name: one for name, one in experiments().items() if any(figure in one.FIGURES for figure in figures)
    }
    cases = {name: one.cases() for name, one in parts.items()}
    recorded = record([case for some in cases.values() for case in some], jobs, progress)
    entries, drawn = [], {}
    for name, one in parts.items():
        chosen = tuple(figure for figure in one.FIGURES if figure in figures)
        entry, more = _evaluate(name, one, chosen, cases[name], recorded)
        entries.append(entry)
        drawn |= more
    quantities = [quantity for entry in entries for quantity in entry["quantities"]]
    summary = {
        "reference": SOURCE,
        **origin(),
        "packages": _packages(recorded),
        "runs": 2 * len(recorded),
        "wall_time": perf_counter() - begin,
        "numbers": len(quantities),
        "source": _verdicts(quantities, "source"),
        "theory": _verdicts(quantities, "theory"),
        "figures": list(drawn),
        "experiments": entries,
    }
    return Reproduction(strict(summary), drawn)


def _verdicts(quantities: Iterable[Mapping[str, Any]], against: str) -> dict[str, int]:
    found = [one["agrees"] for one in quantities if one["against"] == against]
    return {"agree": found.count(True), "differ": found.count(False)}


def _packages(recorded: Mapping[Case, Pair | Failed]) -> dict[str, str]:
    """Versions of the software that ran, where they are known."""
    for one in recorded.values():
        if isinstance(one, Pair):
            packages = one.whole.results.provenance["packages"]
            return {name: version for name, version in packages.items() if version is not None}
    return {}


def _evaluate(
    name: str,
    experiment: Experiment,
    chosen: Sequence[str],
    cases: Iterable[Case],
    recorded: Mapping[Case, Pair | Failed],
) -> tuple[dict[str, Any], dict[str, Figure]]:
    """An experiment's entry of the summary, and its figures."""
    cases = tuple(cases)
    entry: dict[str, Any] = {
        "name": name,
        "title": experiment.TITLE,
        "about": list(experiment.ABOUT),
        "runs": {case.name: {"system": case.system, "overrides": list(case.overrides)} for case in cases},
        "figures": {},
        "quantities": [],
        "errors": [recorded[case].message for case in cases if isinstance(recorded[case], Failed)],
    }
    if entry["errors"]:
        return entry, {}
    whole: dict[str, Recorded] = {case.name: recorded[case].whole for case in cases}
    halved: dict[str, Recorded] = {case.name: recorded[case].halved for case in cases}
    after = {one.key: one.ours for one in experiment.quantities(halved)}
    entry["quantities"] = [
        _as_data(one, after.get(one.key)) for one in experiment.quantities(whole) if one.figure in chosen
    ]
    entry["figures"] = {figure: experiment.FIGURES[figure] for figure in chosen}
    return entry, {figure: experiment.draw(figure, whole) for figure in chosen}


def _as_data(quantity: Quantity, after: float | None) -> dict[str, Any]:
    return {
        "key": quantity.key,
        "figure": quantity.figure,
        "text": quantity.text,
        "unit": quantity.unit,
        "paper": quantity.paper,
        "ours": quantity.ours,
        "criterion": None if quantity.criterion is None else quantity.criterion.text,
        "against": quantity.against,
        "agrees": quantity.agrees,
        "halving_change": None if after is None else after - quantity.ours,
        "note": quantity.note,
    }
