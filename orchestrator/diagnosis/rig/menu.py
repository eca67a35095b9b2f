"""Experiments that a lab can make with a docking rig, as its model can simulate them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .effect import Effect, Parameter, Site, law
from .study import Array, Study

_FLIGHT_STROKE = 0.003  # within the walls of the rig
_ACCELERATION = 2.0  # that its robot follows [m/s2]


@dataclass(frozen=True)
class Load:
    """A known force on the rod's tip, beside that of the walls.

    Attributes:
        effect: whose law adds it, at Site.FORCE; theta: its parameters.
    """

    effect: Effect
    theta: tuple[float, ...]


@dataclass(frozen=True)
class Experiment:
    """Something to run next.

    Attributes:
        name, description: for the lab.
        mass: of the satellite software [kg]; approach_speed [m/s]; those of the first run where None.
        rod: stiffness of the rod over that of the present one; it is as well calibrated, in proportion.
        levers: distances of the contact line from where it is meant to pass, one run each [m].
        motion: commanded position [m] over time [s], shape (n,), instead of the closed loop.
        load: on the rod's tip.
        tracker: standard deviation of a measurement of the tip's position [m]; 0 where there is none.
        ticks: of each run.
    """

    name: str
    description: str
    mass: float | None = None
    approach_speed: float | None = None
    rod: float = 1.0
    levers: tuple[float, ...] = (0.0,)
    motion: Callable[[Array], Array] | None = None
    load: Load | None = None
    tracker: float = 0.0
    ticks: int = 1500


@law
def _stairs(time, step, value, context, memory, theta):
    whole = math.floor(time / theta[1])
    return value - theta[0] * (whole + min((time / theta[1] - whole) * theta[1] / theta[2], 1.0))


@law
def _blows(time, step, value, context, memory, theta):
    since = time - theta[2] * math.floor(time / theta[2])
    return value - theta[0] * math.sin(math.pi * since / theta[1]) if since < theta[1] else value


def _load(name: str, apply: object, theta: tuple[float, ...]) -> Load:
    parameters = tuple(Parameter(f"p{place}", "1", 1.0) for place in range(len(theta)))
    return Load(Effect(f"load.{name}", name, "known load", parameters, site=Site.FORCE, apply=apply), theta)


_WEIGHTS = _load("weights", _stairs, (40.0, 0.3, 0.1))  # 40 N more every 0.3 s, let go within 0.1 s
_HAMMER = _load("hammer", _blows, (100.0, 0.004, 0.1))  # half sines of 100 N and 4 ms, ten a second


def _still(time: Array) -> Array:
    return np.zeros_like(time)


def _chirp(time: Array) -> Array:
    """From 1 to 60 Hz over the run, bounded in stroke and acceleration."""
    rate = math.log(60.0) / time[-1]
    frequency = np.exp(rate * time)
    phase = 2.0 * np.pi * (frequency - 1.0) / rate
    stroke = np.minimum(_FLIGHT_STROKE, _ACCELERATION / (2.0 * np.pi * frequency) ** 2)
    return stroke * np.sin(phase)


def _pressed(time: Array) -> Array:
    """Into the front frame, and a chirp from 2 to 40 Hz upon it."""
    rate = math.log(20.0) / time[-1]
    phase = 2.0 * np.pi * 2.0 * (np.exp(rate * time) - 1.0) / rate
    approach = 0.0058 * np.clip(time / 0.3, 0.0, 1.0)
    return approach + 0.0003 * np.sin(phase) * np.clip(time / 0.3 - 1.0, 0.0, 1.0)


def _reversals(time: Array) -> Array:
    """A triangle of 4 mm at 16 mm/s."""
    return 0.004 * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * time))


# Their order is that of effort, cheapest first: of equals the first is taken.
MENU = (
    Experiment("light satellite", "a contact with 150 kg", mass=150.0),
    Experiment("heavy satellite", "a contact with 900 kg", mass=900.0, ticks=2000),
    Experiment("slow approach", "contacts at 8 mm/s", approach_speed=0.008, ticks=3000),
    Experiment("fast approach", "contacts at 50 mm/s", approach_speed=0.05),
    Experiment("soft rod", "a rod with 0.3 times the stiffness", rod=0.3, ticks=2000),
    Experiment("stiff rod", "a rod with 2.5 times the stiffness", rod=2.5),
    Experiment("free-flight chirp", "command a chirp of 1 to 60 Hz between the frames", motion=_chirp),
    Experiment("slow reversals", "command a triangle of 4 mm at 16 mm/s", motion=_reversals, ticks=3000),
    Experiment("pressed chirp", "press into the front frame, command 2 to 40 Hz upon it", motion=_pressed),
    Experiment("dead weights", "hang known weights on the rod, 40 N each", motion=_still, load=_WEIGHTS),
    Experiment("tip tracker", "contacts with a laser on the rod's tip (5 um)", tracker=5e-6),
    Experiment(
        "dead weights with tip tracker",
        "hang known weights on the rod, 40 N each, with a laser on its tip (5 um)",
        motion=_still,
        load=_WEIGHTS,
        tracker=5e-6,
    ),
    Experiment(
        "hammer",
        "tap the rod with a hammer that measures its force (100 N, 4 ms)",
        motion=_still,
        load=_HAMMER,
    ),
    Experiment(
        "off-axis contact", "contacts with the contact line moved by 0.3 m to either side", levers=(0.3, -0.3)
    ),
)


def menu_of(study: Study) -> tuple[Experiment, ...]:
    """The menu, and after it a study's own experiments; one of the same name takes the other's place."""
    own = {one["name"]: Experiment(**one) for one in study.experiments}
    return tuple(({one.name: one for one in MENU} | own).values())
