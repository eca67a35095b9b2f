"""What the process that holds an FMU measures of it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from time import process_time_ns
from typing import Any

from ...base.errors import FmuError, StepError
from .trial import Ended, Trial

# Of a round [ns]: long against the clock's grain, short against what else the machine does.
_ROUND = 20_000_000


_MOST_STEPS = 200_000


_INSTANCES = 20


# Inputs that follow each other; they end where they began but for one jump.
_ROWS = 256


class _Run:
    """An initialised instance and a way to take many steps of it."""

    def __init__(self, trial: Trial, instance: Any) -> None:
        self.trial, self.instance = trial, instance
        self.rows = trial.rows_of(trial.conditions.amplitude, _ROWS)
        self.calls = instance.native_calls() if trial.description.fmi_version[0] in "23" else None
        # Memory of other types than double is not refilled in machine code.
        self.loop = "python" if self.calls is None else "native"

    def take(self, what: int, first: int, count: int) -> int:
        """Steps, or parts of them; how many went well."""
        from . import bench_loop

        size = self.trial.step
        if self.calls is not None:
            step, setting, getting = bench_loop.tables(self.calls)
            return int(
                bench_loop.run(
                    what, self.calls.version, step, setting, getting, self.rows, self.instance.u, first,
                    count, size,
                )
            )  # fmt: skip
        for index in range(first, first + count):
            if what & bench_loop.SET and self.trial.inputs:
                self.instance.u[:] = self.rows[index % _ROWS]
                self.instance.write_inputs()
            try:
                if what & bench_loop.STEP and self.instance.do_step(self.trial.point(index)) > 1:
                    return index - first
            except StepError:
                return index - first
            if what & bench_loop.GET:
                self.instance.read_outputs()
        return count

    def timed(self, what: int, first: int, count: int) -> tuple[float, int]:
        """CPU time of one step [s], and how many went well."""
        begin = process_time_ns()
        taken = self.take(what, first, count)
        return (process_time_ns() - begin) / 1e9 / max(1, taken), taken


def _calibrate(trial: Trial) -> int | str:
    """How many steps make a round."""
    from .bench_loop import GET, SET, STEP

    count = 16
    while True:
        with trial.made() as instance:
            trial.initialise(instance, trial.rows)
            run = _Run(trial, instance)
            run.take(SET, 0, 1)  # compiles
            each, taken = run.timed(SET + STEP + GET, 0, count)
        if taken < count:
            return taken if taken >= 8 else f"it fails after {taken} steps"
        if each * count * 1e9 >= _ROUND or count >= _MOST_STEPS:
            return count
        count = min(4 * count, _MOST_STEPS)


def _round(trial: Trial, count: int) -> dict[str, Any]:
    """CPU times of one round [s]; those of set, get, step and whole are of one step.

    A step is what the whole takes beyond setting and getting.
    """
    from .bench_loop import GET, SET, STEP

    begin = process_time_ns()
    with trial.made() as instance:
        made = process_time_ns()
        trial.initialise(instance, trial.rows)
        ready = process_time_ns()
        run = _Run(trial, instance)
        run.take(SET, 0, 1)
        get, _ = run.timed(GET, 0, count)
        whole, _ = run.timed(SET + STEP + GET, 0, count)
        # After the steps: some FMUs compute their outputs at the first get after a set.
        setting, _ = run.timed(SET, 0, count)
        return {
            "loop": run.loop,
            "step_size": trial.step,
            "instantiate": (made - begin) / 1e9,
            "initialise": (ready - made) / 1e9,
            "set": setting,
            "get": get,
            "step": max(whole - setting - get, 0.0),
            "whole": whole,
        }


def _memory(trial: Trial) -> int | None:
    """Resident memory of one more instance [bytes]; None if the system does not report it."""
    if not Path("/proc/self/statm").exists():
        return None
    with ExitStack() as stack:
        # The first brings what all share.
        trial.initialise(stack.enter_context(trial.made("first")), trial.rows)
        before = _resident()
        for index in range(_INSTANCES):
            instance = stack.enter_context(trial.made(f"further {index}"))
            trial.initialise(instance, trial.rows)
            if trial.description.capabilities.once_per_process:
                return None
        return max(0, _resident() - before) // _INSTANCES


def _resident() -> int:
    import os

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGESIZE")


def _guarded(request: Callable[..., Any]) -> Callable[..., Any]:
    def answer(trial: Trial, *arguments: Any) -> Any:
        try:
            return request(trial, *arguments)
        except (StepError, FmuError, Ended) as error:
            return " ".join(str(error).split())

    return answer


REQUESTS = {"calibrate": _guarded(_calibrate), "round": _guarded(_round), "memory": _guarded(_memory)}
