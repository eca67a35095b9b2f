"""A single FMU as a config: its default experiment is the run."""

from __future__ import annotations

import re
from collections.abc import Iterable
from decimal import Decimal
from fractions import Fraction
from math import ceil, floor, log10
from pathlib import Path
from typing import NamedTuple

from ..base.errors import ConfigError, FmuError, Problem
from ..fmi import Interface, ModelDescription, load_fmu
from .ssp.load import Loaded

# What is taken where no FMU proposes a stop time, or a step size: so many steps over the run.
_STOP, _STEPS = Fraction(1), 500


class Times(NamedTuple):
    """Start, stop and step size of a run [s], and where each comes from."""

    start: Fraction
    stop: Fraction
    step: Fraction
    notes: tuple[str, ...]


def load_lone_fmu(path: Path) -> Loaded:
    """The config of one FMU: default experiment, all outputs, inputs at their start values.

    Raises: ConfigError if the file is no FMU that can be run.
    """
    try:
        fmu = load_fmu(path)
    except FmuError as error:
        first, _, rest = str(error).partition("\n")
        raise ConfigError([Problem("", first, " ".join(rest.split()))]) from error
    description = fmu.description
    times = times_of([description])
    run = {"master": "gauss-seidel"} | written(times)
    name = instance_name(description.name or path.stem, ())
    data = {"title": description.name or path.stem, "run": run, "instances": {name: {"fmu": path.name}}}
    kind = "model exchange" if description.interface is Interface.MODEL_EXCHANGE else "co-simulation"
    notes = [f"{path.name}: FMI {description.fmi_version}, {kind}", *times.notes]
    return Loaded(data, None, notes, {})


def written(times: Times) -> dict[str, str]:
    """Times as a config has them."""
    keys = {"step_size": times.step, "stop_time": times.stop}
    if times.start:
        keys["start_time"] = times.start
    return {key: _seconds(value) for key, value in keys.items()}


def times_of(descriptions: Iterable[ModelDescription]) -> Times:
    """The times of a run of FMUs: the shortest step size and the latest stop time that they propose."""
    known = list(descriptions)
    starts = [_exact(one.default_start) for one in known if one.default_start is not None]
    stops = [_exact(one.default_stop) for one in known if one.default_stop is not None]
    steps = [_exact(one) for of in known if (one := of.own_step or of.default_step) and one > 0.0]
    start = min(starts, default=Fraction(0))
    stop = max(stops, default=start)
    notes = []
    if stop > start:
        notes.append(f"default experiment: stop time {_seconds(stop)}")
    else:
        stop = start + _STOP
        notes.append(f"no default experiment names a stop time: {_seconds(stop)}, unless another is given")
    if steps:
        step = min(steps)
        notes.append(f"default experiment: step size {_seconds(step)}")
    else:
        step = _round_below((stop - start) / _STEPS)
        notes.append(f"no default experiment names a step size: {_seconds(step)}, unless another is given")
    count = ceil((stop - start) / step)
    if start + count * step != stop:
        stop = start + count * step
        notes.append(f"the stop time is moved to {_seconds(stop)}, a whole number of steps after the start")
    return Times(start, stop, step, tuple(notes))


def instance_name(text: str, taken: Iterable[str]) -> str:
    """A name that a config takes for an instance, like `text`, and none of `taken`."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", text.rpartition(".")[2] or text).strip("_") or "fmu"
    name = name if re.match(r"[A-Za-z_]", name) else f"_{name}"
    used, number, found = {one.casefold() for one in taken}, 2, name
    while found.casefold() in used:
        found, number = f"{name}{number}", number + 1
    return found


def _exact(value: float) -> Fraction:
    """A time as it is written."""
    return Fraction(repr(value))


def _round_below(value: Fraction) -> Fraction:
    """The largest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = Fraction(10) ** floor(log10(value))
    while power > value:
        power /= 10
    return max(one * power for one in (1, 2, 5) if one * power <= value)


def _seconds(value: Fraction) -> str:
    exact = Decimal(value.numerator) / Decimal(value.denominator)
    text = format(exact.normalize(), "f") if Fraction(exact) == value else repr(float(value))
    return f"{text} s"
