"""Config in, results out: the run, the same run with half the step size, and what is written of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryFile
from time import perf_counter
from typing import Any, BinaryIO, cast

from ..base.errors import ConfigError, Interrupted, OrchestratorError, error_data, listed
from ..base.folder_lock import locked
from ..base.provenance import origin, versions
from ..config import Config
from ..fmi import integration_tolerance
from ..fmi.log_file import LOG_FOLDER, logs_in
from ..master.energy import Ledger
from ..results.file_formats import check_formats, strict
from ..results.measures import ChosenMeasure, changes, signal_changes
from ..results.progress import Progress
from ..results.recorders import Recorder, Results, parameters_of
from ..results.summary import Summary
from ..system import checks
from ..system.system import System
from .grid import Grid
from .loop import Observer, Report, simulate
from .pacing import Pace
from .preparation import Prepared, prepare
from .run_folder import begin_folder, folder_at, incomplete, write_run
from .run_result import RunResult

# What a run that writes to no folder may keep in memory [B].
_IN_MEMORY = 256 << 20
_PACKAGES = ("orchestrator", "fmpy", "numpy", "pydantic", "PyYAML")


def run(
    config: str | Path | Mapping[str, Any] | Config | Prepared,
    *,
    out: Path | str | None = None,
    overrides: Iterable[str] = (),
    halving: bool = True,
    formats: Sequence[str] = ("csv",),
    figures: bool = True,
    progress: bool = False,
) -> RunResult:
    """Run a system, and once more with half the step size, which says how far the numbers can be trusted.

    Args:
        config: bundled name, path, plain values, or what `prepare` returned.
        out: folder to write to; nothing is written without it.
        overrides: for example ("robot.tau_m=6 ms",).
        halving: whether to make the second run, the source of `numerics`.
        formats: files to write besides results.arrow, which the run fills as it goes: csv, parquet, mat, h5.
        figures: whether to draw, if `out` is given.
        progress: whether to show a bar on a terminal.
    Returns: results and summary.
    Raises: ConfigError before anything runs, also if another run is writing to `out`; StepError, FmuError or
        Interrupted if the run fails: what was recorded until then, and a summary that holds the error, are
        then in `out`, and in the exception's attribute `result`.
    """
    formats = check_formats(formats)
    prepared = config if isinstance(config, Prepared) else prepare(config, overrides)
    folder = folder_at(out)
    with locked(folder):
        return _run_in(folder, prepared, halving, formats, figures, progress)


def _run_in(
    folder: Path | None,
    prepared: Prepared,
    halving: bool,
    formats: Sequence[str],
    figures: bool,
    progress: bool,
) -> RunResult:
    """See `run`."""
    if folder is not None:
        begin_folder(folder, prepared.config)
    try:
        path = None if folder is None else folder / "results.arrow"
        with logs_in(None if folder is None else folder / LOG_FOLDER):
            results, statistics, ledger = _run_once(prepared, prepared.grid, path, progress, paced=True)
    except _Stopped as stopped:
        error = _finish_failed(prepared, stopped, folder, formats)
        raise error from error.__cause__
    summary: dict[str, Any] = {
        "title": prepared.config.model.title,
        "config": prepared.config.model.to_data(),
    }
    summary["run"], summary["notes"] = statistics, list(prepared.notes)
    made = RunResult(results, Summary(summary), prepared, folder)
    if ledger:
        summary["coupling"] = ledger.summary()
        made.coupling = _energy_signals(ledger)
    failed: OrchestratorError | None = None
    try:
        measured = _measure(prepared.measures, results)
        _merge(summary, measured)
        if halving:
            measured |= {key: summary[key] for key in ("coupling",) if key in summary}
            summary["numerics"] = _numerics(prepared, results, measured, folder, progress)
    except OrchestratorError as error:
        failed = error
        summary["error"] = error_data(error)
    summary["parameters"] = dict(results.parameters)
    summary["provenance"] = dict(results.provenance)
    made.summary = Summary(strict(summary))
    if folder is not None:
        try:
            write_run(made, formats, figures and failed is None)
        except OSError as error:
            failed = failed or incomplete(folder, error)
    if failed is not None:
        failed.result = made  # type: ignore[attr-defined]
        raise failed
    return made


class _Stopped(Exception):
    """A run that did not reach its end, with what it recorded."""

    def __init__(self, error: OrchestratorError, results: Results, statistics: dict[str, Any]) -> None:
        super().__init__(str(error))
        self.error, self.results, self.statistics = error, results, statistics


def _run_once(
    prepared: Prepared,
    grid: Grid,
    path: Path | BinaryIO | None,
    progress: bool,
    label: str = "",
    paced: bool = False,
) -> tuple[Results, dict[str, Any], Ledger]:
    model = prepared.config.model
    recorder = Recorder(
        prepared.system,
        every=model.run.record_every,
        path=path or _scratch(prepared, grid, None),
        points=len(grid),
        parameters=parameters_of(prepared.system),
        provenance=_provenance(prepared),
    )
    observers: list[Observer] = [recorder]
    bar = Progress(len(grid), label or model.title or prepared.config.name) if progress else None
    if bar is not None:
        observers.append(bar)
    report, ledger = Report(), Ledger(prepared.system, every=model.run.record_every)
    realtime = model.run.realtime if paced else None
    pace = None if realtime is None else Pace(realtime, float(grid.start))
    begin = perf_counter()
    error: OrchestratorError | None = None
    try:
        simulate(
            prepared.system,
            prepared.master,
            grid,
            observers,
            report,
            loop=model.run.loop,
            ledger=ledger,
            pace=pace,
            pool=prepared.pool,
        )
    except OrchestratorError as raised:
        error = raised
    except KeyboardInterrupt:
        error = Interrupted("interrupted; what was recorded until then is kept")
    finally:
        wall = perf_counter() - begin
        if bar is not None:
            bar.close()
        recorder.close()
    results = recorder.results()
    instants = results.time
    simulated = float(instants[-1] - instants[0]) if len(results) else 0.0
    del instants
    statistics = {
        "master": model.run.master_name,
        "loop": report.loop,
        "step_size": float(grid.step_size),
        "steps": grid.steps,
        "start_time": float(grid.start),
        "stop_time": float(grid.stop),
        "simulated_time": simulated,
        "wall_time": wall,
        "stepping_time": report.stepping_time,
        "real_time_factor": simulated / report.stepping_time if report.stepping_time > 0.0 else 0.0,
        "instance_time": report.instance_time,
        "log": report.log,
    }
    tolerances = {one.name: integration_tolerance(one.fmu) for one in prepared.system.instances}
    if known := {name: value for name, value in tolerances.items() if value is not None}:
        statistics["tolerance"] = known
    if report.ended is not None:
        statistics["ended"] = {"instance": report.ended.instance, "time": report.ended.time}
    if pace is not None:
        statistics["realtime"] = pace.summary()
    if report.external:
        statistics["external"] = report.external
    if error is not None:
        raise _Stopped(error, results, statistics)
    return results, statistics, ledger


def _energy_signals(ledger: Ledger) -> Results:
    """Energies of the power bonds over time."""
    time, energies = ledger.energies_over_time()
    signals = {
        f"{name}.{what}": column
        for name, columns in energies.items()
        for what, column in zip(("taken", "given", "created"), columns.T, strict=True)
    }
    return Results(time, signals, dict.fromkeys(signals, "J"))


def _measure(measures: Iterable[ChosenMeasure], results: Results) -> dict[str, Any]:
    measured: dict[str, Any] = {}
    for one in measures:
        try:
            _merge(measured, strict(one.measure.measure(results, one.options)))
        except Exception as error:  # whatever a measure trips over, the results are to be kept
            raise OrchestratorError(
                f"measure {one.name} failed: {type(error).__name__}: {error.args[0] if error.args else error}"
            ) from error
    return measured


def _merge(summary: dict[str, Any], more: Mapping[str, Any]) -> None:
    taken = [key for key in more if key in summary]
    if taken:
        raise OrchestratorError(f"two parts of the summary are called {listed(taken)}")
    summary.update(more)


def _scratch(prepared: Prepared, grid: Grid, folder: Path | None) -> BinaryIO | None:
    """A nameless file for results that are too large for memory; None for others."""
    rows = len(grid) // prepared.config.model.run.record_every + 1
    if 8 * rows * (len(prepared.system.recorded) + 1) <= _IN_MEMORY:
        return None
    return cast(BinaryIO, TemporaryFile(buffering=0, dir=folder))


def _numerics(
    prepared: Prepared,
    results: Results,
    measured: Mapping[str, Any],
    folder: Path | None,
    progress: bool,
) -> dict[str, Any]:
    """What half the step size changes."""
    grid = prepared.grid.halved()
    numerics: dict[str, Any] = {"step_size": float(grid.step_size)}
    if external := prepared.config.model.external:
        what = f"{listed(external)} is another program, which would have to run again with this one"
        return numerics | {"error": {"kind": "NotMade", "message": what}}
    refused = checks.step_size(prepared.system.instances, grid.step_size, prepared.config.places)
    if refused:
        return numerics | {"error": error_data(ConfigError(refused))}
    try:
        scratch = _scratch(prepared, grid, folder)
        halved, _, ledger = _run_once(prepared, grid, scratch, progress, "half the step size")
        found = _measure(prepared.measures, halved) | ({"coupling": ledger.summary()} if ledger else {})
        numerics.update(changes(measured, found))
        numerics["signals"] = signal_changes(results, halved)
    except _Stopped as stopped:
        if isinstance(stopped.error, Interrupted):
            raise stopped.error from None
        numerics["error"] = error_data(stopped.error)
    return numerics


def _provenance(prepared: Prepared) -> dict[str, Any]:
    return {**origin(), "packages": versions(_PACKAGES), "fmus": instance_fmus(prepared.system)}


def instance_fmus(system: System) -> dict[str, dict[str, Any]]:
    """Which FMU each instance of a system is of, by name: model, file, FMI version, checksum."""
    checksums: dict[int, str] = {}
    found = {}
    for instance in system.instances:
        fmu = instance.fmu
        if id(fmu) not in checksums:
            checksums[id(fmu)] = fmu.checksum()
        found[instance.name] = {
            "model": fmu.description.name,
            "file": fmu.path.name if fmu.path is not None else None,
            "fmi_version": fmu.description.fmi_version,
            "checksum": checksums[id(fmu)],
        }
    return found


def _finish_failed(
    prepared: Prepared, stopped: _Stopped, folder: Path | None, formats: Sequence[str]
) -> OrchestratorError:
    """Keep what a failed run recorded: on disk, and with the exception, which is to be raised."""
    summary = {
        "title": prepared.config.model.title,
        "config": prepared.config.model.to_data(),
        "run": stopped.statistics,
        "notes": list(prepared.notes),
        "error": error_data(stopped.error),
        "parameters": dict(stopped.results.parameters),
        "provenance": dict(stopped.results.provenance),
    }
    result = RunResult(stopped.results, Summary(strict(summary)), prepared, folder)
    stopped.error.result = result  # type: ignore[attr-defined]
    try:
        if folder is not None:
            write_run(result, formats, False)
    except OSError as unwritten:
        # Most often the disk is full, and the run failed for it: the first error is the one to act on.
        stopped.error.args = (f"{stopped.error}\n  {incomplete(folder, unwritten)}",)
    return stopped.error
