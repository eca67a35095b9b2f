"""Closure of the gap by the effects found, on held-out runs, relative to the noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .finding import NOMINAL, Augmented, Finding
from .model import RigModel
from .motion import STOP, Contact, contacts, stopped_at
from .restart import Restart, contact_error
from .rig import SUBSTEPS
from .study import Array, Role, Run, Study
from .verdict import WITHIN

# Errors per contact, model minus log; the first is of signals, the others of what a contact does.
MEASURES = ("nrmse", "cor", "peak_force", "energy")
_RESAMPLES, _BLOCK, _SEED = 1000, 2, 20190611
# A complete run is resampled in blocks of this length [ticks].
_RUN_BLOCK = 250


@dataclass(frozen=True)
class Ahead:
    """A model's errors one contact ahead.

    Attributes:
        errors: by contact and `MEASURES`, shape (contacts, 4): root mean square of force over measured peak
            and velocity over approach speed; coefficient of restitution; peak force over the measured one;
            kinetic energy after over that before.
        traces: force and velocity errors of each contact, normalised as above, shape (2, ticks), and the
            tick of the contact's first push in it.
    """

    errors: Array
    traces: tuple[tuple[Array, int], ...]


def one_contact_ahead(
    study: Study, run: Run, model: Augmented, among: Sequence[Contact], substeps: int = SUBSTEPS
) -> Ahead:
    """Run a model from the measured state before each contact until the flight after it."""
    restart = Restart(study, run, model, substeps)
    errors, traces = [], []
    for one in among:
        out = restart.ahead(one.begin, one.end - one.begin)
        trace = contact_error(run, one, out)
        span = slice(one.begin, one.end)
        peak, velocity = np.abs(run["sensor_force"][span]).max(), run["desired_velocity"][span]
        after, measured = out[1, -1] / velocity[0], velocity[-1] / velocity[0]
        errors.append(
            (
                float(np.sqrt(np.mean(trace**2))),
                float(measured - after),
                float(np.abs(out[3]).max() / peak - 1.0),
                float(after**2 - measured**2),
            )
        )
        traces.append((trace, one.first - one.begin))
    return Ahead(np.array(errors).reshape(-1, len(MEASURES)), tuple(traces))


def how_far(study: Study, finding: Finding) -> dict[str, Any]:
    """Closure of the gap one contact ahead, and over complete runs under `full_run`.

    Keys: before (the model as handed over), after (the answer), recalibrated, and noise_floor, as root mean
    squares over contacts; closure = (before - after)/(before - noise_floor) with its 95 % interval;
    recalibration_only, the closure by other calibrated numbers alone; within_floor. The main ones are of
    the signals (NRMSE); `measures` holds the same for each of `MEASURES`. A run without
    contacts is one window. Numbers are None without held-out runs.
    """
    models = {"before": NOMINAL, "after": finding.answer, "recalibrated": finding.recalibrated}
    heldout = study.of(Role.HELDOUT)
    pairs = [(run, _repeat(study, run)) for run in heldout]
    ahead = _ahead(study, pairs, models)
    whole = _whole(study, pairs, models)
    return {**ahead, "full_run": whole}


def _windows(study: Study, run: Run) -> list[Contact]:
    """Contacts of a run; one window for the complete run if it has none."""
    peak = int(np.argmax(np.abs(run["sensor_force"])))
    return contacts(study, run) or [Contact(0, peak, peak, peak, len(run))]


def _repeat(study: Study, run: Run) -> Run | None:
    """The repeat of a held-out run."""
    for one in study.of(Role.REPEAT):
        if one.mass == run.mass and one.approach_speed == run.approach_speed:
            return one
    return None


def _ahead(
    study: Study, pairs: Sequence[tuple[Run, Run | None]], models: dict[str, Augmented]
) -> dict[str, Any]:
    errors: dict[str, list[Array]] = {name: [] for name in models}
    floors: dict[str, list[Array]] = {name: [] for name in models}
    for run, repeat in pairs:
        found = _windows(study, run)
        again = [] if repeat is None else _windows(study, repeat)
        for name, model in models.items():
            one = one_contact_ahead(study, run, model, found)
            errors[name].append(one.errors)
            if repeat is not None:
                other = one_contact_ahead(study, repeat, model, again)
                floors[name].append(_differences(one, other))
    gaps = {name: np.concatenate(parts) if parts else np.zeros((0, 4)) for name, parts in errors.items()}
    if not len(gaps["before"]):
        return {**_gap({}, None, within_floor=True), "measures": {}}
    noise = _noise_alone(study, [run for run, _ in pairs])
    measures = {}
    for place, name in enumerate(MEASURES):
        # The errors of a model in a run and in its repeat differ by what does not repeat; the model's own
        # error cancels if both start equally, so the smallest difference is the floor.
        options = [
            float(np.sqrt(np.mean(np.concatenate(parts)[:, place] ** 2) / 2.0))
            for parts in floors.values()
            if parts and sum(len(part) for part in parts)
        ]
        floor = min(options) if options else (noise if name == "nrmse" else 0.0)
        squares = {key: value[:, place] ** 2 for key, value in gaps.items()}
        measures[name] = closure_of(squares, floor, _BLOCK)
    repeated = any(len(part) for parts in floors.values() for part in parts)
    details = {"contacts": len(gaps["before"]), "measures": measures}
    return {**measures["nrmse"], "noise_floor_from": "repeats" if repeated else "specified", **details}


def _differences(one: Ahead, other: Ahead) -> Array:
    """Differences of errors between contacts of the same number, shape (pairs, 4)."""
    found = []
    for number in range(min(len(one.traces), len(other.traces))):
        (a, first_a), (b, first_b) = one.traces[number], other.traces[number]
        lead = min(first_a, first_b)
        length = min(a.shape[1] - first_a, b.shape[1] - first_b) + lead
        a, b = a[:, first_a - lead :][:, :length], b[:, first_b - lead :][:, :length]
        difference = one.errors[number] - other.errors[number]
        difference[0] = np.sqrt(np.mean((a - b) ** 2))
        found.append(difference)
    return np.array(found).reshape(-1, len(MEASURES))


def _noise_alone(study: Study, runs: Sequence[Run]) -> float:
    """NRMSE by the sensor's noise, where nothing was repeated."""
    peaks = [
        np.abs(run["sensor_force"][one.begin : one.end]).max() for run in runs for one in _windows(study, run)
    ]
    return float(np.sqrt(np.mean((study.noise("force") / np.array(peaks)) ** 2) / 2.0))


def closure_of(squares: dict[str, Array], floor: float, block: int) -> dict[str, Any]:
    """Gap before and after, and its closure with an interval by block bootstrap.

    Args:
        squares: squared errors of each model, each of shape (n,), in order of time; not finite of one that
            runs away, whose gap is None.
        block: how many neighbours are drawn together.
    """
    gaps = {name: float(np.sqrt(np.mean(one))) for name, one in squares.items()}
    finite = {name: gap if math.isfinite(gap) else None for name, gap in gaps.items()}
    before = gaps["before"]
    if before < WITHIN * floor or before == 0.0:
        return _gap(finite, floor, within_floor=True)
    if finite["before"] is None or finite["after"] is None:
        return _gap(finite, floor)
    n = len(squares["before"])
    block = min(block, n)
    starts = np.random.default_rng(_SEED).integers(0, n, (_RESAMPLES, -(-n // block)))
    drawn = ((starts[:, :, None] + np.arange(block)) % n).reshape(_RESAMPLES, -1)[:, :n]
    some = {name: np.sqrt(np.mean(one[drawn], axis=1)) for name, one in squares.items()}
    above = some["before"] > floor
    closures = (some["before"] - some["after"])[above] / (some["before"] - floor)[above]
    return _gap(finite, floor, np.quantile(closures, [0.025, 0.975]).tolist())


def _gap(
    gaps: Mapping[str, float | None],
    floor: float | None,
    interval: list[float] | None = None,
    within_floor: bool = False,
) -> dict[str, Any]:
    """As `verdict.Gap`, and the gap after recalibration.

    Args:
        gaps: gap of each model; None where it runs away, or where nothing was held out.
    """
    before = gaps.get("before")

    def closed(name: str) -> float | None:
        left = gaps.get(name)
        if within_floor or before is None or left is None or floor is None:
            return None
        return (before - left) / (before - floor)

    return {
        "before": before,
        "after": gaps.get("after"),
        "recalibrated": gaps.get("recalibrated"),
        "noise_floor": floor,
        "closure": closed("after"),
        "interval": interval,
        "recalibration_only": closed("recalibrated"),
        "within_floor": within_floor,
    }


def _whole(
    study: Study, pairs: Sequence[tuple[Run, Run | None]], models: dict[str, Augmented]
) -> dict[str, Any]:
    """The same over complete runs from their starts, against the repeats.

    The NRMSE is that of position and velocity over their root mean squares; the others are of a run: mean
    restitution per contact, largest force, and kinetic energy at the end over that at the start.
    """
    squares: dict[str, list[Array]] = {name: [] for name in (*models, "repeat")}
    ends: dict[str, list[Array]] = {name: [] for name in (*models, "repeat")}
    for run, repeat in pairs:
        scales = np.array([[np.sqrt(np.mean(run[name] ** 2))] for name in _MOVING])
        signals = np.stack([run[name] for name in (*_MOVING, "sensor_force")])
        count = max(len(contacts(study, run)), 1)
        for name in squares:
            if name != "repeat":
                model = models[name]
                out = RigModel(study, [run]).closed_loop(0, model.calibrated, model.effects, model.theta)
                other = _stopped(out[[0, 1, 3]])
            elif repeat is not None:
                other = np.stack([repeat[key] for key in (*_MOVING, "sensor_force")])
            else:
                continue
            n = min(other.shape[1], signals.shape[1])
            errors = (other[:2, :n] - signals[:2, :n]) / scales
            blocks = np.array_split(np.mean(errors**2, axis=0), max(n // _RUN_BLOCK, 1))
            squares[name].append(np.array([part.mean() for part in blocks]))
            ends[name].append(_outcome(other[:, :n], count) - _outcome(signals[:, :n], count))
    if not pairs:
        return {**_gap({}, None, within_floor=True), "measures": {}}
    measures = {}
    for place, name in enumerate(MEASURES):
        of = {
            key: np.concatenate(squares[key]) if name == "nrmse" else np.array(ends[key])[:, place - 1] ** 2
            for key in squares
            if squares[key]
        }
        # Two runs of the rig differ by the root of two times as much as a model without noise from one.
        again = of.pop("repeat", None)
        floor = 0.0 if again is None else float(np.sqrt(np.mean(again) / 2.0))
        measures[name] = closure_of(of, floor, 1)
    repeated = any(repeat is not None for _, repeat in pairs)
    return {**measures["nrmse"], "noise_floor_from": "repeats" if repeated else "none", "measures": measures}


_MOVING = ("desired_position", "desired_velocity")


def _stopped(out: Array) -> Array:
    """A run up to the rig's stop, at rest afterwards, so that a diverging model is bounded."""
    end = stopped_at(out[0])
    if end == out.shape[1]:
        return out
    held = out.copy()
    held[:, end:] = 0.0
    held[0, end:] = np.sign(out[0, max(end - 1, 0)]) * STOP
    return held


def _outcome(signals: Array, count: int) -> Array:
    """Restitution per contact, largest force [N], energy ratio of a run's position, velocity and force."""
    ratio = abs(signals[1, -1] / signals[1, 0])
    return np.array([ratio ** (1.0 / count), np.abs(signals[2]).max(), ratio**2])
