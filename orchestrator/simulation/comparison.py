"""Several systems in one go, and what their measures draw of them together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, Problem, listed
from ..base.folder_lock import locked
from ..config import Config
from ..results.measures import COMPARISONS
from .run import Prepared, prepare, run
from .run_folder import folder_at
from .run_result import RunResult


def run_each(
    configs: Sequence[str | Path | Config],
    *,
    out: Path | str | None = None,
    overrides: Iterable[str] = (),
    figures: bool = True,
    begin: Callable[[Prepared], None] | None = None,
    **options: Any,
) -> Iterator[RunResult]:
    """Run systems one after the other; all are checked before the first runs.

    Args:
        configs: bundled names, paths or configs that were read. With more than one, `out` gets a folder for
            each, named after the system, and the figures in which their common measures compare them.
        out, overrides, figures, options: see `simulation.run.run`; overrides hold for every system.
        begin: called with each system before it runs.
    Yields: the result of each system as it ends.
    Raises: as `run`; ConfigError with the problems of all systems.
    """
    overrides, begin = tuple(overrides), begin or (lambda one: None)
    prepared, problems, unchecked = [], [], []
    for config in configs:
        try:
            prepared.append(prepare(config, overrides))
        except ConfigError as error:
            problems += error.problems
            name = config.name if isinstance(config, Config) else config
            of = f"{name}: " if len(configs) > 1 else ""
            unchecked += [f"{of}{one}" for one in error.unchecked]
    # Where case does not count in names of files, two folders would be one.
    counts = Counter(one.config.name.casefold() for one in prepared)
    twice = list({one.config.name: None for one in prepared if counts[one.config.name.casefold()] > 1})
    if twice and out is not None:
        problems.append(
            Problem("", f"several systems are called {listed(twice)}", "one folder for each name")
        )
    if problems:
        raise ConfigError(problems, unchecked)
    if len(prepared) == 1 or out is None:
        for one in prepared:
            begin(one)
            yield run(one, out=out, figures=figures, **options)
        return
    whole = folder_at(out)
    assert whole is not None
    with locked(whole):  # each run locks a folder in it
        for name in COMPARISONS:  # of earlier runs, should these fail
            (whole / f"{name}.png").unlink(missing_ok=True)
        finished = {}
        for one in prepared:
            begin(one)
            result = run(one, out=whole / one.config.name, figures=figures, **options)
            finished[one.config.name] = result
            yield result
        if figures:
            _draw_together(finished, whole)


def _draw_together(finished: dict[str, RunResult], folder: Path) -> None:
    from ..plotting import figures as plotting

    kinds = {one.name: one.measure for result in finished.values() for one in result.prepared.measures}
    for kind, measure in kinds.items():
        if not hasattr(measure, "comparison"):
            continue
        runs = {
            name: (result.results, one.options)
            for name, result in finished.items()
            for one in result.prepared.measures
            if one.name == kind
        }
        if len(runs) > 1:
            for name, figure in measure.comparison(runs).items():
                plotting.save(figure, folder / f"{name}.png")
