"""How far the gap of a system shrinks on held-out runs."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..closure import closure_of
from ..finding import NOMINAL, Finding
from ..study import Array
from .repeats import apart
from .replay import PortReplay
from .study import PortStudy, Role

__all__ = ["how_far"]

# Held-out runs are resampled in blocks of this share of a run.
_BLOCKS = 50


def how_far(study: PortStudy, finding: Finding) -> dict[str, Any]:
    """The gap on held-out runs before and after, as `verdict.HowFar`; and by port under `outputs`.

    Errors are relative: root mean square of log minus model over the standard deviation of the log, root mean
    square over the compared ports. The noise floor is that of half the difference of repeats, where there
    are any, else that of the noise as specified; `noise_floor_from` tells which. See `repeats.apart`.
    """
    models = {"before": NOMINAL, "after": finding.answer, "recalibrated": finding.recalibrated}
    runs = study.of(Role.HELDOUT)
    replay = PortReplay(study, runs)
    squares: dict[str, list[Array]] = {name: [] for name in models}
    floors: list[float] = []
    repeated: set[bool] = set()
    by_port: dict[str, dict[str, list[float]]] = {}
    left = {name: replay.of(model) for name, model in models.items()}
    place = 0
    for run in runs:
        ports = replay.compared(run)
        parts: dict[str, list[Array]] = {name: [] for name in models}
        for port in ports:
            noise = study.columns[port].noise
            assert noise is not None
            scale = noise / (float(np.std(run.logs[port][study.settled :])) or noise)
            for name in models:
                r = left[name][place] * scale
                parts[name].append(r**2)
                by_port.setdefault(str(port), {}).setdefault(name, []).append(float(np.mean(r**2)))
            again = apart(study, run, port)
            repeated.add(bool(again))
            floors.append(scale**2 * (float(np.mean(again[0] ** 2)) / noise**2 if again else 1.0))
            place += 1
        for name, those in parts.items():
            mean = np.mean(those, axis=0)
            blocks = np.array_split(mean, min(_BLOCKS, len(mean)))
            squares[name].append(np.array([block.mean() for block in blocks]))
    joined = {name: np.concatenate(those) for name, those in squares.items()}
    outputs = {
        port: {name: float(np.sqrt(np.mean(values))) for name, values in told.items()}
        for port, told in by_port.items()
    }
    told_by = "both" if len(repeated) > 1 else "repeats" if repeated == {True} else "specified"
    found = closure_of(joined, float(np.sqrt(np.mean(floors))), 2)
    return {**found, "noise_floor_from": told_by, "outputs": outputs}
