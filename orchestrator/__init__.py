"""Co-simulation of FMUs: configs, master algorithms, results.

    from orchestrator.simulation.run import run
    result = run("docking-1d", overrides=["robot.tau_m=6 ms"])

Names are imported when they are first used, so that `import orchestrator` costs next to nothing.
"""

from __future__ import annotations

from . import base as _base  # noqa: F401 (notes when the package was loaded)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

__version__ = "0.1.0"

# The functions `run` and `simulate` share their names with their modules, which Python binds here:
# they are imported from there.
_HOME = {
    "ConfigError": "base.errors",
    "FmuError": "base.errors",
    "Grid": "simulation.loop",
    "OrchestratorError": "base.errors",
    "Part": "system.assembly",
    "Recorder": "results.recorders",
    "Results": "results.recorders",
    "StepError": "base.errors",
    "System": "system.system",
    "assemble": "system.assembly",
    "create_master": "master",
    "instantiate": "master.running_instances",
    "load_config": "config",
    "load_fmu": "fmi",
    "load_system": "system.assembly",
    "prepare": "simulation.run",
    "read_results": "results.recorders",
}

__all__ = [*_HOME, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
