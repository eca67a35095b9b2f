"""Checks of an FMU's behaviour by trajectories: the same again, from a saved state, with smaller steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...fmi import Array, Kind
from .finding import Finding, Level, Verdict, failed, passed
from .trial import Trial

# Below this part of an output's range a difference is rounding.
_ROUNDING = 1e-12
# Below this part of its size an output has no range.
_NO_RANGE = 1e-6
# Least effect of a step that is reported if it does not decrease with the step.
_LARGE = 1e-3
_MOST_READ = 5000


def _same(
    check: str,
    trial: Trial,
    one: Array,
    other: Array,
    good: str,
    bad: str,
    remedy: str,
    first: int = 0,
) -> Finding:
    """Passed if two trajectories are the same to the bit.

    Args:
        first: communication point at which they begin.
    """
    found = trial.difference(one, other)
    if found is None:
        return passed(check, good)
    output, row = found
    column, time = trial.outputs.index(output), (first + row) * trial.step
    reason = (
        f"{bad}: {output} at {time:.6g} s is {float(other[row, column])!r}, not {float(one[row, column])!r}."
    )
    return failed(check, Level.ERROR, reason, remedy, output=output, time=time)


def _not_applicable(check: str, reason: str) -> Finding:
    return Finding(check, Verdict.NOT_APPLICABLE, reason)


def runs(trial: Trial) -> Finding:
    """Instantiate, initialise, step, terminate, free."""
    with trial.made() as instance:
        trial.initialise(instance)
        instance.terminate()
    amplitude, steps = trial.conditions.amplitude, trial.conditions.steps
    with trial.made() as instance:
        trial.initialise(instance, trial.rows)
        trial.drive(instance, trial.rows)
        instance.terminate()
        log = instance.log_lines()
    inputs = f"inputs up to {amplitude:g} of their nominal values" if amplitude else "inputs at their start"
    text = f"Instantiated, initialised, {steps} steps of {trial.step:g} s with {inputs}, terminated, freed."
    return passed("run", text, steps=steps, step_size=trial.step, amplitude=amplitude, log=list(log)[-5:])


def values(trial: Trial) -> Finding:
    """Every variable can be read, is finite, and within its declared range."""
    named = [one for one in trial.description.variables.values() if not one.shape][:_MOST_READ]
    readable = [one for one in named if one.kind not in (Kind.BINARY, Kind.CLOCK)]
    strange: dict[str, float] = {}
    outside: dict[str, str] = {}
    with trial.made() as instance:
        trial.initialise(instance, trial.rows)
        for moment in range(2):
            if moment:
                trial.drive(instance, trial.rows)
            got = instance.get_values([one.name for one in readable])
            for one in readable:
                value = got[one.name]
                if not isinstance(value, int | float):
                    continue
                if not math.isfinite(value):
                    strange[one.name] = value
                elif (one.minimum is not None and value < one.minimum) or (
                    one.maximum is not None and value > one.maximum
                ):
                    outside[one.name] = f"{one.name} = {value!r}"
    outputs = [name for name in strange if name in trial.outputs]
    if strange:
        shown = ", ".join(f"{name} = {value!r}" for name, value in list(strange.items())[:5])
        level = Level.ERROR if outputs else Level.WARNING
        remedy = "Give them finite values from initialisation onwards."
        return failed("values", level, f"{len(strange)} variables are not finite: {shown}.", remedy)
    if outside:
        shown = ", ".join(list(outside.values())[:5])
        return failed(
            "values",
            Level.WARNING,
            f"{len(outside)} variables leave the range that is declared for them: {shown}.",
            "Widen minimum and maximum, or keep within them.",
        )
    return passed("values", f"{len(readable)} variables are read, finite, and within their ranges.")


def determinism(trial: Trial) -> Finding:
    """Two runs give the same bits."""
    again = trial.trajectory(trial.rows)
    bad, remedy = "A second run differs", "Seed random numbers, and keep no memory outside the instance."
    return _same("determinism", trial, trial.base, again, "Two runs are the same to the bit.", bad, remedy)


def reset(trial: Trial) -> Finding:
    """After a reset the trajectory is that of a new instance."""
    with trial.made() as instance:
        if not instance.resettable:
            return _not_applicable("reset", "The library has no function for it.")
        trial.initialise(instance, trial.rows)
        trial.drive(instance, trial.rows)
        instance.terminate()
        instance.reset()
        trial.bind(instance)
        start = trial.initialise(instance, trial.rows)
        again = np.vstack([start, trial.drive(instance, trial.rows)])
    good, bad = "After a reset the trajectory is the same to the bit.", "After a reset the trajectory differs"
    remedy = "Have reset restore everything that instantiation sets, memory of earlier steps included."
    return _same("reset", trial, trial.base, again, good, bad, remedy)


def pair(trial: Trial) -> Finding:
    """Two instances in one process do not disturb each other."""
    if trial.description.capabilities.once_per_process:
        return _not_applicable("two instances", "The FMU declares that a process takes one instance only.")
    amplitude, steps = trial.conditions.amplitude, trial.conditions.steps
    others = trial.rows_of(amplitude / 2.0, steps, seed=1)
    alone = trial.trajectory(others)
    with trial.made("one") as one, trial.made("two") as two:
        seen: dict[Any, list[Array]] = {one: [trial.initialise(one, trial.rows)]}
        seen[two] = [trial.initialise(two, others)]
        for index in range(steps):
            for instance, rows in ((one, trial.rows), (two, others)):
                seen[instance].append(trial.drive(instance, rows, index, index + 1)[0])
        together = [np.array(seen[one]), np.array(seen[two])]
    good = "Two instances that step in turn give what each gives alone."
    remedy = "Keep the state in the instance, not in variables of the library."
    finding = _same("two instances", trial, trial.base, together[0], good, "The first is disturbed", remedy)
    if finding.verdict is Verdict.FAILED:
        return finding
    return _same("two instances", trial, alone, together[1], good, "The second is disturbed", remedy)


def halving(trial: Trial) -> Finding:
    """How the outputs change with half and a quarter of the step, the same inputs being held as long."""
    if trial.description.own_step is not None:
        return _not_applicable("step halving", "The FMU declares that it takes one step size only.")
    quarter, half = (trial.trajectory(trial.rows, divided) for divided in (4, 2))
    # What is constant but for rounding has no range to speak of.
    nominal = [trial.description.variables[name].nominal for name in trial.outputs]
    usual = np.maximum(np.abs(trial.base).max(axis=0), nominal)
    spans = np.maximum(np.ptp(trial.base, axis=0), _NO_RANGE * usual)
    changes = np.abs(trial.base - half).max(axis=0) / spans
    smaller = np.abs(half - quarter).max(axis=0) / spans
    size = np.abs(trial.base).max(axis=0) / spans
    rounding = _ROUNDING * np.maximum(1.0, size)
    orders = {}
    worst, which = 0.0, ""
    for column, name in enumerate(trial.outputs):
        change, next_change = float(changes[column]), float(smaller[column])
        if change <= rounding[column]:
            continue
        order = math.log2(change / next_change) if next_change > rounding[column] else math.inf
        orders[name] = {"change": change, "next_change": next_change, "order": order}
        if change > worst:
            worst, which = change, name
    if not orders:
        return passed("step halving", "Half the step changes the outputs by rounding only.")
    order = orders[which]["order"]
    text = f"Half the step changes {which} most, by {worst:.2g} of its range"
    shown = f"order {order:.1f}" if math.isfinite(order) else "a quarter nothing more"
    orders_by_output = {
        name: {key: value if math.isfinite(value) else None for key, value in one.items()}
        for name, one in orders.items()
    }
    growing = [
        name
        for name, one in orders.items()
        if one["change"] > _LARGE and one["next_change"] > 0.9 * one["change"]
    ]
    if growing:
        return failed(
            "step halving",
            Level.WARNING,
            f"{text}; the change does not fall with the step for {', '.join(growing[:5])}.",
            "If it is a sampled component, run it at its sample time; else its results depend on the step.",
            outputs=orders_by_output,
        )
    return passed("step halving", f"{text} ({shown}).", outputs=orders_by_output)


def state(trial: Trial) -> Finding:
    """A saved state gives the same continuation, and saving it changes nothing."""
    if not trial.description.capabilities.save_state:
        return _not_applicable("state", "The FMU does not declare that its state can be saved.")
    rows, middle = trial.rows, len(trial.rows) // 2
    with trial.made() as instance:
        trial.initialise(instance, rows)
        trial.drive(instance, rows, 0, middle)
        saved = instance.save_state()
        first = trial.drive(instance, rows, middle)
        instance.restore_state(saved)
        again = trial.drive(instance, rows, middle)
        instance.free_state(saved)
    base = trial.base[middle + 1 :]
    remedy = "Keep everything that a step depends on in the state, delays and random numbers included."
    good = "From a saved state the run goes on the same to the bit."
    finding = _same("state", trial, base, first, good, "Saving the state changes the run", remedy, middle + 1)
    if finding.verdict is Verdict.FAILED:
        return finding
    return _same(
        "state", trial, base, again, good, "From the saved state the run differs", remedy, middle + 1
    )


def serialisation(trial: Trial) -> Finding:
    """A state that went through bytes into another instance gives the same continuation."""
    able = trial.description.capabilities
    if not (able.save_state and able.serialise_state):
        reason = "The FMU does not declare that its state can be written as bytes."
        return _not_applicable("serialised state", reason)
    rows, middle = trial.rows, len(trial.rows) // 2
    with trial.made() as instance:
        trial.initialise(instance, rows)
        trial.drive(instance, rows, 0, middle)
        saved = instance.save_state()
        data = instance.serialise_state(saved)
        instance.free_state(saved)
    with trial.made("two") as instance:
        trial.initialise(instance, rows)
        saved = instance.deserialise_state(data)
        instance.restore_state(saved)
        again = trial.drive(instance, rows, middle)
        instance.free_state(saved)
    good = f"A state of {len(data)} bytes goes on in another instance, the same to the bit."
    bad = "From the bytes another instance goes on differently"
    remedy = "Write everything that a step depends on, and no addresses."
    return _same("serialised state", trial, trial.base[middle + 1 :], again, good, bad, remedy, middle + 1)
