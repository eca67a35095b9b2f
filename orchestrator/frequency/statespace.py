"""State spaces of FMUs by their own directional derivatives."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arrays import Array, Complex
from ..fmi import Causality, Fmu, FmuInstance, Kind
from ..system.connection import Port


@dataclass(frozen=True)
class StateSpace:
    """x' = A x + B u, y = C x + D u around an operating point, in the FMUs' units.

    Attributes:
        a, b, c, d: shapes (n, n), (n, m), (p, n), (p, m).
        states, inputs, outputs: names.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def response(self, source: str, target: str, omega: ArrayLike) -> Complex:
        """From an input to an output at omega, shape (n,) [rad/s]."""
        column, row = self.inputs.index(source), self.outputs.index(target)
        s = 1j * np.atleast_1d(np.asarray(omega, np.float64))
        eye = np.eye(len(self.a))
        inner = np.linalg.solve(s[:, None, None] * eye - self.a, self.b[:, column, None])[..., 0]
        return inner @ self.c[row] + self.d[row, column]

    def named(self, instance: str) -> StateSpace:
        """The same with the names of an instance's variables in a system."""
        states, inputs, outputs = (
            tuple(str(Port(instance, one)) for one in names)
            for names in (self.states, self.inputs, self.outputs)
        )
        return StateSpace(self.a, self.b, self.c, self.d, states, inputs, outputs)

    def of_states(self, kept: Sequence[int]) -> StateSpace:
        """The same without the other states."""
        names = tuple(self.states[index] for index in kept)
        a, b, c = self.a[np.ix_(kept, kept)], self.b[kept], self.c[:, kept]
        return replace(self, a=a, b=b, c=c, states=names)

    def control(self) -> Any:
        """As python-control's StateSpace."""
        import control

        names = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        return control.ss(self.a, self.b, self.c, self.d, **{key: list(one) for key, one in names.items()})


@dataclass(frozen=True)
class LateInput:
    """A measured path from an input through a delay to states and outputs.

    Attributes:
        delay: [s].
        gains: what the input's delayed value adds to each state's derivative, shape (n,).
        through: what it adds to each output, shape (p,).
    """

    delay: float
    gains: Array
    through: Array


@dataclass(frozen=True)
class Law:
    """Linear equations of an instance whose FMU does not give them, such as of a sampled controller.

    Attributes:
        space: in the limit of short samples, with the names of the FMU's variables.
        hold: by how much later its inputs act there, as half a sample period [s].
        sampled: at samples x+ = A x + B u, y = C x + D u, held between them; None: `space` holds in steps,
            too.
        period: of the samples [s].
        notes: what the equations leave out, one sentence each.
        begins, ends: whether a sample at a communication point takes the inputs that are set there, for the
            step that begins, and those of the step that ends there; where both hold, the second sample takes
            the place of the first.
        late: paths from an input that act there after delays, by its name; its column in `space` is empty.
    """

    space: StateSpace
    hold: float = 0.0
    sampled: StateSpace | None = None
    period: float = 0.0
    notes: tuple[str, ...] = ()
    begins: bool = False
    ends: bool = True
    late: Mapping[str, tuple[LateInput, ...]] = field(default_factory=dict)


def _real(fmu: Fmu, causality: Causality) -> tuple[str, ...]:
    return tuple(
        name
        for name, one in fmu.description.variables.items()
        if one.causality is causality and one.kind is Kind.REAL
    )


def real_ports(fmu: Fmu) -> list[tuple[str, bool]]:
    """Real inputs and outputs by name, and whether it is an output."""
    return [(name, False) for name in _real(fmu, Causality.INPUT)] + [
        (name, True) for name in _real(fmu, Causality.OUTPUT)
    ]


def state_names(fmu: Fmu) -> list[tuple[str, str]]:
    """Derivatives of the continuous states, and the states."""
    path = str(fmu.path)
    return list(_state_names(path, os.stat(path).st_mtime_ns))


@lru_cache
def _state_names(path: str, changed: int) -> tuple[tuple[str, str], ...]:
    from fmpy import read_model_description

    raw = read_model_description(path, validate=False)
    found = [(one.variable, one.variable.derivative) for one in raw.derivatives]
    return tuple((rate.name, state.name) for rate, state in found if state is not None)


def linearised(
    fmu: Fmu, instance: FmuInstance, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> StateSpace:
    """The state space of a running FMU by its directional derivatives, where it stands."""
    pairs = state_names(fmu)
    rates, states = [rate for rate, _ in pairs], tuple(state for _, state in pairs)
    n = len(states)
    # A state that is an output, too, is asked for as the state it is.
    whole = np.zeros((n + len(outputs), n + len(inputs)))
    asked = [*rates, *(name for name in outputs if name not in states)]
    rows = [*range(n), *(n + index for index, name in enumerate(outputs) if name not in states)]
    if asked and (states or inputs):
        whole[rows] = instance.output_derivatives(asked, [*states, *inputs])
    for index, name in enumerate(outputs):
        if name in states:
            whole[n + index, states.index(name)] = 1.0
    return StateSpace(whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:], states, inputs, outputs)


def without_idle_integrators(
    part: StateSpace, read: Collection[str]
) -> tuple[StateSpace, list[str], list[int]]:
    """A state space without states that only count and that nothing shows, such as a clock.

    Args: read: outputs that matter.
    Returns: it, the names of the states that are left out, and the places of the others.
    """
    n = len(part.states)
    shown = np.any(part.c[[name in read for name in part.outputs]], axis=0)
    while True:
        # What a shown state's derivative depends on is shown, too.
        more = shown | np.any(part.a[shown], axis=0)
        if (more == shown).all():
            break
        shown = more
    kept = list(range(n))
    while True:
        idle = [k for k in kept if not shown[k] and not np.any(part.a[k][[j for j in kept if not shown[j]]])]
        if not idle:
            break
        kept = [k for k in kept if k not in idle]
    return part.of_states(kept), [part.states[k] for k in range(n) if k not in kept], kept


@cache
def differentiation(order: int) -> Array:
    """d/dtheta at Chebyshev points from 0 to -1, for a line of unit length; shape (order + 1,) squared."""
    nodes = 0.5 * (np.cos(np.pi * np.arange(order + 1) / order) - 1.0)
    weights = np.ones(order + 1)
    weights[[0, -1]] = 0.5
    weights[1::2] *= -1.0
    gaps = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(gaps, 1.0)
    made = weights[None, :] / weights[:, None] / gaps
    np.fill_diagonal(made, 0.0)
    np.fill_diagonal(made, -made.sum(axis=1))
    made.setflags(write=False)
    return made
