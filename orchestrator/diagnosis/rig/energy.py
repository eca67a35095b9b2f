"""Energy balance of each contact: what every interface adds to CoR^2 - 1, in the log and in the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .components import COMPONENTS
from .finding import NOMINAL, Augmented, Finding
from .model import RigModel
from .motion import Contact, contacts
from .restart import Restart
from .rig import Calibrated
from .study import Array, Role, Run, Study

# The wall as the satellite's position meets it, then what each component adds on the way around the loop.
INTERFACES = ("wall", *COMPONENTS)


@dataclass(frozen=True)
class Balance:
    """Energy of one contact, over the kinetic energy before it.

    Attributes:
        run: its name; contact: its window.
        change: CoR^2 - 1, of the log and of the model one contact ahead, shape (2,).
        measured, modelled: by `INTERFACES`, shape (5,); they add up to `change`.
    """

    run: str
    contact: Contact
    change: Array
    measured: Array
    modelled: Array


def balances(study: Study, run: Run, model: Augmented) -> list[Balance]:
    """Balances of all contacts of a run, beside those of a model from the same states."""
    restart = Restart(study, run, model)
    p = RigModel(study, [run]).parameters(0, model.calibrated, model.effects, model.theta)
    names = ("desired_position", "desired_velocity", "encoder_position", "sensor_force", "compensated_force")
    found = []
    for one in contacts(study, run):
        span = slice(one.begin, one.end)
        log = np.stack([run[name][span] for name in names])
        ahead = restart.ahead(one.begin, one.end - one.begin)[: len(names)]
        parts = [_works(signals, p, study.tick) for signals in (log, ahead)]
        change = np.array([(rate[-1] / rate[0]) ** 2 - 1.0 for rate in (log[1], ahead[1])])
        found.append(Balance(run.name, one, change, *parts))
    return found


def _works(signals: Array, p: Array, tick: float) -> Array:
    """Parts of CoR^2 - 1 by interface, from position, velocity, encoder, force and compensated force.

    v'^2 - v^2 = (v' + v)(v' - v) at each tick, and v' - v = (h/m) F + d, with d what the satellite software
    adds. The force F telescopes: that of the wall at the satellite's position, what the robot's departure
    from it changes, what the measured force adds to the wall's, what the controller adds to that. The sum is
    therefore exact, whatever law the wall really has.
    """
    position, velocity, encoder, force, compensated = signals
    impulse = tick / p[Calibrated.MASS]
    ideal, actual = (_wall(p, x, np.gradient(x, tick)) for x in (position, encoder))
    change = np.diff(velocity)
    shares = np.stack([ideal, actual - ideal, force - actual, compensated - force])[:, :-1] * impulse
    shares = np.vstack([shares, change - impulse * compensated[:-1]])
    return (shares * (velocity[1:] + velocity[:-1])).sum(axis=1) / velocity[0] ** 2


def _wall(p: Array, x: Array, rate: Array) -> Array:
    """Force of the frames on the rod as calibrated, shape (n,) [N]."""
    side = (x > p[Calibrated.FRONT_WALL]).astype(float) - (x < p[Calibrated.REAR_WALL])
    depth = np.where(side > 0, x - p[Calibrated.FRONT_WALL], p[Calibrated.REAR_WALL] - x)
    push = p[Calibrated.CONTACT_STIFFNESS] * depth + p[Calibrated.CONTACT_DAMPING] * side * rate
    return -side * np.maximum(push, 0.0)


def energy(study: Study, finding: Finding) -> dict[str, Any]:
    """Energy balance of the held-out contacts; of the training runs' where nothing was held out.

    Returns: `interfaces`; means over contacts of `measured`, `nominal` (the model as handed over), `excess`
        (their difference) and `answer` (of the model with the effects), by interface; `change`, CoR^2 - 1,
        which each adds up to; and `contacts`, the excess one by one. Empty without contacts.
    """
    runs: Sequence[Run] = study.of(Role.HELDOUT) or study.of(Role.TRAIN)
    nominal = [one for run in runs for one in balances(study, run, NOMINAL)]
    answer = [one for run in runs for one in balances(study, run, finding.answer)]
    if not nominal:
        return {}
    measured = np.mean([one.measured for one in nominal], axis=0)
    believed = np.mean([one.modelled for one in nominal], axis=0)
    balance = {
        "measured": measured,
        "nominal": believed,
        "excess": measured - believed,
        "answer": np.mean([one.modelled for one in answer], axis=0),
    }
    return {
        "interfaces": list(INTERFACES),
        **{name: dict(zip(INTERFACES, value.tolist(), strict=True)) for name, value in balance.items()},
        "change": {name: float(value.sum()) for name, value in balance.items()},
        "contacts": [
            {
                "run": one.run,
                "time": one.contact.first * study.tick,
                "change": float(one.change[0]),
                "excess": float(one.change[0] - one.change[1]),
                "by_interface": dict(zip(INTERFACES, (one.measured - one.modelled).tolist(), strict=True)),
            }
            for one in nominal
        ],
    }
