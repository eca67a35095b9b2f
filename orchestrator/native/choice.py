"""Which loop a run takes."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

from ..errors import ConfigError, Problem
from ..instances import Instances
from ..master import MasterAlgorithm
from ..master.gauss_seidel import GaussSeidel
from ..master.jacobi import Jacobi

__all__ = ["LOOPS", "choose_loop", "schedule"]

LOOPS = ("auto", "python", "native")

# What the interpreter costs per step and per instance of a step beyond the native loop [s];
# python -m tests.benchmarks.step_cost prints the whole costs.
_PER_STEP, _PER_INSTANCE = 5e-6, 7e-6
# What the native loop costs once per process [s]: to compile, to load from disk, when it is there.
_COMPILING, _LOADING, _LOADED = 8.0, 0.8, 0.005


def schedule(instances: Instances, master: MasterAlgorithm) -> tuple[tuple[int, ...], bool] | None:
    """Order of stepping, and whether inputs are fed right before each step; None if the master has no such.

    A master derived from these may do anything in its step: it counts as another.
    """
    if getattr(master, "extrapolation", 0):
        return None
    if type(master) is Jacobi:
        return tuple(range(len(instances))), False
    if type(master) is GaussSeidel:
        return instances.system.order, True
    return None


def obstacle(instances: Instances, master: MasterAlgorithm) -> str:
    """Why the native loop cannot run these instances; empty if it can."""
    if schedule(instances, master) is None:
        return f"the master {type(master).__name__}, or its extrapolation, works in Python"
    for index, one in enumerate(instances.running):
        native_calls = getattr(one, "native_calls", None)
        if native_calls is None or native_calls() is None:
            return f"instance {one.name} is stepped by Python code"
        if instances.layout.text_inputs[index] or instances.layout.text_outputs[index]:
            return f"strings of instance {one.name} are connected"
    if sys.maxsize < 2**32:
        return "addresses of this platform have not 64 bits"
    if not find_spec("numba"):
        return "the package numba is not installed"
    for connection in instances.system.connections:
        for link in connection.wire.links if connection.wire else ():
            if not type(link.effect).__module__.startswith("orchestrator.effects."):
                # Compiles what can be: numba is imported only where all else allows the native loop.
                from .wiring import unfit

                if reason := unfit(link.effect):
                    return f"effect {link.name} on {connection} {reason}"
    return ""


def choose_loop(loop: str, instances: Instances, master: MasterAlgorithm, steps: int) -> str:
    """The loop to take, "python" or "native"; both give the same to the bit.

    Args:
        loop: "auto" takes the native one where it can run and saves more than its start-up costs. It is
            compiled when it first runs, and then kept on disk.
        steps: of the whole run.
    Raises: ConfigError if the native loop is asked for and cannot run.
    """
    if loop == "python":
        return loop
    if loop == "auto":
        if steps * (_PER_STEP + _PER_INSTANCE * len(instances)) < _start_up(instances.wires is not None):
            return "python"
    reason = obstacle(instances, master)
    if not reason:
        return "native"
    if loop == "native":
        raise ConfigError(
            [Problem("run.loop", f"the native loop cannot run this: {reason}", remedy="Use loop: auto.")]
        )
    return "python"


def _start_up(wired: bool) -> float:
    """What the native loop costs before its first step [s].

    Args:
        wired: whether connections have effects, for which it is compiled a second time.
    """
    if "orchestrator.native.kernel" in sys.modules:
        return _LOADED
    source = Path(__file__).with_name("kernel.py")
    # Where numba keeps it elsewhere, since this folder cannot be written, it counts as not compiled.
    python = "".join(map(str, sys.version_info[:2]))
    kept = source.parent.glob(f"__pycache__/kernel.*run_steps-*.py{python}.*.nbc")
    count = sum(one.stat().st_mtime > source.stat().st_mtime for one in kept)
    return _LOADING if count > wired else _COMPILING
