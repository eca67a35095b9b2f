"""A configured system -> the linear system with delays that it is around its start.

Each FMU by its directional derivatives. An input that acts on nothing at once stands behind a delay within
the FMU: the delay is measured, by two runs of the FMU that differ in a step of the input. Delays of
connections are exact, low-pass filters become states, sample and hold counts as a delay of half its period,
and effects that are not linear count as one and are named.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ..base.errors import ConfigError, OrchestratorError, Problem, listed
from ..fmi import FmuInstance, Point, StepStatus
from ..master.running_instances import Instances, instantiate
from ..simulation.run import Prepared, prepare
from ..system.connection import Connection
from ..system.signal_vector import Signals
from ..system.system import Instance
from .connections import effect_note, effect_path, known_effects
from .delay_system import FILTER, DelaySystem, Link, Modes
from .margins import Margins
from .statespace import StateSpace, linearised, real_ports

__all__ = ["Chain", "LateInput", "Linearised", "chains_of", "linearise", "refusal"]

Array = NDArray[np.float64]

_MOST_STEPS = 5_000
# Samples after the first answer that the delay and the gains are fitted to.
_SAMPLES = 24
# Of the fit, relative to the answer: a delay is one only if nothing else remains.
_LEFT = 2e-3


@dataclass(frozen=True)
class LateInput:
    """A measured path from an input through a delay to the states.

    Attributes:
        delay: [s].
        gains: what the input's delayed value adds to each state's derivative, shape (n,).
    """

    delay: float
    gains: Array


@dataclass(frozen=True, repr=False)
class Linearised:
    """A linear system with delays, and what it was made of.

    Attributes:
        system: the closed system.
        point: values of states and connected inputs that it is linear around, by name, in the FMUs' units.
        notes: what was measured, assumed or left out, one sentence each.
        parts: the state space of each instance, by its name.
        late: inputs that act after a delay within their FMU, as "robot.command".
    """

    system: DelaySystem
    point: Mapping[str, float]
    notes: tuple[str, ...]
    parts: Mapping[str, StateSpace]
    late: Mapping[str, LateInput]

    def modes(self, count: int = 6) -> Modes:
        """The rightmost modes; see `DelaySystem.modes`."""
        return self.system.modes(count)

    def margins(self, modes: Modes | None = None, names: Sequence[str] = ()) -> dict[str, Margins]:
        """Margins of connections, the weakest first; see `DelaySystem.margins`.

        Args:
            modes: what `modes` gave; found here if they are not given.
            names: of connections; all within feedback loops if none is named.
        """
        modes = modes or self.modes()
        found = {name: self.system.margins(name, modes) for name in names or self.system.loops()}
        return dict(sorted(found.items(), key=lambda item: item[1].modulus_margin))

    def __repr__(self) -> str:
        modes = self.modes().modes
        shown = ", ".join(f"{one.frequency:.4g} Hz (damping {one.damping:.3g})" for one in modes[:3])
        return f"{len(self.system.states)} states, {len(self.system.links)} links; modes at {shown or 'none'}"


def linearise(
    config: str | Path | Mapping[str, Any] | Prepared,
    overrides: Iterable[str] = (),
    *,
    at_time: float | None = None,
) -> Linearised:
    """The linear system with delays of a configured system, without communication steps.

    Args:
        config, overrides: as `orchestrator.simulation.run.prepare`.
        at_time: the point of a run that it is linear around [s]; None: its start.
    Raises: ConfigError with all FMUs that offer no directional derivatives or whose input acts on their
        states in no way that is known here, and all effects without a transfer function.
    """
    prepared = config if isinstance(config, Prepared) else prepare(config, overrides)
    system = prepared.system
    problems: list[Problem] = []
    notes: list[str] = []
    parts: dict[str, StateSpace] = {}
    hidden: dict[str, LateInput] = {}
    point: dict[str, float] = {}
    fed = {str(connection.target) for connection in system.connections}
    with instantiate(system) as instances:
        signals = instances.initialise(float(prepared.grid.start), float(prepared.grid.stop))
        if at_time is not None:
            notes.append(
                f"linear around t = {_advanced(instances, prepared, signals, at_time):.9g} s of the run"
            )
        for one, running in zip(system.instances, instances.running, strict=True):
            if (refused := refusal(one)) is not None:
                problems.append(refused)
                continue
            inputs = tuple(name for name, _ in real_ports(one.fmu) if f"{one.name}.{name}" in fed)
            outputs = tuple(name for name, is_output in real_ports(one.fmu) if is_output)
            part = linearised(one.fmu, running, inputs, outputs)
            values = running.get_values([*part.states, *inputs])
            point |= {f"{one.name}.{name}": float(value) for name, value in values.items()}
            for index, name in enumerate(inputs):
                if part.b[:, index].any() or part.d[:, index].any():
                    continue
                found = _measured(one, part, name, values, prepared)
                if found == "idle":
                    notes.append(f"{one.name}.{name} acts on nothing at the start; it is left open")
                    continue
                if found is None:
                    problems.append(
                        Problem(
                            one.name,
                            f"input {name} acts on no state's derivative and no output at once",
                            "no pure delay was measured between them: a sample, hidden states or an inactive "
                            "part of the model",
                            "Measure the loop with orchestrator.frequency.sweep_system.",
                        )
                    )
                    continue
                hidden[f"{one.name}.{name}"] = found
                notes.append(
                    f"{one.name}.{name} acts after a delay of {found.delay:.9g} s within the FMU (measured)"
                )
            parts[one.name] = part
    chains, wrong = chains_of(system.connections, notes)
    if problems or wrong:
        raise ConfigError([*problems, *wrong])
    closed = _closed([part.named(name) for name, part in parts.items()], chains, hidden)
    return Linearised(closed, point, tuple(dict.fromkeys(notes)), parts, hidden)


def refusal(one: Instance) -> Problem | None:
    """Why an instance cannot be linearised by its directional derivatives."""
    if one.fmu.description.capabilities.directional_derivatives and one.fmu.path is not None:
        return None
    return Problem(
        one.name,
        "it offers no directional derivatives",
        "they give its linear equations",
        "Export it with providesDirectionalDerivative, or measure the loop with "
        "orchestrator.frequency.sweep_system.",
    )


def _advanced(instances: Instances, prepared: Prepared, signals: Signals, at_time: float) -> float:
    """Step the system to a time. Returns: the time that is reached [s].

    Raises: ConfigError if it lies outside the run; StepError if a step fails.
    """
    grid = prepared.grid
    if not float(grid.start) <= at_time <= float(grid.stop):
        allowed = f"between {float(grid.start):g} s and {float(grid.stop):g} s, the start and stop of the run"
        raise ConfigError([Problem("--at-time", f"{at_time:g} s lies outside the run", allowed)])
    for point in grid:
        if point.last or point.time >= at_time - 1e-9 * point.step_size:
            break
        signals, info = prepared.master.step(instances.system, instances, point, signals)
        info.raise_on_failure(point)
    return float(point.time)


@dataclass(frozen=True)
class Chain:
    """One source of a connection, with what happens on the way."""

    connection: str
    source: str
    target: str
    gain: float
    delay: float
    lags: tuple[float, ...]


def chains_of(connections: Iterable[Connection], notes: list[str]) -> tuple[list[Chain], list[Problem]]:
    """Gain, delay and lags from each source to each input; adds to `notes` what is left out."""
    chains, problems = [], []
    for connection in connections:
        name = str(connection)
        wire = connection.wire
        legs = (
            [(connection.source, 1.0, ())]
            if wire is None
            else [(leg.port, leg.gain, leg.links) for leg in wire.legs]
        )
        for port, gain, own in legs:
            total, delay, lags = gain * connection.gain, 0.0, []
            for link in (*own, *(wire.links if wire is not None else ())):
                path = effect_path(link.effect)
                if path is None or len(path.terms) > 1:
                    what = f"the effect {link.name} has no transfer function that is known here"
                    allowed = f"effects with one: {listed(known_effects())}"
                    problems.append(Problem(name, what, allowed, "Leave it out, or measure the loop."))
                    continue
                if note := effect_note(link.effect):
                    notes.append(f"{name}: {link.name} {note}")
                for term in path.terms:
                    total *= float(np.ravel(term.numerator)[0])
                    delay += float(np.max(term.delay))
                    lags += [float(np.ravel(factor)[1]) for factor in term.factors]
                if not path.terms:
                    total = 0.0
            chains.append(Chain(name, str(port), str(connection.target), total, delay, tuple(lags)))
    return chains, problems


def _closed(parts: list[StateSpace], chains: list[Chain], hidden: Mapping[str, LateInput]) -> DelaySystem:
    lags = [(index, place, lag) for index, one in enumerate(chains) for place, lag in enumerate(one.lags)]
    blocks = [(one.a, one.b, one.c, one.d) for one in parts]
    states = [name for one in parts for name in one.states]
    inputs = [name for one in parts for name in one.inputs]
    outputs = [name for one in parts for name in one.outputs]
    for index, place, lag in lags:
        rate = np.array([[1.0 / lag]])
        blocks.append((-rate, rate, np.eye(1), np.zeros((1, 1))))
        name = f"{chains[index].target}{FILTER}" + (f"[{place}]" if place else "")
        states.append(name)
        inputs.append(f"{name}@{index}")
        outputs.append(f"{name}@{index}")
    a, b, c, d = (scipy.linalg.block_diag(*(one[n] for one in blocks)) for n in range(4))
    if not blocks:
        a = b = c = d = np.zeros((0, 0))
    first = 0
    # A delayed path into an FMU is an input of its own.
    behind: dict[str, int] = {}
    for part in parts:
        for name in part.inputs:
            if name in hidden:
                column = np.zeros((len(a), 1))
                column[first : first + len(part.states), 0] = hidden[name].gains
                behind[name] = b.shape[1]
                b = np.hstack([b, column])
                d = np.hstack([d, np.zeros((len(d), 1))])
                inputs.append(f"{name} delayed")
        first += len(part.states)
    links = []
    for index, one in enumerate(chains):
        if one.source not in outputs:
            continue  # a parameter-like output that nothing drives
        source, gain = outputs.index(one.source), one.gain
        for place, _ in enumerate(one.lags):
            name = f"{one.target}{FILTER}" + (f"[{place}]" if place else "") + f"@{index}"
            links.append(Link(f"{one.connection}{FILTER}", source, inputs.index(name), 1.0))
            source = outputs.index(name)
        if one.target in hidden:
            links.append(
                Link(one.connection, source, behind[one.target], gain, one.delay + hidden[one.target].delay)
            )
        else:
            links.append(Link(one.connection, source, inputs.index(one.target), gain, one.delay))
    return DelaySystem(a, b, c, d, tuple(states), tuple(inputs), tuple(outputs), tuple(links))


def _measured(
    one: Instance, part: StateSpace, name: str, values: Mapping[str, Any], prepared: Prepared
) -> LateInput | Literal["idle"] | None:
    """The delay between an input and the states, from two runs that differ in a step of it.

    Returns: "idle" if nothing answers, None if what answers is no pure delay before the states.
    """
    step = float(prepared.grid.step_size)
    variable = one.variable(name)
    height = 1e-3 * (abs(float(values[name])) or float(variable.nominal or 1.0))
    try:
        answer = _answer(one, part, name, values, height, prepared)
    except OrchestratorError:  # it refuses to run on its own
        return None
    length = len(answer)
    size = np.max(abs(answer), axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    moved = np.flatnonzero(np.max(abs(answer) / scale, axis=1) > 1e-9)
    if not moved.size:
        return "idle"
    states = len(part.states)
    if not size[:states].any():
        return None
    answer, scale = answer[:, :states], scale[:states]
    moved = np.flatnonzero(np.max(abs(answer) / scale, axis=1) > 1e-9)
    onset = int(moved[0])
    rows = np.arange(onset, min(onset + _SAMPLES, length))
    if len(rows) < 4:
        return None
    wanted = answer[rows] / scale

    def fitted(delay: float) -> tuple[float, Array]:
        since = step * rows - delay
        design = np.concatenate([_integral(part.a, max(t, 0.0)) / scale[:, None] for t in since])
        gains, *_ = np.linalg.lstsq(design, wanted.ravel(), rcond=None)
        return float(np.linalg.norm(design @ gains - wanted.ravel())), gains

    low, high = step * max(onset - 1, 0), step * onset
    best = minimize_scalar(
        lambda delay: fitted(delay)[0], bounds=(low, high), method="bounded", options={"xatol": 1e-12}
    )
    delays = [float(best.x), low, high]
    misfits = [fitted(delay)[0] for delay in delays]
    delay = delays[int(np.argmin(misfits))]
    misfit, gains = fitted(delay)
    return LateInput(delay, gains) if misfit <= _LEFT * np.linalg.norm(wanted) else None


def _integral(a: Array, time: float) -> Array:
    """Integral of exp(A t) from 0 to `time`, shape of A."""
    n = len(a)
    whole = np.zeros((2 * n, 2 * n))
    whole[:n, :n], whole[:n, n:] = a, np.eye(n)
    return scipy.linalg.expm(whole * time)[:n, n:]


def _answer(
    one: Instance, part: StateSpace, name: str, values: Mapping[str, Any], height: float, prepared: Prepared
) -> Array:
    """By how much states and outputs of two runs differ after each step, shape (steps + 1, n), relative to
    the height by which an input differs from the first step on.
    """
    begin, step = float(prepared.grid.start), float(prepared.grid.step_size)
    start = {**one.start, **{key: values[key] for key in part.inputs}}
    watched = [*part.states, *(key for key in part.outputs if key not in part.states)]
    inputs = [np.array([float(values[name])]) for _ in range(2)]
    instances: list[FmuInstance] = []
    try:
        for u in inputs:
            instance = one.fmu.instantiate(f"{one.name} linearised")
            instances.append(instance)
            instance.bind([name], u, [], np.zeros(0))
            # On its own it may run longer than the system.
            instance.enter_initialisation(begin, start, begin + (_MOST_STEPS + 1) * step)
            instance.exit_initialisation()

        def difference() -> Array:
            still, changed = (
                np.array([float(value) for value in instance.get_values(watched).values()])
                for instance in instances
            )
            return (changed - still) / height

        inputs[1] += height
        answer, moved = [difference()], 0
        for index in range(_MOST_STEPS):
            status = StepStatus.OK
            for instance in instances:
                instance.write_inputs()
                status = max(status, instance.do_step(Point(index, begin + index * step, step)))
            if status > StepStatus.WARNING:
                break
            answer.append(difference())
            moved += bool(np.max(abs(answer[-1]), initial=0.0) > 0.0)
            if moved > 4 * _SAMPLES:
                break
    finally:
        for instance in instances:
            instance.free()
    return np.array(answer)
