"""The docking rig in machine code: the model that is compared with a rig's logs, effects included.

It takes the rig tick by tick, as its software does, and robot, contact and sensor in sub-steps between the
ticks. The servo is linear but for effects, and is advanced by its exact transition over a sub-step.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ...base.compiled_functions import njit
from .effect import Context, Site

CHANNELS = (
    "desired_position",
    "desired_velocity",
    "encoder_position",
    "sensor_force",
    "compensated_force",
    "stiffness_estimate",
    "contact_force",
    "contact_position",
)
# How many commands before the first tick a run is given.
HISTORY = 64
# The controller software takes what is below for no contact, and estimates stiffness and damping only above,
# where noise hardly counts [N]; filters its rates by these shares per tick; and bounds the damping [N.s/m].
IN_CONTACT = 4.0
_TELLING = 15.0
_FORCE_RATE, _POSITION_RATE = 0.35, 0.25
_STRONGEST_DAMPING = 600.0
# Per tick; with ten, halving the sub-step moves the sampled force of the nominal rig by less than its noise.
SUBSTEPS = 10


class Calibrated(IntEnum):
    """Parameters of the rig, SI (angular frequencies in rad/s)."""

    NATURAL_FREQUENCY = 0
    DAMPING_RATIO = 1
    RESPONSE_DELAY = 2
    CONTACT_STIFFNESS = 3
    CONTACT_DAMPING = 4
    FRONT_WALL = 5
    REAR_WALL = 6
    SENSOR_DELAY = 7
    SENSOR_CUTOFF = 8
    FORCE_BIAS = 9
    LEAD = 10
    STIFFNESS_GAIN = 11
    TICK = 12
    MASS = 13
    NOMINAL_STIFFNESS = 14
    NOMINAL_DAMPING = 15


class State(IntEnum):
    """State of the rig at a tick, out of contact."""

    POSITION = 0
    VELOCITY = 1
    FILTERED_FORCE = 2
    DESIRED_POSITION = 3
    DESIRED_VELOCITY = 4
    FORCE_RATE = 5
    POSITION_RATE = 6
    LAST_FORCE = 7
    LAST_POSITION = 8
    STIFFNESS = 9
    DAMPING = 10
    P00 = 11
    P01 = 12
    P11 = 13
    IN_CONTACT = 14
    CONTACT_POINT = 15
    COMPENSATED_FORCE = 16


class Inject(IntEnum):
    """Measured residuals that can be added to a component's output, one value per tick."""

    POSITION = 0
    FORCE = 1
    COMPENSATED_FORCE = 2
    VELOCITY = 3


_DOUBLE, _POINTER = ir.DoubleType(), ir.DoubleType().as_pointer()


@intrinsic
def _call_law(typing, address, time, step, value, context, memory, theta):
    """Double (*)(double, double, double, double *, double *, double *)"""
    function_type = ir.FunctionType(_DOUBLE, [_DOUBLE] * 3 + [_POINTER] * 3)

    def generate(compiler: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function = builder.inttoptr(arguments[0], function_type.as_pointer())
        pointers = [builder.inttoptr(one, _POINTER) for one in arguments[4:]]
        return builder.call(function, [*arguments[1:4], *pointers])

    word, double = types.int64, types.float64
    return double(word, double, double, double, word, word, word), generate


_OMEGA, _XI, _TAU, _K, _C, _FRONT, _REAR, _TAU_S, _CUTOFF, _BIAS, _LEAD, _GAIN, _TICK, _MASS, _K0, _C0 = map(
    int, Calibrated
)
_X, _V, _Y, _XD, _VD, _G, _U, _FP, _XP, _KE, _CE, _P00, _P01, _P11, _IN, _X0, _OUT = map(int, State)
_AT_COMMAND, _AT_DELAY, _AT_ACCELERATION, _AT_LIMIT, _AT_RATE, _AT_POSITION = map(int, list(Site)[:6])
_AT_STRUCTURE, _AT_STIFFNESS, _AT_CONTACT, _AT_PUSH = map(int, list(Site)[6:10])
_AT_FORCE, _AT_SAMPLE, _AT_BODY = map(int, list(Site)[10:])
_POSITION, _VELOCITY, _ACCELERATION, _COMMAND, _FORCE, _DEPTH = map(int, list(Context)[:6])
_DEPTH_RATE, _SIDE, _STIFFNESS, _DAMPING, _NUMBER, _BODY_MASS = map(int, list(Context)[6:])
_HISTORY, _SUBSTEPS = HISTORY, SUBSTEPS


@njit(error_model="numpy", inline="always")
def pass_site(site, laws, time, step, value, known, memory, theta):
    """Pass a value through the laws of a site; laws are `sites`, `addresses` and `at` of `Laws`."""
    sites, addresses, at = laws
    for one in range(sites[site], sites[site + 1]):
        value = _call_law(
            addresses[one],
            time,
            step,
            value,
            known.ctypes.data,
            memory.ctypes.data + 8 * at[one, 0],
            theta.ctypes.data + 8 * at[one, 1],
        )
    return value


@njit(error_model="numpy")
def _transition(omega, xi, step):
    """Transition of position and velocity of x'' = omega^2 (c - x) - 2 xi omega x' over a step.

    Returns: e11, e12, e21, e22 of the homogeneous part, and the response of x and x' to a unit acceleration.
    """
    decay = xi * omega
    square = omega * omega * (1.0 - xi * xi)
    envelope = math.exp(-decay * step)
    if square > 1e-9:
        root = math.sqrt(square)
        cosine, sine = envelope * math.cos(root * step), envelope * math.sin(root * step) / root
    elif square < -1e-9:
        root = math.sqrt(-square)
        cosine, sine = envelope * math.cosh(root * step), envelope * math.sinh(root * step) / root
    else:
        cosine, sine = envelope, envelope * step
    e11, e12 = cosine + decay * sine, sine
    e21, e22 = -omega * omega * sine, cosine - decay * sine
    return e11, e12, e21, e22, (1.0 - e11) / (omega * omega), sine


@njit(error_model="numpy", nogil=True)
def run_rig(
    p, closed, commands, state, laws, memory, theta, inject, begin, out, substeps=_SUBSTEPS, pull=0.0
):
    """Run the rig over the ticks of `out`.

    Args:
        p: parameters by `Calibrated`, shape (16,).
        closed: whether controller and satellite close the loop; otherwise the commands are what was logged.
        commands: commands sent, shape (HISTORY + n,) [m]; entry HISTORY + i is desired_position[i + 1], sent
            at tick i. In closed loop those from index HISTORY are written.
        state: by `State`, shape (17,); left as it is at the end.
        laws: first law of each site and the end, shape (len(Site) + 1,); addresses, shape (l,); places of
            each law's memory and parameters, shape (l, 2).
        memory, theta: of all laws.
        inject: by `Inject`, shape (4, n + 1).
        begin: number of the first tick.
        out: by `CHANNELS`, shape (8, n); written. With a pull its encoder holds what was measured when given.
        substeps: per tick.
        pull: both poles of the observer that draws the servo to the encoder; none, if zero [rad/s].
    """
    h = p[_TICK]
    dt = h / substeps
    transition = _transition(p[_OMEGA], p[_XI], dt)
    lag = math.exp(-dt * p[_CUTOFF]) if p[_CUTOFF] > 0.0 else 0.0
    # No sensor reads what is still to come: fits may try delays below zero.
    back = max(p[_TAU_S], 0.0) / dt
    known = np.zeros(16)
    known[_STIFFNESS], known[_DAMPING], known[_BODY_MASS] = p[_K], p[_C], p[_MASS]
    # Of a delay beyond the run, or none at all, as fits that run away try, no more is kept than the run.
    longest = float(out.shape[1] * substeps)
    ring = np.zeros(int(back if back < longest else longest) + 3)
    received = commands.copy()
    for i in range(_HISTORY):
        known[_NUMBER] = begin + i - _HISTORY
        time = (begin + i - _HISTORY) * h
        received[i] = pass_site(_AT_COMMAND, laws, time, h, commands[i], known, memory, theta)
    servo = np.array([state[_X], state[_V], state[_X], state[_V], 0.0])
    known[_POSITION], known[_VELOCITY] = servo[0], servo[1]
    servo[2] = pass_site(_AT_POSITION, laws, begin * h, 0.0, servo[0], known, memory, theta)
    servo[4] = servo[2] - servo[0]
    y, contact, force, behind_before = state[_Y], servo[2], 0.0, 0.0
    shift = pass_site(_AT_STRUCTURE, laws, begin * h, 0.0, contact, known, memory, theta) - contact
    for n in range(out.shape[1]):
        time = (begin + n) * h
        known[_NUMBER] = begin + n
        encoder = servo[2] + (inject[0, n] if closed else 0.0)
        sample = pass_site(_AT_SAMPLE, laws, time, h, y + p[_BIAS], known, memory, theta) + inject[1, n]
        if pull > 0.0:
            deviation = out[2, n] - encoder
            servo[0] += 2.0 * pull * h * deviation
            servo[1] += pull * pull * h * deviation
        out[2, n], out[3, n], out[6, n], out[7, n] = encoder, sample, force, contact
        if closed:
            control(p, state, sample, encoder)
            out[0, n], out[1, n] = state[_XD], state[_VD]
            out[4, n], out[5, n] = state[_OUT] + inject[2, n], state[_KE]
            state[_VD] += inject[3, n]
            known[_POSITION], known[_VELOCITY] = state[_XD], state[_VD]
            move_body(laws, time, h, out[4, n], known, memory, theta)
            state[_XD], state[_VD] = known[_POSITION], known[_VELOCITY]
            commands[_HISTORY + n] = state[_XD]
        sent = commands[_HISTORY + n]
        received[_HISTORY + n] = pass_site(_AT_COMMAND, laws, time, h, sent, known, memory, theta)
        for sub in range(substeps):
            now = time + (sub + 1) * dt
            tau = pass_site(_AT_DELAY, laws, now, dt, p[_TAU], known, memory, theta)
            known[_COMMAND] = _delayed(received, n, (sub + 1) * dt - tau, h, dt)
            _move_servo(p, transition, servo, laws, now, dt, known, memory, theta)
            slope = (inject[0, n + 1] - inject[0, n]) / h
            unshifted = servo[2] + inject[0, n] + (sub + 1) * dt * slope
            contact = pass_site(_AT_STRUCTURE, laws, now, dt, unshifted, known, memory, theta)
            # Laws move positions; only what they add is differentiated, so that none adds nothing.
            rate = servo[3] + slope + (contact - unshifted - shift) / dt
            shift = contact - unshifted
            force = _push(p, contact, rate, laws, now, dt, known, memory, theta)
            known[_FORCE] = force
            index = n * substeps + sub + 1
            ring[index % len(ring)] = force
            behind = _behind(ring, index, back)
            y = lag * y + (1.0 - lag) * 0.5 * (behind_before + behind)
            behind_before = behind
    state[_X], state[_V], state[_Y] = servo[0], servo[1], y


@njit(error_model="numpy", inline="always")
def _move_servo(p, transition, servo, laws, now, dt, known, memory, theta):
    """Advance position and velocity of the servo, and what the encoder sees of them, by a sub-step."""
    x, v, command = servo[0], servo[1], known[_COMMAND]
    linear = p[_OMEGA] * p[_OMEGA] * (command - x) - 2.0 * p[_XI] * p[_OMEGA] * v
    known[_POSITION], known[_VELOCITY], known[_ACCELERATION] = x, v, linear
    disturbed = pass_site(_AT_ACCELERATION, laws, now, dt, linear, known, memory, theta)
    e11, e12, e21, e22, b1, b2 = transition
    x_next = command + e11 * (x - command) + e12 * v + b1 * (disturbed - linear)
    v_next = e21 * (x - command) + e22 * v + b2 * (disturbed - linear)
    # The mean over the sub-step is bounded: where a command arrives, the acceleration jumps and falls fast.
    mean = (v_next - v) / dt
    acceleration = pass_site(_AT_LIMIT, laws, now, dt, mean, known, memory, theta)
    if acceleration != mean:
        v_next = v + dt * acceleration
        x_next = x + 0.5 * dt * (v + v_next)
    limited = pass_site(_AT_RATE, laws, now, dt, v_next, known, memory, theta)
    if limited != v_next:
        x_next, v_next = x + 0.5 * dt * (v + limited), limited
    # The mean over the sub-step: its value at the begin is off by what the servo decays in half of it.
    known[_POSITION], known[_VELOCITY], known[_ACCELERATION] = x_next, v_next, (v_next - v) / dt
    seen = pass_site(_AT_POSITION, laws, now, dt, x_next, known, memory, theta)
    servo[3] = v_next + (seen - x_next - servo[4]) / dt
    servo[0], servo[1], servo[2], servo[4] = x_next, v_next, seen, seen - x_next


@njit(error_model="numpy", inline="always")
def _push(p, contact, rate, laws, now, dt, known, memory, theta):
    """Force of the frames on the rod."""
    side, depth = 0.0, 0.0
    if contact > p[_FRONT]:
        side, depth = 1.0, contact - p[_FRONT]
    elif contact < p[_REAR]:
        side, depth = -1.0, p[_REAR] - contact
    known[_DEPTH], known[_DEPTH_RATE], known[_SIDE] = depth, side * rate, side
    # The damping's jump at the onset is spread over the sub-step in which it falls: otherwise the force would
    # jump as a wall is moved across a sub-step, and derivatives would be wrong.
    crossing = side * rate * dt
    share = depth / crossing if depth < crossing else 1.0
    stiffness = pass_site(_AT_STIFFNESS, laws, now, dt, p[_K], known, memory, theta)
    known[_STIFFNESS] = stiffness
    plain = stiffness * depth + share * p[_C] * side * rate
    push = pass_site(_AT_CONTACT, laws, now, dt, plain, known, memory, theta)
    push = pass_site(_AT_PUSH, laws, now, dt, push, known, memory, theta)
    force = -side * max(push, 0.0) if side != 0.0 else 0.0
    return pass_site(_AT_FORCE, laws, now, dt, force, known, memory, theta)


@njit(error_model="numpy")
def move_body(laws, time, tick, force, known, memory, theta):
    """Satellite software over a tick: four semi-implicit sub-steps, velocity first.

    Position and velocity stand in `known`, and are left there.

    Returns: the mean force, laws included [N].
    """
    total = 0.0
    for sub in range(4):
        now = time + 0.25 * sub * tick
        body = pass_site(_AT_BODY, laws, now, 0.25 * tick, force, known, memory, theta)
        known[_VELOCITY] += 0.25 * tick * body / known[_BODY_MASS]
        known[_POSITION] += 0.25 * tick * known[_VELOCITY]
        total += 0.25 * body
    return total


@njit(error_model="numpy", inline="always")
def _delayed(received, n, since, h, dt):
    """The command that acts on the servo over a sub-step, which ends `since` after tick n, delay included.

    Where it changes within the sub-step, it is the mean. None acts before it is sent: fits may try delays
    below zero.
    """
    ticks = min(math.floor(since / h), 0.0)
    index = max(_HISTORY + n + int(ticks), 0)
    share = (since - ticks * h) / dt
    if share >= 1.0 or index == 0:
        return received[index]
    return share * received[index] + (1.0 - share) * received[index - 1]


@njit(error_model="numpy", inline="always")
def _behind(ring, index, back):
    """Force `back` sub-steps before an index, linear between sub-steps; zero before the run."""
    at = index - back
    if at < 0.0:
        return 0.0
    low = int(at)
    part = at - low
    if part == 0.0:
        return ring[low % len(ring)]
    return (1.0 - part) * ring[low % len(ring)] + part * ring[(low + 1) % len(ring)]


@njit(error_model="numpy")
def control(p, state, force, position):
    """The controller software at a tick; its output is left in the state."""
    h = p[_TICK]
    state[_G] += _FORCE_RATE * ((force - state[_FP]) / h - state[_G])
    state[_U] += _POSITION_RATE * ((position - state[_XP]) / h - state[_U])
    state[_FP], state[_XP] = force, position
    led = force + p[_LEAD] * state[_G]
    if abs(force) <= IN_CONTACT:
        state[_IN] = 0.0
        state[_OUT] = force
        return
    if state[_IN] == 0.0:
        state[_IN] = 1.0
        state[_X0] = position + force / max(state[_KE], 1000.0)
    if abs(led) > _TELLING:
        state[_P00] += 1e4
        state[_P11] += 1.0
        h0, h1 = -(position - state[_X0]), -state[_U]
        s0 = state[_P00] * h0 + state[_P01] * h1
        s1 = state[_P01] * h0 + state[_P11] * h1
        s = h0 * s0 + h1 * s1 + 4.0
        gain0, gain1 = s0 / s, s1 / s
        error = led - h0 * state[_KE] - h1 * state[_CE]
        state[_KE] += gain0 * error
        state[_CE] += gain1 * error
        state[_P00] -= gain0 * s0
        state[_P01] -= gain0 * s1
        state[_P11] -= gain1 * s1
        state[_KE] = min(max(state[_KE], 0.4 * p[_K0]), 2.0 * p[_K0])
        state[_CE] = min(max(state[_CE], 0.0), _STRONGEST_DAMPING)
    state[_OUT] = (
        led - (1.0 + p[_GAIN]) * state[_KE] * (state[_XD] - position) - state[_CE] * (state[_VD] - state[_U])
    )
