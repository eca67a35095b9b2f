"""What a client is asked to run: FMUs, start values, connections, a step size; and what we make of it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.fmi import Kind
from orchestrator.fmi.variable import Value
from orchestrator.results.recorders import Results
from orchestrator.simulation.run import prepare, run

__all__ = ["Job", "Part", "deviation", "job_of"]


@dataclass(frozen=True)
class Part:
    """An instance: `start` by variable, in the units of its FMU, where it is not the FMU's own."""

    name: str
    path: str
    start: dict[str, Value]


@dataclass(frozen=True)
class Job:
    """A system for a master that exchanges signals once a step.

    Attributes:
        name: what it is.
        parts: the instances, in the order in which our Gauss-Seidel steps them.
        links: source and target as "instance.variable".
        step_size: [s]; steps: how many.
        watched: outputs to compare, as "instance.variable".
        package: the same system as an SSP, for tools that read one.
        bench: an FMU with inputs u[1] to u[64] that do nothing.
        initial: what connected inputs get in the first step, for masters that do not carry outputs to them
            before it.
        driven: values of the outputs that feed the inputs, shape (steps + 1,) each.
    """

    name: str
    parts: tuple[Part, ...]
    links: tuple[tuple[str, str], ...]
    step_size: float
    steps: int
    watched: tuple[str, ...]
    package: str = ""
    bench: str = ""
    initial: dict[str, float] = field(default_factory=dict)
    driven: dict[str, list[float]] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    @classmethod
    def of(cls, data: dict[str, Any]) -> Job:
        """The inverse of `plain`."""
        parts = tuple(Part(**part) for part in data["parts"])
        links = tuple((source, target) for source, target in data["links"])
        return cls(**{**data, "parts": parts, "links": links, "watched": tuple(data["watched"])})


def job_of(
    name: str,
    config: str | Path | Mapping[str, Any],
    overrides: Iterable[str] = (),
    *,
    master: str = "jacobi",
    watched: str = "",
    package: Path | None = None,
    bench: Path | None = None,
) -> tuple[Job, Results]:
    """A job of a config without effects, and our results.

    Args:
        watched: the instance whose outputs are compared; empty: all.
        package: the same config as an SSP, of which only outputs that feed something are compared.
        bench: see `Job`.
    """
    prepared = prepare(config, [*overrides, f"run.master={master}", "run.loop=python"])
    results = run(prepared, halving=False, figures=False).results
    links = [(str(one.source), str(one.target)) for one in prepared.system.connections]
    ports = [
        f"{one.name}.{variable.name}"
        for one in prepared.system.instances
        if watched in ("", one.name)
        for variable in one.fmu.description.outputs
        if variable.kind is Kind.REAL
    ]
    if package:
        ports = [port for port in ports if any(port == source for source, _ in links)]
    return Job(
        name=name,
        parts=tuple(
            Part(
                one.name,
                str(one.fmu.path),
                {key: value for key, value in one.start.items() if value != one.variable(key).start},
            )
            for one in map(prepared.system.instances.__getitem__, prepared.system.order)
        ),
        links=tuple(links),
        step_size=float(prepared.grid.step_size),
        steps=len(results) - 1,
        watched=tuple(ports),
        package=str(package or ""),
        bench=str(bench or ""),
        initial={target: float(results[source][0]) for source, target in links},
        driven={source: results[source].tolist() for source, _ in links},
    ), results


def deviation(job: Job, values: dict[str, list[float]], results: Results) -> tuple[float, str]:
    """The largest deviation, relative to the largest value of the signal, and of which.

    Infinite where one is missing.
    """
    worst = (0.0, "")
    for name in job.watched:
        ours = np.asarray(results[name][1:], float)
        theirs = np.asarray(values.get(name, ()), float)
        if theirs.shape != ours.shape or not np.isfinite(theirs).all():
            return math.inf, name
        size = float(np.abs(results[name]).max())
        found = float(np.abs(theirs - ours).max()) / max(size, 1e-5)
        worst = (found, name) if found > worst[0] else worst
    return worst
