"""A config -> all that a run needs, checked: system, master, communication points, measures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, Problem, in_order
from ..config import Config, Draft, read_config
from ..config.base import exact_time
from ..master import MasterAlgorithm, create_master
from ..results.measures import ChosenMeasure, check_measures, measure_names
from ..system import checks
from ..system.assembly import CheckedSystem, check_system
from ..system.instance_pool import InstancePool
from ..system.system import System
from .grid import Grid, time_problems

# Beyond which a run is announced as long: of slow FMUs so many steps take hours.
_MANY_STEPS = 10_000_000


@dataclass(frozen=True)
class Prepared:
    """A config that is known to run: everything that can be checked beforehand is.

    Attributes:
        pool: of instances, where many runs follow each other.
    """

    config: Config
    system: System
    master: MasterAlgorithm
    grid: Grid
    measures: tuple[ChosenMeasure, ...]
    pool: InstancePool | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What was accepted, and a user should know."""
        return (*self.config.notes, *self.system.notes, *self._long())

    def _long(self) -> tuple[str, ...]:
        """What to say of a run that may take long, as a default experiment of tiny steps does."""
        steps, size = self.grid.steps, float(self.grid.step_size)
        if steps <= _MANY_STEPS:
            return ()
        return (f"the run takes {steps:,} steps of {size:g} s; run.step_size and run.stop_time set others",)


@dataclass(frozen=True)
class ConfigCheck:
    """What is known of a config, right or not.

    Attributes:
        config: as far as it can be read.
        system: without what has problems.
        prepared: None where there are problems.
        problems, unchecked: see `ConfigError`.
        whole: whether the system has all instances, and all signals that are to be recorded.
    """

    config: Config
    system: System
    prepared: Prepared | None
    problems: tuple[Problem, ...]
    unchecked: tuple[str, ...]
    whole: bool


def prepare(
    config: str | Path | Mapping[str, Any] | Config,
    overrides: Iterable[str] = (),
    folder: Path | None = None,
) -> Prepared:
    """Read a config and check it, its FMUs, connections, master, times and measures.

    Args:
        config, overrides, folder: see `load_config`.
    Raises: ConfigError with all problems.
    """
    check = check_config(config, overrides, folder)
    if check.prepared is None:
        notes = (*check.config.notes, *check.system.notes)
        raise ConfigError(check.problems, check.unchecked, notes)
    return check.prepared


def check_config(
    config: str | Path | Mapping[str, Any] | Config,
    overrides: Iterable[str] = (),
    folder: Path | None = None,
) -> ConfigCheck:
    """As `prepare`, of a config that may have problems. Raises: ConfigError if little of it can be read."""
    draft = read_config(config, overrides, folder)
    problems, unchecked = [*draft.problems], [*draft.unchecked]
    if draft.config is None:
        raise ConfigError(problems, unchecked)
    model, places, gaps = draft.config.model, draft.config.places, draft.gaps
    master = grid = None
    if gaps.whole("run", "master"):
        try:
            master = create_master(model.run.master, places.text(("run", "master")), places)
        except ConfigError as error:
            problems += error.problems
    try:
        grid = _grid(draft, unchecked)
    except ConfigError as error:
        problems += error.problems
    measures, wrong = check_measures(draft.config)
    problems += wrong
    unread = model.measures.keys() & set(measure_names()) - {one.name for one in measures}
    unchecked += [f"signals of measures.{name}" for name in sorted(unread)]
    needed = {name: ("measures", one.name) for one in measures for name in one.signals()}
    # Whether an unknown master solves loops is unknown: one mistake is reported once.
    checked = check_system(draft, needed, loops=master is None or master.solves_loops)
    problems += checked.problems
    unchecked += checked.unchecked
    problems += _steps(draft, checked, master, unchecked)
    prepared = None
    if not problems and master is not None and grid is not None:
        prepared = Prepared(draft.config, checked.system, master, grid, tuple(measures))
    names = {one.name for one in checked.system.instances}
    whole = names == model.instances.keys() | model.external.keys() and gaps.whole("run", "record")
    whole &= not (gaps.further("instances") or gaps.beneath("instances"))
    whole &= not problems or model.run.record == "all"
    ordered = tuple(in_order(problems))
    return ConfigCheck(draft.config, checked.system, prepared, ordered, tuple(unchecked), whole)


def _grid(draft: Draft, unchecked: list[str]) -> Grid | None:
    """The communication points; None if not all times are known. Raises: ConfigError."""
    assert draft.config is not None
    run, place = draft.config.model.run, draft.config.places.text(("run",))

    def knows(key: str) -> bool:
        return draft.gaps.knows("run", key)

    if all(map(knows, ("start_time", "stop_time", "step_size"))):
        return Grid.of(run, place)
    unchecked.append("whether the run is a whole number of steps")
    if problems := time_problems(run, place, knows):
        raise ConfigError(problems)
    return None


def _steps(
    draft: Draft, checked: CheckedSystem, master: MasterAlgorithm | None, unchecked: list[str]
) -> list[Problem]:
    """What instances cannot do of the steps that they are to take, and what else the master asks for."""
    assert draft.config is not None
    places, system = draft.config.places, checked.system
    settled = [one for one in system.instances if one.name not in checked.unsettled]
    problems = [] if master is None else master.check(system, places)
    if draft.problems or checked.problems:
        # Signals and bonds may be missing for what is wrong; what an FMU cannot do it cannot in any case.
        paths = [("instances", one.name, *key) for one in settled for key in ((), ("step_size",))]
        sure = set(map(places.text, paths))
        if master is None or any(one.place not in sure for one in problems):
            unchecked.append("what the master asks of the system")
        problems = [one for one in problems if one.place in sure]
    known = draft.gaps.knows("run", "step_size")
    if not known:
        unchecked.append("step sizes of FMUs")
    size = exact_time(draft.config.model.run.step_size) if known else Fraction(0)
    return problems + (checks.step_size(settled, size, places) if size > 0 else [])
