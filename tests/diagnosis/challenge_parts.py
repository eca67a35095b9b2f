"""Parts of the challenge's rig, each run by itself."""

from __future__ import annotations

from functools import cache

import numpy as np

from orchestrator.diagnosis.rig.challenge.contact import contact_force
from orchestrator.diagnosis.rig.challenge.draw import NOISE, RUNS, Plan, draw_case, make_run
from orchestrator.diagnosis.rig.challenge.draw import TICKS as RUN_TICKS
from orchestrator.diagnosis.rig.challenge.plant import fresh, integrate
from orchestrator.diagnosis.rig.challenge.rig import COLUMNS, drive
from orchestrator.diagnosis.rig.challenge.rig_parameters import rig_parameters
from orchestrator.diagnosis.rig.challenge.series import draw_series
from orchestrator.diagnosis.rig.challenge.software import (
    compensate,
    first_controller,
    first_satellite,
    move_satellite,
)

TICK = 1e-3
TICKS = 2000
PLANT = {
    "omega": 470.0,
    "xi": 0.8,
    "k": 1e5,
    "c": 50.0,
    "front": 0.005,
    "rear": -0.005,
    "cutoff": 1250.0,
}
REAR = PLANT["rear"] - PLANT["front"]
FORCE, ENCODER = COLUMNS.index("sensor_force"), COLUMNS.index("encoder_position")
RUN = RUNS[0]


def series_of(values):
    return draw_series(values, (0.0, 0.0), TICKS, np.random.SeedSequence(1))


def force_at(depth, rate=0.0, t=0.0, memory=(), **values):
    """Force on the rod at the front frame [N]."""
    _, remembered, *_ = fresh()
    s = fresh()[0]
    s[0], s[1] = PLANT["front"] + depth, rate
    for place, value in memory:
        remembered[place] = value
    return contact_force(rig_parameters({**PLANT, **values}), t, s, remembered)[0]


def moved(command, ticks, start=0.0, speed=0.0, **values):
    """Position of the rod, and force on it, at each tick, under commands by time; shape (2, ticks)."""
    p = rig_parameters({**PLANT, **values})
    s, memory, work, times, sensed = fresh()
    s[0], s[1] = start, speed
    count, out = 0, np.zeros((2, ticks))
    for n in range(ticks):
        now = n * TICK
        out[:, n] = s[0], contact_force(p, now, s, memory)[0]
        count = integrate(p, now, now + TICK, 2.5e-5, s, memory, command(now), work, times, sensed, count)
    return out


def pressed(now):
    """A command that goes 1 mm into the front frame and out again, within 0.2 s."""
    return 0.0045 + 0.0015 * np.sin(np.pi * min(now, 0.2) / 0.2) ** 2


def twice(now):
    """The same every 0.25 s."""
    return pressed(now % 0.25)


def pushed(force, tick=0, **values):
    """Speed after a tick of a satellite of 100 kg at rest [m/s]."""
    state = first_satellite(0.0)
    move_satellite(rig_parameters(values), 100.0, tick * TICK, TICK, force, 0.0, state)
    return state[1]


def answers(forces, desired=0.0, **values):
    """The controller's output at each of some forces; the rod stays where it is."""
    p, state, found = rig_parameters(values), first_controller(1e5, 50.0, 0.0, 0.0), []
    for force in forces:
        compensate(p, 1e5, 1.8e-3, TICK, force, 0.0, desired, 0.0, state)
        found.append(state[11])
    return np.array(found)


def lags(speed, **values):
    """By how much the rod lags behind a command of one speed [m/s], at each tick [m]."""
    found = moved(lambda now: speed * (now + 0.5 * TICK), 900, 0.0, speed, **values)[0]
    return speed * TICK * np.arange(900) - found


@cache
def smooth():
    """A rig that is as the lab believes, but for its calibration, and its first run."""
    case = draw_case(Plan("none", (), 0.0), 78, 1, roughness=0.0)
    return case, make_run(case, 0)


@cache
def driven(**rig_parameters):
    """Output of the rig's blocks without noise, driven by its log, with further parameters; the series."""
    case, log = smooth()
    values = {**case.values, "noise_scale": 0.0, **rig_parameters}
    series = draw_series(values, NOISE, RUN_TICKS, np.random.SeedSequence(1))
    return drive(case.lab, values, RUN.mass, RUN.speed, log, series), series


def rates(position):
    return np.gradient(position, TICK)
