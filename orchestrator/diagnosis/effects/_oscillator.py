"""A mass on a spring that hangs at the satellite: what appendages and sloshing liquids have in common."""

from __future__ import annotations

from numba import njit

from ..effect import Context

__all__ = ["body_force"]

_POSITION = int(Context.POSITION)
_VELOCITY = int(Context.VELOCITY)
_MASS = int(Context.MASS)


@njit(cache=True)
def body_force(step, value, context, memory, share, frequency, damping_ratio):
    """Force that gives software which knows the whole mass only the body's acceleration [N].

    Position and velocity of the mass, and whether it has begun, stand in `memory`; it begins at rest relative
    to the body.

    Args:
        step: [s]; value: force on the satellite [N].
        share: of the whole mass that hangs at the spring.
        frequency: [rad/s]; damping_ratio: [1].
    """
    if memory[2] == 0.0:
        memory[0], memory[1], memory[2] = context[_POSITION], context[_VELOCITY], 1.0
    stretch, rate = memory[0] - context[_POSITION], memory[1] - context[_VELOCITY]
    pull = -(frequency * frequency * stretch + 2.0 * damping_ratio * frequency * rate)
    memory[1] += step * pull
    memory[0] += step * memory[1]
    return (value - share * context[_MASS] * pull) / (1.0 - share)
