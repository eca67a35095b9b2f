"""Which loop a run takes."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from ...base.compiled_functions import is_kept
from ...base.errors import ConfigError, Problem
from ...master import MasterAlgorithm
from ...master.gauss_seidel import GaussSeidel
from ...master.jacobi import Jacobi
from ...master.running_instances import Instances

# What the interpreter costs per step and per instance of a step beyond the native loop [s];
# python -m tests.benchmarks.step_cost prints the whole costs.
_PER_STEP, _PER_INSTANCE = 5e-6, 7e-6
# What the native loop costs once per process [s]: to compile, to load from disk, when it is there.
_COMPILING, _LOADING, _LOADED = 8.0, 0.8, 0.005


class Schedule(NamedTuple):
    """How a master steps.

    Attributes:
        order: positions of instances in the order of stepping.
        late: whether inputs are fed right before each step.
        extrapolation: order of the polynomials that inputs follow; 0 where they hold.
    """

    order: tuple[int, ...]
    late: bool
    extrapolation: int


def schedule(instances: Instances, master: MasterAlgorithm) -> Schedule | None:
    """How a master steps; None if it does something else.

    A master derived from these may do anything in its step: it counts as another.
    """
    if type(master) is Jacobi:
        return Schedule(tuple(range(len(instances))), False, master.extrapolation)
    if type(master) is GaussSeidel:
        return Schedule(instances.system.order, True, master.extrapolation)
    return None


def obstacle(instances: Instances, master: MasterAlgorithm, ledger: bool = False) -> str:
    """Why the native loop cannot run these instances; empty if it can.

    Args:
        ledger: whether the coupling's energy is kept books of.
    """
    planned = schedule(instances, master)
    if planned is None:
        return f"the master {type(master).__name__} works in Python"
    if planned.extrapolation and ledger:
        return "the energies of inputs that follow curves are reckoned in Python"
    for index, one in enumerate(instances.running):
        native_calls = getattr(one, "native_calls", None)
        if native_calls is None or (calls := native_calls()) is None:
            return f"instance {one.name} is stepped by Python code"
        if planned.extrapolation and one.description.followed and not calls.bend:
            return f"instance {one.name} takes the course of its inputs in Python"
        if instances.layout.text_inputs[index] or instances.layout.text_outputs[index]:
            return f"strings of instance {one.name} are connected"
    if sys.maxsize < 2**32:
        return "addresses of this platform have not 64 bits"
    if not find_spec("numba"):
        return "the package numba is not installed"
    for wired in instances.layout.wired:
        for effect, _ in wired.links:
            if not type(effect).__module__.startswith("orchestrator.effects."):
                # Compiles what can be: numba is imported only where all else allows the native loop.
                from .effects import unfit

                if reason := unfit(effect):
                    links = wired.connection.wire.every_link if wired.connection.wire else ()
                    name = next((one.name for one in links if one.effect is effect), "")
                    return f"effect {name or type(effect).__name__} on {wired.connection} {reason}"
    return ""


def choose_loop(
    loop: str, instances: Instances, master: MasterAlgorithm, steps: int, ledger: bool = False
) -> str:
    """The loop to take, "python" or "native"; both give the same to the bit.

    Args:
        loop: "auto" takes the native one where it can run and saves more than its start-up costs. It is
            compiled when it first runs, and then kept on disk. "prefer native" takes it where it can run.
        steps: of the complete run.
        ledger: whether the coupling's energy is kept books of.
    Raises: ConfigError if the native loop is asked for and cannot run.
    """
    if loop == "python":
        return loop
    if loop == "auto":
        bent = bool(getattr(master, "extrapolation", 0))
        kernel = kernel_of(instances.connections is not None, bent)
        saved = steps * (_PER_STEP + _PER_INSTANCE * len(instances))
        if saved < _start_up(kernel, saved):
            return "python"
    reason = obstacle(instances, master, ledger)
    if not reason:
        return "native"
    if loop == "native":
        raise ConfigError(
            [Problem("run.loop", f"the native loop cannot run this: {reason}", remedy="Use loop: auto.")]
        )
    return "python"


def kernel_of(wired: bool, bent: bool) -> str:
    """Name of the function that takes the steps: each is compiled for itself, and holds what it serves.

    Args:
        wired: whether connections have effects; bent: whether inputs follow curves.
    """
    return "run_bent_steps" if bent else "run_wired_steps" if wired else "run_steps"


def _start_up(kernel: str, saved: float) -> float:
    """What the native loop costs before its first step; see `kernel_of` [s].

    Args:
        saved: what it saves [s]; where that decides, kept files are not looked at, which takes 20 ms.
    """
    if "orchestrator.simulation.native.kernel" in sys.modules:
        return _LOADED
    if saved < _LOADING:
        return _LOADING
    if saved >= _COMPILING:
        return _COMPILING
    return _LOADING if is_kept(Path(__file__).with_name("kernel.py"), kernel) else _COMPILING
