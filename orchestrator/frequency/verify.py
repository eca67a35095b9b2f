"""The dominant root as a co-simulation shows it: a small change of a start value, and how it dies away.

Two runs that differ in one start value alone differ by the free response of the linear system. Its poles
are read by the matrix pencil method (Hua and Sarkar, IEEE Trans. Acoust. Speech Signal Process. 38, 1990), at
the config's communication step and at half of it: what then remains between them is the step's doing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import ConfigError, OrchestratorError, Problem, listed
from ..simulation.run import Prepared, prepare, run
from .delay_system import Mode
from .from_system import Linearised

__all__ = ["verified", "verify_text"]

# Samples of a period, or of the time constant of a real root, and how many are taken.
_DENSITY = 24
_SAMPLES = 192
_CHANGE = 1e-4
_CHANNELS = 6
# Singular values below this share of the largest are noise.
_NOISE = 1e-6


def verified(
    config: str | Path | Mapping[str, Any], linear: Linearised, overrides: Iterable[str] = ()
) -> dict[str, Any]:
    """Compare the dominant root with the decay and frequency of a co-simulation.

    Args:
        config, overrides: as for `prepare`.
        linear: the system around its start.
    Returns: a dict with `changed` (the start value that was changed), `root`, and for each step `step` [s],
        `found` (the pole) and `difference` (its distance from the root, relative to the root); the last one
        is step 0, extrapolated from the two others, since the error of masters without iteration falls with
        the step.
    Raises: OrchestratorError if no mode can be excited or none is found; StepError if a run fails.
    """
    overrides = tuple(overrides)
    mode = linear.modes().dominant
    if mode is None:
        raise OrchestratorError("--verify: the system has no root but 0, whose decay could be looked at")
    prepared = prepare(config, overrides)
    step = float(prepared.grid.step_size)
    spacing = (2 * np.pi / abs(mode.root.imag) if mode.root.imag else 1 / abs(mode.root)) / _DENSITY
    name, changes = _changed(config, overrides, prepared, linear, mode)
    poles = []
    for size in (step, step / 2):
        stride = max(1, round(spacing / size))
        stop = float(prepared.grid.start) + size * stride * _SAMPLES
        common = (*overrides, f"run.step_size={size!r} s", f"run.stop_time={stop!r} s")
        one, other = (_signals(config, (*common, *extra), stride) for extra in ((), changes))
        poles.append((size, _nearest(one - other, size * stride, mode.root)))
    poles.append((0.0, 2 * poles[1][1] - poles[0][1]))
    steps = [
        {
            "step": size,
            "found": [found.real, found.imag],
            "difference": abs(found - mode.root) / abs(mode.root),
        }
        for size, found in poles
    ]
    return {"changed": name, "root": [mode.root.real, mode.root.imag], "steps": steps}


def verify_text(report: dict[str, Any]) -> str:
    """The comparison in lines for terminals."""
    lines = [f"co-simulated after a small change of {report['changed']}:"]
    for one in report["steps"]:
        real, imaginary = one["found"]
        root = f"{real:.6g}" + (f" +-{abs(imaginary):.6g}j" if imaginary else "")
        where = f"step {1e3 * one['step']:g} ms" if one["step"] else "extrapolated to step 0"
        lines.append(f"  {where}: {root} 1/s, {100 * one['difference']:.2g} % from the root")
    return "\n".join(lines)


def _changed(
    config: str | Path | Mapping[str, Any],
    overrides: tuple[str, ...],
    prepared: Prepared,
    linear: Linearised,
    mode: Mode,
) -> tuple[str, tuple[str, ...]]:
    """The state that takes the largest part in a mode and has a start value; the change of the config."""
    tried = []
    for name, _ in mode.participation:
        instance = next((one for one in prepared.system.instances if name.startswith(f"{one.name}.")), None)
        if instance is None or name not in linear.point:
            continue
        variable = instance.variable(name.removeprefix(f"{instance.name}."))
        value = float(linear.point[name])
        value += _CHANGE * (abs(value) or float(variable.nominal or 1.0))
        changes = (f"{name}={value!r} {variable.unit or ''}".rstrip(),)
        try:
            prepare(config, (*overrides, *changes))
        except ConfigError:
            tried.append(name)
            continue
        return name, changes
    raise ConfigError(
        [
            Problem(
                "--verify",
                f"no state of the dominant mode has a start value (tried: {listed(tried)})",
                "one of them has to be a start value of its FMU",
            )
        ]
    )


def _signals(
    config: str | Path | Mapping[str, Any], overrides: tuple[str, ...], stride: int
) -> NDArray[np.float64]:
    """Recorded signals at every `stride`-th point, shape (samples, signals)."""
    results = run(config, overrides=overrides, halving=False, figures=False)
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
