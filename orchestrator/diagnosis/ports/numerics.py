"""The co-simulation's own error, by halving its step, before anything is blamed on the system."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from ..finding import Augmented
from ..verdict import Warned
from .replay import PortReplay
from .steps import with_steps
from .study import PortStudy, Role

__all__ = ["doubts", "doubts_of_answer", "numerics"]

# A step whose halving changes more than this share of the gap is no step to diagnose with; nor one whose
# halving changes so many times the noise of the logs: effects of that size may be the step's.
_DOUBTFUL, _LOUD = 0.1, 2.0
# A gap of so many times the noise is noise.
_NOISY = 1.3
# Share of what the answer leaves at a port from which what halving changes there is much of it.
_MUCH = 0.5


def numerics(study: PortStudy, models: Mapping[str, Augmented]) -> dict[str, Any]:
    """What halving the communication step changes, as a fraction of the gap.

    Logs are fed on a curve through their samples, so that the hold of their values over a step, which acts
    as half a step's delay, counts as an error of the step, too. Instances with a step of their own keep it.
    Held-out runs; train runs where there are none.

    Args:
        models: by name; the gap is that of the first, the answer the last.
    Returns: `error`, the root mean square change at the compared ports over the spread of their logs, of the
        model that changes most; `gap`, between model and log; `noise`, of the logs as specified, both the
        same way; `fraction`, of error and gap; `step_size` and `interval` of the samples [s];
        `models`, the error of each; `ports`, of the answer: what halving changes there and what the answer
        leaves, root mean squares over the noise. None where a model runs away, or where FMUs take no step of
        half the length: then `halved` is false.
    """
    runs = study.of(Role.HELDOUT) or study.of(Role.TRAIN)
    shorter = with_steps(study, 2)
    step, fine = PortReplay(study, runs), PortReplay(study if shorter is None else shorter, runs)
    gaps: list[float] = []
    noises: list[float] = []
    errors: dict[str, float] = {}
    ports: dict[str, list[tuple[float, float]]] = {}
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
                noise = float(study.columns[port].noise or 0.0)
                if name == list(models)[-1] and noise > 0.0:
                    left = (log - coarse[port][study.settled :]) / noise
                    moved = apart * spread / noise
                    ports.setdefault(str(port), []).append(
                        (float(np.mean(moved**2)), float(np.mean(left**2)))
                    )
                if name == next(iter(models)):
                    gaps.append(float(np.mean(((log - coarse[port][study.settled :]) / spread) ** 2)))
                    noises.append((noise / spread) ** 2)
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
        "ports": {port: _rms(pairs) for port, pairs in ports.items() if known and np.isfinite(pairs).all()},
    }


def _rms(pairs: Sequence[tuple[float, float]]) -> dict[str, float]:
    """Of one port, over all runs, from mean squares."""
    changes, leaves = np.sqrt(np.mean(pairs, axis=0)).tolist()
    return {"changes": changes, "leaves": leaves}


def doubts(found: Mapping[str, Any]) -> list[Warned]:
    """What to say about a step that is too long."""
    fraction = found["fraction"]
    runs_away = found["error"] is None
    loud = not runs_away and found["error"] > _LOUD * found["noise"]
    if not runs_away:
        # Without any gap, or with one that noise makes, there is none that the step could make.
        noisy = found["gap"] <= _NOISY * found["noise"] and found["error"] < found["noise"]
        if fraction is None or (not loud and (fraction <= _DOUBTFUL or noisy)):
            return []
    step = _step(found)
    what = "a model runs away or ends early" if found["halved"] else f"FMUs take no steps of half of {step}"
    what += ", so that the co-simulation's own error is not known"
    if not runs_away:
        what = f"halving the step of {step} changes the signals by {100 * fraction:.3g} % of the gap"
    if loud:
        times = found["error"] / found["noise"] if found["noise"] > 0.0 else math.inf
        what += f" and {times:.2g} times the noise: effects of that size may be the step's"
    return [Warned(place="numerics", what=what, remedy=_shorter(found))]


def doubts_of_answer(found: Mapping[str, Any], fed: Collection[str] = ()) -> list[Warned]:
    """What to say about a step that is too long for the answer, though it may do for the system as believed.

    Dry friction and limits switch from one sample to the next: what a step misses of them is no effect's, but
    the answer's own numbers, or a further effect, make up for it.

    Args:
        found: see `numerics`, of models with the answer last; fed: ports whose logs go along a curve.
    """
    step, own = _step(found), found["models"].get("answer")
    if found["error"] is None:
        return []
    if own is None:
        what = f"the answer runs away in steps of half of {step}, so that its own error is not known"
        return [Warned(place="numerics", what=what, remedy=_shorter(found))]
    seen = {port: one for port, one in found["ports"].items() if one["changes"] > 1.0}
    share = own / found["gap"] if found["gap"] else 0.0
    much = {port: one for port, one in seen.items() if one["changes"] > _MUCH * one["leaves"]}
    if not seen or not (much or share > _DOUBTFUL):
        return []
    port, one = max((much or seen).items(), key=lambda item: item[1]["changes"])
    what = (
        f"with the answer, halving the step of {step} changes {port} by {one['changes']:.2g} times its "
        f"noise, where the answer leaves {one['leaves']:.2g}, and the signals by {100 * share:.2g} % of the "
        "gap: what is left, and the answer's numbers, may be the step's"
    )
    remedy = _shorter(found)
    if fed:
        remedy += f" Of what a digital controller gave ({', '.join(fed)}), say `hold: true`."
    return [Warned(place="numerics", what=what, remedy=remedy)]


def _step(found: Mapping[str, Any]) -> str:
    return f"{1e3 * found['step_size']:g} ms"


def _shorter(found: Mapping[str, Any]) -> str:
    return (
        f"Set run.step_size to a part of {_step(found)} and the study's interval to "
        f"{1e3 * found['interval']:g} ms, unless the step is a controller's sample time."
    )
