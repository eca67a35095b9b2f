"""Co-simulation of FMUs, stability of delayed loops, and diagnosis of the gap to the real machine.

    import orchestrator as orc

    result = orc.run("docking-1d", set={"robot.tau_m": "6 ms"})
    result["contact.force"]                       # a signal: values, time, unit
    result.plot("satellite.velocity", "contact.force")
    result.summary.stiffness_estimate

What `__all__` names is the public interface: it stays as it is, or changes with a warning of one version.
Everything else is private to the project. What is not needed is not imported: `import orchestrator` takes no
time to speak of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from . import base as _base  # noqa: F401 (notes when the package was loaded)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from .base.errors import ConfigError, FmuError, OrchestratorError, StepError
    from .campaign.sweep import Swept
    from .diagnosis.rig.diagnosed import Diagnosed
    from .diagnosis.unknown_input.diagnose import DiagnosedSystem
    from .frequency.linear_config import LinearConfig
    from .report.system_view import System
    from .results.signal import Signal
    from .results.summary import Summary
    from .simulation.run_result import RunResult
    from .translate.build_report import BuildReport

__version__ = "0.2.0"

__all__ = [
    "ConfigError",
    "FmuError",
    "OrchestratorError",
    "RunResult",
    "Signal",
    "StepError",
    "Summary",
    "System",
    "__version__",
    "build",
    "diagnose",
    "linearise",
    "load",
    "read_results",
    "run",
    "sweep",
]

_HOME = {
    "ConfigError": "base.errors",
    "FmuError": "base.errors",
    "OrchestratorError": "base.errors",
    "RunResult": "simulation.run_result",
    "Signal": "results.signal",
    "StepError": "base.errors",
    "Summary": "results.summary",
    "System": "report.system_view",
}


def run(
    system: str | Path | Mapping[str, Any] | System,
    *,
    set: Mapping[str, Any] | None = None,
    inputs: Path | str | None = None,
    record: str | Sequence[str] = (),
    out: Path | str | None = None,
    halving: bool = True,
    progress: bool = False,
) -> RunResult:
    """Run a system, and once more with half the step size, which says how far the numbers can be trusted.

    Args:
        system: name of a bundled system, path of a .yaml, .fmu, .ssp or .ssd file, a `System`, or a dict with
            the keys of a config; its plain numbers are in SI units.
        set: values by path, such as {"robot.tau_m": "6 ms", "run.stop_time": 2.0}: texts with a unit, or
            plain numbers in SI units.
        inputs: a CSV file of signals over time: a column `time [s]`, and one for each input that it feeds.
        record: patterns of further variables to record, such as "der(*)" or "robot.*".
        out: folder to write results, summary and figures to; nothing is written without it.
        halving: whether to make the second run, the source of `summary.numerics`.
        progress: whether to show a bar on a terminal.
    Returns: a `RunResult`: the signals by name, the summary, and where files are.
    Raises: ConfigError before anything runs; StepError or FmuError if the run fails: their attribute `result`
        holds what was recorded until then.
    """
    from .simulation.run import run as run_config

    source: Any = system.check() if hasattr(system, "check") else _source(system)
    if set or inputs is not None or record:
        source = _changed(system, set)
    if inputs is not None or record:
        from .system.command_line_signals import requested

        source = requested(
            source,
            inputs=None if inputs is None else str(inputs),
            record=[record] if isinstance(record, str) else list(record),
        )
    return run_config(source, out=out, halving=halving, progress=progress)


def load(system: str | Path | Mapping[str, Any], *, set: Mapping[str, Any] | None = None) -> System:
    """Read a system, to look at it, change it, draw it or run it.

    Args:
        system, set: see `run`.
    Raises: ConfigError with all problems of the config's form; `System.check` looks into the FMUs.
    """
    from .report.system_view import System

    return System.of(_changed(system, set))


def sweep(
    system: str | Path | Mapping[str, Any] | System,
    over: Mapping[str, Sequence[Any] | Mapping[str, Any]],
    *,
    set: Mapping[str, Any] | None = None,
    derived: Mapping[str, str] | None = None,
    store: Path | str | None = None,
    jobs: int | None = None,
    **options: Any,
) -> Swept:
    """Run a system at all combinations of values.

    Args:
        system, set: see `run`.
        over: values by path: a list, or a range as study files have it: {"from": "1 ms", "to": "8 ms",
            "count": 8}.
        derived: further numbers of each run by name, such as {"peak": "max(abs(contact.force))"}.
        store: folder that keeps the runs; runs that it holds are not made again. None: a temporary one.
        jobs: number of processes; None: one per core.
        options: further keys of a study file, such as record="all".
    Returns: `.to_dataframe()` and `.columns()` give the points with what their runs gave: the quantities in
        `derived`, or the numbers of the summaries if none is named.
    Raises: ConfigError with all problems before the first run.
    """
    from .base.temporary_folders import scratch_folder
    from .campaign.sweep import Study
    from .system.si_numbers import SiNumbers

    numbers = SiNumbers(_changed(system, None))
    grid = {
        path: dict(values) if isinstance(values, Mapping) else [numbers.value(path, one) for one in values]
        for path, values in over.items()
    }
    source = _source(system)
    study: dict[str, Any] = {"system": dict(source) if isinstance(source, Mapping) else str(source)}
    study |= {"design": {"grid": grid}, **options}
    if set:
        study["set"] = {path: numbers.value(path, value) for path, value in set.items()}
    if derived:
        study["derived"] = dict(derived)
    return Study(study).run(scratch_folder("sweep-") if store is None else store, jobs=jobs)


def _source(system: Any) -> Any:
    """A system as files have it: name, path, or plain values with units. Raises: ConfigError."""
    from .system.si_numbers import in_config_units

    if hasattr(system, "check"):
        return system.data
    return in_config_units(system) if isinstance(system, Mapping) else system


def _changed(system: Any, changes: Mapping[str, Any] | None) -> Any:
    """The config of a system with values changed. Raises: ConfigError."""
    from .base.errors import ConfigError, Problem
    from .config import load_config
    from .system.si_numbers import SiNumbers

    config = load_config(_source(system))
    if not changes:
        return config
    if not hasattr(changes, "items"):
        raise ConfigError([Problem("set", f"got {changes!r}", 'values by path, as {"robot.tau_m": "6 ms"}')])
    numbers = SiNumbers(config)
    return load_config(config, [numbers.override(path, value) for path, value in changes.items()])


def linearise(
    system: str | Path | Mapping[str, Any] | System,
    *,
    set: Mapping[str, Any] | None = None,
    at_time: float | str | None = None,
    at: str = "start",
    fix: Sequence[str] = (),
) -> LinearConfig:
    """Linearise a system around a point: a linear system with exact delays, without communication steps.

    Args:
        system, set: see `run`.
        at_time: the point of a run that it is linear around, "0.5 s" or a number [s]; None: see `at`.
        at: "start", or "trim": around the steady state, as `orchestrator stability --trim` finds it.
        fix: states that keep their start values there and may go on changing, as "path.turned".
    Returns: `.modes()`, `.roots()`, `.margins()` of each connection in a feedback loop,
        `.open("a.y -> b.u")`, `.chart(...)`, `.to_control()`, figures such as `.bode()`, and `.system` with
        its matrices.
    Raises: ConfigError with what cannot be linearised.
    """
    from .base.errors import ConfigError, Problem
    from .config.base import seconds
    from .frequency.linear_config import linear_config

    if at not in ("start", "trim"):
        raise ConfigError([Problem("at", f"no operating point {at!r}", "start or trim; at_time for times")])
    try:
        time = None if at_time is None else seconds(at_time)
    except ValueError as error:
        allowed = "a text with a unit, as '0.5 s', or a number [s]"
        raise ConfigError([Problem("at_time", str(error), allowed)]) from None
    return linear_config(_changed(system, set), time, fix if at == "trim" else None)


def build(
    model_file: Path | str | Any,
    output: Path | str | None = None,
    *,
    model: str | None = None,
    fmi_version: str = "2.0",
    platforms: Sequence[str] = (),
    libraries: Sequence[Path | str] = (),
) -> BuildReport:
    """Make an FMU from a Modelica file, or from a linear system of python-control or scipy.

    Args:
        model_file: a .mo file; or a StateSpace or TransferFunction of python-control, or a linear system of
            scipy.signal. Its inputs are u or u1, u2, outputs y or y1, y2, states x1, x2, or as its labels
            say.
        output: the FMU; by default the model's name in the working directory.
        model: qualified name, where the file holds several; of a linear system the name that it gets.
        fmi_version: "2.0" or "3.0".
        platforms: such as ("linux64", "win64"); by default this machine's.
        libraries: folders with further Modelica libraries, beside those of MODELICAPATH.
    Returns: `.path` is the FMU; notes say what the author of the model should know.
    Raises: BuildError for what cannot be translated, with the line.
    """
    from pathlib import Path

    from .translate.build import build as build_model
    from .translate.linear_model import build_linear, is_linear
    from .translate.package import named_platforms, this_platform

    chosen = named_platforms(platforms) if platforms else (this_platform(),)
    if is_linear(model_file):
        name = model or "LinearSystem"
        target = Path(output or f"{name}.fmu")
        return build_linear(model_file, target, name, fmi_version=fmi_version, platforms=chosen)
    file = Path(model_file)
    made = Path(output) if output is not None else Path(f"{(model or file.stem).rpartition('.')[2]}.fmu")
    folders = [Path(one) for one in libraries]
    return build_model(file, made, model=model, fmi_version=fmi_version, platforms=chosen, libraries=folders)


def diagnose(study: Path | str, out: Path | str | None = None) -> Diagnosed | DiagnosedSystem:
    """Find from logs why a machine differs from its model.

    Args:
        study: a study file, or a folder that holds one.
        out: folder to write the page and diagnosis.json to.
    Returns: the diagnosis and its findings. For a docking rig, `.diagnosis` holds the content of
        diagnosis.json; for any other system, `.data` does, `.answer` the laws, and `print` shows it.
    Raises: ConfigError with all problems of the study.
    """
    from .base.errors import extras_named

    with extras_named():
        from pathlib import Path

        from .diagnosis.rig.diagnose import diagnose as diagnose_study
        from .diagnosis.study.study import is_port_study
        from .diagnosis.unknown_input.diagnose import diagnose_system

        return (diagnose_system if is_port_study(Path(study)) else diagnose_study)(study, out)


def read_results(path: Path | str) -> RunResult:
    """Read a run back from its files.

    Args:
        path: a folder that `run` wrote, or a file of results: arrow, csv, parquet, mat or h5.
    Returns: the run, also one that was killed or is still running.
    Raises: OrchestratorError if it cannot be read.
    """
    from .simulation.run_result import read_run

    return read_run(path)


def __getattr__(name: str) -> Any:
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
