"""The real rig's force sensor: reading from force and other influences."""

from __future__ import annotations

import math

import numpy as np

from ....base.compiled_functions import njit
from .plant import DRAWN

_REPORTED, _OVER = 6.0, 2.0  # force at which a contact is reported, and at which its end is [N]
_LOUD = 100.0  # at which an amplifier that turns itself down is recognised by how much [N]
_RANGE_BACK = 0.6  # of the force at which a sensor goes to its upper range: where it goes back


@njit(error_model="numpy")
def first_amplifier(position):
    """What the amplifier is at the start, where the rod is [m], shape (13,).

    By place: play of the hysteresis; instant of the last reading; force and charge then; tare, and whether
    it is taken; whether the upper range is on; a smoothed force; level that the gain follows; charge of its
    cable [N], and where the rod was then [m]; whether it has reported a contact, and what remains of that
    pulse [N].
    """
    amplifier = np.zeros(13)
    amplifier[10] = position
    return amplifier


@njit(error_model="numpy")
def age_of(p, now, tick, phase):
    """How old the newest sample of a sensor with its own cycle is [s]; whether it is new at this tick."""
    if p.cycle <= 0.0:
        return 0.0, True
    turns = now / p.cycle + phase
    return p.cycle * (turns - math.floor(turns)), math.floor(turns) > math.floor(turns - tick / p.cycle)


@njit(error_model="numpy")
def beside_force(p, position, rate, drawn):
    """What the sensor reads [N] of the rod's guide and of the motor.

    Args:
        position [m], rate [m/s]: of the rod; drawn: what the drive asks of the motor [m/s2].
    """
    extra = 0.0
    if p.bushing > 0.0:
        extra -= p.bushing * math.tanh(rate / p.bushing_rate)
    if p.pickup != 0.0:
        extra += p.pickup * math.sin(2.0 * math.pi * position / p.pickup_pitch + p.pickup_phase)
    if p.ghost != 0.0:
        extra += p.ghost * position  # its converter reads the channel of the position before
    if p.ground != 0.0:
        extra += p.ground * abs(drawn) / DRAWN  # the drive's current comes back by the sensor's ground
    return extra


@njit(error_model="numpy")
def rubbed(p, since, position, amplifier):
    """What a cable that rubs where it is bent reads [N], some time [s] after the reading before."""
    amplifier[9] = amplifier[9] * math.exp(-since / p.tribo_time) + p.tribo * (position - amplifier[10])
    amplifier[10] = position
    return amplifier[9]


@njit(error_model="numpy")
def read(p, now, value, memory, amplifier):
    """The sensor's reading [N] before noise; the amplifier's state is advanced."""
    if p.hysteresis != 0.0:
        played = min(max(amplifier[0], value - p.hysteresis_width), value + p.hysteresis_width)
        value += p.hysteresis * (played - value)
        amplifier[0] = played
    value = _amplified(p, now - amplifier[1], value, amplifier)
    amplifier[1] = now
    reading = (1.0 + p.gain) * value * (1.0 + p.force_curve * abs(value)) + p.bias + memory[4]
    # A drift that slows down, as of something that warms.
    reading += p.drift * 20.0 * (1.0 - math.exp(-now / 20.0))
    return reading


@njit(error_model="numpy")
def _amplified(p, since, value, amplifier):
    """What an amplifier makes of a force [N] some time [s] after the one before."""
    if p.leak > 0.0:
        charge = amplifier[3] * math.exp(-p.leak * since) + value - amplifier[2]
        amplifier[2], amplifier[3] = value, charge
        value = charge
    if p.tare > 0.0:
        # A part of the first reading of a contact becomes the zero until the next contact.
        if abs(value) < 0.25 * p.tare_force:
            amplifier[4], amplifier[5] = 0.0, 0.0
        elif abs(value) > p.tare_force and amplifier[5] == 0.0:
            amplifier[4], amplifier[5] = p.tare * value, 1.0
        value -= amplifier[4]
    if p.preload > 0.0 and value > p.preload_force:
        value -= p.preload * (value - p.preload_force)  # pulled off what it was screwed to
    if p.pulse != 0.0:
        # A switch that says about contacts, its wire beside the sensor's.
        amplifier[12] *= math.exp(-since / p.pulse_time)
        if abs(value) > _REPORTED and amplifier[11] == 0.0:
            amplifier[11] = 1.0
            amplifier[12] += p.pulse
        elif abs(value) < _OVER and amplifier[11] == 1.0:
            amplifier[11] = 0.0
            amplifier[12] -= p.pulse
        value += amplifier[12]
    if p.fringe > 0.0:
        value += p.fringe * math.sin(
            2.0 * math.pi * value / p.fringe_span
        )  # between two fringes of its light
    if p.range_gain != 0.0:
        if abs(value) > p.range_force:
            amplifier[6] = 1.0
        elif abs(value) < _RANGE_BACK * p.range_force:
            amplifier[6] = 0.0
        value *= 1.0 + p.range_gain * amplifier[6]
    if p.calm > 0.0:
        # Smooths what hardly moves, and lets steps pass.
        off = value - amplifier[7]
        amplifier[7] += off * (1.0 - p.calm * math.exp(-abs(off) / p.calm_step))
        value = amplifier[7]
    if p.agc > 0.0:
        # Turns itself down where it is loud.
        amplifier[8] += (1.0 - math.exp(-since / p.agc_time)) * (abs(value) - amplifier[8])
        value /= 1.0 + p.agc * amplifier[8] / _LOUD
    return value


@njit(error_model="numpy")
def digits(p, reading, resolution):
    """The reading as a faulty converter gives it: clipped, with a wrong bit, quantised."""
    if p.clip > 0.0:
        reading = min(max(reading, -p.clip), p.clip)
    if p.bit != 0.0 and math.floor((reading + p.bit_at) / p.bit_weight) % 2.0 == 1.0:
        reading += p.bit  # one bit of its converter weighs too much
    if abs(reading) < p.cut:
        reading = 0.0  # what is that small is shown as none
    step = max(p.force_step, resolution)
    return step * round(reading / step) if step > 0.0 else reading
