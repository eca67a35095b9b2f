"""Servo, structure and sensor of the real rig between two ticks, by Runge-Kutta in fine steps; see `contact`.

Written without a look at the model that diagnosis fits: forms of effects differ from it where a real rig's
would (rounded onset of contact, soft limits, an exponential Stribeck curve, stiffness that decays).
"""

from __future__ import annotations

import math

import numpy as np

from ....base.compiled_functions import njit
from .contact import BEHIND, contact_force, depth_of, lifted, output

# Servo x, v; resonance q, q'; Maxwell z; sensor's filter and an extra one; a moving wall w, w'. Then those
# that few rigs have: servo's integral; bristle of its friction; base b, b'; loose plate w, w'; hose h, h';
# the sensor's element e, e'; by which share the servo's supply is used up; the rod's middle sideways y, y';
# what the encoder's converter has tracked r, r'; the drive's current, as the acceleration that it asks for;
# how the slide swings on its air y, y', over what it does by itself; the command as it was, from which the
# drive has its rate.
STATES = 28
_USUAL = 9
# Output of the play; deepest penetration of this contact; offset of the wall in this contact; creep; heat;
# how far the mount slipped. Then how far the servo has gone over to its soft gain; how far the tip has slid
# into its seat, and whether it does; what the bolted joint carries [N]; phase of the floor at the start; what
# the encoder has lost; by which share the force of a contact is off. For how long the servo still yields to
# what it hit [s], whether it has noticed that, how far it yields; since when the rod touches [s]; how deep
# the pads of the front and of the rear frame are dented [m]. How fast the rod came into this contact [m/s];
# whether the foil is torn, and whether the tape holds; by how much the rod is shorter [m], and its slide
# lifted [m]. Which way the servo last went, and the share of a kick that is left, by its way; by how much the
# overload clutch has given way [m]; impulse that the front frame has borne [N.s]; logarithm of what the
# stiffness of this contact is off by; how far the room before the port is filled. What the servo asks for
# until its next cycle [m/s2], and when that begins [s]; where the rod sits in its chuck [m]; for how long it
# has touched the front frame [s]; what has warmed the rubber of the front and of the rear frame (see
# `_WORK`). Which way the slide is turned in its guide, from -1 to 1; impulse that has flattened what sticks
# on the port [N.s]; which way a frame's ropes rub, from -1 to 1; to where a cup was pressed [m].
MEMORY = 40
_SWITCHING, _SEATING = 4e-3, 1.5e-3  # how long a servo's gain takes to change, a tip to slide [s]
_HUNG_XI, _BEHIND_XI = 0.1, 0.2  # damping ratios of what holds a loose plate, and of the frame behind it
DRAWN = 15.0  # what the drive asks for at full speed, as an acceleration [m/s2]
_TAPE_REACH = 6.0  # reaches of a tape's hooks beyond which the last has let go
_WINDING = 2e-3  # how long a motor's current takes [s]
_KICK_RATE = 5e-4  # least speed at which a servo detects a reversal [m/s]
_CLUTCH_BACK = 0.75  # of the force at which an overload clutch gives way: where it comes back
_WHIP_FORCE = 50.0  # at which a rod that bows is recognised by how much [N]
_BRAKE_RATE = 5e-4  # over which a brake's friction turns [m/s]
_CYCLE = 2e-4  # least duration of a servo's cycle [s]
_CHUCKED = 5e-4  # how long a rod takes to slide in its chuck [s]
_EXCITED, _LOADED = 0.3, 4.0  # how fast a slide's swing grows, and by how much at most a load damps it
FORWARD = 1.5e-3  # time constant of a drive's estimate of the rate of its command [s]
_STRAIGHT = 2e-3  # how long ropes take to be straight again [s]
_CUP_REACH = 4e-4  # beyond which a cup has let go [m]
_WORK = 0.1  # at which rubber that its work warms is recognised by how much [J]
_OPENING = 5e-3  # how long what a seal held takes to leave [s]


@njit(error_model="numpy")
def _derivative(p, t, s, memory, command, ds):
    x, v = s[0], s[1]
    force, side, depth, rate = contact_force(p, t, s, memory)
    a = p.omega * p.omega * (command - x - memory[3]) - 2.0 * p.xi * p.omega * v + p.load * force
    if p.loop > 0.0:
        # Held; a cycle that is hardly longer than a step of integration, in part.
        held = memory[30] + p.load * force
        a += min(p.loop / _CYCLE, 1.0) * (held - a)
    if p.forward != 0.0:
        # What damps it damps the less, the faster the command moves.
        forward_rate = (command - s[27]) / FORWARD
        a += 2.0 * p.xi * p.omega * p.forward * forward_rate
        ds[27] = forward_rate
    if p.idle > 0.0:
        # While its switches change over, the drive gives nothing: small currents do not come about.
        asked = p.omega * p.omega * (command - x - memory[3]) - 2.0 * p.xi * p.omega * v
        a -= p.idle * math.tanh(asked / p.idle)
    if p.sag > 0.0:
        # What the drive draws lowers the voltage that it has; what damps the motor needs none.
        asked = p.omega * p.omega * (command - x - memory[3])
        a -= p.sag * s[19] * asked
        ds[19] = (math.tanh(abs(asked) / DRAWN) - s[19]) / p.sag_time
    if p.soft_gain != 0.0:
        a -= p.omega * p.omega * p.soft_gain * memory[6] * (command - x - memory[3])
    if p.guard > 0.0:
        a -= p.omega * p.omega * p.guard * memory[15] * (command - x - memory[3])
    if p.kick > 0.0:
        a += p.kick * memory[25]
    if p.cold != 0.0:
        a -= 2.0 * p.xi * p.omega * p.cold * math.exp(-t / p.cold_time) * v
    if p.integral != 0.0:
        a += p.omega * p.omega * s[9]
        ds[9] = p.integral * (command - x)
    if p.one_sided != 0.0:
        a -= 2.0 * p.xi * p.omega * p.one_sided * v * math.tanh(v / p.one_sided_rate)
    if p.dahl > 0.0:
        # A bristle that bends until it slides.
        a -= p.dahl * s[10]
        ds[10] = (v - abs(v) * s[10]) / p.dahl_length
    if p.pole > 0.0:
        # A worn spot of the motor, where it pulls less.
        spot = math.exp(-(((x - p.pole_at) / p.pole_width) ** 2))
        a -= p.omega * p.omega * p.pole * spot * (command - x - memory[3])
    if p.brake > 0.0:
        # Not quite open, and its disc not flat: it drags once in each turn.
        drags = max(math.sin(2.0 * math.pi * x / p.brake_pitch + p.brake_phase), 0.0)
        a -= p.brake * drags * math.tanh(v / _BRAKE_RATE)
    if p.gear > 0.0:
        a -= p.gear * abs(force) * math.tanh(v / p.gear_rate)  # teeth rub the more, the more they carry
    if p.coulomb > 0.0:
        excess = p.stribeck * math.exp(-abs(v) / p.stribeck_rate) if p.stribeck > 0.0 else 0.0
        a -= p.coulomb * (1.0 + excess) * v / math.sqrt(v * v + 2.25e-8)  # rounded over 0.15 mm/s
    if p.acceleration_limit > 0.0:
        share = abs(a) / p.acceleration_limit
        if share > 0.5:
            a /= (1.0 + share**32) ** (1.0 / 32.0)
    if p.rate_limit > 0.0 and ((v >= p.rate_limit and a > 0.0) or (v <= -p.rate_limit and a < 0.0)):
        a = 0.0
    ds[0], ds[1] = v, a
    total = a
    if p.resonance != 0.0:
        w = p.resonance_omega
        ds[2] = s[3]
        ds[3] = -w * w * s[2] - 2.0 * p.resonance_xi * w * s[3] - p.resonance * a
        total += ds[3]
    if p.maxwell != 0.0:
        ds[4] = (rate if depth > 0.0 else 0.0) - s[4] / p.maxwell_time
    ds[5] = p.cutoff * (force - p.tool * total - s[5])
    if p.taut != 0.0:
        ds[5] += p.cutoff * _cable(p, s, memory)
    if p.hose > 0.0:
        # It hangs on the rod behind the sensor, and swings.
        position, speed = output(p, s, memory)
        w = p.hose_omega
        swing = w * w * (s[15] - position) + 2.0 * p.hose_xi * w * (s[16] - speed)
        ds[5] += p.cutoff * p.hose * swing
        ds[15], ds[16] = s[16], -swing
    if p.ring > 0.0:
        w = p.ring_omega
        ds[17], ds[18] = s[18], w * w * (s[5] - s[17]) - 2.0 * p.ring_xi * w * s[18]
    if p.whip > 0.0:
        w = p.whip_omega
        ds[20], ds[21] = s[21], w * w * (force / _WHIP_FORCE - s[20]) - 2.0 * p.whip_xi * w * s[21]
    if p.resolver > 0.0:
        # Its loop of second type has no lag at a steady speed.
        position, _ = output(p, s, memory)
        w = p.resolver
        ds[22] = s[23] + 2.0 * p.resolver_xi * w * (position - s[22])
        ds[23] = w * w * (position - s[22])
    if p.ground != 0.0:
        ds[24] = (p.omega * p.omega * (command - x) - s[24]) / _WINDING
    if p.hammer > 0.0:
        # Air that carries a slide excites it, until a load or its own swing damps it.
        w = p.hammer_omega
        damped = s[25] * s[25] + min(abs(force) / p.hammer_force, _LOADED)
        ds[25], ds[26] = s[26], _EXCITED * w * (1.0 - damped) * s[26] - w * w * s[25]
    if p.filter_time > 0.0:
        ds[6] = (s[5] - s[6]) / p.filter_time
    if p.wall_mass > 0.0:
        w = p.wall_omega
        ds[7] = s[8]
        ds[8] = (-force if side > 0.0 else 0.0) / p.wall_mass - w * w * s[7] - 0.1 * w * s[8]
    if p.sway != 0.0:
        w = p.sway_omega
        ds[11] = s[12]
        ds[12] = p.sway * (force - p.sway_arm * total) - w * w * s[11] - 2.0 * p.sway_xi * w * s[12]
    if p.plate > 0.0:
        ds[13], ds[14] = s[14], _plate(p, s, -force if side > 0.0 else 0.0)


@njit(error_model="numpy")
def _cable(p, s, memory):
    """Force on the rod [N] of a cable that hangs loose up to some way to one side."""
    position, _ = output(p, s, memory)
    side = math.copysign(1.0, p.taut)
    return -p.taut * max(side * position - p.taut_from, 0.0)


@njit(error_model="numpy")
def _plate(p, s, push):
    """Acceleration [m/s2] of a plate that hangs before the front frame, and rests against it where pushed."""
    w, behind = p.plate_omega, 0.0
    if s[13] > 0.0:
        k = BEHIND * p.k
        behind = max(k * s[13] + 2.0 * _BEHIND_XI * math.sqrt(k * p.plate) * s[14], 0.0)
    return (push - behind) / p.plate - w * w * (s[13] + p.plate_gap) - 2.0 * _HUNG_XI * w * s[14]


@njit(error_model="numpy")
def remember(p, t, s, memory, step):
    """Update the memory of a step: play, depth, creep and gain of the servo, heat, slip."""
    if p.backlash > 0.0:
        memory[0], _ = output(p, s, memory)
    if p.rate_limit > 0.0:
        s[1] = min(max(s[1], -p.rate_limit), p.rate_limit)
    if p.plasticity > 0.0 or p.maxwell != 0.0:
        _, depth, _ = depth_of(p, t, s, memory)
        memory[1] = max(memory[1], depth) if depth > 0.0 else 0.0
        if depth <= 0.0:
            s[4] = 0.0
    if p.creep != 0.0:
        memory[3] += step * (p.creep * s[0] - memory[3]) / p.creep_time
    if p.heat != 0.0:
        memory[4] += step * (p.heat * abs(s[5]) - memory[4]) / p.heat_time
    if p.slip > 0.0:
        force, _, _, _ = contact_force(p, t, s, memory)
        memory[5] += step * p.slip * (force - min(max(force, -p.slip_force), p.slip_force))
    if p.soft_gain != 0.0:
        memory[6] += step / _SWITCHING * ((1.0 if abs(s[1]) < p.soft_gain_rate else 0.0) - memory[6])
    if p.seat > 0.0:
        _sit(p, t, s, memory, step)
    if p.guard > 0.0:
        _watch(p, t, s, memory, step)
    if p.chatter > 0.0 and depth_of(p, t, s, memory)[1] <= 0.0:
        memory[16] = t
    if p.pad > 0.0:
        # Foam that is dented by and by, and rises again as slowly.
        side, depth, _ = depth_of(p, t, s, memory)
        for place in range(17, 19):
            near = side == (1.0 if place == 17 else -1.0)
            pressed = max(depth + memory[place], 0.0) if near and depth > 0.0 else 0.0
            memory[place] += step / p.pad_time * (p.pad * pressed - memory[place])
    if p.thick > 0.0 or p.foil > 0.0 or p.hook > 0.0:
        _touch(p, t, s, memory)
    if p.unscrew > 0.0:
        # It turns in its thread under load, and never back.
        force, _, _, _ = contact_force(p, t, s, memory)
        memory[22] += step * p.unscrew * abs(force)
    if p.lift > 0.0:
        memory[23] += step / p.lift_time * (lifted(p, s[1] + s[3]) - memory[23])
    if p.kick > 0.0:
        _turn(p, s, memory, step)
    if p.clutch > 0.0:
        # A spring that is tight until some force, and rubs.
        force, _, _, _ = contact_force(p, t, s, memory)
        least = p.clutch * max(abs(force) - p.clutch_force, 0.0)
        most = p.clutch * max(abs(force) - _CLUTCH_BACK * p.clutch_force, 0.0)
        memory[26] = math.copysign(min(max(abs(memory[26]), least), most), force)
    if p.snap > 0.0:
        force, side, _, _ = contact_force(p, t, s, memory)
        memory[27] += step * abs(force) if side > 0.0 else 0.0
    if p.vent > 0.0:
        side, depth, _ = depth_of(p, t, s, memory)
        sealed = side > 0.0 and depth > 0.0
        memory[29] += step * ((1.0 - memory[29]) / p.vent_time if sealed else -memory[29] / _OPENING)
    if p.chuck > 0.0:
        # It slides where it is pushed hard enough, as far as its play goes.
        force, _, _, _ = contact_force(p, t, s, memory)
        beyond = force - min(max(force, -p.chuck_force), p.chuck_force)
        memory[32] += step / _CHUCKED * beyond / p.k
        memory[32] = min(max(memory[32], -p.chuck), p.chuck)
    if p.ejector > 0.0:
        side, depth, _ = depth_of(p, t, s, memory)
        memory[33] = memory[33] + step if side > 0.0 and depth > 0.0 else 0.0
    if p.worked > 0.0:
        force, side, _, rate = contact_force(p, t, s, memory)
        for place in range(34, 36):
            taken = abs(force) * max(rate, 0.0) if side == (1.0 if place == 34 else -1.0) else 0.0
            memory[place] += step * (taken / _WORK - memory[place] / p.worked_time)
    if p.yaw != 0.0:
        _, rate = output(p, s, memory)
        memory[36] += step * (rate - abs(rate) * memory[36]) / p.yaw_length
    if p.clay > 0.0 or p.rope > 0.0 or p.cup > 0.0:
        _give(p, t, s, memory, step)
    if p.joint > 0.0:
        # Friction between its plates takes up a part of the force before they move.
        force, _, _, _ = contact_force(p, t, s, memory)
        memory[9] = min(max(memory[9], force - p.joint_force), force + p.joint_force)


@njit(error_model="numpy")
def _touch(p, t, s, memory):
    """What a contact finds and leaves: speed of the rod that comes, a foil's tear, hooks of a tape."""
    side, depth, rate = depth_of(p, t, s, memory)
    if depth <= 0.0:
        memory[19] = max(rate, 0.0)
    if side > 0.0 and depth + p.foil_at > p.foil_stretch:
        memory[20] = 1.0
    if side > 0.0 and depth > 0.0:
        memory[21] = 1.0
    elif side < 0.0 or depth < -_TAPE_REACH * p.hook_reach:
        memory[21] = 0.0


@njit(error_model="numpy")
def _give(p, t, s, memory, step):
    """What a contact does to clay on the port, to a frame's ropes and to a cup."""
    force, side, _, _ = contact_force(p, t, s, memory)
    _, depth, rate = depth_of(p, t, s, memory)
    if side > 0.0 and depth > 0.0:
        memory[37] += step * max(-force, 0.0)
        memory[39] = max(memory[39], depth)
    elif side < 0.0 or depth < -_CUP_REACH:
        memory[39] = 0.0
    if p.rope > 0.0:
        rubs = (rate - abs(rate) * memory[38]) / p.rope_length
        memory[38] += step * (rubs if depth > 0.0 else -memory[38] / _STRAIGHT)


@njit(error_model="numpy")
def _turn(p, s, memory, step):
    """A servo that has turned is helped over friction that it does not have."""
    memory[25] -= step / p.kick_time * memory[25]
    if abs(s[1]) > _KICK_RATE and s[1] * memory[24] <= 0.0:
        way = math.copysign(1.0, s[1])
        memory[25] = way if memory[24] != 0.0 else 0.0
        memory[24] = way


@njit(error_model="numpy")
def _cycle(p, t, s, memory, command):
    """A servo computes what it asks for once in each of its cycles."""
    if t >= memory[31] - 1e-9:
        memory[30] = p.omega * p.omega * (command - s[0]) - 2.0 * p.xi * p.omega * s[1]
        memory[31] = p.loop * (math.floor((t + 1e-9) / p.loop) + 1.0)


@njit(error_model="numpy")
def _watch(p, t, s, memory, step):
    """A servo that takes a force for a collision yields for some time, once in each contact."""
    force, _, _, _ = contact_force(p, t, s, memory)
    if abs(force) < 0.3 * p.guard_force:
        memory[14] = 0.0
    elif abs(force) > p.guard_force and memory[14] == 0.0:
        memory[13], memory[14] = p.guard_time, 1.0
    memory[13] = max(memory[13] - step, 0.0)
    memory[15] += step / _SWITCHING * ((1.0 if memory[13] > 0.0 else 0.0) - memory[15])


@njit(error_model="numpy")
def _sit(p, t, s, memory, step):
    """A tip that stands askew slides into its seat once pushed hard enough, and is askew again when free."""
    force, _, _, _ = contact_force(p, t, s, memory)
    _, depth, _ = depth_of(p, t, s, memory)
    if abs(force) > p.seat_force:
        memory[8] = 1.0
    elif depth + memory[7] < 0.0:
        memory[8] = 0.0
    memory[7] += step / _SEATING * (p.seat * memory[8] - memory[7])


@njit(error_model="numpy")
def integrate(p, begin, end, longest, s, memory, command, work, times, sensed, count):
    """Integrate from one instant to another, over which the command is constant.

    Args:
        longest: step [s]; work: room, shape (5, STATES).
        times, sensed: instants and the sensor's filtered force there, circular; count: how many were written.
    Returns: the new count.
    """
    steps = max(math.ceil((end - begin) / longest - 1e-9), 1)
    step = (end - begin) / steps
    k1, k2, k3, k4, mid = work[0], work[1], work[2], work[3], work[4]
    size = times.shape[0]
    rare = p.integral != 0.0 or p.dahl > 0.0 or p.sway != 0.0 or p.plate > 0.0 or p.hose > 0.0
    rare = rare or p.ring > 0.0 or p.sag > 0.0 or p.whip > 0.0 or p.resolver > 0.0
    rare = rare or p.ground != 0.0 or p.hammer > 0.0 or p.forward != 0.0
    states = STATES if rare else _USUAL
    for i in range(steps):
        t = begin + i * step
        if p.loop > 0.0:
            _cycle(p, t, s, memory, command)
        _derivative(p, t, s, memory, command, k1)
        for j in range(states):
            mid[j] = s[j] + 0.5 * step * k1[j]
        _derivative(p, t + 0.5 * step, mid, memory, command, k2)
        for j in range(states):
            mid[j] = s[j] + 0.5 * step * k2[j]
        _derivative(p, t + 0.5 * step, mid, memory, command, k3)
        for j in range(states):
            mid[j] = s[j] + step * k3[j]
        _derivative(p, t + step, mid, memory, command, k4)
        for j in range(states):
            s[j] += step / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j])
        remember(p, t + step, s, memory, step)
        times[count % size] = t + step
        sensed[count % size] = s[6] if p.filter_time > 0.0 else s[5]
        if p.ring > 0.0:
            sensed[count % size] += p.ring * (s[17] - s[5])  # its element swings on what holds it
        count += 1
    return count


@njit(error_model="numpy")
def past(times, sensed, count, t):
    """The sensor's filtered force at an instant not long ago, linear between steps; zero before the run."""
    size = times.shape[0]
    index = count - 1
    last = max(count - size, 0)
    while index > last and times[index % size] > t:
        index -= 1
    at = index % size
    if index < last or times[at] > t:
        return 0.0 if count < size else sensed[at]
    if index == count - 1:
        return sensed[at]
    following = (index + 1) % size
    share = (t - times[at]) / (times[following] - times[at])
    return (1.0 - share) * sensed[at] + share * sensed[following]


@njit(error_model="numpy")
def fresh():
    """State, memory, room and history of a run."""
    return np.zeros(STATES), np.zeros(MEMORY), np.zeros((5, STATES)), np.zeros(4096), np.zeros(4096)
