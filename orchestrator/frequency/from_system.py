"""A configured system -> the linear system with delays that it is around its start.

Each FMU by its directional derivatives, or without them by its measured step responses. An input that acts
on nothing at once stands behind a delay within the FMU: the delay is measured, by two runs of the FMU that
differ in a step of the input. Delays of connections are exact, low-pass filters become states, sample and
hold counts as a delay of half its period, and effects that are not linear count as one and are named. What
the config's measures know beyond that, a point and laws of instances, is asked of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ..base.errors import ConfigError, OrchestratorError, Problem, listed
from ..master.running_instances import Instances, instantiate
from ..results.measures import choose_measures
from ..simulation.run import Prepared, prepare
from ..system.connection import Connection
from ..system.external import ExternalFmu
from ..system.signal_vector import Signals
from ..system.system import Instance
from .connections import effect_note, effect_path, known_effects
from .delay_system import FILTER, DelaySystem, Link, Modes
from .inner_delays import InnerDelay, inner_delays
from .margins import Margins
from .measured_part import answer, measured_part, passage
from .measured_samples import sampled_law, sampling
from .statespace import LateInput, Law, StateSpace, linearised, real_ports

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Chain", "LateInput", "Law", "LinearPoint", "Linearised", "chains_of", "linearise", "refusal"]

Array = NDArray[np.float64]

_MOST_STEPS = 5_000
# Samples after the first answer that the delay and the gains are fitted to.
_SAMPLES = 24
# Of the fit, relative to the answer: a delay is one only if nothing else remains.
_LEFT = 2e-3


@dataclass(frozen=True)
class LinearPoint:
    """What a measure knows of a system that is to be linearised.

    Attributes:
        start: start values of its operating point by instance and variable, FMU's units.
        laws: by instance.
    """

    start: Mapping[str, Mapping[str, Any]]
    laws: Mapping[str, Law]


@dataclass(frozen=True, repr=False)
class Linearised:
    """A linear system with delays, and what it was made of.

    Attributes:
        system: the closed system.
        point: values of states and connected inputs that it is linear around, by name, in the FMUs' units.
        notes: what was measured, assumed or left out, one sentence each.
        parts: the state space of each instance, by its name.
        late: inputs that act after a delay within their FMU, as "robot.command".
        inner: delays between states of instances, by their name.
        laws: of instances whose equations a measure of the config knows, or that sample.
        told: those whose law a measure of the config knows.
        start: start values of the operating point that a measure of the config chose, by instance and
            variable, FMU's units; None: the point is no start of a run.
    """

    system: DelaySystem
    point: Mapping[str, float]
    notes: tuple[str, ...]
    parts: Mapping[str, StateSpace]
    late: Mapping[str, LateInput]
    laws: Mapping[str, Law] = field(default_factory=dict)
    inner: Mapping[str, tuple[InnerDelay, ...]] = field(default_factory=dict)
    told: tuple[str, ...] = ()
    start: Mapping[str, Mapping[str, Any]] | None = field(default_factory=dict)

    @property
    def chosen(self) -> bool:
        """Whether a measure of the config chose the operating point."""
        return bool(self.start)

    def started(self, prepared: Prepared) -> Prepared:
        """The system with the start values of the operating point."""
        return _started(prepared, self.start or {})

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

    def bode(self, connection: str = "") -> Figure:
        """Bode diagram of the open loop at a connection; without one, at the weakest."""
        from . import figures

        return figures.bode(*self._opened(connection))

    def nyquist(self, connection: str = "") -> Figure:
        """Nyquist diagram of the open loop at a connection; without one, at the weakest."""
        from . import figures

        return figures.nyquist(*self._opened(connection))

    def nichols(self, connection: str = "") -> Figure:
        """Nichols diagram of the open loop at a connection; without one, at the weakest."""
        from . import figures

        return figures.nichols(*self._opened(connection))

    def _opened(self, connection: str) -> tuple[str, Array, NDArray[np.complex128]]:
        """Name of a connection, frequencies around its crossovers [rad/s], and its open loop there."""
        modes = self.modes()
        found = self.margins(modes, [connection] if connection else ())
        if not found:
            raise ConfigError([Problem("system", "no connection lies within a feedback loop")])
        name, one = next(iter(found.items()))
        sizes = [abs(mode.root) for mode in modes.modes if abs(mode.root) > 1e-9][:2]
        sizes += [each.omega for each in one.crossovers]
        omega = np.geomspace(0.05 * min(sizes or [1.0]), 20.0 * max(sizes or [1.0]), 1500)
        return name, omega, self.system.open_loop(name, omega)

    def __repr__(self) -> str:
        modes = self.modes().modes
        shown = ", ".join(f"{one.frequency:.4g} Hz (damping {one.damping:.3g})" for one in modes[:3])
        return f"{len(self.system.states)} states, {len(self.system.links)} links; modes at {shown or 'none'}"


def linearise(
    config: str | Path | Mapping[str, Any] | Prepared,
    overrides: Iterable[str] = (),
    *,
    at_time: float | None = None,
    point: LinearPoint | None = None,
) -> Linearised:
    """The linear system with delays of a configured system, without communication steps.

    Args:
        config, overrides: as `orchestrator.simulation.run.prepare`.
        at_time: the point of a run that it is linear around [s]; None: its start.
        point: start values and laws in place of those that the config's measures know.
    Raises: ConfigError with all FMUs that can neither be differentiated nor measured or whose input acts on
        their states in no way that is known here, and all effects without a transfer function.
    """
    prepared = config if isinstance(config, Prepared) else prepare(config, overrides)
    if outside := [
        Problem(one.name, "it is another program: nothing is known of what it does", "", "Leave it out.")
        for one in prepared.system.instances
        if isinstance(one.fmu, ExternalFmu)
    ]:
        raise ConfigError(outside)
    point = point or _known_point(prepared)
    if at_time is not None:
        return replace(_linearised(prepared, at_time, point.laws), start=None)
    made = _linearised(_started(prepared, point.start), None, point.laws)
    return replace(made, start=point.start)


def _known_point(prepared: Prepared) -> LinearPoint:
    """What the measures of a config know."""
    start: dict[str, Mapping[str, Any]] = {}
    laws: dict[str, Law] = {}
    for chosen in choose_measures(prepared.config):
        known = getattr(chosen.measure, "linear_point", None)
        if known is not None:
            one = known(prepared, chosen.options)
            start, laws = start | one.start, laws | one.laws
    return LinearPoint(start, laws)


def _started(prepared: Prepared, start: Mapping[str, Mapping[str, Any]]) -> Prepared:
    """The system with other start values."""
    instances = tuple(
        replace(one, start={**one.start, **start.get(one.name, {})}) for one in prepared.system.instances
    )
    return replace(prepared, system=replace(prepared.system, instances=instances))


def _linearised(prepared: Prepared, at_time: float | None, laws: Mapping[str, Law]) -> Linearised:
    system = prepared.system
    problems: list[Problem] = []
    notes: list[str] = []
    parts: dict[str, StateSpace] = {}
    known = dict(laws)
    hidden: dict[str, LateInput] = {}
    inner: dict[str, tuple[InnerDelay, ...]] = {}
    point: dict[str, float] = {}
    fed = {str(connection.target) for connection in system.connections}
    seen = {str(leg) for connection in system.connections for leg in _sources(connection)}
    with instantiate(system) as instances:
        signals = instances.initialise(float(prepared.grid.start), float(prepared.grid.stop))
        if at_time is not None:
            notes.append(
                f"linear around t = {_advanced(instances, prepared, signals, at_time):.9g} s of the run"
            )
        for one, running in zip(system.instances, instances.running, strict=True):
            inputs = tuple(name for name, _ in real_ports(one.fmu) if f"{one.name}.{name}" in fed)
            outputs = tuple(name for name, is_output in real_ports(one.fmu) if is_output)
            read = tuple(name for name in outputs if f"{one.name}.{name}" in seen)
            if one.name in laws:
                part = laws[one.name].space
                notes += [f"{one.name}: {note}" for note in laws[one.name].notes]
            elif refusal(one) is None:
                part = linearised(one.fmu, running, inputs, outputs)
            else:
                part = StateSpace(*(np.zeros((0, 0)) for _ in range(4)), (), (), ())
            names = [name for name in part.states if name in one.fmu.description.variables]
            values = running.get_values([*names, *inputs])
            point |= {f"{one.name}.{name}": float(value) for name, value in values.items()}
            parts[one.name] = part
            if one.name in known:
                continue
            why = "offers no directional derivatives" if refusal(one) is not None else ""
            if (
                not why
                and not part.states
                and inputs
                and any(not part.d[outputs.index(key)].any() for key in read)
            ):
                why = "names no states"
            if why:
                sampled = _by_samples(one, inputs, read, values, prepared)
                if isinstance(sampled, Law):
                    known[one.name] = sampled
                    parts[one.name] = sampled.space
                    notes += [f"{one.name}: {note}" for note in sampled.notes]
                    continue
                if sampled:
                    problems.append(Problem(one.name, f"it {why}, and {sampled}", "", _REMEDY))
                    continue
                found = _by_steps(one, inputs, read, values, prepared, why)
                if isinstance(found, str) and refusal(one) is not None:
                    problems.append(Problem(one.name, f"it {why}, and {found}", "", _REMEDY))
                    continue
                if not isinstance(found, str) and (refusal(one) is not None or found[0].states):
                    parts[one.name], late, more = found
                    hidden |= late
                    notes += more
                    continue
                if isinstance(found, str) and not all(_acts(part, name) for name in inputs):
                    problems.append(Problem(one.name, f"it {why}, and {found}", "", _MEASURE))
                    continue
            if refusal(one) is None:
                inner[one.name], unknown = inner_delays(one, part, values, prepared)
                notes += [_inner_note(one, part, each) for each in inner[one.name]]
                notes += [f"{one.name}: {unknown}"] if unknown else []
            for name in inputs:
                _behind(one, part, name, values, prepared, hidden, notes, problems)
    chains, wrong = chains_of(system.connections, notes)
    if problems or wrong:
        raise ConfigError([*problems, *wrong])
    chains = [
        replace(one, delay=one.delay + known[name].hold)
        if (name := one.target.partition(".")[0]) in known
        else one
        for one in chains
    ]
    paths = {name: (one,) for name, one in hidden.items()}
    for name, law in known.items():
        paths |= {f"{name}.{port}": late for port, late in law.late.items()}
    closed = _closed(parts, chains, paths, inner)
    return Linearised(
        closed, point, tuple(dict.fromkeys(notes)), parts, hidden, known, inner=inner, told=tuple(laws)
    )


def _by_samples(
    one: Instance,
    inputs: tuple[str, ...],
    read: tuple[str, ...],
    values: Mapping[str, Any],
    prepared: Prepared,
) -> Law | str:
    """The law of an instance that samples; why it is not known; empty if the instance does not sample."""
    if not inputs or not read:
        return ""
    values = {name: values[name] for name in inputs}
    when = sampling(one, inputs, read, values, prepared)
    if isinstance(when, str) or when is None:
        return when or ""
    found = sampled_law(one, inputs, read, values, prepared, when)
    if isinstance(found, str):
        return found
    law, error = found
    count = len(law.sampled.states) if law.sampled is not None else 0
    states = f"{count} state{'' if count == 1 else 's'}"
    text = (
        f"samples every {law.period:.6g} s; its response from sample to sample was measured: {states}, error "
        f"{100 * error:.2g} %; a held output counts as half a period late"
    )
    return replace(law, notes=(text,))


def _by_steps(
    one: Instance,
    inputs: tuple[str, ...],
    read: tuple[str, ...],
    values: Mapping[str, Any],
    prepared: Prepared,
    why: str,
) -> tuple[StateSpace, dict[str, LateInput], list[str]] | str:
    """The state space of an instance by its step responses, inputs behind a delay, and notes."""
    told = measured_part(one, inputs, read, {name: values[name] for name in inputs}, prepared)
    if isinstance(told, str):
        return told
    part, delays, error = told
    late = {}
    for name, delay in delays.items():
        column = inputs.index(name)
        late[f"{one.name}.{name}"] = LateInput(delay, part.b[:, column].copy(), part.d[:, column].copy())
        part.b[:, column], part.d[:, column] = 0.0, 0.0
    if not inputs:
        return part, late, [f"{one.name} {why} and has no connected input: its own motion is left out"]
    within = f", after delays of {listed(f'{delay:.6g} s' for delay in delays.values())}" if delays else ""
    count = f"{len(part.states)} state{'' if len(part.states) == 1 else 's'}"
    text = f"{one.name} {why}; its step response was measured: {count}{within}, error {100 * error:.2g} %"
    return part, late, [text] if read else []


def _inner_note(one: Instance, part: StateSpace, inner: InnerDelay) -> str:
    columns = np.array([*part.states, *part.inputs])[np.flatnonzero(inner.seen)]
    rows = np.array([*part.states, *part.outputs])[np.flatnonzero([*inner.gains, *inner.through])]
    return (
        f"{one.name}: {listed(map(str, columns))} acts on {listed(map(str, rows))} after a delay of "
        f"{inner.delay:.9g} s within the FMU (measured)"
    )


def _acts(part: StateSpace, name: str) -> bool:
    """Whether an input acts on a state's derivative or an output at once."""
    column = part.inputs.index(name)
    return bool(part.b[:, column].any() or part.d[:, column].any())


def _behind(
    one: Instance,
    part: StateSpace,
    name: str,
    values: Mapping[str, Any],
    prepared: Prepared,
    hidden: dict[str, LateInput],
    notes: list[str],
    problems: list[Problem],
) -> None:
    """An input that acts on nothing at once: the delay that it stands behind, or why there is none."""
    if _acts(part, name):
        return
    found = _measured(one, part, name, values, prepared)
    if found == "idle":
        notes.append(f"{one.name}.{name} acts on nothing at the start; it is left open")
    elif found is None:
        problems.append(
            Problem(
                one.name,
                f"input {name} acts on no state's derivative and no output at once",
                "no pure delay was measured between them: a sample, hidden states or an inactive part of the "
                "model",
                _MEASURE,
            )
        )
    else:
        hidden[f"{one.name}.{name}"] = found
        notes.append(f"{one.name}.{name} acts after a delay of {found.delay:.9g} s within the FMU (measured)")


def _sources(connection: Connection) -> list[Any]:
    return [connection.source] if connection.wire is None else [leg.port for leg in connection.wire.legs]


_MEASURE = "Measure the loop with orchestrator.frequency.sweep_system."
_REMEDY = (
    "Export it with providesDirectionalDerivative, or measure the loop with "
    "orchestrator.frequency.sweep_system."
)


def refusal(one: Instance) -> Problem | None:
    """Why an instance cannot be linearised by its directional derivatives."""
    if one.fmu.description.capabilities.directional_derivatives and one.fmu.path is not None:
        return None
    return Problem(
        one.name,
        "it offers no directional derivatives",
        "they give its linear equations",
        _REMEDY,
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
                if path is None:
                    what = f"the effect {link.name} has no transfer function that is known here"
                    allowed = f"effects with one: {listed(known_effects())}"
                    problems.append(Problem(name, what, allowed, "Leave it out, or measure the loop."))
                    continue
                if note := effect_note(link.effect):
                    notes.append(f"{name}: {link.name} {note}")
                total, delay = total * path.gain, delay + path.delay
                lags += [path.lag] if path.lag else []
            chains.append(Chain(name, str(port), str(connection.target), total, delay, tuple(lags)))
    return chains, problems


def _closed(
    own: Mapping[str, StateSpace],
    chains: list[Chain],
    hidden: Mapping[str, tuple[LateInput, ...]],
    inner: Mapping[str, tuple[InnerDelay, ...]],
) -> DelaySystem:
    parts = [part.named(name) for name, part in own.items()]
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
    first, row = 0, 0
    # A delayed path into an FMU is an input of its own.
    behind: dict[str, list[int]] = {}
    for part in parts:
        for name in part.inputs:
            for path in hidden.get(name, ()):
                column = np.zeros((len(a), 1))
                column[first : first + len(part.states), 0] = path.gains
                behind.setdefault(name, []).append(b.shape[1])
                b = np.hstack([b, column])
                through = np.zeros((len(d), 1))
                through[row : row + len(part.outputs), 0] = path.through
                d = np.hstack([d, through])
                inputs.append(f"{name} delayed")
        first, row = first + len(part.states), row + len(part.outputs)
    links = []
    first, entry, row = 0, 0, 0
    for name, part in own.items():
        n, m, p = len(part.states), len(part.inputs), len(part.outputs)
        for number, path in enumerate(inner.get(name, ()), 1):
            # What is delayed is an output, and what comes back an input of the instance.
            b, d, c = np.pad(b, ((0, 0), (0, 1))), np.pad(d, ((0, 1), (0, 1))), np.pad(c, ((0, 1), (0, 0)))
            b[first : first + n, -1], d[row : row + p, -1] = path.gains, path.through
            c[-1, first : first + n], d[-1, entry : entry + m] = path.seen[:n], path.seen[n:]
            inputs.append(f"{name}.delay[{number}]")
            outputs.append(f"{name}.delay[{number}]")
            links.append(Link(f"{inputs[-1]}{FILTER}", len(outputs) - 1, len(inputs) - 1, 1.0, path.delay))
        first, entry, row = first + n, entry + m, row + p
    for name, places in behind.items():
        if len(places) == 1:
            continue
        # Several paths part behind the input, which passes its value on to them.
        d = np.vstack([d, np.zeros((1, d.shape[1]))])
        c = np.vstack([c, np.zeros((1, c.shape[1]))])
        d[-1, inputs.index(name)] = 1.0
        outputs.append(f"{name} passed")
        links += [
            Link(f"{name}{FILTER}", len(outputs) - 1, place, 1.0, path.delay)
            for place, path in zip(places, hidden[name], strict=True)
        ]
    for index, one in enumerate(chains):
        if one.source not in outputs:
            continue  # a parameter-like output that nothing drives
        source, gain = outputs.index(one.source), one.gain
        for place, _ in enumerate(one.lags):
            name = f"{one.target}{FILTER}" + (f"[{place}]" if place else "") + f"@{index}"
            links.append(Link(f"{one.connection}{FILTER}", source, inputs.index(name), 1.0))
            source = outputs.index(name)
        if len(behind.get(one.target, ())) == 1:
            (path,) = hidden[one.target]
            links.append(Link(one.connection, source, behind[one.target][0], gain, one.delay + path.delay))
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
    watched = [*part.states, *(key for key in part.outputs if key not in part.states)]
    values = {key: values[key] for key in part.inputs}
    try:
        found = answer(one, name, values, watched, prepared, _MOST_STEPS, 4 * _SAMPLES)
    except OrchestratorError:  # it refuses to run on its own
        return None
    size = np.max(abs(found), axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    moved = np.flatnonzero(np.max(abs(found) / scale, axis=1) > 1e-9)
    if not moved.size:
        return "idle"
    states = len(part.states)
    onset = int(moved[0])
    rows = np.arange(onset, min(onset + _SAMPLES, len(found)))
    if len(rows) < 4:
        return None
    outputs = np.array([watched.index(key) for key in part.outputs], np.intp)
    through = np.zeros(len(part.outputs))
    if not size[:states].any():
        # Nothing but the delay lies between input and outputs: they jump when it is over.
        jump = found[rows[-1]]
        if np.max(abs(found[rows] - jump) / scale) > _LEFT:
            return None
        which = int(np.argmax(size))
        delay = passage(one, name, values, watched[which], prepared, step * max(onset - 1, 0))
        return LateInput(delay, np.zeros(states), jump[outputs])
    wanted = found[rows, :states] / scale[:states]
    transition, whole = scipy.linalg.expm(part.a * step), _integral(part.a, step)

    def fitted(delay: float) -> tuple[float, Array]:
        since = step * rows - delay
        parts = [_integral(part.a, max(since[0], 0.0)), _integral(part.a, max(since[1], 0.0))]
        while len(parts) < len(rows):
            parts.append(whole + transition @ parts[-1])
        design = np.concatenate([one / scale[:states, None] for one in parts])
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
    if misfit > _LEFT * np.linalg.norm(wanted):
        return None
    if states < len(watched):
        left = found[rows][:, outputs] - found[rows, :states] @ part.c.T
        through = left[-1] if np.max(abs(left[-1]) / scale[outputs]) > 1e-6 else through
    return LateInput(delay, gains, through)


def _integral(a: Array, time: float) -> Array:
    """Integral of exp(A t) from 0 to `time`, shape of A."""
    n = len(a)
    whole = np.zeros((2 * n, 2 * n))
    whole[:n, :n], whole[:n, n:] = a, np.eye(n)
    return scipy.linalg.expm(whole * time)[:n, n:]
