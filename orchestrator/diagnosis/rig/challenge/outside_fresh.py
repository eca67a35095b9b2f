"""Further kinds of effects outside the catalogue, made without knowledge of the diagnosis.

Nothing that weighs candidates may import this module, nor be fitted to what it holds: see `outside` for those
that were known when the diagnosis was made.
"""

from __future__ import annotations

import numpy as np

from .hidden import Draw, between, draws, free, kinds, sized, turns, whole


def _tracker(rng: np.random.Generator, size: float) -> dict[str, float]:
    # What it errs by where all speeds up grows with the square of its memory [ticks].
    memory = float(np.sqrt(size)) * between(rng, 2.5, 5.0)
    return {"tracker": memory / (1.0 + memory)}


_DRAWS: dict[str, Draw] = {
    "robot.feed-forward": draws(forward=sized(0.15, 0.5)),
    "robot.idle-switches": draws(idle=sized(0.9, 3.2)),
    "structure.hunting-axis": draws(hunt=sized(4e-6, 1.5e-5), hunt_omega=turns(1.2, 5.0)),
    "structure.yawing-slide": draws(yaw=sized(8e-6, 3e-5, sign="first"), yaw_length=free(5e-5, 3e-4)),
    "sensor.ghost-channel": draws(ghost=sized(120.0, 450.0, sign="first")),
    "sensor.filling-buffer": draws(buffer=sized(7e-4, 2.5e-3), buffer_period=free(0.08, 0.6)),
    "sensor.drive-noise": draws(buzz=sized(0.7, 2.5)),
    # Mounted again for each run.
    "contact.clay": draws(clay=sized(1.5e-5, 6e-5), clay_impulse=free(3.0, 15.0)),
    "contact.wire-rope": draws(rope=sized(2.0, 7.0), rope_length=free(5e-5, 3e-4)),
    "contact.suction-cup": draws(cup=sized(2.0, 7.0), cup_reach=free(8e-5, 4e-4)),
    "link.tracking-filter": _tracker,
    "link.wandering-delay": draws(wander=sized(2e-4, 8e-4), wander_time=free(0.06, 0.5)),
    "dynamics.force-rezeroed": draws(rezero=sized(0.09, 0.35)),
    "dynamics.drift-correction": draws(corrected=sized(20.0, 80.0)),
    "controller.dull-derivative": draws(dull=sized(0.4, 0.8, most=1.2)),
    "controller.late-release": draws(release=whole(5.0, 18.0)),
}

FRESH = kinds(_DRAWS, {"sensor.drive-noise", "link.wandering-delay"})
