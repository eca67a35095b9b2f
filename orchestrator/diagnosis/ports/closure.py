"""How far the gap of a system shrinks on held-out runs."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...system.connection import Port
from ..closure import closure_of
from ..finding import NOMINAL, Augmented, Finding
from ..study import Array
from ..verdict import WITHIN
from .repeats import repeats_of
from .replay import PortReplay
from .seek import carries
from .study import PortRun, PortStudy, Role

__all__ = ["how_far"]

# Held-out runs are resampled in blocks of this share of a run.
_BLOCKS = 50


def how_far(study: PortStudy, finding: Finding) -> dict[str, Any]:
    """The gap on held-out runs before and after, as `verdict.HowFar`; and by port under `outputs`.

    Errors are relative: root mean square of log minus model over the standard deviation of the log, root mean
    square over the compared ports where the gap stands beyond the noise, or grows beyond it with the answer:
    a precise port would drown in the noise of others. Where it does at none, over all of them.
    `noise_floor_from` says where the noise floor is from; see `_Floor`; `over_recalibration` is the log
    likelihood of the answer over other calibrated numbers alone [nats].
    """
    models = {"before": NOMINAL, "after": finding.answer, "recalibrated": finding.recalibrated}
    runs = study.of(Role.HELDOUT)
    replay = PortReplay(study, runs)
    left = {name: replay.of(model) for name, model in models.items()}
    floors = _Floor(study, models.values())
    found: list[_Channel] = []
    repeated: set[bool] = set()
    for place, (run, port) in enumerate(replay.channels):
        noise = float(study.columns[port].noise or 0.0)
        scale = noise / (float(np.std(run.logs[port][study.settled :])) or noise)
        own = {name: some[place] for name, some in left.items()}
        again = floors.of(run, port, list(own.values()))
        repeated.add(again is not None)
        floor = scale**2 * (1.0 if again is None else again)
        found.append(_Channel(run, port, {name: (r * scale) ** 2 for name, r in own.items()}, floor))
    by_port: dict[Port, list[_Channel]] = {}
    for one in found:
        by_port.setdefault(one.port, []).append(one)
    beyond = {port for port, those in by_port.items() if _beyond(those)}
    counted = [one for one in found if one.port in beyond] or found
    joined = {name: np.concatenate(_blocks(runs, counted, name)) for name in models}
    outputs = {
        str(port): {name: float(np.sqrt(np.mean([one.square(name) for one in those]))) for name in models}
        for port, those in by_port.items()
    }
    told_by = "both" if len(repeated) > 1 else "repeats" if repeated == {True} else "specified"
    floor = float(np.sqrt(np.mean([one.floor for one in counted])))
    over = _over(left["after"], left["recalibrated"])
    told = {"noise_floor_from": told_by, "over_recalibration": over, "outputs": outputs}
    return {**closure_of(joined, floor, 2), **told}


def _over(answer: Sequence[Array], other: Sequence[Array]) -> float | None:
    """Log likelihood of one model's residuals over another's, by channel; None where one runs away [nats].

    Squares of a channel count by what those of the better model carry, as in fits.
    """
    total = 0.0
    for r, without in zip(answer, other, strict=True):
        with np.errstate(over="ignore", invalid="ignore"):
            total += 0.5 * float(without @ without - r @ r) / min(carries(r), carries(without))
    return total if math.isfinite(total) else None


@dataclass(frozen=True)
class _Channel:
    """A port in a run: squared relative errors by model, and what noise makes of them."""

    run: PortRun
    port: Port
    squares: Mapping[str, Array]
    floor: float

    def square(self, model: str) -> float:
        return float(np.mean(self.squares[model]))


def _beyond(channels: Sequence[_Channel]) -> bool:
    """Whether the gap at a port stands beyond the noise, or grows beyond it with the answer."""
    before, after = (float(np.mean([one.square(name) for one in channels])) for name in ("before", "after"))
    floor = WITHIN**2 * float(np.mean([one.floor for one in channels]))
    # What runs away is beyond, too.
    return not before <= floor or not after <= max(floor, WITHIN**2 * before)


def _blocks(runs: Collection[PortRun], channels: Collection[_Channel], model: str) -> list[Array]:
    """Squared errors of a model in blocks of time, by run."""
    found = []
    for run in runs:
        those = [one.squares[model] for one in channels if one.run is run]
        if those:
            mean = np.mean(those, axis=0)
            found.append(np.array([block.mean() for block in np.array_split(mean, min(_BLOCKS, len(mean)))]))
    return found


class _Floor:
    """What of normalised residuals does not repeat: mean squares, by run and port, of noise of one of them.

    Runs that repeat each other differ by their noise, and by what that made of a loop. Where the log of this
    noise is fed, the model makes the same of it, and logs differ by more than the noise. Where it is fed to
    what the machine did not give it to, residuals do. So the least counts, of the logs' difference and that
    of each model's residuals.
    """

    def __init__(self, study: PortStudy, models: Collection[Augmented]) -> None:
        self._study, self._models = study, tuple(models)
        self._again: dict[str, list[dict[Port, Array]]] = {}

    def of(self, run: PortRun, port: Port, residuals: Sequence[Array]) -> float | None:
        """None where no repeat tells it.

        Args:
            residuals: of the models there.
        """
        study, found = self._study, []
        for other in repeats_of(study, run):
            if port not in other.logs:
                continue
            if other.name not in self._again:
                replay = PortReplay(study, [other])
                self._again[other.name] = [
                    dict(zip(replay.compared(other), replay.of(model), strict=True)) for model in self._models
                ]
            n = min(len(run), len(other))
            logs = (run.logs[port][:n] - other.logs[port][:n])[study.settled :]
            differ = [logs / float(study.columns[port].noise or 1.0)]
            for r, again in zip(residuals, self._again[other.name], strict=True):
                m = n - study.settled
                differ.append(r[:m] - again[port][:m])
            squares = [float(np.mean(one**2)) / 2.0 for one in differ]
            found.append(min(filter(math.isfinite, squares)))
        return float(np.mean(found)) if found else None
