"""The dominant root as a co-simulation shows it: a small change, and how it dies away.

Two runs that differ in one start value, or by a short pulse at one input, then differ by the free response of
the linear system. Its poles are read by the matrix pencil method (Hua and Sarkar, IEEE Trans. Acoust. Speech
Signal Process. 38, 1990), at the config's communication step and at half of it: what then remains between
them is the step's doing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..base.arrays import Array
from ..base.errors import ConfigError, OrchestratorError, Problem
from ..effects.base import Effect
from ..simulation.run import Prepared, prepare, run
from ..system.connection import Port
from .alone import usual_size
from .excite import with_effect
from .from_system import Linearised
from .modes import Mode
from .sampled_system import sampled_system
from .step_report import at_step, moving_modes, pairs, resting_roots

# Samples of a period, or of the time constant of a real root, and how many are taken.
_DENSITY = 24
_SAMPLES = 192
# Of a growing mode: how far it may grow, and the fewest samples.
_GROWN = 1e5
_FEWEST = 32
_CHANGE = 1e-4
_CHANNELS = 6
# Singular values below this share of the largest are noise.
_NOISE = 1e-6
# Samples that a pulse lasts.
_PULSE = 2
# A pole this far from the predicted one, relative to it, is not that of the linear system.
_UNLIKE = 0.01


class _Pulse(Effect):
    """y = x, and x + height from one instant until before another [s]."""

    jittable: ClassVar[bool] = True

    height: float
    begin: float
    end: float

    @staticmethod
    def kernel(time: float, x: Any, options: Any, memory: Any, commit: bool) -> float:
        return x[0] + (options[0] if options[1] <= time < options[2] else 0.0)


def verified(
    config: str | Path | Mapping[str, Any],
    linear: Linearised,
    overrides: Iterable[str] = (),
    hold: Mapping[str, float] | None = None,
    momentary: Collection[complex] = (),
) -> dict[str, Any]:
    """Compare dominant roots with the decay and frequency of co-simulations.

    Args:
        config, overrides: as for `prepare`.
        linear: the system around its start, a time of a run, or a point that a measure of the config chose.
        hold: constants by input, FMU's units, that let a run rest at such a point; None: not known.
        momentary: roots that hold for one moment only, which no run shows; see `momentary_roots`.
    Returns: a dict with
        `changed`, `pulse`: the start value that was changed, or the input that a pulse was added to; which.
        `root`: of the machine.
        For each step `step` [s], `found` (the pole) and `difference` (its distance from the root, relative to
        the root). The last one is step 0, extrapolated from the two others, since the error of masters
        without iteration falls with the step. It is left out where a mode of the step's own grows.
        `sampled`: `step`, `predicted`, `found` and `difference` of the roots that master and step give. These
        are the one that stands for the machine's and the dominant one, or the latter alone where it grows;
        none where the sampled system is not known.
    Raises: OrchestratorError if no mode can be excited or none is found; StepError if a run fails.
    """
    overrides = tuple(overrides)
    if linear.chosen and hold is None:
        what = "it is linear around a point that a measure of the config chose: a run does not stay there"
        remedy = "Compare what the measure adds to the report with a run."
        raise ConfigError([Problem("--verify", what, "", remedy)])
    runs = _Runs(config, overrides, linear, hold or {})
    modes = linear.modes()
    mode = next((one for one in moving_modes(modes) if one.root not in momentary), None)
    if mode is None:
        raise OrchestratorError("--verify: the system has no lasting root but 0, whose decay a run shows")
    prepared = runs.plain
    step = float(prepared.grid.step_size)
    poles: list[tuple[float, complex]] = []
    overgrown = False
    sampled: list[dict[str, Any]] = []
    for size in (step, step / 2):
        size, changes = at_step(prepared, size, own=True)
        try:
            made = sampled_system(runs.prepared(changes), linear, resting_roots(modes))
        except ConfigError:
            poles.append((size, runs.pole(mode, size)))
            continue
        found = made.modes()
        place = pairs(found, [mode])[0]
        near = mode if place is None else found[place]
        other = found[0] if found and place != 0 else None
        if other is not None and other.root.real > 0.0:  # it outgrows all others
            near, other, overgrown = other, None, True
        predicted = [(one, runs.pole(one, size, made.period)) for one in (near, other) if one is not None]
        poles.append((size, predicted[0][1]))
        sampled += [
            {
                "step": size,
                "predicted": [one.root.real, one.root.imag],
                "found": [pole.real, pole.imag],
                "difference": abs(pole - one.root) / abs(one.root),
            }
            for one, pole in predicted
            if one is not mode
        ]
    if not overgrown:
        poles.append((0.0, 2 * poles[1][1] - poles[0][1]))
    steps = [
        {
            "step": size,
            "found": [pole.real, pole.imag],
            "difference": abs(pole - mode.root) / abs(mode.root),
        }
        for size, pole in poles
    ]
    name, value = runs.changed(mode)
    return {
        "changed": name,
        "pulse": value is None,
        "root": [mode.root.real, mode.root.imag],
        "steps": steps,
        "sampled": sampled,
    }


class _Runs:
    """Co-simulations of a config from the point that its linear system is of, held there."""

    def __init__(
        self,
        config: str | Path | Mapping[str, Any],
        overrides: tuple[str, ...],
        linear: Linearised,
        hold: Mapping[str, float],
    ) -> None:
        self.config, self.overrides, self.linear, self.hold = config, overrides, linear, hold
        self._changed: dict[complex, tuple[str, float | None]] = {}

    @cached_property
    def plain(self) -> Prepared:
        """The system as the config has it."""
        return self.prepared()

    def prepared(self, overrides: Iterable[str] = (), start: Mapping[str, float] | None = None) -> Prepared:
        """The system with further overrides, and start values of states, FMU's units."""
        made = self.linear.started(prepare(self.config, (*self.overrides, *overrides)))
        system = made.system
        instances = [
            replace(one, start={**one.start, **_own(one.name, start or {})}) for one in system.instances
        ]
        connections = [
            replace(one, offset=one.offset + self.hold.get(str(one.target), 0.0))
            for one in system.connections
        ]
        return replace(
            made, system=replace(system, instances=tuple(instances), connections=tuple(connections))
        )

    def pole(self, mode: Mode, size: float, period: float | None = None) -> complex:
        """The pole of a co-simulation with a step that is nearest to a mode's root; samples lie whole
        periods apart.
        """
        root, own = mode.root, round((period or size) / size)
        name, value = self.changed(mode)
        spacing = (2 * np.pi / abs(root.imag) if root.imag else 1 / abs(root)) / _DENSITY
        stride = own * max(1, round(spacing / (own * size)))
        samples = _SAMPLES
        if root.real > 0.0:
            samples = int(np.clip(np.log(_GROWN) / (root.real * size * stride), _FEWEST, _SAMPLES))
        begin = float(self.plain.grid.start)
        before = 0 if self.linear.time is None else round((self.linear.time - begin) / size)
        # Samples begin where the pulse has ended.
        first = before + _PULSE * stride if value is None else 0
        changes = at_step(self.plain, size, first + stride * samples, own=True)[1]
        plain = self.prepared(changes)
        if value is None:
            # Communication points may lie beside their times by rounding.
            ends = [begin + (place - 0.25) * size for place in (before, first)]
            other = self._pulsed(plain, name, ends)
        else:
            other = self.prepared(changes, {name: value})
        moved = _signals(other, stride, first) - _signals(plain, stride, first)
        return _nearest(moved, size * stride, root)

    @staticmethod
    def _pulsed(prepared: Prepared, name: str, ends: Sequence[float]) -> Prepared:
        """The system with a pulse at an input between two instants [s]."""
        target = Port.of(name)
        one = next(one for one in prepared.system.instances if one.name == target.instance)
        connection = next(one for one in prepared.system.connections if one.target == target)
        start = float(one.start.get(target.variable, 0.0))
        height = _CHANGE * usual_size(start, one.variable(target.variable)) / connection.gain
        pulse = _Pulse(height=height, begin=ends[0], end=ends[1])
        return replace(prepared, system=with_effect(prepared.system, target, pulse))

    def changed(self, mode: Mode) -> tuple[str, float | None]:
        """The state that takes the largest part in a mode and has a start value, and another value of it; or,
        away from the start or without such a state, the input that moves the mode most, and None.
        """
        if mode.root not in self._changed:
            self._changed[mode.root] = self._change_of(mode)
        return self._changed[mode.root]

    def _change_of(self, mode: Mode) -> tuple[str, float | None]:
        for name, _ in mode.participation if self.linear.time is None else ():
            instance = next(
                (one for one in self.plain.system.instances if name.startswith(f"{one.name}.")), None
            )
            if instance is None or name not in self.linear.point:
                continue
            variable = instance.variable(name.removeprefix(f"{instance.name}."))
            value = float(self.linear.point[name])
            value += _CHANGE * usual_size(value, variable)
            try:
                prepare(self.config, (*self.overrides, f"{name}={value!r} {variable.unit or ''}".rstrip()))
            except ConfigError:
                continue
            return name, value
        return self._moving_input(mode), None

    def _moving_input(self, mode: Mode) -> str:
        """The connected input whose usual change moves a mode most."""
        fed = {str(one.target) for one in self.plain.system.connections}
        moved = self.linear.system.moved(mode.root)
        sizes = {}
        for one in self.plain.system.instances:
            for port, share in moved.items():
                name = port.removesuffix(" delayed")
                if name in fed and name.startswith(f"{one.name}."):
                    variable = one.variable(name.removeprefix(f"{one.name}."))
                    sizes[name] = usual_size(self.linear.point.get(name, 0.0), variable) * share
        if not sizes:
            what = "no state of the dominant mode has a start value, and no connection moves it"
            raise ConfigError([Problem("--verify", what, "one of both is needed")])
        return max(sizes, key=lambda name: sizes[name])


def _own(instance: str, start: Mapping[str, float]) -> dict[str, float]:
    """Those start values that are of an instance."""
    return {
        name.removeprefix(f"{instance}."): value
        for name, value in start.items()
        if name.startswith(f"{instance}.")
    }


def verify_text(report: dict[str, Any]) -> str:
    """The comparison in lines for terminals."""
    how = "a short pulse at" if report["pulse"] else "a small change of"
    lines = [f"co-simulated after {how} {report['changed']}:"]
    for one in report["steps"]:
        where = f"step {1e3 * one['step']:g} ms" if one["step"] else "extrapolated to step 0"
        lines.append(f"  {where}: {_root(one['found'])} 1/s, {100 * one['difference']:.2g} % from the root")
    for one in report["sampled"]:
        lines.append(
            f"  step {1e3 * one['step']:g} ms: {_root(one['found'])} 1/s, predicted with master and step "
            f"{_root(one['predicted'])}: {100 * one['difference']:.2g} % apart"
        )
    if any(one["difference"] > _UNLIKE for one in report["sampled"]):
        lines.append(
            "  the runs do not move as the linear system: what it leaves out acts at its operating point, or "
            "that moves"
        )
    return "\n".join(lines)


def _root(root: Sequence[float]) -> str:
    return f"{root[0]:.6g}" + (f" +-{abs(root[1]):.6g}j" if root[1] else "")


def _signals(prepared: Prepared, stride: int, first: int) -> Array:
    """Recorded signals at every `stride`-th point from the first on, shape (samples, signals)."""
    results = run(prepared, halving=False, figures=False)
    columns = [np.asarray(results[name].values, dtype=float) for name in results.names]
    return np.column_stack([one for one in columns if one.ndim == 1])[first::stride]


def _nearest(response: Array, spacing: float, root: complex) -> complex:
    """The pole of a response, shape (samples, signals), that is nearest to a root."""
    sizes = np.max(abs(response), axis=0)
    largest = np.argsort(sizes)[::-1][:_CHANNELS]
    chosen = [one for one in largest if sizes[one] > 0.0 and np.isfinite(sizes[one])]
    if not chosen:
        raise OrchestratorError("--verify: no recorded signal answers to the changed start value")
    response = response[:, chosen] / sizes[chosen]
    rows = len(response) // 2
    blocks = [
        np.lib.stride_tricks.sliding_window_view(response[:, k], rows).T for k in range(response.shape[1])
    ]
    hankel = np.vstack(blocks)
    left, values, _ = np.linalg.svd(hankel, full_matrices=False)
    order = max(1, int(np.sum(values > _NOISE * values[0])))
    base = left[:, :order].reshape(len(blocks), rows, order)
    first = base[:, :-1].reshape(-1, order)
    second = base[:, 1:].reshape(-1, order)
    transition, *_ = np.linalg.lstsq(first, second, rcond=None)
    poles = np.log(np.linalg.eigvals(transition).astype(complex)) / spacing
    return complex(poles[np.argmin(abs(poles - root))])
