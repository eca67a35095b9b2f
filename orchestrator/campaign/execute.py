"""One run of a sweep, in the process of a worker: a task in, a row out."""

from __future__ import annotations

import gc
import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ..base.errors import ConfigError, FmuError, OrchestratorError, StepError
from ..config import load_config
from ..fmi.workers import Failure, Retry
from ..master.running_instances import instantiate
from ..results.measures import ChosenMeasure
from ..results.recorders import Results
from ..simulation.native.choice import obstacle
from ..simulation.run import Prepared, prepare, run
from ..simulation.run_result import RunResult
from ..system.instance_pool import InstancePool
from ..system.system import Instance
from .axes import as_text
from .derived import Derived
from .models import RecordModel

# Stands before the place of a file in an override.
FILES = "files:"
# Systems that are kept ready, for overrides that change more than start values.
_KEPT = 32
# How many rows `decimated` keeps of a trajectory at most.
_DECIMATED = 1000


class Task(NamedTuple):
    """A run: its identity, start values in the FMUs' units, and other changes of the config as text."""

    key: str
    starts: tuple[tuple[str, str, Any], ...] = ()
    others: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Order:
    """What all runs of a study have in common; it travels to the workers.

    Attributes:
        config: plain values; FMUs and files of effects stand as FILES and their place.
        derived: expressions by name.
        record: what is kept of trajectories.
        halving: whether each run is made with half the step, too.
        retry: what to do about runs that fail without their process.
        warm: whether so many steps are to be made that the native loop is worth loading at once.
    """

    config: Mapping[str, Any]
    derived: Mapping[str, str]
    record: str | RecordModel
    halving: bool
    warm: bool = False
    retry: Retry = field(default_factory=Retry)


@dataclass(frozen=True)
class Row:
    """What is kept of a run.

    Attributes:
        key: its identity.
        kind, message: why it failed; empty if it did not.
        derived, changes: the quantities, and what half the step size changes of them.
        numbers: of the summary, by path.
        halving_error: why the run with half the step size failed; empty if it did not.
        log: warnings and errors of instances.
        timing: wall_time, stepping_time, of both runs [s]; loop; steps.
        trajectory: an Arrow stream; empty if none is kept.
        attempts: how many were made in this process.
    """

    key: str
    kind: str = ""
    message: str = ""
    derived: Mapping[str, float | None] | None = None
    changes: Mapping[str, float | None] | None = None
    numbers: Mapping[str, float] | None = None
    halving_error: str = ""
    log: Mapping[str, Sequence[str]] | None = None
    timing: Mapping[str, Any] | None = None
    trajectory: bytes = b""
    attempts: int = 1


class _Everything:
    """All measures of a config as one, and the derived quantities, which read their numbers."""

    options: Any = None

    def __init__(self, chosen: Sequence[ChosenMeasure], derived: Sequence[Derived]) -> None:
        self._chosen, self._derived = chosen, derived

    def measure(self, results: Results, options: Any) -> dict[str, Any]:
        measured: dict[str, Any] = {}
        for one in self._chosen:
            measured.update(one.measure.measure(results, one.options))
        measured["derived"] = {one.name: one.value(results, measured) for one in self._derived}
        return measured

    def figures(self, results: Results, options: Any) -> dict[str, Any]:
        return {}


class Context:
    """What a worker keeps from run to run: FMUs unpacked, systems checked, machine code loaded."""

    def __init__(self, order: Order, folder: Path) -> None:
        self.order, self._folder = order, folder
        self._config = load_config(_placed(order.config, folder))
        self._derived = [Derived(name, text) for name, text in order.derived.items()]
        self._ready: dict[tuple[tuple[str, str], ...], Prepared] = {}
        self._held: dict[int, Any] = {}
        if order.warm:
            base = self._prepared(())
            with instantiate(base.system) as instances:
                fits = base.config.model.run.loop != "python" and not obstacle(instances, base.master)
            if fits:
                from ..simulation.native import loop  # noqa: F401 (loaded once for all runs)
        # What stays from run to run need not be looked through again and again for what can go.
        gc.freeze()

    def prepared(self, task: Task) -> Prepared:
        """What runs. Raises: ConfigError."""
        base = self._prepared(task.others)
        if not task.starts:
            return base
        changed: dict[str, dict[str, Any]] = {}
        for instance, variable, value in task.starts:
            changed.setdefault(instance, {})[variable] = value

        def started(one: Instance) -> Instance:
            more = changed.get(one.name)
            return one if more is None else replace(one, start={**one.start, **more})

        system = replace(base.system, instances=tuple(map(started, base.system.instances)))
        return replace(base, system=system)

    def _prepared(self, others: tuple[tuple[str, str], ...]) -> Prepared:
        found = self._ready.get(others)
        if found is None:
            texts = [f"{path}={_override(text, self._folder)}" for path, text in others]
            made = prepare(self._config, texts)
            everything = ChosenMeasure(
                "of the study",
                _Everything(made.measures, self._derived),
                SimpleNamespace(),  # type: ignore[arg-type]
            )
            found = replace(made, measures=(everything,), pool=InstancePool())
            for one in found.system.instances:
                self._hold(one)
            while len(self._ready) >= _KEPT:
                oldest = self._ready.pop(next(iter(self._ready)))
                if oldest.pool is not None:
                    oldest.pool.close()
            self._ready[others] = found
        return found

    def _hold(self, instance: Instance) -> None:
        """Keep an FMU unpacked from run to run."""
        archive = getattr(instance.fmu, "_unpacked", None)
        if archive is not None and id(archive) not in self._held:
            archive.acquire()
            self._held[id(archive)] = archive

    def run(self, task: Task) -> Row:
        """Make a run, and keep what is asked for."""
        try:
            prepared = self.prepared(task)
        except (ConfigError, FmuError) as error:
            return Row(task.key, "config", self._message(error))
        try:
            made = run(prepared, halving=self.order.halving, figures=False)
        except OrchestratorError as error:
            partial = getattr(error, "result", None)
            row = Row(task.key, _kind(error), self._message(error))
            return row if partial is None else self._filled(row, partial)
        finally:
            self._renew()
        return self._filled(Row(task.key), made)

    def _renew(self) -> None:
        """Unpack again what an instance has made unusable for others."""
        for archive in self._held.values():
            if archive.corrupt:
                archive.release()
                archive.acquire()

    def _message(self, error: OrchestratorError) -> str:
        """A message that is the same on every machine."""
        return str(error).replace(f"{self._folder}{os.sep}", "")

    def _filled(self, row: Row, made: RunResult) -> Row:
        summary = made.summary
        numerics = summary.get("numerics") or {}
        error = numerics.get("error")
        ran = summary.get("run") or {}
        names = ("loop", "steps", "simulated_time", "wall_time", "stepping_time")
        parts = {key: summary[key] for key in summary if key not in _APART}
        if ended := ran.get("ended"):
            parts["ended"] = {"time": ended["time"]}
        return replace(
            row,
            derived=summary.get("derived"),
            changes=numerics.get("derived"),
            numbers=dict(flat(parts)),
            halving_error=error["message"] if error else "",
            log=ran.get("log") or None,
            timing={name: ran.get(name) for name in names},
            trajectory=self._trajectory(made.results),
        )

    def _trajectory(self, results: Results) -> bytes:
        import pyarrow as pa

        record = self.order.record
        if record == "none" or not len(results):
            return b""
        every, names = 1, list(results.signals)
        if record == "decimated":
            every = max(math.ceil(len(results) / _DECIMATED), 1)
        elif isinstance(record, RecordModel):
            every, names = record.every, record.signals or names
        columns = {"time": results.time, **{name: results[name] for name in names}}
        batch = pa.record_batch({name: np.ascontiguousarray(one[::every]) for name, one in columns.items()})
        sink = io.BytesIO()
        with pa.ipc.new_stream(sink, batch.schema) as stream:
            stream.write_batch(batch)
        return sink.getvalue()


# Parts of a summary that are no numbers of the run, or are kept elsewhere.
_APART = ("title", "config", "parameters", "provenance", "run", "error", "derived", "notes")


def begin(order: Order, folder: Path) -> Context:
    """What a worker does before its first run."""
    return Context(order, folder)


def execute(context: Context, task: Task) -> Row:
    """Make a run. Failures of the run are reported in the row."""
    attempts = 0
    while True:
        row, attempts = context.run(task), attempts + 1
        if not row.kind or not context.order.retry.again(Failure(row.kind, row.message), attempts):
            return replace(row, attempts=attempts)


def flat(value: Any, path: str = "") -> list[tuple[str, float]]:
    """Numbers of nested mappings and lists by path, contacts[0].cor; texts and gaps are left out."""
    if isinstance(value, Mapping):
        inner = ((f"{path}.{key}" if path else str(key), one) for key, one in value.items())
    elif isinstance(value, list | tuple):
        inner = ((f"{path}[{index}]", one) for index, one in enumerate(value))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        return [(path, float(value))]
    else:
        return []
    return [found for name, one in inner for found in flat(one, name)]


def _kind(error: OrchestratorError) -> str:
    status = error.status if isinstance(error, StepError) else ""
    if status in ("not finite", "not converged", "not integrated"):
        return "diverged"
    return {"crashed": "crash", "time limit": "time limit"}.get(status, "error")  # of isolated FMUs


def _placed(data: Any, folder: Path) -> Any:
    """Plain values of a config with its files where they are on this machine."""
    if isinstance(data, Mapping):
        return {key: _placed(one, folder) for key, one in data.items()}
    if isinstance(data, list | tuple):
        return [_placed(one, folder) for one in data]
    return _text(data, folder) if isinstance(data, str) else data


def _override(text: str, folder: Path) -> str:
    return as_text(_text(text, folder)) if text.startswith(FILES) else text


def _text(text: str, folder: Path) -> str:
    return str(folder / text.removeprefix(FILES)) if text.startswith(FILES) else text


def as_json(row: Row) -> bytes:
    """A row without its trajectory, for the journal; numbers to the last bit."""
    data = {
        name: getattr(row, name)
        for name in row.__dataclass_fields__
        if name not in ("trajectory", "attempts")
    }
    return json.dumps(data, ensure_ascii=False, separators=(",", ":")).encode()
