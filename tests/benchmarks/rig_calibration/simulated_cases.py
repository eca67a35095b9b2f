"""Simulated cases for learning: the challenge's rig with hardware effects, or effects outside the catalogue.

Kinds outside the catalogue are made here, by deforming what was logged; others are those of the challenge's
own that are known. Its fresh ones are kept for blind checks.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from orchestrator.diagnosis.rig.challenge import draw, hidden
from orchestrator.diagnosis.rig.challenge.hidden import between
from orchestrator.diagnosis.rig.challenge.rig import COLUMNS, FORCE_RESOLUTION, POSITION_RESOLUTION, TICK
from orchestrator.diagnosis.rig.misfit import stretches
from orchestrator.diagnosis.rig.study import Array, Nominal, Role, Run, Study

__all__ = ["ODDITIES", "bare_study", "logged", "observed", "simulated_case", "simulated_study"]

# Of `COLUMNS` as logged; the force's resolution is 0.1 N.
_DIGITS = (9, 9, 6, 1, 4, 1)
# Cases are taken from a plan of so many, so that the first ones do not depend on how many are asked for.
_PLANNED = 1000
# Other labs' rigs are smoother or rougher than that of the challenge.
_ROUGHNESS = (0.5, 2.0)


@dataclass(frozen=True)
class _Logged:
    """Signals to be deformed: encoder position [m] and force [N] by tick, shape (n,); random for each run."""

    position: Array
    force: Array
    chance: np.random.Generator

    @property
    def time(self) -> Array:
        return TICK * np.arange(len(self.force))

    @property
    def velocity(self) -> Array:
        """Smoothed [m/s]."""
        return np.convolve(np.gradient(self.position, TICK), np.ones(9) / 9.0, "same")


_Deform = Callable[[_Logged, np.random.Generator, float], _Logged]


def _beat(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """The sensor's sensitivity rises and falls."""
    wave = np.sin(2.0 * np.pi * between(rng, 1.0, 6.0) * log.time + rng.uniform(0.0, 6.0))
    return replace(log, force=log.force * (1.0 + size * between(rng, 0.08, 0.25) * wave))


def _ringing(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """The sensor's body rings."""
    omega, damping = 2.0 * np.pi * between(rng, 60.0, 200.0) * TICK, between(rng, 0.03, 0.1)
    a = [1.0, -2.0 * np.exp(-damping * omega) * np.cos(omega), np.exp(-2.0 * damping * omega)]
    rung = lfilter([sum(a)], a, log.force)
    return replace(log, force=log.force + size * between(rng, 0.2, 0.6) * (rung - log.force))


def _tether(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """A cable pulls at the sensor, in proportion to the position."""
    return replace(log, force=log.force - size * between(rng, 150.0, 600.0) * log.position)


def _encoder_walk(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """The encoder loses counts at random."""
    n = len(log.position)
    lost = (log.chance.random(n) < 4.0 * TICK) * log.chance.standard_normal(n)
    return replace(log, position=log.position + size * between(rng, 1.5e-5, 5e-5) * np.cumsum(lost))


def _vibration(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """The floor shakes the robot."""
    wave = np.sin(2.0 * np.pi * between(rng, 4.0, 40.0) * log.time + rng.uniform(0.0, 6.0))
    return replace(log, position=log.position + size * between(rng, 8e-6, 4e-5) * wave)


def _warming(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """The robot's arm grows as it warms up."""
    growth = hidden.signed(rng) * between(rng, 2e-5, 1e-4) * (1.0 - np.exp(-log.time))
    return replace(log, position=log.position + size * growth)


def _spot(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """The rod is held at one position."""
    near = np.exp(-(((log.position - rng.uniform(-0.004, 0.004)) / between(rng, 3e-4, 1e-3)) ** 2))
    return replace(log, force=log.force + size * hidden.signed(rng) * between(rng, 3.0, 10.0) * near)


def _ringing_rod(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """The rod rings after each hit."""
    hit = np.flatnonzero(np.diff((np.abs(log.force) > 6.0).astype(int)) == 1)
    struck = np.zeros(len(log.force))
    struck[hit] = np.sign(log.force[hit])
    t = np.arange(0.0, 0.15, TICK)
    ring = np.exp(-t / between(rng, 0.01, 0.04)) * np.sin(2.0 * np.pi * between(rng, 60.0, 220.0) * t)
    wave = np.convolve(struck, ring)[: len(struck)]
    return replace(log, force=log.force + size * between(rng, 4.0, 15.0) * wave)


def _rubbing(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """The rod rubs in its guide, in flight as in contact."""
    push = np.tanh(log.velocity / 2e-3)
    return replace(log, force=log.force - size * between(rng, 1.0, 4.0) * push)


def _bristles(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """The frames carry bristles that push before the rod touches."""
    push, reach = size * between(rng, 0.5, 2.5), between(rng, 5e-5, 6e-4)
    force = log.force.copy()
    for way, touched in ((1.0, log.force < -6.0), (-1.0, log.force > 6.0)):
        if touched.any():
            gap = np.min(way * log.position[touched]) - way * log.position
            force -= way * push * np.exp(-np.maximum(gap, 0.0) / reach)
    return replace(log, force=force)


def _unsettled(log: _Logged, rng: np.random.Generator, size: float) -> _Logged:
    """The sensor's zero is another in each contact."""
    zero, spread = np.zeros(len(log.force)), size * between(rng, 0.5, 2.5)
    for contact in stretches(np.abs(log.force) > 6.0):
        zero[contact] = spread * log.chance.standard_normal()
    return replace(log, force=log.force + zero)


_DEFORMED: dict[str, _Deform] = {
    "sensor.beat": _beat,
    "sensor.ringing": _ringing,
    "sensor.tether": _tether,
    "robot.encoder-walk": _encoder_walk,
    "robot.vibration": _vibration,
    "robot.warming": _warming,
    "contact.spot": _spot,
    "contact.ringing": _ringing_rod,
    "contact.rubbing": _rubbing,
    "contact.bristles": _bristles,
    "sensor.unsettled": _unsettled,
}


def _no_parameters(rng: np.random.Generator, size: float) -> dict[str, float]:
    """No parameters: these effects act on the log, not in the rig."""
    return {}


ODDITIES = tuple(hidden.Hidden(name, _no_parameters) for name in _DEFORMED)


def simulated_case(seed: int, number: int, tight: float = 1.0, plan: draw.Plan | None = None) -> draw.Case:
    """A case of the challenge's rig.

    Args:
        tight: by how much the lab's tolerances are smaller than its errors.
        plan: what is hidden; by default what the number has in a plan of many cases.
    """
    plan = plan or draw.plan_cases(_PLANNED, seed, hidden.HARDWARE, ODDITIES, True)[number - 1]
    rng = np.random.default_rng(np.random.SeedSequence([seed, number, 3]))
    return draw.draw_case(plan, seed, number, between(rng, *_ROUGHNESS), tight)


def logged(case: draw.Case, roles: Collection[Role] = tuple(Role)) -> dict[int, Array]:
    """Logs of a case before they are deformed, shape (6, n), SI, by index in `draw.RUNS`."""
    return {
        index: draw.make_run(case, index) for index, run in enumerate(draw.RUNS) if Role(run.role) in roles
    }


def simulated_study(
    seed: int,
    number: int,
    tight: float = 1.0,
    plan: draw.Plan | None = None,
    roles: Collection[Role] = tuple(Role),
) -> tuple[Study, draw.Plan]:
    """A case with a hidden effect of the rig's hardware, or outside the catalogue.

    Args:
        seed, number, tight, plan: see `simulated_case`; roles: of the runs that are made.
    """
    case = simulated_case(seed, number, tight, plan)
    logs = logged(case, roles)
    if case.plan.kind == "outside" and case.plan.effects[0].id in _DEFORMED:
        logs = {index: _deformed(case, index, log) for index, log in logs.items()}
    return observed(case, logs), case.plan


def _deformed(case: draw.Case, index: int, log: Array) -> Array:
    """A log with a hidden effect outside the catalogue; size and kind are equal in every run."""
    rng = np.random.default_rng(np.random.SeedSequence([case.seed, case.number, 4]))
    chance = np.random.default_rng(np.random.SeedSequence([case.seed, case.number, 5, index]))
    rows = dict(zip(COLUMNS, log, strict=True))
    made = _Logged(rows["encoder_position"], rows["sensor_force"], chance)
    made = _DEFORMED[case.plan.effects[0].id](made, rng, case.plan.magnitude)
    rows |= {"encoder_position": made.position, "sensor_force": made.force}
    return np.stack(list(rows.values()))


def observed(case: draw.Case, logs: Mapping[int, Array]) -> Study:
    """The study of a case as its files describe it: the nominal rig, and logs of some runs.

    Args:
        logs: rows by `COLUMNS`, each of shape (6, n), SI, by index in `draw.RUNS`.
    """
    tolerances = draw.tolerances(case.lab)
    nominal = {name: Nominal(value, tolerances.get(name, 0.0)) for name, value in case.lab.nominal.items()}
    specified = zip(
        ("encoder_noise", "force_noise", "encoder_resolution", "force_resolution"),
        (*draw.NOISE, POSITION_RESOLUTION, FORCE_RESOLUTION),
        strict=True,
    )
    nominal |= {name: Nominal(value, 0.0) for name, value in specified}
    runs = []
    for index, log in logs.items():
        columns = {
            name: np.round(row, digits) for name, row, digits in zip(COLUMNS, log, _DIGITS, strict=True)
        }
        columns["time"] = TICK * np.arange(log.shape[1])
        run = draw.RUNS[index]
        runs.append(Run(run.name, Role(run.role), run.mass, run.speed, columns))
    return Study(f"case-{case.number:04d}", TICK, nominal, tuple(runs))


def bare_study(seed: int, number: int, roles: Collection[Role] = tuple(Role)) -> Study:
    """A case without hidden effects, with calibration errors and roughness."""
    return simulated_study(seed, number, plan=draw.Plan("none", (), 0.0), roles=roles)[0]
