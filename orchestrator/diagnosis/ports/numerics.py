"""The co-simulation's own error, by halving its step, before anything is blamed on the system."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..finding import Augmented
from ..verdict import Warned
from .replay import PortReplay
from .steps import with_steps
from .study import PortStudy, Role

__all__ = ["doubts", "numerics"]

# A step whose halving changes more than this share of the gap is no step to diagnose with; nor one whose
# halving changes so many times the noise of the logs: effects of that size may be the step's.
_DOUBTFUL, _LOUD = 0.1, 2.0
# A gap of so many times the noise is noise.
_NOISY = 1.3


def numerics(study: PortStudy, models: Mapping[str, Augmented]) -> dict[str, Any]:
    """What halving the communication step changes, as a fraction of the gap.

    Logs are fed on a curve through their samples, so that the hold of their values over a step, which acts
    as half a step's delay, counts as an error of the step, too. Instances with a step of their own keep it.
    Held-out runs; train runs where there are none.

    Args:
        models: by name; the gap is that of the first.
    Returns: `error`, the root mean square change at the compared ports over the spread of their logs, of the
        model that changes most; `gap`, between model and log; `noise`, of the logs as specified, both the
        same way; `fraction`, of error and gap; `step_size` and `interval` of the samples [s];
        `models`, the error of each. None where a model runs away, or where FMUs take no step of half the
        length: then `halved` is false.
    """
    runs = study.of(Role.HELDOUT) or study.of(Role.TRAIN)
    shorter = with_steps(study, 2)
    step, fine = PortReplay(study, runs), PortReplay(study if shorter is None else shorter, runs)
    gaps: list[float] = []
    noises: list[float] = []
    errors: dict[str, float] = {}
    for name, model in models.items():
        changes = []
        for run in runs:
            coarse, halved = (
                one.signals(run, model.calibrated, model.effects, model.theta) for one in (step, fine)
            )
            for port in step.compared(run):
                log = run.logs[port][study.settled :]
                spread = float(np.std(log)) or float(study.columns[port].noise or 1.0)
                apart = (halved[port] - coarse[port])[study.settled :] / spread
                changes.append(float(np.mean(apart**2)))
                if name == next(iter(models)):
                    gaps.append(float(np.mean(((log - coarse[port][study.settled :]) / spread) ** 2)))
                    noises.append((float(study.columns[port].noise or 0.0) / spread) ** 2)
        errors[name] = float(np.sqrt(np.mean(changes)))
    gap, error = float(np.sqrt(np.mean(gaps))), max(errors.values())
    known = shorter is not None and np.isfinite(gap) and np.isfinite(error)
    return {
        "error": error if known else None,
        "gap": gap if known else None,
        "noise": float(np.sqrt(np.mean(noises))),
        "fraction": error / gap if known and gap > 0.0 else None,
        "step_size": float(study.prepared.grid.step_size),
        "interval": study.interval,
        "halved": shorter is not None,
        "models": {name: value if known and np.isfinite(value) else None for name, value in errors.items()},
    }


def doubts(found: Mapping[str, Any]) -> list[Warned]:
    """What to tell of a step that is too long."""
    fraction = found["fraction"]
    runs_away = found["error"] is None
    loud = not runs_away and found["error"] > _LOUD * found["noise"]
    if not runs_away:
        # Without any gap, or with one that noise makes, there is none that the step could make.
        noisy = found["gap"] <= _NOISY * found["noise"] and found["error"] < found["noise"]
        if fraction is None or (not loud and (fraction <= _DOUBTFUL or noisy)):
            return []
    step = f"{1e3 * found['step_size']:g} ms"
    what = "a model runs away" if found["halved"] else f"FMUs take no steps of half of {step}"
    what += ", so that the co-simulation's own error is not known"
    if not runs_away:
        what = f"halving the step of {step} changes the signals by {100 * fraction:.3g} % of the gap"
    if loud:
        times = found["error"] / found["noise"] if found["noise"] > 0.0 else math.inf
        what += f" and {times:.2g} times the noise: effects of that size may be the step's"
    remedy = (
        f"Set run.step_size to a part of {step} and the study's interval to {1e3 * found['interval']:g} ms, "
        "unless the step is a controller's sample time."
    )
    return [Warned(place="numerics", what=what, remedy=remedy)]
