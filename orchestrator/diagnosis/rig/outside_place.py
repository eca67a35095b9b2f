"""Where something outside the catalogue acts on the way from the link to the sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .fit import Fit
from .held_out import Judge
from .misfit import near_contact, unexplained
from .nuisance import along_way, positions, touching
from .residual_evidence import ResidualEvidence
from .study import Array

# Log evidence of a line, of samples that stay put or stand out, from which the sensor is where it comes from
# [nats].
_CLEAR = 20.0
# Log likelihood of a period in the link from which it is where something outside the catalogue acts: other
# things shake commands as well [nats].
_PERIOD = 3.0
# Share of what the encoder deviates that a wave along the way explains, from which the robot is where it
# comes from.
_WAY = 0.5
# Variances that residuals may have where a run is fastest, over that of the noise.
_VARIANCES = np.geomspace(1e-2, 1e8, 60)
# Log likelihood of commands at wrong times from which the link is where it comes from, and what it may cost
# to take for them what keeps a period [nats].
_WRONG, _CHANCE = 15.0, 50.0
# Samples of a run that say about its flights, or of its contacts.
_FEWEST = 100


def place_outside(judge: Judge, none: Fit, sensor_only: float, regular: float) -> str:
    """Place of an unknown effect, link, robot, contact or sensor, from the residual of all effects.

    An effect that imitates what is there leaves what it happens to, anywhere.

    Args:
        judge: of what fits leave; none: the fit of the calibration alone.
        sensor_only: log evidence of what only a sensor makes of a force, as a line [nats].
        regular: log likelihood that what is random in the link keeps a period [nats].
    """
    by, fit, _ = judge.carried(none)
    model, left = by.weighing.model, by.fitter.marginal.left(fit.residuals)
    late = wrong_times(left[0::2], positions(model, fit))
    # A line in the force shakes the commands, too: with more evidence for that, it comes from there. What
    # comes back at the same places of the way, as cogging, comes back in time where the robot's speed is one.
    if late > (-_CHANCE if regular > _PERIOD else _WRONG) and not sensor_only > max(_CLEAR, regular):
        if not along_way(model, left) > _WAY:
            return "link"
    return part_of_chain(judge.leaves(none).every, left[1::2], touching(model, fit), sensor_only)


def wrong_times(channels: Sequence[Array], positions: Sequence[Array]) -> float:
    """Log likelihood that residuals of the encoder are of commands at wrong times, over even ones [nats].

    Such are as large as the robot is fast: their variance goes with the square of the speed. What shakes or
    creeps goes on where it turns.

    Args:
        channels: residuals over their noise, by run; positions: of the robot, of the same samples.
    """
    evidence = 0.0
    for r, x in zip(channels, positions, strict=True):
        square, speed = r**2, np.abs(np.gradient(x))
        if not np.isfinite(square).all():
            continue
        even = max(float(np.mean(square)), 1.0)
        growing = 1.0 + np.outer(_VARIANCES, (speed / max(float(speed.max()), 1e-12)) ** 2)
        costs = 0.5 * np.sum(np.log(growing) + square / growing, axis=1)
        evidence += 0.5 * (len(r) * math.log(even) + float(np.sum(square)) / even) - float(costs.min())
    return evidence


def part_of_chain(
    rest: ResidualEvidence, forces: Sequence[Array], touching: Sequence[Array], sensor_only: float
) -> str:
    """The robot, the contact, or the sensor, which shows beside contacts, too.

    What acts in the structure shows as the contact's.

    Args:
        rest: what none leaves; forces: its residuals of the force, by run.
        touching: whether the rod touches at each tick, by run.
        sensor_only: see `place_outside`.
    """
    within = [near_contact(one)[: len(r)] for one, r in zip(touching, forces, strict=True)]
    flights, contacts = (
        unexplained([r[some] for some, r in zip(where, forces, strict=True) if some.sum() > _FEWEST])
        for where in ([~one for one in within], within)
    )
    contacts = max(contacts, rest.contact)
    moved = max(rest.encoder, rest.moved, rest.shaken)
    pushed = max(rest.force, rest.pushed, rest.struck, rest.repeated, contacts, flights)
    if sensor_only > _CLEAR and pushed + sensor_only > moved:
        return "sensor"
    if moved > pushed:
        return "robot"
    return "sensor" if flights > contacts else "contact"
