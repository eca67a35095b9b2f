"""Stochastic effects of the sensor, detected by statistics of the best deterministic model's residual."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .coloured_noise import COLOUR, WHITE, Colour, coloured, small_colour
from .dropout import held_longer, in_turn, lost_in_contact, lost_in_flight, piled
from .misfit import narrow_band_line, stretches, uneven, wave
from .model import RigModel
from .nuisance import repeating, settling_weights
from .study import Array

# Ticks about a contact that count with it.
_MARGIN = 40
# Shorter flights say nothing.
_FLIGHT = 40
# Correlation of neighbouring samples above which coloured noise counts as drift.
_WANDER = 0.99
# Samples over which noise is summed at least, to see whether it comes and goes.
_MEMORY = 8


@dataclass(frozen=True)
class Noise:
    """A stochastic effect, weighed.

    Attributes:
        theta: its parameters.
        log_evidence: over its absence [nats].
        scale: by which the noise of its channel appears larger to a fit.
        uneven: see `misfit.uneven`, a noise that comes and goes is something else; of lost samples see
            `dropout.in_turn`.
    """

    id: str
    theta: tuple[float, ...]
    log_evidence: float
    scale: float = 1.0
    uneven: float = 0.0


def flights(touching: Array) -> list[slice]:
    """Stretches without contact, from whether a replay touches at each tick, shape (n,)."""
    touched = np.convolve(touching, np.ones(2 * _MARGIN + 1), "same") > 0.5
    touched |= settling_weights(len(touched)) == 0.0
    return [one for one in stretches(~touched) if one.stop - one.start >= _FLIGHT]


@dataclass(frozen=True)
class Force:
    """Residual force samples beyond what models of the rig explain.

    Attributes:
        noises: stochastic effects found.
        line: log evidence of a narrow-band line, in time or along the robot's way [nats]; held: of samples
            that repeat in contact more often than out of it, or pile up at an end of a run's range, as where
            the sensor saturates; spiky: of single samples that stand out, as no normal noise has. None is an
            effect of the catalogue.
        colour: small coloured noise that is no effect.
    """

    noises: tuple[Noise, ...]
    line: float
    held: float
    colour: Colour = WHITE
    spiky: float = 0.0


def sensor_noise(model: RigModel, left: Sequence[Array], contact: Sequence[Array]) -> Force:
    """Weigh coarse resolution, lost samples and coloured noise of the force.

    Args:
        left: residuals of the force by run, over its noise.
        contact: whether a replay touches, per tick, by run; coloured noise is sought in flights only.
    """
    nominal = model.study.nominal
    # A sensor that has no noise of its own has that of its rounding.
    noise, resolution = nominal["force_noise"].value or model.noise[1], nominal["force_resolution"].value
    windows = [flights(one) for one in contact]
    found = []
    forces = [run["sensor_force"] for run in model.runs]
    samples = np.concatenate(forces)
    step = _lattice(samples, resolution)
    if step > 1.5 * resolution:
        found.append(Noise("sensor.quantisation", (step,), float(len(samples)) * math.log(step / resolution)))
    repeats = tuple(map(repeating, forces))
    raw = [force[window] for force, some in zip(forces, windows, strict=True) for window in some]
    held = 0.0
    if step < noise:
        held = max(held_longer(repeats, contact, windows), piled(forces, step, noise))
    lost = 0.0
    if raw and step < noise:
        lost, evidence = lost_in_flight(raw, step)
        # In flight, samples repeat by chance, too. What stays put in contact alone is nothing lost.
        certain, sure = (0.0, 0.0) if held > 0.0 else lost_in_contact(forces, contact, step, noise)
        if sure > max(evidence, 0.0):
            lost = certain
        evidence = max(evidence, 0.0) + sure
        if evidence > 0.0:
            again = [one[window] for one, some in zip(repeats, windows, strict=True) for window in some]
            found.append(Noise("sensor.dropout", (lost,), evidence, uneven=in_turn(again)))
    # Repeated samples are no samples of their own; where none are lost they are chance.
    parts = [
        r[window][~again[window]] if lost > 0.02 else r[window]
        for r, again, some in zip(left, repeats, windows, strict=True)
        for window in some
    ]
    parts = [noise * part for part in parts if len(part) >= 30]
    # A coarse resolution adds a noise of its own that is not white out of contact, and hides small others;
    # beside a noise that is as large as the step, it is white (Widrow, Kollar: Quantization Noise, 2008).
    spread = math.sqrt(sum(float(one @ one) for one in parts) / max(sum(map(len, parts)), 1))
    if not parts or noise < step > spread:
        return Force(tuple(found), 0.0, held)
    if step > noise:
        noise = math.hypot(noise, step / math.sqrt(12.0))
    evidence, deviation, keep = coloured(parts, noise)
    # What is lost says about no line, but keeps its place in time.
    kept = [np.where(again, 0.0, r) if lost > 0.02 else r for r, again in zip(left, repeats, strict=True)]
    line = max(narrow_band_line(kept, windows)[0], _along_way(model, kept, windows))
    if line > max(evidence, 10.0):
        return Force(tuple(found), line, held)
    small = small_colour([part / noise for part in parts])
    # Little of it is roughness of every rig; only what that does not explain says about an effect.
    evidence -= small.log_likelihood
    if deviation > COLOUR * noise and 0.3 < keep < _WANDER and evidence > 0.0:
        apparent = deviation * math.sqrt((1.0 + keep) / (1.0 - keep))
        scale = math.hypot(1.0, apparent / noise)
        intermittent = uneven(parts, (_MEMORY, max(_MEMORY, round(1.0 / (1.0 - keep)))))
        found.append(Noise("sensor.coloured-noise", (deviation,), evidence, scale, intermittent))
        return Force(tuple(found), 0.0, held)
    return Force(tuple(found), 0.0, held, small, uneven(parts, (1,)))


def _along_way(model: RigModel, left: Sequence[Array], windows: Sequence[Sequence[slice]]) -> float:
    """Log evidence of a wave along the robot's position in flights, as induced by motors or magnets [nats].

    Args:
        left: residuals over their noise, by run, zero where they say nothing; windows: flights of each.
    """
    parts, ways = [], []
    for run, r, some in zip(model.runs, left, windows, strict=True):
        for window in some:
            nonzero = r[window] != 0.0
            if np.count_nonzero(nonzero) >= _FLIGHT:
                part = r[window][nonzero]
                parts.append(part - part.mean())
                ways.append(run["encoder_position"][window][nonzero])
    if not parts:
        return 0.0
    # What is longer than half a flight may be anything slow.
    longest = 0.5 * float(np.median([np.ptp(way) for way in ways]))
    gain, _, _ = wave(parts, ways, longest)
    return max(gain - math.log(sum(map(len, parts))), 0.0)


def _lattice(samples: Array, resolution: float) -> float:
    """The coarsest step whose multiples, rounded to the resolution, all samples are."""
    best = resolution
    for step in np.arange(1, 401) * 0.5 * resolution:
        if step <= best:
            continue
        nearest = np.round(samples / step) * step
        if np.mean(np.abs(np.round(nearest / resolution) * resolution - samples) < 0.51 * resolution) > 0.999:
            fine = np.unique(np.round(samples / resolution))
            # A step below two of the resolution would hold nearly every sample anyway.
            expected = len(fine) / max((fine[-1] - fine[0]) + 1.0, 1.0)
            if step >= 2.0 * resolution and expected < 0.9:
                best = float(step)
    return best
