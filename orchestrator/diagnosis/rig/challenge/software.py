"""The rig's software at a tick, satellite and compliance controller, hidden effects included."""

from __future__ import annotations

import math

import numpy as np

from ....base.compiled_functions import njit

_DOCK = 0.005  # where the satellite's software believes the port to be [m]
_LOOSE_XI = 0.2


@njit(error_model="numpy")
def first_satellite(speed):
    """What the satellite is at the start, shape (13,).

    By place: position and velocity of itself and of what hangs on it; whether it fires; position and velocity
    of what is loose in it; for how long it still thrusts towards the port, and whether it has begun to;
    velocity of what hangs on it by friction; the force smoothed [N]; where the rod was measured to be [m];
    what is taken for the force of nothing [N].
    """
    return np.array([0.0, speed, 0.0, speed, 0.0, 0.0, speed, 0.0, 0.0, speed, 0.0, 0.0, 0.0])


@njit(error_model="numpy")
def move_satellite(p, mass, now, tick, force, extra, s):
    """A tick of the satellite under a held force [N]: four semi-implicit Euler sub-steps.

    Args:
        extra: force of the rig's surroundings on the body [N].
        s: see `first_satellite`; advanced.
    """
    dt = 0.25 * tick
    if p.timer > 0.0:
        # The time that has passed is read from a clock of coarse steps.
        dt = 0.25 * p.timer * (math.floor((now + tick) / p.timer) - math.floor(now / p.timer))
    if p.smoothed > 0.0:
        s[10] += tick / (tick + p.smoothed) * (force - s[10])  # so that noise does not move the satellite
        force = s[10]
    if p.rezero > 0.0:
        # A sensor's zero, as it is taken to be: what the force is on average.
        s[12] += p.rezero * tick * (force - s[12])
        force -= s[12]
    if p.ignored > 0.0:
        force = math.copysign(max(abs(force) - p.ignored, 0.0), force)
    total = mass * (1.0 + p.mass)
    if p.joined > 0.0 and abs(force) > p.joined_force:
        total *= 1.0 + p.joined  # what presses that hard is taken for docked: one body with the port
    if p.fuel != 0.0:
        total *= max(1.0 - p.fuel * now, 0.1)
    if p.thrust > 0.0:
        # Thrusters brake from one speed down to half of it.
        if abs(s[1]) > p.thrust_speed:
            s[4] = 1.0
        elif abs(s[1]) < 0.5 * p.thrust_speed:
            s[4] = 0.0
        extra -= math.copysign(p.thrust * s[4], s[1])
    if p.box > 0.0 and abs(s[0]) > p.box_edge and s[0] * s[1] > 0.0:
        extra -= math.copysign(p.box, s[0])  # its keeper of stations knows of no port
    if p.corrected > 0.0:
        extra += mass * p.corrected * (s[11] - s[0])  # pulled towards the rod, against drift
    if p.stuck != 0.0 and now >= p.stuck_from:
        # A valve that does not close, until its tank is empty.
        extra += p.stuck * math.exp(-(now - p.stuck_from) / p.stuck_time)
    if p.spin > 0.0:
        # The lever of the contact turns with the body.
        force *= 1.0 + p.spin * math.sin(p.spin_omega * now + p.spin_phase) ** 2
    if p.seek > 0.0:
        # The satellite thrusts for some time to keep contact, once in each contact.
        if abs(force) < 0.3 * p.seek_force:
            s[8] = 0.0
        elif force < -p.seek_force and s[8] == 0.0:
            s[7], s[8] = p.seek_time, 1.0
        extra += p.seek if s[7] > 0.0 else 0.0
        s[7] -= tick
    hung, loose, rubbed = total * p.appendage, total * p.loose, total * p.rubbed
    w = p.appendage_omega
    for _ in range(4):
        push = force * (1.0 + p.mass_offset * p.mass_offset) + extra + mass * p.gravity
        if p.cable != 0.0:
            push -= p.cable * s[0]
        if p.drag != 0.0:
            push -= p.drag * s[1]
        if p.plume > 0.0:
            # What its thrusters blow at the port comes back.
            push -= p.plume * math.exp(-max(_DOCK - s[0], 0.0) / p.plume_reach)
        if hung > 0.0:
            pull = hung * (w * w * (s[2] - s[0]) + 2.0 * p.appendage_xi * w * (s[3] - s[1]))
            s[3] -= dt * pull / hung
            push += pull
        if loose > 0.0:
            # Free within a gap; what holds it there can but push.
            beyond = s[5] - s[0] - min(max(s[5] - s[0], -p.loose_gap), p.loose_gap)
            if beyond != 0.0:
                w, side = p.loose_omega, math.copysign(1.0, beyond)
                hit = w * w * abs(beyond) + 2.0 * _LOOSE_XI * w * side * (s[6] - s[1])
                s[6] -= dt * side * max(hit, 0.0)
                push += loose * side * max(hit, 0.0)
            s[5] += dt * s[6]
        s[1] += dt * push / (total - hung - loose - rubbed)
        if rubbed > 0.0:
            # Its hinge's friction takes it along, but for hard pushes.
            own = total - hung - loose - rubbed
            given = (s[1] - s[9]) * own * rubbed / (own + rubbed)
            given = min(max(given, -dt * p.rubbed_force), dt * p.rubbed_force)
            s[1] -= given / own
            s[9] += given / rubbed
        s[0] += dt * s[1]
        s[2] += dt * s[3]
    if p.fix > 0.0 and math.floor((now + tick) / p.fix_period) > math.floor(now / p.fix_period):
        s[1] = p.fix * round(s[1] / p.fix)  # output of a navigation filter, in coarse steps


@njit(error_model="numpy")
def first_controller(k, c, position, speed):
    """What the controller remembers at the start, shape (22,).

    By place: F_prev, g, x_prev, u, in contact, x0, k_est, c_est, p00, p01, p11, output; ticks
    since contact; whether the last force was doubted; a notch's low and band pass; how near
    it is to its next overrun; energy that this contact holds, and the most that it did [J]; impulse of this
    contact [N.s]; ticks for which the force has been one of contact, and for which it is still taken for
    one once it is not.
    """
    s = np.zeros(22)
    s[2], s[3], s[6], s[7], s[8], s[10] = position, speed, k, c, (0.15 * k) ** 2, 60.0**2
    return s


@njit(error_model="numpy")
def compensate(p, k, lead, tick, force, position, desired, rate, s):
    """A tick of the compliance controller.

    Args:
        k: nominal stiffness [N/m], which bounds the estimate; lead: as calibrated [s].
        force, position: measured; desired, rate: of the satellite software.
        s: see `first_controller`; advanced, the output [N] last.
    """
    if p.gate > 0.0:
        # A reading that jumps counts little, as an error of the bus might cause it; but not two in a row.
        doubted = s[13] < 0.5 and abs(force - s[0]) > p.gate_step
        s[13] = 1.0 if doubted else 0.0
        if doubted:
            force += p.gate * (s[0] - force)
    if p.notch > 0.0:
        # Keeps a mode of the structure out of the loop.
        turn = p.notch_omega * tick
        s[14] += turn * s[15]
        s[15] += turn * (force - s[14] - p.notch_width * s[15])
        force -= p.notch * p.notch_width * s[15]
    speed, before = (position - s[2]) / tick, s[3]
    s[3] = 0.75 * s[3] + 0.25 * speed
    if p.payload != 0.0:
        force += p.payload * (s[3] - before) / tick  # as if the sensor carried more than is known
    slope = (force - s[0]) / tick
    if p.dull > 0.0:
        s[1] += 0.35 * (1.0 - p.dull) * (slope - s[1])  # its filter set for noisier sensors
    else:
        s[1] = 0.65 * s[1] + 0.35 * slope
    s[0], s[2] = force, position
    led = (lead + p.lead) * s[1]
    if p.lead_bound > 0.0:
        led = min(max(led, -p.lead_bound), p.lead_bound)  # limits the lead of noise
    ahead = force + led
    earlier = s[11]
    s[20] = s[20] + 1.0 if abs(force) > 4.0 else 0.0
    touching = s[20] > p.debounce
    if touching:
        s[21] = p.release
    elif s[21] > 0.0:
        s[21], touching = s[21] - 1.0, True  # so that a bounce does not end the contact
    if touching:
        if s[4] < 0.5:
            s[4], s[5] = 1.0, position + force / max(s[6], 1000.0)
        if abs(ahead) > 15.0:
            _estimate(s, k, ahead)
        stretch = desired - position + p.stale * speed * tick  # the encoder as it was before
        if p.count > 0.0:
            stretch = p.count * math.floor(stretch / p.count)  # as integers cut off
        out = ahead - (1.0 + p.stiffness_gain) * s[6] * stretch - s[7] * (rate - s[3])
        if p.helped > 0.0:
            out += p.helped * math.tanh(s[3] / p.helped_rate)  # against friction that the rig does not have
        if p.blend > 0.0:
            out += p.blend * (-s[6] * (position - s[5]) - s[7] * s[3] - ahead)  # the force as it expects it
        if p.summed > 0.0:
            s[19] += force * tick
            out += p.summed * s[19]
        if p.ramp > 0.0:
            # What compensates is faded in.
            s[12] += 1.0
            out = force + (1.0 - math.exp(-s[12] * tick / p.ramp)) * (out - force)
    else:
        s[4], s[12], s[19] = 0.0, 0.0, 0.0
        if p.forget > 0.0:
            s[6] = max(s[6] * (1.0 - p.forget * tick), 0.4 * k)
        out = force
    if p.passive > 0.0:
        # Keeps a part of the returned energy, so that a contact cannot create energy.
        s[17] = s[17] - force * rate * tick if abs(force) > 4.0 else 0.0
        s[18] = max(s[18], s[17]) if abs(force) > 4.0 else 0.0
        if s[17] < p.passive_from * s[18]:
            out *= 1.0 - p.passive
    if p.output_limit > 0.0:
        out = math.copysign(min(abs(out), p.output_limit), out)
    if p.overrun > 0.0 and abs(force) > 4.0 and abs(ahead) > 15.0:
        # An estimate takes so long that the output now and then is not there in time.
        s[16] += p.overrun
        if s[16] >= 1.0:
            s[16] -= 1.0
            out = earlier
    s[11] = out


@njit(error_model="numpy")
def _estimate(s, k, ahead):
    s[8] += 1e4
    s[10] += 1.0
    h0, h1 = s[5] - s[2], -s[3]
    ph0, ph1 = s[8] * h0 + s[9] * h1, s[9] * h0 + s[10] * h1
    spread = h0 * ph0 + h1 * ph1 + 4.0
    surprise = ahead - h0 * s[6] - h1 * s[7]
    s[6] = min(max(s[6] + ph0 / spread * surprise, 0.4 * k), 2.0 * k)
    s[7] = min(max(s[7] + ph1 / spread * surprise, 0.0), 600.0)
    s[8] -= ph0 * ph0 / spread
    s[9] -= ph0 * ph1 / spread
    s[10] -= ph1 * ph1 / spread
