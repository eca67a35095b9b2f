"""A mass on a spring that hangs at the satellite: what appendages and sloshing liquids have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ....base.compiled_functions import njit
from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site

_POSITION = int(Context.POSITION)
_VELOCITY = int(Context.VELOCITY)
_MASS = int(Context.MASS)


@njit()
def body_force(step, value, context, memory, share, frequency, damping_ratio):
    """Force that produces the body's acceleration in software that uses the total mass [N].

    Position and velocity of the mass, and whether it has begun, stand in `memory`; it begins at rest relative
    to the body.

    Args:
        step: [s]; value: force on the satellite [N].
        share: of the total mass that is attached to the spring.
        frequency: [rad/s]; damping_ratio: [1].
    """
    if memory[2] == 0.0:
        memory[0], memory[1], memory[2] = context[_POSITION], context[_VELOCITY], 1.0
    stretch, rate = memory[0] - context[_POSITION], memory[1] - context[_VELOCITY]
    pull = -(frequency * frequency * stretch + 2.0 * damping_ratio * frequency * rate)
    memory[1] += step * pull
    memory[0] += step * memory[1]
    return (value - share * context[_MASS] * pull) / (1.0 - share)


def hanging(
    name: str, words: str, source: str, law: Any, damping_ratio: float, starts: Sequence[float]
) -> Effect:
    """The effect of a hanging mass.

    Args:
        law: that calls `body_force` with this damping ratio [1].
        starts: frequencies that a fit begins from [rad/s].
    """
    return Effect(
        id=name,
        words=words,
        equation="m_a (q'' + 2 z w q' + w^2 q) = -m_a x'', (m - m_a) x'' = F - m_a (x'' + q''), "
        f"z = {damping_ratio:g}",
        source=source,
        parameters=(
            Parameter("mass", "1", 0.1, low=0.0, high=0.9, starts=(0.05,)),
            Parameter("frequency", "rad/s", 0.8, low=0.5, high=400.0, starts=tuple(starts), shape=True),
        ),
        site=Site.BODY,
        apply=law,
        memory=3,
        written=lambda t, rig: start(
            "satellite",
            hanging_share=(t["mass"], "1"),
            hanging_frequency=(t["frequency"], "rad/s"),
            hanging_damping=(damping_ratio, "1"),
        ),
    )
