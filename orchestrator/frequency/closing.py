"""Instances and connections -> one closed system with delays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from ..base.arrays import Array
from ..base.errors import Problem, listed
from ..system.connection import Connection
from .connections import effect_note, effect_path, known_effects
from .delay_equation import Link
from .delay_system import FILTER, DelaySystem
from .inner_delays import InnerDelay
from .statespace import LateInput, StateSpace


def sources(connection: Connection) -> list[Any]:
    """The ports that a connection reads."""
    return [connection.source] if connection.wire is None else [leg.port for leg in connection.wire.legs]


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


def closed_system(
    own: Mapping[str, StateSpace],
    chains: list[Chain],
    hidden: Mapping[str, tuple[LateInput, ...]],
    inner: Mapping[str, tuple[InnerDelay, ...]],
) -> DelaySystem:
    """One system of all instances, filters of connections and delays.

    Args:
        own: state spaces by instance; chains: what feeds their inputs.
        hidden: paths from an input that act after delays, by "instance.input".
        inner: delays between states, by instance.
    """
    parts = [part.named(name) for name, part in own.items()]
    filters = [
        _filter(f"{one.target}{FILTER}" + (f"[{place}]" if place else ""), index, lag)
        for index, one in enumerate(chains)
        for place, lag in enumerate(one.lags)
    ]
    blocks, links = _Blocks([*parts, *filters]), []
    # A delayed path into an FMU is an input of its own.
    behind = {
        name: [blocks.fed(f"{name} delayed", part, path.gains, path.through) for path in hidden[name]]
        for part in parts
        for name in part.inputs
        if name in hidden
    }
    for part, (name, _) in zip(parts, own.items(), strict=True):
        for number, delayed in enumerate(inner.get(name, ()), 1):
            # What is delayed is an output, and what comes back an input of the instance.
            port = f"{name}.delay[{number}]"
            target = blocks.fed(port, part, delayed.gains, delayed.through)
            source = blocks.seen(port, part, delayed.seen)
            links.append(Link(f"{port}{FILTER}", source, target, 1.0, delayed.delay))
    for name, places in behind.items():
        if len(places) > 1:
            # The input passes its value on to several paths.
            source = blocks.passed(name)
            links += [
                Link(f"{name}{FILTER}", source, place, 1.0, path.delay)
                for place, path in zip(places, hidden[name], strict=True)
            ]
    for index, one in enumerate(chains):
        if one.source not in blocks.outputs:
            continue  # a parameter-like output that nothing drives
        source, gain = blocks.outputs.index(one.source), one.gain
        for place, _ in enumerate(one.lags):
            name = f"{one.target}{FILTER}" + (f"[{place}]" if place else "") + f"@{index}"
            links.append(Link(f"{one.connection}{FILTER}", source, blocks.inputs.index(name), 1.0))
            source = blocks.outputs.index(name)
        if len(behind.get(one.target, ())) == 1:
            (path,) = hidden[one.target]
            links.append(Link(one.connection, source, behind[one.target][0], gain, one.delay + path.delay))
        else:
            links.append(Link(one.connection, source, blocks.inputs.index(one.target), gain, one.delay))
    return blocks.closed(links)


def _filter(name: str, index: int, lag: float) -> StateSpace:
    """A low-pass filter of a connection, its place among them `index`, as a block of its own."""
    rate, port = np.array([[1.0 / lag]]), (f"{name}@{index}",)
    return StateSpace(-rate, rate, np.eye(1), np.zeros((1, 1)), (name,), port, port)


class _Blocks:
    """State spaces side by side, with further inputs and outputs."""

    def __init__(self, parts: Sequence[StateSpace]) -> None:
        self.states = [name for one in parts for name in one.states]
        self.inputs = [name for one in parts for name in one.inputs]
        self.outputs = [name for one in parts for name in one.outputs]
        # Of no blocks block_diag makes one column.
        self.a, self.b, self.c, self.d = (
            scipy.linalg.block_diag(*(getattr(one, name) for one in parts)) if parts else np.zeros((0, 0))
            for name in "abcd"
        )
        self._state = {name: place for place, name in enumerate(self.states)}
        self._input = {name: place for place, name in enumerate(self.inputs)}
        self._output = {name: place for place, name in enumerate(self.outputs)}

    def fed(self, name: str, part: StateSpace, gains: Array, through: Array) -> int:
        """Add an input that acts on the states and outputs of a part. Returns: its place."""
        self.b, self.d = (np.pad(one, ((0, 0), (0, 1))) for one in (self.b, self.d))
        self.b[[self._state[one] for one in part.states], -1] = gains
        self.d[[self._output[one] for one in part.outputs], -1] = through
        self.inputs.append(name)
        return len(self.inputs) - 1

    def seen(self, name: str, part: StateSpace, shares: Array) -> int:
        """Add an output that shows states and inputs of a part. Returns: its place."""
        self.c, self.d = (np.pad(one, ((0, 1), (0, 0))) for one in (self.c, self.d))
        n = len(part.states)
        self.c[-1, [self._state[one] for one in part.states]] = shares[:n]
        self.d[-1, [self._input[one] for one in part.inputs]] = shares[n:]
        self.outputs.append(name)
        return len(self.outputs) - 1

    def passed(self, name: str) -> int:
        """Add an output that shows an input. Returns: its place."""
        self.c, self.d = (np.pad(one, ((0, 1), (0, 0))) for one in (self.c, self.d))
        self.d[-1, self._input[name]] = 1.0
        self.outputs.append(f"{name} passed")
        return len(self.outputs) - 1

    def closed(self, links: Sequence[Link]) -> DelaySystem:
        """The system with links from outputs to inputs."""
        states, inputs, outputs = map(tuple, (self.states, self.inputs, self.outputs))
        return DelaySystem(self.a, self.b, self.c, self.d, states, inputs, outputs, tuple(links))
