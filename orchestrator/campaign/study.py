"""A study: a system, the points at which it is run, and what is kept of each run; checked before it runs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cached_property
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from ..base.digests import digest_of
from ..base.errors import ConfigError, Problem
from ..config import Places, compose, put_value
from ..fmi.workers import Retry
from ..system.checks import start_value
from ..system.system import Instance
from .axes import Level, as_text
from .checking import Checked, check_study
from .execute import FILES, Order, Task
from .models import RecordModel
from .packing import Packed, pack
from .software_version import effect_sources, product
from .variants import written

if TYPE_CHECKING:
    import pyarrow as pa

_POINTS_AT_ONCE = 10_000


class CheckedStudy:
    """A study that has passed all checks.

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
        self._take("study", check_study({"format": "sweep/1", **data}, Places("study"), Path.cwd()))

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a study file. Raises: ConfigError with all problems."""
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError([Problem(str(path), f"cannot be read ({error})")]) from error
        data, places, twice = compose(text, path.name)
        if not isinstance(data, dict):
            raise ConfigError([Problem(path.name, "not a study", "a mapping with format, system and design")])
        study = cls.__new__(cls)
        study._take(path.stem, check_study(data, places, path.parent, [problem for _, problem in twice]))
        return study

    def _take(self, name: str, checked: Checked) -> None:
        self.name = name
        self.model, self.prepared, self.axes = checked.model, checked.prepared, checked.axes
        self._checked, self._block, self._repeats = checked, checked.block, checked.repeats

    def __len__(self) -> int:
        """How many points there are, repeats included."""
        return len(self._block) * len(self._repeats)

    # The runs.

    @cached_property
    def _packed(self) -> Packed:
        return pack(self.prepared, self._checked.files)

    @property
    def files(self) -> dict[str, bytes]:
        """Everything that has to travel: FMUs and files of effects, by place."""
        return self._packed.files

    def order(self, runs: int) -> Order:
        """What all runs have in common.

        Args:
            runs: how many are to be made.
        """
        steps = runs * self.prepared.grid.steps * (3 if self.model.step_halving else 1)
        return Order(
            self._packed.config,
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
        data = json.loads(json.dumps(self._packed.config))
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

    def task(self, index: int) -> tuple[Task, dict[str, Level]]:
        """A run, and the values that the design has for it."""
        number, repeat = divmod(index, len(self._repeats))
        point = self._block[number] | self._repeats[repeat]
        data = json.loads(self._identity)
        starts, others = [], []
        replaced: dict[str, Instance] = {}
        for path, level in point.items():
            if level.file is None:
                continue
            name = str(self.axes[path].target[1])
            place = self._packed.varied[level.file]
            data["instances"][name]["fmu"] = FILES + place
            others.append((f"{name}.fmu", FILES + place))
            instance = self._checked.variants.instance(name, level.file)
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
                    given = written(axis, level)
                    description = replaced[name].fmu.description
                    there = start_value(name, description, variable, given, path)
                    if isinstance(there, Problem):  # the run fails and reports it
                        others.append((path, as_text(given)))
                    else:
                        value = there
                put_value(data, axis.target, value)
                starts.append((name, variable, value))
                continue
            put_value(data, axis.target, level.canonical)
            if axis.effect:
                data.setdefault("varied_effects", {})[path] = self._checked.variants.sources(path, level)
            text = level.text
            if level.source is not None:
                name = str(level.shown).rpartition(":")[2]
                text = f"{FILES}{self._packed.varied[level.source]}:{name}"
            others.append((path, text))
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
                "point": pa.array([index // len(self._repeats) for index in chosen], pa.int64()),
                "repeat": pa.array([index % len(self._repeats) for index in chosen], pa.int32()),
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
        files = sorted(self._packed.varied.values())
        sources = [self._checked.variants.sources(*one) for one in self._checked.effects]
        return digest_of((data + "".join(files) + "".join(chain(*sources))).encode())[:12]

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
            "config": self._packed.config,
            "product": product(),
        }


def _column(values: list[Any]) -> pa.Array:
    import pyarrow as pa

    there = [one for one in values if one is not None]
    if there and all(type(one) is bool for one in there):
        return pa.array(values, pa.bool_())
    if all(type(one) in (int, float) for one in there):
        return pa.array([None if one is None else float(one) for one in values], pa.float64())
    return pa.array([None if one is None else str(one) for one in values])
