"""Draws cases: a lab, its real rig with calibration errors, roughness and hidden effects, and its runs."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .hidden import TIED, Hidden, between, signed
from .rig import Array, Lab, simulate
from .rig_parameters import CALIBRATED
from .series import Series, draw_series


@dataclass(frozen=True)
class RunPlan:
    """A run that the lab makes: name, role, mass of the satellite software [kg], speed of approach [m/s]."""

    name: str
    role: str
    mass: float
    speed: float


RUNS = (
    RunPlan("train-1", "train", 279.07, 0.02),
    RunPlan("train-2", "train", 404.49, 0.02),
    RunPlan("train-3", "train", 521.74, 0.014),
    RunPlan("heldout-1", "heldout", 340.0, 0.024),
    RunPlan("heldout-2", "heldout", 279.07, 0.016),
    RunPlan("repeat-1", "repeat", 340.0, 0.024),
    RunPlan("repeat-2", "repeat", 279.07, 0.016),
)
TICKS = 3000
NOISE = (2e-6, 0.5)  # of encoder [m] and force sensor [N]

_TURN = 2.0 * np.pi
# What the lab's calibration leaves open: one standard deviation, SI; of the stiffness, relative.
_TOLERANCES = {
    "contact_damping": 5.0,
    "front_wall": 8e-6,
    "rear_wall": 8e-6,
    "natural_frequency": _TURN * 0.45,
    "damping_ratio": 0.01,
    "response_delay": 3e-5,
    "sensor_delay": 3e-5,
    "sensor_cutoff": 0.0,
    "force_bias": 0.15,
}
_STIFFNESS_TOLERANCE = 0.015
# Of every rig, by parameter; sizes are normal. There is some besides that differs from sample to sample.
ROUGHNESS = {
    "load": 4e-4,
    "coulomb": 4e-3,
    "encoder_wave": 5e-7,
    "onset": 1e-6,
    "cubic": 8e-4,
    "force_curve": 1e-5,
}
# Shares of the kinds of cases if pairs and kinds outside are requested.
SHARES = {"none": 4 / 16, "single": 6 / 16, "pair": 3 / 16, "outside": 3 / 16}


@dataclass(frozen=True)
class Plan:
    """Hidden effects of a case: kind (none, single, pair, outside), effects, their magnitude (1: strong)."""

    kind: str
    effects: tuple[Hidden, ...]
    magnitude: float


@dataclass(frozen=True)
class Case:
    """A lab and its real rig.

    Attributes:
        values: parameters of the real rig.
        plain: parameters of the same rig without the hidden effects.
        hidden: what each effect drew, by id.
    """

    plan: Plan
    lab: Lab
    values: Mapping[str, float]
    plain: Mapping[str, float]
    hidden: Mapping[str, Mapping[str, float]]
    seed: int
    number: int


def tolerances(lab: Lab) -> dict[str, float]:
    """Standard deviations of the lab's calibration by the names of case.yaml, SI."""
    return {"contact_stiffness": _STIFFNESS_TOLERANCE * lab.nominal["contact_stiffness"], **_TOLERANCES}


def plan_cases(
    count: int,
    seed: int,
    pool: Sequence[Hidden],
    outside: Sequence[Hidden] = (),
    pairs: bool = False,
    magnitude: float | None = None,
) -> list[Plan]:
    """Hidden effects of each case; all effects are used equally often.

    They are distributed by `SHARES`; kinds that are not requested become single effects.

    Args:
        magnitude: of every effect; None draws from 0.03 (nearly none) to 1.2 (strong), its logarithm uniform.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0]))
    kinds = ["none"] * round(SHARES["none"] * count)
    kinds += ["pair"] * (round(SHARES["pair"] * count) if pairs else 0)
    kinds += ["outside"] * (round(SHARES["outside"] * count) if outside else 0)
    kinds += ["single"] * (count - len(kinds))
    rng.shuffle(kinds)
    singles, others = _turns(rng, pool), _turns(rng, outside)
    plans = []
    alike = False
    for kind in kinds:
        size = between(rng, 0.03, 1.2) if magnitude is None else magnitude
        effects: tuple[Hidden, ...] = ()
        if kind == "single":
            effects = (next(singles),)
        elif kind == "outside":
            effects = (next(others),)
        elif kind == "pair":
            alike = not alike
            effects = _pair(rng, pool, alike)
        plans.append(Plan(kind, effects, size if effects else 0.0))
    return plans


def _turns(rng: np.random.Generator, pool: Sequence[Hidden]):
    while True:
        yield from (pool[i] for i in rng.permutation(len(pool)))


def _pair(rng: np.random.Generator, pool: Sequence[Hidden], alike: bool) -> tuple[Hidden, ...]:
    """Two effects, at one place or two, that can be distinguished in theory."""
    while True:
        first, second = (pool[i] for i in rng.choice(len(pool), 2, replace=False))
        if (first.place == second.place) != alike:
            continue
        if not any({first.id, second.id} <= group for group in TIED):
            return tuple(sorted((first, second), key=lambda one: one.id))


def draw_case(plan: Plan, seed: int, number: int, roughness: float = 1.0, tight: float = 1.0) -> Case:
    """A lab and its rig.

    Args:
        number: of the case, from 1.
        roughness: factor on all roughness; 0 makes a rig that is as smooth as the lab believes.
        tight: by how much the lab's tolerances are smaller than its errors.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, number, 0]))
    lab = _lab(rng)
    plain = {
        parameter: lab.nominal[name] + tight * sigma * float(np.clip(rng.standard_normal(), -2.5, 2.5))
        for name, parameter in CALIBRATED.items()
        for sigma in (tolerances(lab)[name],)
    }
    plain["c"] = max(plain["c"], 0.0)
    plain |= _roughness(rng, roughness)
    values, hidden = dict(plain), {}
    for effect in plan.effects:
        chance = np.random.default_rng(
            np.random.SeedSequence([seed, number, 1, zlib.crc32(effect.id.encode())])
        )
        hidden[effect.id] = effect.draw(chance, plan.magnitude)
        values = changed(values, effect, hidden[effect.id])
    return Case(plan, lab, values, plain, hidden, seed, number)


def changed(values: Mapping[str, float], effect: Hidden, drawn: Mapping[str, float]) -> dict[str, float]:
    """Parameters of a rig with an additional effect, from the effect's draws."""
    found = dict(values)
    for parameter, value in drawn.items():
        found[parameter] = (
            found[parameter] * (1.0 + value)
            if parameter in effect.relative
            else found.get(parameter, 0.0) + value
        )
    return found


def _lab(rng: np.random.Generator) -> Lab:
    nominal = {
        "contact_stiffness": float(rng.choice([176000.0, 120000.0, 70000.0])),
        "contact_damping": float(rng.choice([0.0, 50.0, 100.0])),
        "front_wall": 0.005,
        "rear_wall": -0.005,
        "natural_frequency": _TURN * 75.0,
        "damping_ratio": 0.8,
        "response_delay": 0.002,
        "sensor_delay": 0.001,
        "sensor_cutoff": _TURN * 200.0,
        "force_bias": 0.0,
    }
    return Lab(nominal)


def _roughness(rng: np.random.Generator, factor: float) -> dict[str, float]:
    """Roughness of every rig that no model contains, each kind with its own size."""
    sizes = factor * np.minimum(np.abs(rng.standard_normal(8)), 2.0)
    found = {
        "load": ROUGHNESS["load"] * sizes[0] * signed(rng),
        "coulomb": ROUGHNESS["coulomb"] * sizes[1],
        "encoder_wave": ROUGHNESS["encoder_wave"] * sizes[2],
        "encoder_pitch": between(rng, 5e-4, 4e-3),
        "onset": ROUGHNESS["onset"] * sizes[3],
        "cubic": ROUGHNESS["cubic"] * sizes[4] * signed(rng),
        "force_curve": ROUGHNESS["force_curve"] * sizes[5] * signed(rng),
        "wall_scatter": 6e-7 * sizes[6],
        "jitter": 8e-6 * sizes[7],
        "noise_scale": float(np.exp(0.01 * factor * rng.standard_normal())),
        # Every second sensor has a little noise that is not white.
        "colour": min(factor, 1.0) * NOISE[1] * between(rng, 0.15, 0.25) * float(rng.random() < 0.5),
        "colour_keep": between(rng, 0.8, 0.95),
    }
    return {name: float(value) for name, value in found.items()}


def run_series(case: Case, index: int, values: Mapping[str, float]) -> Series:
    """Random series of a run; they depend only on the parameters that describe the randomness."""
    return draw_series(values, NOISE, TICKS, np.random.SeedSequence([case.seed, case.number, 2, index]))


def make_run(case: Case, index: int) -> Array:
    """The logged columns of run `RUNS[index]`, shape (6, n), SI."""
    plan = RUNS[index]
    series = run_series(case, index, case.values)
    return simulate(case.lab, case.values, plan.mass, plan.speed, TICKS, series)
