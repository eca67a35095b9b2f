"""Position of the rod's tip in the real rig, and the contact force at one instant.

States and memory are those of `plant`, which integrates them.
"""

from __future__ import annotations

import math

from ....base.compiled_functions import njit

_REFERENCE_DEPTH = 5e-4  # at which a power-law contact is as stiff as a linear one [m]
_CUBIC_DEPTH = 1e-3
BEHIND = 11.0  # stiffness of the frame behind a loose plate, over that of frame and plate
_FILM_REACH = 15.0  # gaps of a film beyond which it is none
_MAGNET_REACH = 12.0  # the same of a magnet's
_LATCH_WIDTH = 1.0 / 3.0  # of a latch's depth: from where it is hardest to its crest
# Of its reach, over which a brush stiffens; rate over which it turns [m/s]; of its force, what it keeps on
# the way out.
_BRUSH_SHARE, _BRUSH_RATE, _BRUSH_OUT = 0.3, 2e-3, 0.2
_PAD_SPEED = 0.02  # at which a pad that stiffens with it is reported how much [m/s]
_SEAL = 5e-5  # over which a seal opens [m]
_TOOTH = 0.8  # of a ratchet's pitch, what its pawl climbs
_TOOTH_RATE = 1e-3  # over which a ratchet turns [m/s]
_RELEASE, _STROKE = 3e-3, 3e-5  # how long an ejector takes to push [s], and over which its stroke ends [m]
_HUNT_EDGE = 8.0  # how square a hunting axis moves: slope of its jumps over that of a sine
_FOIL_PLAIN = 0.4  # of the force at which a foil tears, what does not grow with the stretch's third power


@njit(error_model="numpy")
def output(p, s, memory):
    """Position [m] and rate [m/s] of the robot's flange, which the encoder sees."""
    x, v = s[0] + s[2], s[1] + s[3]
    if p.backlash > 0.0:
        half = 0.5 * p.backlash
        if x - half > memory[0]:
            x -= half
        elif x + half < memory[0]:
            x += half
        else:
            return memory[0], 0.0
    return x, v


@njit(error_model="numpy")
def lifted(p, rate):
    """By how much a slide floats on its oil at some rate [m/s], once it does [m]."""
    return p.lift * (1.0 - math.exp(-abs(rate) / p.lift_rate)) if p.lift > 0.0 else 0.0


@njit(error_model="numpy")
def _contact_point(p, t, s, memory):
    position, rate = output(p, s, memory)
    if p.lost > 0.0:
        position += memory[11]
    stretch = 1.0 + p.scale + p.bend * position
    point = stretch * position - p.offset + memory[5] + s[11]
    rate = (stretch + p.bend * position) * rate + s[12]
    if p.joint > 0.0:
        point += p.joint * memory[9]
    if p.clutch > 0.0:
        point += memory[26]
    if p.chuck > 0.0:
        point += memory[32]
    if p.hammer > 0.0:
        point += p.hammer * s[25]
        rate += p.hammer * s[26]
    if p.thread > 0.0:
        # A spindle behind the encoder, its pitch uneven.
        turned = 2.0 * math.pi * position / p.thread_pitch + p.thread_phase
        point += p.thread * math.sin(turned)
        rate *= 1.0 + 2.0 * math.pi * p.thread / p.thread_pitch * math.cos(turned)
    if p.growth != 0.0:
        # What warms grows.
        left = math.exp(-t / p.growth_time)
        point += p.growth * (1.0 - left)
        rate += p.growth / p.growth_time * left
    if p.lift > 0.0:
        # Oil between slide and guide carries the more, the faster it goes; the tip rises with the slide.
        point += memory[23]
        rate += (lifted(p, s[1] + s[3]) - memory[23]) / p.lift_time
    if p.hunt > 0.0:
        # An axis across, which sticks, is wound up, jumps, and the same the other way.
        turned = p.hunt_omega * t + memory[10]
        side = math.tanh(_HUNT_EDGE * math.sin(turned))
        point += p.hunt * side
        rate += p.hunt * _HUNT_EDGE * p.hunt_omega * math.cos(turned) * (1.0 - side * side)
    if p.yaw != 0.0:
        # The slide turns in its guide the way that friction takes it; the rod is not in its middle.
        speed = s[1] + s[3]
        point -= p.yaw * memory[36]
        rate -= p.yaw * (speed - abs(speed) * memory[36]) / p.yaw_length
    if p.floor > 0.0:
        turned = p.floor_omega * t + memory[10]
        point += p.floor * math.sin(turned)
        rate += p.floor * p.floor_omega * math.cos(turned)
    return point, rate


@njit(error_model="numpy")
def depth_of(p, t, s, memory):
    """Side (1 front, -1 rear), penetration [m] and its rate [m/s] of the nearer frame; negative if free."""
    point, rate = _contact_point(p, t, s, memory)
    short, shorter = memory[22], 0.0
    if p.whip > 0.0:
        short += p.whip * s[20] * s[20]  # whatever side it bows to
        shorter = 2.0 * p.whip * s[20] * s[21]
    if 2.0 * point > p.front + p.rear:
        depth = point - p.front - memory[2] - s[7] - s[13] - memory[7] - memory[17] - short
        if p.clay > 0.0:
            depth += p.clay * math.exp(-memory[37] / p.clay_impulse)  # stuck on the port, and beaten flat
        return 1.0, depth, rate - s[8] - s[14] - shorter
    return -1.0, p.rear - memory[2] - point - memory[7] - memory[18] - short, -rate - shorter


@njit(error_model="numpy")
def contact_force(p, t, s, memory):
    """Force on the rod [N], negative at the front frame; side, effective penetration [m] and its rate."""
    side, depth, rate = depth_of(p, t, s, memory)
    touch, pull = 1.0, 0.0
    if p.adhesion > 0.0 and rate < 0.0:
        pull = p.adhesion * math.exp(-((depth / p.adhesion_range) ** 2))
    if p.film > 0.0 and depth > -_FILM_REACH * p.film_gap:
        # What is squeezed out of a gap h resists as 1/h^3; the frame's roughness keeps it open.
        pull -= p.film * rate / (1.0 + max(-depth, 0.0) / p.film_gap) ** 3
    if p.magnet > 0.0 and side > 0.0 and depth > -_MAGNET_REACH * p.magnet_gap:
        pull += p.magnet / (1.0 + max(-depth, 0.0) / p.magnet_gap) ** 2
    if p.brush > 0.0 and depth > -p.brush_reach:
        # Bristles before the frame, which drag once they are bent.
        bent = 1.0 - math.exp(-(depth + p.brush_reach) / (_BRUSH_SHARE * p.brush_reach))
        way = 0.5 * (1.0 + math.tanh(rate / _BRUSH_RATE))
        pull -= p.brush * bent * (_BRUSH_OUT + (1.0 - _BRUSH_OUT) * way)
    if p.foil > 0.0 and side > 0.0 and memory[20] == 0.0:
        # Left on the port: the first that comes stretches it until it tears.
        stretch = max((depth + p.foil_at) / p.foil_stretch, 0.0)
        pull -= p.foil * stretch * (_FOIL_PLAIN + (1.0 - _FOIL_PLAIN) * stretch * stretch)
    if p.hook > 0.0 and side > 0.0 and depth < 0.0 and memory[21] > 0.0:
        # A tape whose hooks let go one by one.
        stretch = -depth / p.hook_reach
        pull += p.hook * stretch * math.exp(1.0 - stretch)
    if p.cup > 0.0 and side > 0.0 and memory[39] > 0.0:
        # Pressed empty, it sucks on the way out, until its lip lets go.
        back = max(memory[39] - depth, 0.0)
        pull += p.cup * (1.0 - math.exp(-back / p.cup_reach)) * math.exp(min(depth, 0.0) / _SEAL)
    if p.vent > 0.0 and side > 0.0:
        # A room that the rod seals, and into which gas leaks.
        pull -= p.vent * memory[29] * math.exp(min(depth, 0.0) / _SEAL)
    if p.onset > 0.0:
        if depth < -50.0 * p.onset:
            return side * pull, side, 0.0, 0.0
        reach = math.sqrt(depth * depth + p.onset * p.onset)
        touch = 0.5 * (1.0 + depth / reach)
        depth = 0.5 * (depth + reach)
    elif depth <= 0.0:
        return side * pull, side, 0.0, 0.0
    rate *= touch
    k = p.k * (1.0 - side * p.asymmetry) * math.exp(-p.softening * t)
    if p.thick > 0.0:
        k *= 1.0 + p.thick * memory[19] / _PAD_SPEED  # a pad whose paste stiffens where it is struck
    if memory[28] != 0.0:
        k *= math.exp(memory[28])
    if p.snap > 0.0 and side > 0.0 and memory[27] > p.snap_after:
        k *= 1.0 - p.snap  # one of the frame's springs has broken
    if p.worked > 0.0:
        k *= math.exp(-p.worked * memory[34 if side > 0.0 else 35])  # rubber that its work warms is softer
    if p.plate > 0.0 and side > 0.0:
        k *= BEHIND / (BEHIND - 1.0)  # in series with the frame behind the plate, as stiff as without it
    spring = k * depth
    if p.hertz != 0.0:
        spring *= (depth / _REFERENCE_DEPTH) ** p.hertz
    if p.plasticity > 0.0 and depth < memory[1]:
        left = (depth - p.plasticity * memory[1]) / (1.0 - p.plasticity)
        spring = k * memory[1] * (left / memory[1]) ** (1.0 + 0.3 * p.plasticity) if left > 0.0 else 0.0
    if p.cubic != 0.0:
        spring += k * p.cubic * depth * (depth / _CUBIC_DEPTH) ** 2
    if p.second != 0.0:
        beyond = depth - p.second_depth
        spring += 0.5 * p.second * k * (beyond + math.sqrt(beyond * beyond + 1e-10))
    if p.maxwell != 0.0:
        spring += p.maxwell * k * s[4]
    damper = (p.c + p.crossley * depth) * rate
    if p.valve > 0.0 and rate > 0.0:
        damper += p.valve * rate * rate  # oil through an orifice, which comes back through a valve
    if p.compliance > 0.0:
        # The mount's spring in series with spring and damper of the frame, to first order in the rate.
        soft = 1.0 + k * p.compliance
        spring, damper = spring / soft, damper / (soft * soft)
    push = spring + damper
    if p.slack > 0.0 and push > 0.0:
        push -= k * p.slack * (1.0 - math.exp(-push / p.slack_force))
    if p.friction != 0.0:
        push *= 1.0 + p.friction * math.tanh(rate / p.friction_rate)
    if p.latch > 0.0 and side > 0.0:
        # A sprung pawl: pushed aside up to its crest, then it pulls in.
        u = (p.latch_depth - depth) / (_LATCH_WIDTH * p.latch_depth)
        push += p.latch * u * math.exp(0.5 * (1.0 - u * u))
    if p.ratchet > 0.0 and side > 0.0:
        # Its pawl climbs tooth after tooth on the way in, and is lifted on the way out.
        tooth = depth / p.ratchet_pitch
        tooth -= math.floor(tooth)
        climbed = tooth / _TOOTH if tooth < _TOOTH else (1.0 - tooth) / (1.0 - _TOOTH)
        push += 0.5 * p.ratchet * climbed * (1.0 + math.tanh(rate / _TOOTH_RATE))
    if p.rope > 0.0:
        push += p.rope * memory[38]  # strands of wire that rub against each other
    if p.ejector > 0.0 and side > 0.0 and memory[33] > p.ejector_after:
        # A spring that a switch releases some time after the touch; it is cocked again when all is free.
        since = memory[33] - p.ejector_after
        push += p.ejector * (1.0 - math.exp(-since / _RELEASE)) * (1.0 - math.exp(-depth / _STROKE))
    if p.scrape > 0.0:
        push *= 1.0 + memory[12]
    if p.chatter > 0.0:
        push *= 1.0 + p.chatter * math.sin(p.chatter_omega * (t - memory[16]))
    return side * (pull - max(push, 0.0)), side, depth, rate
