"""Instances and connections -> one closed system with delays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from ..base.errors import Problem, listed
from ..system.connection import Connection
from .connections import effect_note, effect_path, known_effects
from .delay_equation import Link
from .delay_system import FILTER, DelaySystem
from .inner_delays import InnerDelay
from .statespace import LateInput, StateSpace

__all__ = ["Chain", "chains_of", "closed_system", "sources"]


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
