"""The steady state of a system: start values of states at which nothing changes, inputs as they are given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg

from ..base.arrays import Array
from ..base.errors import ConfigError, Problem, StepError, listed, nearest
from ..fmi import Variable
from ..master.running_instances import instantiate
from ..simulation.run import Prepared
from ..system.system import Instance, System
from .alone import Alone
from .closing import chains_of
from .inner_delays import initial_gains
from .linear_parts import refusal
from .statespace import StateSpace, linearised, real_ports, state_names

# A rate counts as none below this share of what a change of the states by their own size would make of it.
_AT_REST = 1e-9
_MOST = 200
_LAST = 3


@dataclass(frozen=True)
class TrimmedState:
    """A state at the operating point.

    Attributes:
        value: in the FMU's unit.
        rate: what is left of its derivative [unit/s].
        unit: empty where the FMU declares none.
        fixed: whether it kept its start value, and may go on changing.
    """

    value: float
    rate: float
    unit: str
    fixed: bool


@dataclass(frozen=True)
class Trimmed:
    """A system at its steady state.

    Attributes:
        prepared: the system, with the found start values.
        overrides: the same start values as changes of the config.
        states: by name.
        evaluations: how often the system was initialised for it.
    """

    prepared: Prepared
    overrides: tuple[str, ...]
    states: Mapping[str, TrimmedState]
    evaluations: int


def trim(prepared: Prepared, fixed: Sequence[str] = ()) -> Trimmed:
    """Find start values of the states at which their derivatives vanish.

    Newton's method within bounds, with the FMUs' directional derivatives and the static gains of connections.
    Inputs that nothing feeds and parameters keep their values. Where many states will do, as of a free
    integrator, those near the start values are taken. Minimum and maximum of states are kept.

    Args:
        prepared: the checked system.
        fixed: states that keep their start value and may go on changing, as "path.turned".
    Raises: ConfigError for FMUs without directional derivatives, unknown states, states without a start value
        that can be set, and where no steady state is found: it names what goes on changing.
    """
    from scipy.optimize import least_squares  # slow to import

    search = _Search(prepared, tuple(fixed))
    begin = search.begin
    if not search.free:
        found = begin[:0]
    else:
        scale = search.scale(begin)
        solution = least_squares(
            lambda x: search.at(x).rates[search.free] / search.nominal[search.free],
            np.clip(begin[search.free], search.low, search.high),
            jac=lambda x: (
                search.at(x).slopes[np.ix_(search.free, search.free)] / search.nominal[search.free, None]
            ),
            bounds=(search.low, search.high),
            x_scale=scale[search.free],
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
            max_nfev=_MOST,
        )
        found = solution.x
        # Bounds slow the search down near its end.
        for _ in range(_LAST):
            slopes = search.at(found).slopes[np.ix_(search.free, search.free)]
            if not np.isfinite(slopes).all():
                break
            step, *_ = np.linalg.lstsq(slopes, search.at(found).rates[search.free], rcond=1e-12)
            found = np.clip(found - step, search.low, search.high)
    at = search.at(found)
    search.check(at)
    overrides, states = [], {}
    for index, name in enumerate(search.names):
        variable = search.variables[index]
        value = float(at.values[index])
        rest = index in search.free
        if rest:
            overrides.append(f"{name}={variable.written(value)!s}")
        states[name] = TrimmedState(value, float(at.rates[index]), variable.unit_name, not rest)
    system = search.system(found)
    return Trimmed(replace(prepared, system=system), tuple(overrides), states, search.evaluations)


def trim_text(trimmed: Trimmed) -> str:
    """The operating point in lines for terminals."""
    times = f"{trimmed.evaluations} evaluation{'' if trimmed.evaluations == 1 else 's'}"
    lines = [f"steady state, found in {times}:"]
    for name, one in trimmed.states.items():
        unit = one.unit or "1"
        held = ", fixed" if one.fixed else ""
        value = f"{one.value:.9g} {one.unit}".rstrip()
        lines.append(f"  {name} = {value}, rate {one.rate:.2g} {unit}/s{held}")
    return "\n".join(lines)


@dataclass(frozen=True)
class _At:
    """States, their derivatives, and the derivatives of these by the states, shape (n, n)."""

    values: Array
    rates: Array
    slopes: Array


class _Search:
    """Evaluates a system with other start values."""

    def __init__(self, prepared: Prepared, fixed: tuple[str, ...]) -> None:
        self.prepared = prepared
        system = prepared.system
        problems = [found for one in system.instances if (found := refusal(one)) is not None]
        if problems:
            raise ConfigError(problems)
        self.chains, wrong = chains_of(system.connections, [])
        self.own = [state_names(one.fmu) for one in system.instances]
        of = [(one, state) for one, own in zip(system.instances, self.own, strict=True) for _, state in own]
        self.names = [f"{one.name}.{state}" for one, state in of]
        problems += wrong
        problems += [
            Problem("--fix", f"no state {name}", f"states: {listed(self.names)}", nearest(name, self.names))
            for name in fixed
            if name not in self.names
        ]
        if not self.names:
            problems.append(Problem("--trim", "no FMU in the system names continuous states"))
        if problems:
            raise ConfigError(problems)
        self.variables: list[Variable] = [one.variable(state) for one, state in of]
        self.nominal = np.array([float(one.nominal or 1.0) for one in self.variables])
        self.free = [index for index, name in enumerate(self.names) if name not in fixed]
        self._check_start_values()
        free = [self.variables[index] for index in self.free]
        self.low = np.array([-np.inf if one.minimum is None else one.minimum for one in free])
        self.high = np.array([np.inf if one.maximum is None else one.maximum for one in free])
        self.evaluations = 0
        self._known: dict[bytes, _At] = {}
        self.begin = self.at(None).values

    def _check_start_values(self) -> None:
        problems = []
        for index in self.free:
            if not self.variables[index].settable:
                remedy = f"Keep it as the model starts it: --fix {self.names[index]}."
                what = f"state {self.names[index]} has no start value that can be set"
                problems.append(Problem("--trim", what, "trimming looks for start values of states", remedy))
        if problems:
            raise ConfigError(problems)

    def scale(self, values: Array) -> Array:
        """The size that each state has, shape (n,)."""
        return np.maximum(self.nominal, abs(values))

    def system(self, free: Array) -> System:
        """The system with start values of the free states."""
        changed: dict[str, dict[str, Any]] = {}
        for index, value in zip(self.free, free, strict=True):
            instance, _, state = self.names[index].partition(".")
            changed.setdefault(instance, {})[state] = float(value)
        whole = self.prepared.system
        return replace(
            whole,
            instances=tuple(
                replace(one, start={**one.start, **changed.get(one.name, {})}) for one in whole.instances
            ),
        )

    def at(self, free: Array | None) -> _At:
        """Rates and slopes with start values of the free states; None: those of the config."""
        key = b"" if free is None else free.tobytes()
        if key not in self._known:
            self.evaluations += 1
            try:
                found = self._evaluated(self.prepared.system if free is None else self.system(free))
            except StepError:
                if free is None:
                    raise
                # Out of the model's reach: the search takes a shorter step.
                count = len(self.names)
                found = _At(*(np.full(shape, np.nan) for shape in (count, count, (count, count))))
            self._known = {key: found}
        return self._known[key]

    def _evaluated(self, system: System) -> _At:
        grid = self.prepared.grid
        fed = {str(connection.target) for connection in system.connections}
        values, rates, parts = [], [], []
        with instantiate(system) as instances:
            instances.initialise(float(grid.start), float(grid.stop))
            for one, running, own in zip(system.instances, instances.running, self.own, strict=True):
                ports = real_ports(one.fmu)
                inputs = tuple(name for name, out in ports if not out and f"{one.name}.{name}" in fed)
                part = linearised(one.fmu, running, inputs, tuple(name for name, out in ports if out))
                known = running.get_values([name for pair in own for name in pair] + list(inputs))
                values += [float(known[state]) for _, state in own]
                rates += [float(known[rate]) for rate, _ in own]
                parts.append((one, self._at_rest(one, part, known)))
        slopes = self._slopes([part.named(one.name) for one, part in parts])
        return _At(np.array(values), np.array(rates), slopes)

    def _at_rest(self, one: Instance, part: StateSpace, values: Mapping[str, Any]) -> StateSpace:
        """With the steady effect of delays within the FMU: at the start they pass on what they are given."""
        at = Alone(one, self.prepared, part.inputs, part.outputs, values)
        made, n = initial_gains(at, part, idle=True), len(part.states)
        return replace(
            part,
            a=part.a + made[:n, :n],
            b=part.b + made[:n, n:],
            c=part.c + made[n:, :n],
            d=part.d + made[n:, n:],
        )

    def _slopes(self, parts: Sequence[StateSpace]) -> Array:
        a, b, c, d = (scipy.linalg.block_diag(*(getattr(one, name) for one in parts)) for name in "abcd")
        inputs = [name for one in parts for name in one.inputs]
        outputs = {name: place for place, name in enumerate(name for one in parts for name in one.outputs)}
        k = np.zeros((len(inputs), len(outputs)))
        for one in self.chains:
            if one.source in outputs and one.target in inputs:
                k[inputs.index(one.target), outputs[one.source]] += one.gain
        loop = np.eye(len(inputs)) - k @ d
        if inputs and np.linalg.cond(loop) > 1e12:
            raise ConfigError([Problem("--trim", "an algebraic loop has no solution at the start", "")])
        return a + b @ np.linalg.solve(loop, k @ c)

    def check(self, at: _At) -> None:
        """Raises: ConfigError naming the states that go on changing."""
        size = abs(at.slopes) @ self.scale(at.values)
        left = [index for index in self.free if not abs(at.rates[index]) <= _AT_REST * size[index]]
        if not left:
            return
        problems = []
        for index in sorted(left, key=lambda one: -abs(at.rates[one]) / self.nominal[one]):
            name, unit = self.names[index], self.variables[index].unit_name or "1"
            bound = not at.slopes[index].any()
            why = ", whatever the states are" if bound else ""
            what = f"no steady state: {name} goes on changing by {at.rates[index]:.4g} {unit}/s{why}"
            remedy = f"If it may, keep it at its start value: --fix {name}."
            problems.append(Problem("--trim", what, "derivatives of all states are to vanish", remedy))
        raise ConfigError(problems)
