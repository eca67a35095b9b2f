"""Make a case: a system, logs of a copy that hides laws, and the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...base.arrays import Array
from .draw import draw
from .hidden import Sizes, choices, outside, scaled
from .plant import Acting, Drawn, Drive, Lost, Plant

Random = np.random.Generator
CLEAR = 3.0
"""A hidden law is clear if what no calibration removes of it is this many times the noise."""
RUNS = (("a", "train", 500), ("b", "validation", 350), ("c", "held-out", 400))
"""Runs of a random case: name, role, samples."""
_KINDS = {"none": 0.16, "one": 0.5, "two": 0.17, "outside": 0.17}
_ATTEMPTS = 30


@dataclass(frozen=True)
class Draft:
    """A system that can hide laws.

    Attributes:
        drives: gives what drives each run.
        calibrated: indices of parameters with their tolerances, whose true values are drawn.
        noise: of each compared signal; None: drawn by its spread. varied: share of a state's spread by which
            runs begin elsewhere. runs: names and roles.
    """

    plant: Plant
    drives: Callable[[Random], list[Drive]]
    calibrated: list[tuple[int, float]]
    noise: Array | None
    varied: float
    title: str
    runs: list[tuple[str, str]]


@dataclass(frozen=True)
class Case:
    """A case before it is written; `signals` and `logs` of each run."""

    draft: Draft
    drives: list[Drive]
    laws: list[Acting]
    parameters: Array
    starts: list[Array]
    size: Array
    noise: Array
    signals: list[Array]
    logs: list[Array]
    truth: dict[str, Any]


def drawn(random: Random) -> Draft:
    """A random system with what drives it."""
    plant = Drawn(draw(random))
    made = plant.drawing
    free = [k for k, one in enumerate(plant.parameters) if one not in made.known]
    chosen = sorted(random.permutation(free)[: int(random.integers(2, 5))].tolist())
    calibrated = [
        (k, float(f"{abs(plant.nominal[k]) * random.choice([0.01, 0.02, 0.03, 0.05]):.3g}")) for k in chosen
    ]
    steps = bool(random.random() < 0.4)

    def drives(again: Random) -> list[Drive]:
        return [
            Drive(np.column_stack([driven(again, count, steps, *of) for of in made.driven.values()]), steps,
                  made.interval) for *_, count in RUNS
        ]  # fmt: skip

    return Draft(plant, drives, calibrated, None, float(random.choice([0.0, 0.05])), made.domain,
                 [(name, role) for name, role, _ in RUNS])  # fmt: skip


def driven(random: Random, count: int, steps: bool, mean: float, size: float) -> Array:
    """A signal that drives a run: steps of random length and height, or tones around the mean."""
    if steps:
        values = np.empty(count)
        at = 0
        while at < count:
            length = int(random.integers(15, 80))
            values[at : at + length] = mean + size * random.uniform(-1.0, 1.0)
            at += length
    else:
        tones, phases = np.exp(random.uniform(np.log(0.02), np.log(0.25), 6)), random.uniform(0.0, 6.3, 6)
        values = mean + size * np.sin(np.outer(np.arange(count), tones) + phases).sum(axis=1) / 3.0
    return np.round(values, 6)


def make(seed: int, draft: Callable[[Random], Draft], kind: str | None = None) -> Case:
    """A case of a seed: the first attempt whose copy can be integrated.

    Args:
        kind: "none", "one", "two" or "outside"; None: drawn.
    Raises: Lost if no attempt can.
    """
    for attempt in range(_ATTEMPTS):
        random = np.random.default_rng([seed, attempt])
        hidden = kind or str(random.choice(list(_KINDS), p=list(_KINDS.values())))
        try:
            return _made(seed, random, draft(random), hidden)
        except (Lost, OverflowError, ZeroDivisionError):
            continue
    raise Lost(f"seed {seed}: none of {_ATTEMPTS} systems can be simulated")


def _made(seed: int, random: Random, draft: Draft, kind: str) -> Case:
    plant, drives = draft.plant, draft.drives(random)
    nx = len(plant.states)
    size = np.maximum(np.abs(plant.start), 1e-3)
    plain = plant.simulate(drives[0], plant.nominal, plant.start, [], size)
    size = np.maximum(np.maximum(plain[:, :nx].std(axis=0), 1e-3 * np.abs(plain[:, :nx]).max(axis=0)), 1e-9)
    sizes = Sizes(
        plain.mean(axis=0), plain.std(axis=0), np.abs(plain).max(axis=0), drives[0].interval,
        len(plain) * drives[0].interval,
    )  # fmt: skip
    parameters = plant.nominal.copy()
    for k, tolerance in draft.calibrated:
        parameters[k] += tolerance * float(np.clip(random.standard_normal(), -2.0, 2.0))
    starts = [plant.start + draft.varied * sizes.spread[:nx] * random.standard_normal(nx) for _ in drives]
    columns = _columns(plant)
    noise = draft.noise
    if noise is None:
        noise = sizes.spread[columns] * np.exp(random.uniform(np.log(1e-3), np.log(1.5e-2), len(columns)))
        noise = np.array([float(f"{one:.2g}") for one in noise])
    if (noise <= 0.0).any():
        raise Lost("a compared signal rests")
    laws = _chosen(plant, sizes, random, kind)
    for again in range(3):
        signals = [
            plant.simulate(one, parameters, start, laws, size)
            for one, start in zip(drives, starts, strict=True)
        ]
        evidence, effects = _evidence(
            draft, drives[0], parameters, starts[0], laws, size, noise, sizes, signals[0]
        )
        weak = [k for k, one in enumerate(evidence) if one < 1.2 * CLEAR]
        if not weak or again == 2:
            break
        laws = [
            scaled(one, min(4.0, 2.0 * CLEAR / max(evidence[k], 1e-3))) if k in weak else one
            for k, one in enumerate(laws)
        ]
    logs = [one[:, columns] + noise * random.standard_normal((len(one), len(columns))) for one in signals]
    truth = {
        "format": "blind-truth/1", "seed": seed, "title": draft.title, "kind": kind,
        "parts": len({one.split(".")[0] for one in (*plant.inputs, *plant.outputs)}),
        "hidden": [
            {"law": one.name, "family": one.family, "place": one.place, "acts_on": one.kind,
             "signal": one.signal, "numbers": dict(one.numbers), "over_noise": round(strength, 3),
             "effect_over_noise": round(effect, 3), "outside": one.outside, "same_place": _same(plant, one)}
            for one, strength, effect in zip(laws, evidence, effects, strict=True)
        ],
        "clear": bool(all(one >= CLEAR for one in evidence)),
        "parameters": {plant.parameters[k]: float(parameters[k]) for k, _ in draft.calibrated},
    }  # fmt: skip
    return Case(draft, drives, laws, parameters, starts, size, noise, signals, logs, truth)


def _columns(plant: Plant) -> list[int]:
    first = len(plant.states) + len(plant.inputs)
    return [first + plant.outputs.index(one) for one in plant.compared]


def _chosen(plant: Plant, sizes: Sizes, random: Random, kind: str) -> list[Acting]:
    if kind == "none":
        return []
    if kind == "outside":
        return [outside(plant, sizes, random)]
    found = choices(plant, sizes, random)
    wanted = 1 if kind == "one" else 2
    laws: list[Acting] = []
    for name in random.permutation(sorted(found)).tolist():
        one = found[name][int(random.integers(len(found[name])))]
        if all(one.family != other.family and one.place != other.place for other in laws):
            laws.append(one)
        if len(laws) == wanted:
            return laws
    raise Lost("too few laws are physical in this system")


def _evidence(
    draft: Draft, drive: Drive, parameters: Array, start: Array, laws: Sequence[Acting], size: Array,
    noise: Array, sizes: Sizes, signals: Array,
) -> tuple[list[float], list[float]]:  # fmt: skip
    """Size over noise of what each law changes in the first run, beyond and with what calibration removes."""
    plant, columns = draft.plant, _columns(draft.plant)
    if not laws:
        return [], []

    def logged(p: Array, x: Array, some: Sequence[Acting]) -> Array:
        return np.ravel(plant.simulate(drive, p, x, some, size)[:, columns] / noise)

    whole = np.ravel(signals[:, columns] / noise)
    moves = []
    for k, tolerance in draft.calibrated:
        moved = parameters.copy()
        moved[k] += 0.2 * tolerance
        moves.append((logged(moved, start, laws) - whole) / 0.2)
    for k in range(len(start)):
        moved = start.copy()
        moved[k] += 0.01 * max(sizes.spread[k], size[k])
        moves.append((logged(parameters, moved, laws) - whole) / 0.01)
    a = np.vstack([np.array(moves).T, np.eye(len(moves))])
    found, effects = [], []
    for one in laws:
        effect = whole - logged(parameters, start, [other for other in laws if other is not one])
        effects.append(float(np.sqrt(np.mean(effect**2))))
        b = np.r_[effect, np.zeros(len(moves))]
        left = effect - (a @ np.linalg.lstsq(a, b, rcond=1e-10)[0])[: len(effect)]
        found.append(float(np.sqrt(np.mean(left**2))))
    return found, effects


def _same(plant: Plant, law: Acting) -> list[str]:
    """Names of places that are the same as a law's: all of its component, and those joined by one wire."""
    instance = law.place.split(".")[0]
    mine = [one for one in (*plant.inputs, *plant.outputs) if one.split(".")[0] == instance]
    mine += [f"der({one})" for one in plant.states if one.split(".")[0] == instance]
    for target, legs in plant.legs.items():
        if target == law.place and len(legs) == 1:
            mine.append(legs[0][0])
        if len(legs) == 1 and legs[0][0] == law.place:
            mine.append(target)
    return sorted(set(mine))


def write_system(case: Case, folder: Path, fmus: str) -> None:
    """Write system.yaml of a random system. `fmus`: where its FMUs are, from the folder."""
    plant = case.draft.plant
    assert isinstance(plant, Drawn)
    made, started = plant.drawing, dict(zip(plant.states, plant.start.tolist(), strict=True))
    instances = {}
    for name, part in made.parts.items():
        start = {
            one: f"{value!r} {unit}"
            for (one, unit), value in zip(part.parameters.items(), made.numbers[name], strict=True)
        }
        start |= {
            one: f"{started[f'{name}.{one}']!r} {unit}"
            for one, unit in part.states.items() if one in part.outputs or f"{name}.{one}" in made.starts
        }  # fmt: skip
        instances[name] = {"fmu": f"{fmus}/{part.name}.fmu", "start": start}
    for target in plant.external:
        name, port = target.split(".")
        instances[name]["start"][port] = f"{made.driven[target][0]} {plant.units[target]}"
    connections = [
        {"from": [one if gain == 1.0 else {"port": one, "gain": gain} for one, gain in legs], "to": target}
        for target, legs in plant.legs.items()
    ]
    interval = case.drives[0].interval
    run = {"master": "gauss-seidel", "step_size": f"{interval!r} s", "stop_time": f"{100 * interval:.6g} s"}
    _dump(folder / "system.yaml", {"title": f"A random system, {case.draft.title}", "run": run,
                                   "instances": instances, "connections": connections})  # fmt: skip


def write_study(case: Case, folder: Path) -> None:
    """Write study.yaml and its logs."""
    plant, held = case.draft.plant, case.drives[0].held
    columns: dict[str, Any] = {"time": {"column": "time", "unit": "s"}}
    header = ["time [s]"]
    fed = [k for k, one in enumerate(plant.external) if one not in plant.varied]
    for k in fed:
        one = plant.external[k]
        columns[one] = {"column": f"u{k}", "unit": plant.units[one]} | ({"hold": True} if held else {})
        header.append(f"u{k} [{plant.units[one]}]")
    for k, (one, noise) in enumerate(zip(plant.compared, case.noise.tolist(), strict=True)):
        unit = plant.units[one]
        columns[one] = {"column": f"y{k}", "unit": unit, "noise": f"{noise!r} {unit}", "feed": False}
        columns[one] |= {"start": True} if one in plant.begun else {}
        header.append(f"y{k} [{unit}]")
    runs: list[dict[str, Any]] = []
    for (name, role), drive in zip(case.draft.runs, case.drives, strict=True):
        values = _set(plant, drive)
        runs.append({"file": f"{name}.csv", "role": role} | ({"set": values} if values else {}))
    study = {
        "format": "port-study/1", "system": "system.yaml", "interval": f"{case.drives[0].interval!r} s",
        "columns": columns,
        "calibrated": {
            plant.parameters[k]: {"tolerance": f"{tolerance!r} {plant.units[plant.parameters[k]]}"}
            for k, tolerance in case.draft.calibrated
        },
        "runs": runs,
    }  # fmt: skip
    for (name, _), drive, logs in zip(case.draft.runs, case.drives, case.logs, strict=True):
        time = np.arange(len(logs)) * drive.interval
        table = np.column_stack([time, drive.values[:, fed], logs])
        np.savetxt(
            folder / f"{name}.csv", table, delimiter=",", header=",".join(header), comments="", fmt="%.12g"
        )
    _dump(folder / "study.yaml", study)


def _set(plant: Plant, drive: Drive) -> dict[str, str]:
    """Parameters and start values of a run that differ from the config's."""
    return {
        one: f"{float(drive.values[0, k])!r} {plant.units[one]}"
        for k, one in enumerate(plant.external)
        if one in plant.varied and not np.isnan(drive.values[0, k])
    }


def _dump(path: Path, data: Any) -> None:
    path.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True), encoding="utf-8")
