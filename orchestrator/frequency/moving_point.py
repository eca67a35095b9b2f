"""Which roots hold for one moment only: the run moves the operating point on before they could act.

A root s states how motion grows or decays within 1/|s|. At a point where a run does not rest, the linear
equations change meanwhile. The run goes on from there, and the equations are taken again at later instants:
where a root has changed by a share of itself within its own 1/|s|, it says nothing about the run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..base.errors import OrchestratorError
from ..master.running_instances import Instances, instantiate
from ..simulation.run import Prepared
from .from_system import Linearised
from .modes import Modes
from .statespace import StateSpace

# A root that changes by more than this share of itself does not hold; ratio of the instants looked at.
_CHANGED, _RATIO = 0.3, 1.4
# Communication steps that the run goes on for at most.
_MOST = 2000
# Matrices and signals that differ by less, relative to their largest number, are the same.
_SAME = 1e-9


def momentary_roots(prepared: Prepared, linear: Linearised, modes: Modes) -> dict[complex, float]:
    """Roots that hold for one moment only.

    Equations of measured instances and delays are taken to stay as they are. A run that fails is followed
    until then.

    Args:
        prepared: the checked system, with the start values that it is linear around.
        linear: around the start or a time of the run.
        modes: of the linear system.
    Returns: by root, the time within which it changes by 30 % [s]; empty if the run rests at the point, or if
        a measure of the config chose it.
    """
    if linear.chosen:
        return {}
    size = max((abs(one.root) for one in modes.modes), default=0.0)
    left = [one.root for one in modes.modes if abs(one.root) > 1e-9 * size]
    found: dict[complex, float] = {}
    try:
        with instantiate(prepared.system) as instances:
            _follow(prepared, linear, instances, list(dict.fromkeys(left)), found)
    except OrchestratorError:
        pass
    return found


def _follow(
    prepared: Prepared,
    linear: Linearised,
    instances: Instances,
    left: list[complex],
    found: dict[complex, float],
) -> None:
    grid, step = prepared.grid, float(prepared.grid.step_size)
    signals = instances.initialise(float(grid.start), float(grid.stop))
    begin = float(grid.start) if linear.time is None else linear.time
    after, first = step, None
    for point in grid:
        passed = point.time - begin
        if passed > (_MOST + 0.5) * step:
            break
        if abs(passed) < 0.5 * step:
            first = signals.values.copy()
            before = linear.parts_at(prepared, instances)
        elif first is not None:
            if passed < 1.5 * step and _same([first], [signals.values]):
                return
            if passed >= after - 1e-9 * step:
                after = max(_RATIO * after, passed + step)
                left = [root for root in left if passed <= 1.0 / abs(root)]
                changed = _changed(linear, before, linear.parts_at(prepared, instances), left)
                found |= dict.fromkeys(changed, passed)
                left = [root for root in left if root not in changed]
                if not left:
                    return
        if point.last:
            break
        signals, info = prepared.master.step(instances.system, instances, point, signals)
        info.raise_on_failure(point)


def _changed(
    linear: Linearised, before: Mapping[str, StateSpace], now: Mapping[str, StateSpace], roots: list[complex]
) -> list[complex]:
    """Those of the roots that differ by more than `_CHANGED` of themselves with the state spaces of now."""
    matrices = ([m for one in each.values() for m in (one.a, one.b, one.c, one.d)] for each in (before, now))
    if _same(*matrices):
        return []
    system = linear.closed(now)
    near = {root: system.root_near(root) for root in roots}
    return [root for root, one in near.items() if one is None or abs(one - root) > _CHANGED * abs(root)]


def _same(some: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> bool:
    return all(
        np.max(abs(one - other), initial=0.0) <= _SAME * np.max(abs(one), initial=0.0)
        for one, other in zip(some, others, strict=True)
    )
