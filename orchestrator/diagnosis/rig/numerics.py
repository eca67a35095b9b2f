"""The model's own numerical error, by halving its sub-steps, before anything is blamed on the rig."""

from __future__ import annotations

from typing import Any

import numpy as np

from .closure import one_contact_ahead
from .finding import NOMINAL, Finding
from .model import RigModel
from .motion import contacts
from .rig import SUBSTEPS
from .study import Role, Study


def numerics(study: Study, finding: Finding) -> dict[str, Any]:
    """Change by halving the sub-steps, as a fraction of the gap.

    Returns: `error`, the root mean square change of force over peak and velocity over approach speed, one
        contact ahead over the held-out runs, or those of training where there are none; `gap`, that between
        the model as handed over and the log; `fraction`, of the two; `substeps` per tick. Numbers are None
        without contacts. `replay_change`, root mean square, that of the encoder position over whole runs that
        the answer's model replays from the logged commands, and the encoder's `replay_noise` [m]: a servo at
        its limit may go another way, and then its replay says nothing of a run's end.
    """
    changes, gaps = [], []
    for run in study.of(Role.HELDOUT) or study.of(Role.TRAIN):
        among = contacts(study, run)
        for model in (NOMINAL, finding.answer):
            coarse = one_contact_ahead(study, run, model, among)
            fine = one_contact_ahead(study, run, model, among, 2 * SUBSTEPS)
            if model is NOMINAL:
                gaps += [float(np.mean(one**2)) for one, _ in coarse.traces]
            changes += [
                float(np.mean((one - other) ** 2))
                for (one, _), (other, _) in zip(coarse.traces, fine.traces, strict=True)
            ]
    whole = {"substeps": SUBSTEPS, **_whole_runs(study, finding)}
    if not gaps:
        return {"error": None, "gap": None, "fraction": None, **whole}
    error, gap = float(np.sqrt(np.mean(changes))), float(np.sqrt(np.mean(gaps)))
    return {"error": error, "gap": gap, "fraction": error / gap if gap > 0.0 else None, **whole}


def _whole_runs(study: Study, finding: Finding) -> dict[str, float]:
    """Change of the encoder over complete replays by halving the sub-steps, and its noise [m]."""
    model, answer = RigModel(study, study.runs), finding.answer
    both = model, model.finer()
    squares = []
    for index in range(len(study.runs)):
        coarse, fine = (one.replay(index, answer.calibrated, answer.effects, answer.theta)[2] for one in both)
        squares.append(float(np.mean((fine - coarse) ** 2)))
    return {"replay_change": float(np.sqrt(np.mean(squares))), "replay_noise": model.noise[0]}
