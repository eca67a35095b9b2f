"""The servo has a highest speed, or a highest acceleration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter, savgol_filter

from ..config_changes import start
from ..effect import Effect, Parameter, Seen, Site, law

# Ticks over which speeds and accelerations are taken.
_TICKS = 61
# Share of the highest speed at which a servo counts as limited. A limit lies there or a little above: a servo
# is faster for a moment after each command, and the limit then shows in its mean speed alone.
_AT, _ABOVE = 0.99, (1.0, 1.0025, 1.005, 1.01, 1.02)
# An acceleration is bounded where commands ask for so many times as much.
_BOUNDED = 1.5
# Ticks in which a servo forgets that it stood still.
_BEGIN = 64
# A servo that runs into its limit again and again goes far astray with a limit that is a little off: starts
# lie so far around the one seen, so many of them.
_AROUND, _STARTS = 0.04, 17
# Of the largest acceleration that commands ask for: limits that show seldom, or little.
_SELDOM = (0.95, 0.8, 0.65, 0.5, 0.35)


@law
def _law(time, step, value, context, memory, theta):
    return min(max(value, -theta[0]), theta[0])


def _rates(signals: Sequence[NDArray[np.float64]], tick: float, order: int) -> NDArray[np.float64]:
    """Sizes of derivatives of positions, of all runs in a row."""
    found = [savgol_filter(one, _TICKS, 2, deriv=order, delta=tick) for one in signals]
    return np.abs(np.concatenate(found))


def _propose_speeds(seen: Seen) -> Sequence[tuple[float, ...]]:
    """A limit shows as the speed that the robot has wherever it is fast.

    A servo at its limit falls behind: with a limit that is a little off a replay is soon far away, and no
    derivative leads from there to the right one.
    """
    if min(map(len, seen.position)) <= _TICKS:
        return []
    found = _rates(seen.position, seen.tick, 1)
    highest = float(np.quantile(found, 0.995))
    if highest == 0.0:
        return []
    shown = float(np.median(found[found > _AT * highest]))
    return [(factor * shown,) for factor in _ABOVE]


def _propose_accelerations(seen: Seen) -> Sequence[tuple[float, ...]]:
    """A limit shows as the size that the acceleration mostly has, while commands ask for more; one that is
    seldom reached lies below the largest acceleration that they ask for.
    """
    seldom = [(_largest(seen) * share,) for share in _SELDOM]
    if min(map(len, seen.position)) <= _TICKS:
        return seldom
    found, asked = (_rates(signals, seen.tick, 2) for signals in (seen.position, seen.commands))
    highest = float(np.quantile(found, 0.99))
    if float(np.quantile(asked, 0.99)) < _BOUNDED * highest:
        return seldom
    limit = float(np.median(found[found > 0.5 * highest]))
    return [(limit * factor,) for factor in np.linspace(1.0 - _AROUND, 1.0 + _AROUND, _STARTS).tolist()]


def _largest(seen: Seen) -> float:
    """The largest acceleration of a servo without limit: it jumps where a command arrives [m/s2]."""
    omega, xi, _ = seen.lag
    servo = ([omega**2, 0.0, 0.0], [1.0, 2.0 * xi * omega, omega**2])
    above, below, _ = cont2discrete(servo, seen.tick)
    begun = (np.abs(lfilter(above[0], below, run - run[0])[_BEGIN:]) for run in seen.commands)
    return max(float(run.max(initial=0.0)) for run in begun)


EFFECTS = (
    Effect(
        id="robot.acceleration-limit",
        words="The servo has a highest acceleration",
        equation="|x''| <= A",
        source="Slotine, Li: Applied Nonlinear Control, ch. 5",
        parameters=(
            Parameter("limit", "m/s2", 1.0, low=0.01, high=1000.0, starts=(0.1, 0.3, 0.8), shape=True),
        ),
        site=Site.LIMIT,
        apply=_law,
        written=lambda t, rig: start("robot", acceleration_limit=(t["limit"], "m/s2")),
        propose=_propose_accelerations,
    ),
    Effect(
        id="robot.rate-limit",
        words="The servo has a highest speed",
        equation="|x'| <= V",
        source="Slotine, Li: Applied Nonlinear Control, ch. 5",
        parameters=(Parameter("limit", "m/s", 1.0, low=0.001, high=10.0, starts=(0.015, 0.022), shape=True),),
        site=Site.RATE,
        apply=_law,
        written=lambda t, rig: start("robot", rate_limit=(t["limit"], "m/s")),
        propose=_propose_speeds,
    ),
)
