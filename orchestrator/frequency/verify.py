"""The dominant root as a co-simulation shows it: a small change of a start value, and how it dies away.

Two runs that differ in one start value alone differ by the free response of the linear system. Its poles
are read by the matrix pencil method (Hua and Sarkar, IEEE Trans. Acoust. Speech Signal Process. 38, 1990), at
the config's communication step and at half of it: what then remains between them is the step's doing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import ConfigError, OrchestratorError, Problem, listed
from ..simulation.run import Prepared, prepare, run
from .from_system import Linearised
from .modes import Mode
from .sampled_system import sampled_system
from .step_report import at_step, pairs, resting_roots

__all__ = ["verified", "verify_text"]

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
# A pole this far from the predicted one, relative to it, is not that of the linear system.
_UNLIKE = 0.01


def verified(
    config: str | Path | Mapping[str, Any],
    linear: Linearised,
    overrides: Iterable[str] = (),
    hold: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Compare dominant roots with the decay and frequency of co-simulations.

    Args:
        config, overrides: as for `prepare`.
        linear: the system around its start, or a point that a measure of the config chose.
        hold: constants by input, FMU's units, that let a run rest at such a point; None: not known.
    Returns: a dict with `changed` (the start value that was changed), `root` (the machine's), and for each
        step `step` [s], `found` (the pole) and `difference` (its distance from the root, relative to the
        root); the last one is step 0, extrapolated from the two others, since the error of masters without
        iteration falls with the step; it is left out where a mode of the step's own grows. `sampled` holds
        `step`, `predicted`, `found` and `difference` of the roots that the master and the step give: the one
        that stands for the machine's, and the dominant one if that is another, or this alone where it grows;
        it is empty where the sampled system is not known.
    Raises: OrchestratorError if no mode can be excited or none is found; StepError if a run fails.
    """
    overrides = tuple(overrides)
    if linear.start is None:
        what = "it is linear around a later point of the run, which no run starts from"
        raise ConfigError([Problem("--verify", what, "", "Leave out --at-time, or use --trim.")])
    if linear.chosen and hold is None:
        what = "it is linear around a point that a measure of the config chose: a run does not stay there"
        remedy = "Compare what the measure adds to the report with a run."
        raise ConfigError([Problem("--verify", what, "", remedy)])
    runs = _Runs(config, overrides, linear, hold or {})
    modes = linear.modes()
    mode = modes.dominant
    if mode is None:
        raise OrchestratorError("--verify: the system has no root but 0, whose decay could be looked at")
    prepared = runs.prepared()
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
    return {
        "changed": runs.changed(mode)[0],
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
        spacing = (2 * np.pi / abs(root.imag) if root.imag else 1 / abs(root)) / _DENSITY
        stride = own * max(1, round(spacing / (own * size)))
        samples = _SAMPLES
        if root.real > 0.0:
            samples = int(np.clip(np.log(_GROWN) / (root.real * size * stride), _FEWEST, _SAMPLES))
        changes = at_step(self.prepared(), size, stride * samples, own=True)[1]
        one, other = (
            _signals(self.prepared(changes, start), stride) for start in ({}, dict([self.changed(mode)]))
        )
        return _nearest(one - other, size * stride, root)

    def changed(self, mode: Mode) -> tuple[str, float]:
        """The state that takes the largest part in a mode and has a start value, and another value of it."""
        tried = []
        for name, _ in mode.participation:
            instance = next(
                (one for one in self.prepared().system.instances if name.startswith(f"{one.name}.")), None
            )
            if instance is None or name not in self.linear.point:
                continue
            variable = instance.variable(name.removeprefix(f"{instance.name}."))
            value = float(self.linear.point[name])
            value += _CHANGE * (abs(value) or float(variable.nominal or 1.0))
            try:
                prepare(self.config, (*self.overrides, f"{name}={value!r} {variable.unit or ''}".rstrip()))
            except ConfigError:
                tried.append(name)
                continue
            return name, value
        raise ConfigError(
            [
                Problem(
                    "--verify",
                    f"no state of the dominant mode has a start value (tried: {listed(tried)})",
                    "one of them has to be a start value of its FMU",
                )
            ]
        )


def _own(instance: str, start: Mapping[str, float]) -> dict[str, float]:
    """Those start values that are of an instance."""
    return {
        name.removeprefix(f"{instance}."): value
        for name, value in start.items()
        if name.startswith(f"{instance}.")
    }


def verify_text(report: dict[str, Any]) -> str:
    """The comparison in lines for terminals."""
    lines = [f"co-simulated after a small change of {report['changed']}:"]
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
            "  the runs do not move as the linear system: what it leaves out acts at its operating point"
        )
    return "\n".join(lines)


def _root(root: Sequence[float]) -> str:
    return f"{root[0]:.6g}" + (f" +-{abs(root[1]):.6g}j" if root[1] else "")


def _signals(prepared: Prepared, stride: int) -> NDArray[np.float64]:
    """Recorded signals at every `stride`-th point, shape (samples, signals)."""
    results = run(prepared, halving=False, figures=False)
    columns = [np.asarray(results[name].values, dtype=float) for name in results.names]
    return np.column_stack([one for one in columns if one.ndim == 1])[::stride]


def _nearest(response: NDArray[np.float64], spacing: float, root: complex) -> complex:
    """The pole of a response, shape (samples, signals), that is nearest to a root."""
    sizes = np.max(abs(response), axis=0)
    chosen = np.argsort(sizes)[::-1][:_CHANNELS]
    chosen = [one for one in chosen if sizes[one] > 0.0 and np.isfinite(sizes[one])]
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
