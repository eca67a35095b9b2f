"""A study: a system, the points at which it is run, and what is kept of each run; checked before it runs."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..checks import start_value
from ..config import Config, Places, compose, dump, move_effects, put_value
from ..digests import digest_of
from ..errors import ConfigError, Problem, in_order, listed, nearest
from ..run import Prepared, prepare
from ..system import Instance
from ..workers import Retry
from ..workers.files import place_of
from .axes import Axis, Level, axis_of
from .derived import Derived, parse_derived, unknown_numbers
from .design import Block, Blocks, paths_of, seeds
from .draft import read_study
from .execute import FILES, Order, Task
from .models import RecordModel
from .product import effect_sources, product
from .tables import RESERVED

if TYPE_CHECKING:
    import pyarrow as pa

    from .sweep import Swept

__all__ = ["Study"]

_POINTS_AT_ONCE = 10_000
# Values that are tried by checking the whole system with each; beyond that the ends are.
_MOST_TRIED = 100


class Study:
    """What is constructed can be run; see `Study.load` for files.

    Attributes:
        model: the values.
        prepared: the system without the design's values.
        axes: what the design varies, by path.
        name: the file's stem, for progress and lists.
    """

    def __init__(self, source: Mapping[str, Any] | None = None, /, **values: Any) -> None:
        """
        Args:
            source, values: what a study file holds, by key; `format` may be left out, and keys that are words
                of Python end in an underscore (`set_`).
        Raises: ConfigError with all problems.
        """
        data = {key.rstrip("_"): value for key, value in {**(source or {}), **values}.items()}
        self._make({"format": "sweep/1", **data}, Places("study"), Path.cwd(), "study", [])

    @staticmethod
    def load(path: Path | str) -> Study:
        """Read a study file. Raises: ConfigError with all problems."""
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError([Problem(str(path), f"cannot be read ({error})")]) from error
        data, places, twice = compose(text, path.name)
        if not isinstance(data, dict):
            raise ConfigError([Problem(path.name, "not a study", "a mapping with format, system and design")])
        study = Study.__new__(Study)
        study._make(data, places, path.parent, path.stem, [problem for _, problem in twice])
        return study

    def _make(
        self, data: Mapping[str, Any], places: Places, folder: Path, name: str, problems: list[Problem]
    ) -> None:
        """See `__init__`; `problems`: that reading found."""
        self.name, self._places = name, places
        unchecked: list[str] = []
        self.model, unread, whole = read_study(data, places, problems)
        prepared = None
        if "system" not in unread:
            prepared = self._system(data.get("system"), folder, problems, unchecked)
        if prepared is None:
            self._derive(None, problems)
            unchecked.append("the design's values, and signals and numbers of quantities")
            raise ConfigError(in_order(dict.fromkeys(problems)), unchecked)
        self.prepared = prepared
        derived = self._derive([str(port) for port in prepared.system.recorded], problems)
        self.axes = self._axes(problems, "design" not in unread)
        blocks = Blocks(self.axes, problems, self._place)
        repeats = self._repeats(problems)
        self._repeat: Sequence[dict[str, Level]] = repeats
        if "design" in unread:
            raise ConfigError(in_order(dict.fromkeys(problems)), ["the design's values"])
        self._block: Block = blocks.make(self.model.design, ("design",))
        if whole:
            problems += self._unknown_numbers(derived, blocks)
        if not problems and not len(self._block):
            problems.append(Problem(self._place(("design",)), "the design has no points"))
        if not problems:
            problems += self._tried(blocks)
        if problems:
            raise ConfigError(in_order(dict.fromkeys(problems)))

    def _place(self, path: tuple[str | int, ...]) -> str:
        return self._places.text(path)

    def _system(
        self, system: Any, folder: Path, problems: list[Problem], unchecked: list[str]
    ) -> Prepared | None:
        if isinstance(system, str) and (folder / system).is_file():
            system = folder / system
        texts = [f"{path}={_text(value)}" for path, value in self.model.set_.items()]
        try:
            made = prepare(system, texts)
        except ConfigError as error:
            problems += error.problems
            unchecked += error.unchecked
            return None
        model = made.config.model
        # What comes from outside, or takes the clock's time, is not the same run twice.
        for given, path, what in (
            (model.external, "external", f"{listed(model.external)} is another program"),
            (model.run.realtime, "run.realtime", "runs of a sweep are not paced by the clock"),
        ):
            if given:
                place = f"{self._place(('system',))}: {path}"
                problems.append(
                    Problem(place, what, "a sweep runs what is the same each time", "Take it out.")
                )
        return made

    def _derive(self, recorded: list[str] | None, problems: list[Problem]) -> tuple[Derived, ...]:
        """The derived quantities; `recorded`: signals, None if they are not known."""
        for name in self.model.derived:
            if name.casefold() in RESERVED:
                what = f"{name!r} cannot name a quantity"
                problems.append(Problem(self._place(("derived", name)), what, "the store has a column of it"))
        self._distinct(self.model.derived, "derived", problems)
        derived: tuple[Derived, ...] = ()
        try:
            derived = parse_derived(self.model.derived, recorded, lambda name: self._place(("derived", name)))
        except ConfigError as error:
            problems += error.problems
        record = self.model.record
        if recorded is None:
            return derived
        for signal in (record.signals or []) if isinstance(record, RecordModel) else []:
            if signal not in recorded:
                allowed = f"recorded are: {listed(recorded)}"
                place = self._place(("record", "signals"))
                problems.append(Problem(place, f"no signal {signal!r}", allowed, nearest(signal, recorded)))
        if record != "none":
            chosen = record.signals if isinstance(record, RecordModel) else None
            self._distinct(chosen or recorded, "record", problems)
        return derived

    def _unknown_numbers(self, derived: Sequence[Derived], blocks: Blocks) -> list[Problem]:
        system = self.prepared.system
        known = dict.fromkeys(_numbers_of(system.instances))
        for axis in self.axes.values():
            if axis.known:
                known[f"{axis.target[1]}.{axis.target[3]}"] = None
        if any(name not in known for one in derived for name in one.numbers):
            # Another FMU may have further parameters.
            for path, levels in blocks.levels.items():
                files = [level.file for level in levels if level.file is not None]
                made = (self._made_of(str(self.axes[path].target[1]), file) for file in files)
                known |= dict.fromkeys(_numbers_of(one for one in made if one is not None))
        recorded = [str(port) for port in system.recorded]
        instances = [one.name for one in system.instances]
        measured = bool(self.prepared.measures)

        def place(name: str) -> str:
            return self._place(("derived", name))

        return unknown_numbers(derived, list(known), recorded, instances, measured, place)

    def _distinct(self, names: Iterable[str], key: str, problems: list[Problem]) -> None:
        """Names of columns, which SQL reads without regard to case, so that one would hide the other."""
        met: dict[str, str] = {}
        for name in names:
            other = met.setdefault(name.casefold(), name)
            if other == name:
                continue
            place = ("derived", name) if key == "derived" else (key,)
            what = f"{name!r} and {other!r} differ in case only"
            remedy = "Rename one of them." if key == "derived" else "Keep one of them, by record.signals."
            problems.append(
                Problem(self._place(place), what, "the store's columns do not tell them apart", remedy)
            )

    def _axes(self, problems: list[Problem], designed: bool) -> dict[str, Axis]:
        axes: dict[str, Axis] = {}
        targets: dict[tuple[str | int, ...], str] = {}
        into = self.model.repeats.into if self.model.repeats else []
        for path in (*(paths_of(self.model.design) if designed else ()), *into):
            where = ("repeats", "into") if path in into else ("design",)
            made = axis_of(path, self.prepared.system, self.prepared.config, self._place(where))
            if isinstance(made, Problem):
                problems.append(made)
                continue
            target = made.target[:2] if made.target[2:] in (("fmu",), ("form",)) else made.target
            if target in targets:
                what = f"{path} and {targets[target]} set the same value"
                problems.append(Problem(self._place(where), what, remedy="Let one of them vary it."))
            targets[target] = path
            axes[path] = made
        columns = {f"{name}.change".casefold(): name for name in self.model.derived}
        for path in axes if self.model.step_halving else ():
            if name := columns.get(path.casefold()):
                what = f"{name!r} cannot name a quantity"
                allowed = f"its change at half the step size stands in the column of {path}"
                problems.append(Problem(self._place(("derived", name)), what, allowed, "Rename it."))
        return axes

    def _repeats(self, problems: list[Problem]) -> list[dict[str, Level]]:
        if self.model.repeats is None:
            return [{}]
        made: list[dict[str, Level]] = []
        place = self._place(("repeats", "into"))
        for repeat in seeds(self.model.repeats):
            levels = {}
            for path, seed in repeat.items():
                level = self.axes[path].read(seed, place) if path in self.axes else None
                if isinstance(level, Level):
                    levels[path] = level
                elif level is not None and not made:
                    problems.append(level)
            made.append(levels)
        return made

    def _tried(self, blocks: Blocks) -> list[Problem]:
        """Problems of the design's values, each in the system as it is, and of its first and last point."""
        found: list[Problem] = []
        for path, levels in blocks.levels.items():
            axis = self.axes[path]
            tried = list(levels)
            if axis.start:
                tried = tried[:1]  # each was checked when it was read; this asks whether it may be set at all
            elif len(tried) > _MOST_TRIED:
                tried = [*tried[: _MOST_TRIED - 1], tried[-1]]
            for level in tried:
                found += self._problems_at({path: level}, levels[level])
        if not found:
            for index in sorted({0, len(self._block) - 1}):
                point = self._block[index] | self._repeat[0]
                found += self._problems_at(point, f"{self._place(('design',))}: point {index}")
        return found

    def _problems_at(self, point: Mapping[str, Level], place: str) -> list[Problem]:
        texts = []
        for path, level in point.items():
            axis, text = self.axes[path], level.text
            if level.file is not None:
                path, text = f"{axis.target[1]}.fmu", _text(str(level.file.resolve()))
            elif axis.start:
                text = _text(self._written(axis, level))
            texts.append(f"{path}={text}")
        made = [self.axes[path].target[1] for path, level in point.items() if level.file is not None]
        config = _without_form(self.prepared.config, made) if made else self.prepared.config
        try:
            prepare(config, texts)
        except ConfigError as error:
            return [replace(one, place=f"{place}: {one.place}") for one in error.problems]
        return []

    def _written(self, axis: Axis, level: Level) -> Any:
        return f"{level.shown!r} {axis.unit}" if axis.unit not in ("", "1") else level.shown

    def __len__(self) -> int:
        """How many points there are, repeats included."""
        return len(self._block) * len(self._repeat)

    # The runs.

    @cached_property
    def files(self) -> dict[str, bytes]:
        """Everything that has to travel: FMUs and files of effects, by place."""
        return {**self._config_and_files[1], **{place: data for place, data in self._file_levels.values()}}

    @cached_property
    def _file_levels(self) -> dict[Path, tuple[str, bytes]]:
        found = {}
        for axis in self.axes.values():
            if axis.target[2:] in (("fmu",), ("form",)):
                for path in self._paths_of(axis):
                    data = path.read_bytes()
                    found[path] = place_of(data, path.name), data
        return found

    def _paths_of(self, axis: Axis) -> list[Path]:
        blocks = Blocks(self.axes, [])
        blocks.make(self.model.design, ())
        return [level.file for level in blocks.levels[axis.path] if level.file is not None]

    @cached_property
    def _config_and_files(self) -> tuple[dict[str, Any], dict[str, bytes]]:
        config = self.prepared.config
        data, files = config.model.to_data(), {}
        paths = {one.name: one.fmu.path for one in self.prepared.system.instances}
        for name, instance in data["instances"].items():
            path = paths[name]
            content = path.read_bytes()
            place = place_of(content, path.name)
            files[place] = content
            instance["fmu"] = FILES + place
            instance.pop("form", None)

        def moved(file: str) -> str:
            path = config.folder / file
            content = path.read_bytes()
            place = place_of(content, path.name)
            files[place] = content
            return FILES + place

        move_effects(data, moved)
        return data, files

    def order(self, runs: int) -> Order:
        """What all runs have in common.

        Args:
            runs: how many are to be made.
        """
        steps = runs * self.prepared.grid.steps * (3 if self.model.step_halving else 1)
        return Order(
            self._config_and_files[0],
            self.model.derived,
            self.model.record,
            self.model.step_halving,
            # The interpreter needs some 50 us a step, to load machine code takes a second.
            warm=steps > 50_000,
            retry=self.retry,
        )

    @property
    def retry(self) -> Retry:
        """What to do about runs that fail."""
        given = self.model.retry
        return Retry() if given is None else Retry(given.attempts, frozenset(given.kinds))

    @cached_property
    def _identity(self) -> str:
        """What a run's identity is made from, but for the design's values, as JSON."""
        run = self.prepared.config.model.run
        start, stop, step = run.times()
        data = json.loads(json.dumps(self._config_and_files[0]))
        data.pop("title", None)
        data["run"] |= {"start_time": str(start), "stop_time": str(stop), "step_size": str(step)}
        data["run"].pop("loop", None)  # results are the same to the bit
        data["order"] = list(data["instances"])
        for one in self.prepared.system.instances:
            data["instances"][one.name]["start"] = dict(one.start)
        record = self.model.record
        data["kept"] = {
            "halving": self.model.step_halving,
            "derived": self.model.derived,
            "record": record.to_data() if isinstance(record, RecordModel) else record,
        }
        data["product"] = product()
        if sources := effect_sources(self.prepared.system):
            data["effects"] = sources
        return json.dumps(data)

    def _sources(self, path: str, level: Level) -> list[str]:
        """Of the effect that a value of an axis over effects names: its name does not tell its code."""
        known = self._varied_sources.get((path, level))
        if known is None:
            try:
                known = effect_sources(prepare(self.prepared.config, [f"{path}={level.text}"]).system)
            except ConfigError:  # its run fails and tells why
                known = []
            self._varied_sources[path, level] = known
        return known

    @cached_property
    def _varied_sources(self) -> dict[tuple[str, Level], list[str]]:
        return {}

    def _made_of(self, name: str, file: Path) -> Instance | None:
        """An instance as it is of another FMU, whose units may be others; None if it cannot be."""
        known = self._instances
        if (name, file) not in known:
            try:
                texts = [f"{name}.fmu={_text(str(file.resolve()))}"]
                system = prepare(_without_form(self.prepared.config, [name]), texts).system
                known[name, file] = next(one for one in system.instances if one.name == name)
            except ConfigError:
                known[name, file] = None
        return known[name, file]

    @cached_property
    def _instances(self) -> dict[tuple[str, Path], Instance | None]:
        return {}

    def task(self, index: int) -> tuple[Task, dict[str, Level]]:
        """A run, and the values that the design has for it."""
        number, repeat = divmod(index, len(self._repeat))
        point = self._block[number] | self._repeat[repeat]
        data = json.loads(self._identity)
        starts, others = [], []
        replaced: dict[str, Instance] = {}
        for path, level in point.items():
            if level.file is None:
                continue
            name = str(self.axes[path].target[1])
            place = self._file_levels[level.file][0]
            data["instances"][name]["fmu"] = FILES + place
            others.append((f"{name}.fmu", FILES + place))
            instance = self._made_of(name, level.file)
            if instance is not None:
                replaced[name] = instance
                data["instances"][name]["start"] = dict(instance.start)
        for path, level in point.items():
            axis = self.axes[path]
            if level.file is not None:
                continue
            if axis.start:
                name, variable, value = str(axis.target[1]), str(axis.target[3]), level.canonical
                if name in replaced:
                    # In the unit that this FMU has it in.
                    written = self._written(axis, level)
                    description = replaced[name].fmu.description
                    there = start_value(name, description, variable, written, path)
                    if isinstance(there, Problem):  # the run fails and tells it
                        others.append((path, _text(written)))
                    else:
                        value = there
                put_value(data, axis.target, value)
                starts.append((name, variable, value))
                continue
            put_value(data, axis.target, level.canonical)
            if axis.target[0] == "connections" and axis.target[-1] == "effect":
                data.setdefault("varied_effects", {})[path] = self._sources(path, level)
            others.append((path, level.text))
        key = digest_of(json.dumps(data, sort_keys=True).encode())
        return Task(key, tuple(starts), tuple(others)), point

    def tasks(self) -> Iterator[Task]:
        """All runs, in the order of the design."""
        for index in range(len(self)):
            yield self.task(index)[0]

    def points(self, study: str) -> Iterator[pa.Table]:
        """The design as tables: study, point, repeat, values by path, and the identity of the run."""
        import pyarrow as pa

        numbers = iter(range(len(self)))
        while chosen := list(islice(numbers, _POINTS_AT_ONCE)):
            made = [self.task(index) for index in chosen]
            columns: dict[str, Any] = {
                "study": pa.array([study] * len(made)),
                "point": pa.array([index // len(self._repeat) for index in chosen], pa.int64()),
                "repeat": pa.array([index % len(self._repeat) for index in chosen], pa.int32()),
                "run": pa.array([task.key for task, _ in made]),
            }
            for path in self.axes:
                shown = [point[path].shown if path in point else None for _, point in made]
                columns[path] = _column(shown)
            yield pa.table(columns)

    @cached_property
    def id(self) -> str:
        """Of the study: its content, the system and the product included."""
        data = self.model.model_dump_json(by_alias=True) + self._identity
        files = sorted(place for place, _ in self._file_levels.values())
        return digest_of((data + "".join(files)).encode())[:12]

    def about(self) -> dict[str, Any]:
        """What is kept of the study besides its points."""
        return {
            "title": self.model.title or self.name,
            "system": self.prepared.config.name,
            "points": len(self),
            "axes": {path: axis.unit for path, axis in self.axes.items()},
            "derived": self.model.derived,
            "step_halving": self.model.step_halving,
            "study": self.model.to_data() | {"system": str(self.model.system)},
            "config": self._config_and_files[0],
            "product": product(),
        }

    def run(self, store: Path | str, **options: Any) -> Swept:
        """Make the runs that the store does not hold yet; see `sweep`."""
        from .sweep import sweep

        return sweep(self, store, **options)


def _column(values: list[Any]) -> pa.Array:
    import pyarrow as pa

    there = [one for one in values if one is not None]
    if there and all(type(one) is bool for one in there):
        return pa.array(values, pa.bool_())
    if all(type(one) in (int, float) for one in there):
        return pa.array([None if one is None else float(one) for one in values], pa.float64())
    return pa.array([None if one is None else str(one) for one in values])


def _numbers_of(instances: Iterable[Instance]) -> Iterator[str]:
    """Names of the parameters and start values of instances that are numbers."""
    for one in instances:
        given = {each.name: each.start for each in one.fmu.description.parameters} | dict(one.start)
        for name, value in given.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                yield f"{one.name}.{name}"


def _text(value: Any) -> str:
    """A value as an override has it."""
    return dump({"x": value}).partition(":")[2].strip()


def _without_form(config: Config, instances: Sequence[object]) -> Config:
    """The config without the form of instances that are given another FMU."""
    data = config.model.to_data()
    for name in instances:
        data["instances"][name].pop("form", None)
    # Not read anew from plain values: relative paths in it start from its own folder.
    return replace(config, model=type(config.model).model_validate(data))
