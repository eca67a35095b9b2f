"""Check a traced component against its Python code: both are driven with the same random numbers."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca

from orchestrator.base.errors import BuildError

from .component import DISCARD, ERROR, ComponentProgram

TOLERANCE = 1e-9
"""Largest difference, relative to the largest size that the number has had. Matrix products of numpy round in
an order of their own; so much may such a difference grow in a few hundred steps."""
RUNS, STEPS = 6, 500
# How often an input jumps, by run, and how far from its start value, in nominal values: components look at
# thresholds, and wait.
_JUMPS = (0.1, 0.02, 0.005)
_SIZES = (0.02, 0.3, 1.0)
_STEP_SIZE = 5e-4


def check_component(script: Path, cls: Any, program: ComponentProgram, seed: int = 1) -> str:
    """Drive the Python code and the functions with the same inputs, and compare every variable.

    The Python code is asked first, as its FMU would be; a hidden memory, which the functions cannot have,
    shows as a difference.

    Args:
        script: for messages.
        cls: the component's class, not traced.
        program: what was traced.
        seed: of the random numbers.
    Returns: what was found, as a sentence.
    Raises: BuildError naming the variable and the step of the first difference.
    """
    source = random.Random(seed)
    largest, steps = 0.0, 0
    for run in range(RUNS):
        model = cls(instance_name="check")
        model.log = lambda *arguments, **options: None
        variables = list(model.vars.values())
        pair = _Pair(program, variables)
        start = 0.0 if run % 2 == 0 else 0.25
        try:
            model.setup_experiment(start, None, None)
            model.enter_initialization_mode()
            model.exit_initialization_mode()
        except (ArithmeticError, ValueError, RuntimeError) as error:
            raise BuildError(
                f"{script.name}: native form: start values are refused, so it cannot be checked: {error}"
            ) from error
        pair.take(program.setup, start, 0.0)
        pair.take(program.initialise, start, 0.0)
        base = list(pair.u)
        values = list(base)
        nominal = pair.nominal_inputs(getattr(model, "type_attributes", {}))
        for number in range(STEPS):
            for index in range(len(values)):
                if source.random() < _JUMPS[run % len(_JUMPS)]:
                    values[index] = base[index] + nominal[index] * source.gauss(0.0, source.choice(_SIZES))
                else:
                    values[index] += 0.05 * source.gauss(0.0, 1.0) * abs(values[index] - base[index])
            pair.set_inputs(values)
            time = start + number * _STEP_SIZE
            failed = False
            try:
                done = bool(model.do_step(time, _STEP_SIZE))
            except (ValueError, RuntimeError):
                done, failed = False, True
            except ArithmeticError as error:
                raise BuildError(
                    f"{script.name}: native form: the step from {time!r} s fails in Python ({error}), while "
                    "compiled code goes on with numbers that are none; keep the model from it, or raise "
                    "ValueError there"
                ) from error
            refused = pair.take(program.advance, time, _STEP_SIZE)
            if done is refused:
                raise BuildError(
                    f"{script.name}: native form: the step from {time!r} s is "
                    f"{'done' if done else 'refused'} in Python, not natively; a step may depend on "
                    "registered variables only"
                )
            if failed:
                break
            difference, name = pair.difference(time + _STEP_SIZE)
            if not difference <= TOLERANCE:
                raise BuildError(
                    f"{script.name}: native form: {name} differs by {difference:.1e} of its size after the "
                    f"step from {time!r} s; allowed {TOLERANCE:g}. All memory has to lie in registered "
                    "variables that can be set"
                )
            largest, steps = max(largest, difference), steps + 1
    return f"agrees with the Python code over {steps} random steps, largest relative difference {largest:.1e}"


class _Pair:
    """The Python model's variables and the functions' arguments."""

    def __init__(self, program: ComponentProgram, registered: list[Any]) -> None:
        self.program, self.registered = program, registered
        self.x, self.u, self.p = (
            [float(variable.start or 0.0) for variable in program.of_kind(kind)]
            for kind in ("STATE", "INPUT", "PARAMETER")
        )
        self._sizes = [0.0] * len(registered)

    def nominal_inputs(self, attributes: Mapping[str, Mapping[str, str]]) -> list[float]:
        """Sizes of the inputs, as declared; 1 where nothing is."""
        inputs = self.program.of_kind("INPUT")
        return [float(attributes.get(variable.name, {}).get("nominal", 1.0)) for variable in inputs]

    def set_inputs(self, values: list[float]) -> None:
        for item, variable in zip(self.registered, self.program.variables, strict=True):
            if variable.kind != "INPUT":
                continue
            value = values[variable.index]
            given = {"float": float, "int": round, "bool": lambda number: number > 0.0}[variable.type](value)
            item.setter(given)
            self.u[variable.index] = float(given)

    def take(self, function: ca.Function, time: float, step_size: float) -> bool:
        """Take over the new states; whether that was refused."""
        states, outcome = function(time, step_size, self.x, self.u, self.p)
        refused = self.program.outcomes[int(outcome)].status in (DISCARD, ERROR)
        if not refused:
            self.x = states.full().ravel().tolist()
        return refused

    def difference(self, time: float) -> tuple[float, str]:
        """Largest difference relative to a variable's size so far, and its name."""
        computed = self.program.algebraics(time, 0.0, self.x, self.u, self.p).full().ravel().tolist()
        worst = (0.0, "")
        for place, (item, variable) in enumerate(zip(self.registered, self.program.variables, strict=True)):
            if variable.kind not in ("STATE", "ALGEBRAIC"):
                continue
            found = (self.x if variable.kind == "STATE" else computed)[variable.index]
            expected = float(item.getter())
            self._sizes[place] = max(self._sizes[place], abs(expected))
            if found != expected and not (math.isnan(found) and math.isnan(expected)):
                worst = max(worst, (abs(found - expected) / self._sizes[place], variable.name))
        return worst
