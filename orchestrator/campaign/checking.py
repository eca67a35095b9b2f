"""A study as it is written -> its system, axes and points; all that is wrong with it is reported at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, Problem, in_order, listed, nearest
from ..config import Places, correct_spelling, file_of
from ..simulation.preparation import ConfigCheck, Prepared, check_config
from ..system.system import Instance
from .axes import Axis, Level, as_text, axis_of
from .derived import Derived, parse_derived, unknown_numbers
from .design import Block, Blocks, paths_of, seeds
from .models import RecordModel, StudyModel
from .partial_study import read_study
from .tables import RESERVED
from .variants import Variants

# Values that are tried by checking the system with each; beyond that the ends are.
_MOST_TRIED = 100


@dataclass(frozen=True)
class Checked:
    """A study with nothing wrong.

    Attributes:
        model: the values.
        prepared: the system without the design's values.
        axes: what the design varies, by path.
        block: its points.
        repeats: what each repeat of a point has besides.
        variants: the system with values of the design.
        files: FMUs, and Python files of effects, that the design varies.
        effects: values of axes over effects, with their paths.
    """

    model: StudyModel
    prepared: Prepared
    axes: dict[str, Axis]
    block: Block
    repeats: Sequence[dict[str, Level]]
    variants: Variants
    files: tuple[Path, ...]
    effects: tuple[tuple[str, Level], ...]


def check_study(
    data: Mapping[str, Any], places: Places, folder: Path, problems: Iterable[Problem] = ()
) -> Checked:
    """Check a study's plain values.

    Args:
        places: where the values were written, for messages.
        folder: from which relative paths in it start.
        problems: found earlier, to be reported together with those found here.
    Raises: ConfigError with all problems.
    """
    return _Check(places, list(problems)).study(data, folder)


class _Check:
    """Checks a study, and collects what is wrong with it."""

    def __init__(self, places: Places, problems: list[Problem]) -> None:
        self._places, self._problems = places, problems

    def study(self, data: Mapping[str, Any], folder: Path) -> Checked:
        """See `check_study`."""
        unchecked: list[str] = []
        data = dict(data)
        self._problems += correct_spelling(data, self._places, StudyModel)[0]
        self._model, unread, whole = read_study(data, self._places, self._problems)
        checked = self._system(data.get("system"), folder, unchecked) if "system" not in unread else None
        if checked is None:
            self._derive(None)
            unchecked.append("the design's values, and signals and numbers of quantities")
            raise self._error(unchecked)
        self._checked, self._moved = checked, file_of(folder, checked.config.folder)
        recorded = [str(port) for port in checked.system.recorded]
        derived = self._derive(recorded if checked.whole else None)
        self._axes = self._make_axes("design" not in unread)
        self._variants = Variants(checked.config, self._axes)
        blocks = Blocks(self._axes, self._problems, self._place)
        repeats = self._repeats()
        if "design" in unread:
            raise self._error([*unchecked, "the design's values"])
        block = blocks.make(self._model.design, ("design",))
        prepared = checked.prepared
        if prepared is None:
            what = "numbers and instants" if checked.whole else "signals, numbers and instants"
            raise self._error([*unchecked, "the system with the design's values", f"{what} of quantities"])
        if whole:
            self._problems += self._unknown_numbers(derived, blocks, prepared)
            self._problems += self._unreached(derived, block, prepared)
        if not self._problems and not len(block):
            self._problems.append(Problem(self._place(("design",)), "the design has no points"))
        self._problems += self._tried(blocks)
        if not self._problems:
            self._problems += self._tried_points(block, repeats)
        if self._problems:
            raise self._error()
        levels = [(path, level) for path in self._axes for level in blocks.levels[path]]
        travelling = (file for _, level in levels for file in (level.file, level.source))
        files = tuple(file for file in travelling if file is not None)
        effects = tuple(one for one in levels if self._axes[one[0]].effect)
        return Checked(self._model, prepared, self._axes, block, repeats, self._variants, files, effects)

    def _error(self, unchecked: Sequence[str] = ()) -> ConfigError:
        return ConfigError(in_order(dict.fromkeys(self._problems)), unchecked)

    def _place(self, path: tuple[str | int, ...]) -> str:
        return self._places.text(path)

    def _system(self, system: Any, folder: Path, unchecked: list[str]) -> ConfigCheck | None:
        if isinstance(system, str) and (folder / system).is_file():
            system = folder / system
        texts = [f"{path}={as_text(value)}" for path, value in self._model.set_.items()]
        try:
            made = check_config(system, texts, folder)
        except ConfigError as error:
            self._problems += error.problems
            unchecked += error.unchecked
            return None
        self._problems += made.problems
        unchecked += made.unchecked
        external, run = made.config.model.external, made.config.model.run
        # What comes from outside, or takes the clock's time, is not the same run twice.
        for given, path, what in (
            (external, "external", f"{listed(external)} is another program"),
            (run.realtime, "run.realtime", "runs of a sweep are not paced by the clock"),
        ):
            if given:
                place = f"{self._place(('system',))}: {path}"
                self._problems.append(
                    Problem(place, what, "a sweep runs what is the same each time", "Take it out.")
                )
        return made

    # Quantities and signals.

    def _derive(self, recorded: list[str] | None) -> tuple[Derived, ...]:
        """The derived quantities; `recorded`: signals, None if they are not known."""
        problems, written = self._problems, self._model.derived
        for name in written:
            if name.casefold() in RESERVED:
                what = f"{name!r} cannot name a quantity"
                problems.append(Problem(self._place(("derived", name)), what, "the store has a column of it"))
        self._distinct(written, "derived")
        derived: tuple[Derived, ...] = ()
        try:
            derived = parse_derived(written, recorded, lambda name: self._place(("derived", name)))
        except ConfigError as error:
            problems += error.problems
        record = self._model.record
        if recorded is None:
            return derived
        for signal in (record.signals or []) if isinstance(record, RecordModel) else []:
            if signal not in recorded:
                allowed = f"recorded are: {listed(recorded)}"
                place = self._place(("record", "signals"))
                problems.append(Problem(place, f"no signal {signal!r}", allowed, nearest(signal, recorded)))
        if record != "none":
            chosen = record.signals if isinstance(record, RecordModel) else None
            self._distinct(chosen or recorded, "record")
        return derived

    def _unknown_numbers(
        self, derived: Sequence[Derived], blocks: Blocks, prepared: Prepared
    ) -> list[Problem]:
        system = prepared.system
        known = dict.fromkeys(_numbers_of(system.instances))
        for axis in self._axes.values():
            if axis.known:
                known[f"{axis.target[1]}.{axis.target[3]}"] = None
        if any(name not in known for one in derived for name in one.numbers):
            # Another FMU may have further parameters.
            for path, levels in blocks.levels.items():
                files = [level.file for level in levels if level.file is not None]
                name = str(self._axes[path].target[1])
                made = (self._variants.instance(name, file) for file in files)
                known |= dict.fromkeys(_numbers_of(one for one in made if one is not None))
        recorded = [str(port) for port in system.recorded]
        instances = [one.name for one in system.instances]
        measured = bool(prepared.measures)

        def place(name: str) -> str:
            return self._place(("derived", name))

        return unknown_numbers(derived, list(known), recorded, instances, measured, place)

    def _unreached(self, derived: Sequence[Derived], block: Block, prepared: Prepared) -> list[Problem]:
        """Problems of instants that a run does not record; where times vary, of the first such point."""
        wanted = [(one.name, instant) for one in derived for instant in one.instants]
        run = prepared.config.model.run
        start, stop, step = run.times()
        given: dict[str, Any] = {"start_time": start, "stop_time": stop, "step_size": step}
        given["record_every"] = run.record_every
        paths = {axis.target[1]: path for path, axis in self._axes.items() if axis.target[0] == "run"}
        varied = {key: paths[key] for key in given if key in paths}
        found: dict[tuple[str, float], Problem] = {}
        for number in range((len(block) if varied else 1) if wanted else 0):
            point = block[number] if varied else {}
            levels = {key: point[path].canonical for key, path in varied.items() if path in point}
            try:
                start, stop, step, every = (Fraction(one) for one in (given | levels).values())
                rows = (stop - start) // (step * every)
            except (ValueError, ZeroDivisionError):
                rows = -1
            if rows < 0:
                continue  # there is no such run, which is reported as that
            first, last = float(start), float(start + rows * step * every)
            for name, instant in wanted:
                if first <= instant <= last or (name, instant) in found:
                    continue
                what = f"{name}: at {instant:.12g} s nothing is recorded"
                whose = f"point {number} of the design" if varied else "the run"
                allowed = f"{whose} is recorded from {first:.12g} s to {last:.12g} s; "
                allowed += f"run.stop_time is {float(stop):.12g} s"
                found[name, instant] = Problem(self._place(("derived", name)), what, allowed)
        return list(found.values())

    def _distinct(self, names: Iterable[str], key: str) -> None:
        """Names of columns, which SQL reads without regard to case, so that one would hide the other."""
        met: dict[str, str] = {}
        for name in names:
            other = met.setdefault(name.casefold(), name)
            if other == name:
                continue
            place = ("derived", name) if key == "derived" else (key,)
            what = f"{name!r} and {other!r} differ in case only"
            remedy = "Rename one of them." if key == "derived" else "Keep one of them, by record.signals."
            self._problems.append(
                Problem(self._place(place), what, "the store's columns do not distinguish them", remedy)
            )

    # The design.

    def _make_axes(self, designed: bool) -> dict[str, Axis]:
        axes: dict[str, Axis] = {}
        targets: dict[tuple[str | int, ...], str] = {}
        into = self._model.repeats.into if self._model.repeats else []
        for path in (*(paths_of(self._model.design) if designed else ()), *into):
            where = ("repeats", "into") if path in into else ("design",)
            system, config = self._checked.system, self._checked.config
            made = axis_of(path, system, config, self._moved, self._place(where))
            if made is None or (isinstance(made, Problem) and not self._checked.whole):
                continue  # what is wrong with the system may be what it lacks
            if isinstance(made, Problem):
                self._problems.append(made)
                continue
            target = made.target[:2] if made.target[2:] in (("fmu",), ("form",)) else made.target
            if target in targets:
                what = f"{path} and {targets[target]} set the same value"
                self._problems.append(Problem(self._place(where), what, remedy="Let one of them vary it."))
            targets[target] = path
            axes[path] = made
        columns = {f"{name}.change".casefold(): name for name in self._model.derived}
        for path in axes if self._model.step_halving else ():
            if name := columns.get(path.casefold()):
                what = f"{name!r} cannot name a quantity"
                allowed = f"its change at half the step size stands in the column of {path}"
                place = self._place(("derived", name))
                self._problems.append(Problem(place, what, allowed, "Rename it."))
        return axes

    def _repeats(self) -> list[dict[str, Level]]:
        if self._model.repeats is None:
            return [{}]
        made: list[dict[str, Level]] = []
        place = self._place(("repeats", "into"))
        for repeat in seeds(self._model.repeats):
            levels = {}
            for path, seed in repeat.items():
                level = self._axes[path].read(seed, place) if path in self._axes else None
                if isinstance(level, Level):
                    levels[path] = level
                elif level is not None and not made:
                    self._problems.append(level)
            made.append(levels)
        return made

    def _tried(self, blocks: Blocks) -> list[Problem]:
        """Problems of the design's values, each in the system as it is."""
        found: list[Problem] = []
        for path, levels in blocks.levels.items():
            tried = list(levels)
            if self._axes[path].start:
                tried = tried[:1]  # each was checked when it was read; this asks whether it may be set at all
            elif len(tried) > _MOST_TRIED:
                tried = [*tried[: _MOST_TRIED - 1], tried[-1]]
            for level in tried:
                found += self._variants.problems({path: level}, levels[level])
        return found

    def _tried_points(self, block: Block, repeats: Sequence[dict[str, Level]]) -> list[Problem]:
        """Problems of the design's first and last point."""
        found: list[Problem] = []
        for index in sorted({0, len(block) - 1}):
            point = block[index] | repeats[0]
            found += self._variants.problems(point, f"{self._place(('design',))}: point {index}")
        return found


def _numbers_of(instances: Iterable[Instance]) -> Iterator[str]:
    """Names of the parameters and start values of instances that are numbers."""
    for one in instances:
        given = {each.name: each.start for each in one.fmu.description.parameters} | dict(one.start)
        for name, value in given.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                yield f"{one.name}.{name}"
