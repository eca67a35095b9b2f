"""Random and periodic series of a run: noise, arrivals of commands, lost samples, bursts, walls."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ....base.arrays import Array

TICK = 1e-3
# Ticks before the first, at which the rod moved already.
HISTORY = 64
_CONTACTS = 400
_DEEPEST = 2  # frames by which a buffer may be too full or too empty


class Series(NamedTuple):
    """Series of a run.

    Attributes:
        arrival: when the command of tick i - 64 reaches the servo, shape (64 + n,) [s]; infinite if lost.
        encoder: noise [m]; force: noise of all kinds [N]; body: force on the satellite [N]; shape (n,).
        held, missed: ticks at which sensor or controller do nothing, shape (n,).
        wall: where the frames stand in each contact, shape (400,) [m].
        payload: which tick's command is the one that then holds, shape (64 + n,).
        deviate: by how much each command is falsified on its way [m], shape (n,).
        supply: by which share the sensor's supply is off, shape (n,).
        floor: phase in which the floor vibrates at the start [rad].
        zero: zero of the sensor, beginning with each contact, shape (400,) [N].
        lost: what the encoder loses at each tick [m]; scrape: share by which the force of a contact
            fluctuates, shape (n,).
        cycle: how far the sensor is in its own cycle at the start, from 0 to 1.
        skipped, key: ticks whose increment of the command is lost, and at which the whole command is sent,
            shape (n,).
        bridged: ticks whose command is lost and made up; sampling: by how much too early the sensor is read
            [s]; shape (n,).
        hits: logarithm of what the stiffness of each contact is off by, shape (400,).
        buzz: what the drive adds to the force at full speed, shape (n,) [N].
    """

    arrival: Array
    encoder: Array
    force: Array
    held: NDArray[np.bool_]
    missed: NDArray[np.bool_]
    body: Array
    wall: Array
    payload: NDArray[np.int64]
    corruption: Array
    supply: Array
    floor: float
    zero: Array
    lost: Array
    scrape: Array
    cycle: float
    skipped: NDArray[np.bool_]
    key: NDArray[np.bool_]
    bridged: NDArray[np.bool_]
    sampling: Array
    hits: Array
    buzz: Array


def draw_series(
    values: Mapping[str, float], noise: tuple[float, float], ticks: int, seed: np.random.SeedSequence
) -> Series:
    """Draw the series of a run.

    Each kind has a stream of its own: taking an effect away leaves the chance of all others as it was.

    Args:
        values: parameters of the rig.
        noise: standard deviations of encoder [m] and sensor [N].
    """
    get = values.get
    streams = [np.random.default_rng(one) for one in seed.spawn(31)]
    t = TICK * np.arange(ticks)
    scale = get("noise_scale", 0.0)
    encoder = scale * noise[0] * streams[0].standard_normal(ticks)
    force = scale * noise[1] * streams[1].standard_normal(ticks)
    for name, stream in (("coloured", streams[2]), ("colour", streams[9])):
        force += get(name, 0.0) * _process(get(f"{name}_keep", 0.0), ticks, stream)
    phase = 2.0 * np.pi * streams[3].random(2)
    force += get("hum", 0.0) * np.sin(get("hum_omega", 0.0) * t + phase[0])
    spikes = streams[3].random(ticks) < get("spike_rate", 0.0) * TICK
    force += get("spikes", 0.0) * spikes * streams[3].standard_normal(ticks)
    force += get("wire", 0.0) * _episodes(get("wire_rate", 0.0), get("wire_time", 0.0), ticks, streams[21])
    held = streams[4].random(ticks) < get("dropout", 0.0)
    missed = streams[5].random(ticks) < get("missed", 0.0)
    missed[0] = False
    body = get("wheel", 0.0) * np.sin(get("wheel_omega", 0.0) * t + phase[1])
    if get("burst", 0.0):
        period, length = get("burst_period", 1.0), get("burst_length", 0.0)
        at = np.mod(t + period * streams[6].random(), period)
        sign = np.where(np.floor((t + period) / period) % 2.0 < 1.0, 1.0, -1.0)
        body = body + get("burst", 0.0) * sign * (at < length)
    if get("crew", 0.0):
        body = body + get("crew", 0.0) * _process(_kept(get("crew_time", 0.0)), ticks, streams[15])
    wall = get("wall_scatter", 0.0) * streams[8].standard_normal(_CONTACTS)
    arrival = _arrivals(values, ticks, streams[7], streams[10]) + _detour(values, ticks, streams[12])
    arrival += _queue(values, ticks, streams[16]) + _slips(values, ticks, streams[25])
    arrival += _wandering(values, ticks, streams[28])
    arrival = _slots(arrival, get("slot", 0.0), streams[27])
    payload = _payload(values, ticks, streams[11])
    falsified = streams[13].random(ticks) < get("corrupt_rate", 0.0) * TICK
    corruption = get("corrupt", 0.0) * falsified * np.where(streams[13].random(ticks) < 0.5, -1.0, 1.0)
    phase = 2.0 * np.pi * streams[14].random(2)
    supply = get("ripple", 0.0) * np.sin(get("ripple_omega", 0.0) * t + phase[0])
    floor = float(phase[1])
    zero = get("zero", 0.0) * streams[17].standard_normal(_CONTACTS)
    zero[0] = 0.0  # taken before the run
    slipped = streams[18].random(ticks) < get("lost_rate", 0.0) * TICK
    lost = get("lost", 0.0) * slipped * np.where(streams[18].random(ticks) < 0.5, -1.0, 1.0)
    scrape = get("scrape", 0.0) * _process(_kept(get("scrape_time", 0.0)), ticks, streams[19])
    cycle = float(streams[20].random())
    skipped = streams[22].random(ticks) < get("increments", 0.0)
    turns = t / get("increments_key", 1.0) + streams[22].random()
    key = np.diff(np.floor(turns), prepend=-1.0) > 0.0
    bridged = _episodes(get("bridge_rate", 0.0), get("bridge", 0.0), ticks, streams[23])
    sampling = get("sampling", 0.0) * streams[24].random(ticks)
    # Samples wait in a buffer that fills by and by, until it is emptied.
    sampling += get("buffer", 0.0) * np.mod(t / get("buffer_period", 1.0) + streams[29].random(), 1.0)
    hits = get("hits", 0.0) * streams[26].standard_normal(_CONTACTS)
    buzz = get("buzz", 0.0) * streams[30].standard_normal(ticks)
    return Series(
        arrival, encoder, force, held, missed, body, wall, payload, corruption, supply, floor, zero,
        lost, scrape, cycle, skipped, key, bridged, sampling, hits, buzz,
    )  # fmt: skip


def _process(keep: float, ticks: int, stream: np.random.Generator) -> Array:
    """First-order noise with standard deviation one; `keep` is the correlation of neighbouring ticks."""
    return lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], stream.standard_normal(ticks))


def _kept(time: float) -> float:
    """What a tick keeps of noise that is forgotten in some time [s]."""
    return float(np.exp(-TICK / time)) if time > 0.0 else 0.0


def _episodes(rate: float, time: float, ticks: int, stream: np.random.Generator) -> NDArray[np.bool_]:
    """What befalls now and then [1/s], for times that differ about one [s]."""
    begins = stream.random(ticks) < rate * TICK
    lasts = np.ceil(time / TICK * stream.standard_exponential(ticks))
    index = np.arange(ticks)
    return np.maximum.accumulate(np.where(begins, index + lasts, 0.0)) > index


def _queue(values: Mapping[str, float], ticks: int, stream: np.random.Generator) -> Array:
    """How long commands wait behind what others have sent in bursts, which drains by and by."""
    length = HISTORY + ticks
    burst, drain = values.get("queue", 0.0), values.get("queue_drain", 0.0) * TICK
    came = burst * (stream.random(length) < values.get("queue_rate", 0.0) * TICK)
    waits, wait = np.zeros(length), 0.0
    if burst > 0.0:
        for i in range(length):
            wait = max(wait - drain, 0.0) + came[i]
            waits[i] = wait
    return waits


def _slips(values: Mapping[str, float], ticks: int, stream: np.random.Generator) -> Array:
    """How much later commands leave a buffer that fills or empties by a frame now and then."""
    length = HISTORY + ticks
    slips = stream.random(length) < values.get("frame_slip_rate", 0.0) * TICK
    ways = np.where(stream.random(length) < 0.5, -1, 1)
    level, levels = 0, np.zeros(length)
    for i in HISTORY + np.flatnonzero(slips[HISTORY:]):
        # Where it is full or empty, the other way.
        level += ways[i] if abs(level + ways[i]) <= _DEEPEST else -ways[i]
        levels[i:] = level
    return values.get("frame_slip", 0.0) * levels


def _wandering(values: Mapping[str, float], ticks: int, stream: np.random.Generator) -> Array:
    """How much later commands come as the load of the network rises and falls."""
    wander, length = values.get("wander", 0.0), HISTORY + ticks
    if wander <= 0.0:
        return np.zeros(length)
    return wander * np.abs(_process(_kept(values.get("wander_time", 0.0)), length, stream))


def _slots(arrival: Array, slot: float, stream: np.random.Generator) -> Array:
    """When commands come that wait for the next slot of time [s] that is theirs."""
    begin = stream.random()
    return slot * (np.ceil(arrival / slot - begin) + begin) if slot > 0.0 else arrival


def _payload(values: Mapping[str, float], ticks: int, stream: np.random.Generator) -> NDArray[np.int64]:
    """Command in force after each arrival: late ones are obeyed although newer ones arrived before."""
    index = np.arange(HISTORY + ticks)
    late = round(values.get("reorder_ticks", 0.0))
    if late < 1:
        return index
    first = late + 1
    delayed = first + np.flatnonzero(stream.random(ticks) < values.get("reorder", 0.0))
    payload = index.copy()
    payload[delayed] = delayed - 1
    payload[delayed + late] = delayed
    return payload


def _detour(values: Mapping[str, float], ticks: int, stream: np.random.Generator) -> Array:
    """Delay of commands on the longer of two routes, before or after some instant."""
    route = values.get("route", 0.0)
    sent = TICK * np.arange(-HISTORY, ticks)
    changed = sent > TICK * ticks * stream.uniform(0.2, 0.8)
    return abs(route) * (changed if route > 0.0 else ~changed)


def _arrivals(
    values: Mapping[str, float], ticks: int, stream: np.random.Generator, resets: np.random.Generator
) -> Array:
    get = values.get
    index = np.arange(-HISTORY, ticks)
    sent = TICK * index
    arrival = sent + get("tau", 0.0) + get("skew", 0.0) * np.maximum(sent, 0.0)
    arrival += get("jitter", 0.0) * stream.random(len(sent))
    lost = stream.random(len(sent)) < get("loss", 0.0)
    stall, period = get("stall", 0.0), get("stall_period", 1.0)
    if stall > 0.0:
        into = np.mod(arrival + period * stream.random(), period)
        arrival += np.where(into < stall, stall - into, 0.0)
    if get("reset", 0.0) > 0.0:
        # A clock that runs slow and is set right time and again.
        period = get("reset_period", 1.0)
        arrival += get("reset", 0.0) * np.mod(sent / period + resets.random(), 1.0)
    hold = round(get("hold", 0.0))
    if hold > 1:
        lost |= (index + 1) % hold != 0
    lost[0] = False
    return np.where(lost, np.inf, arrival)
