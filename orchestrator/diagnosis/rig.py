"""The docking rig in machine code: the model that is compared with a rig's logs, effects included.

It takes the rig tick by tick, as its software does, and the robot, the contact and the sensor in sub-steps
between the ticks. The servo is linear but for effects, and is advanced by its exact transition over a sub-step.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from .effect import Site

__all__ = ["CHANNELS", "HISTORY", "SUBSTEPS", "Calibrated", "Inject", "State", "run_rig"]

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
    """What the rig remembers at a tick, out of contact."""

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
    """double (*)(double, double, double, double *, double *, double *)"""
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
_AT_STRUCTURE, _AT_CONTACT, _AT_FORCE, _AT_DELAYED, _AT_SAMPLE, _AT_BODY = map(int, list(Site)[6:])
_RING = 4096  # sub-steps of force that are kept for the sensor's delay
_HISTORY, _SUBSTEPS = HISTORY, SUBSTEPS


@njit(cache=True, error_model="numpy")
def _apply(first, end, laws, at, time, step, value, context, memory, theta):
    """Pass a value through the laws of a site."""
    for one in range(first, end):
        value = _call_law(
            laws[one], time, step, value, context, memory + 8 * at[one, 0], theta + 8 * at[one, 1]
        )
    return value


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy", nogil=True)
def run_rig(p, closed, commands, state, sites, laws, at, memory, theta, inject, begin, out):
    """Run the rig over the ticks of `out`.

    Args:
        p: parameters by `Calibrated`, shape (16,).
        closed: whether controller and satellite close the loop; otherwise the commands are what was logged.
        commands: commands sent, shape (HISTORY + n,) [m]; entry HISTORY + i is desired_position[i + 1], sent
            at tick i. In closed loop those from HISTORY on are written.
        state: by `State`, shape (17,); left as it is at the end.
        sites: first law of each site, and the end, shape (len(Site) + 1,).
        laws: addresses, shape (l,); at: of each law's memory and parameters, shape (l, 2).
        memory, theta: of all laws.
        inject: by `Inject`, shape (4, n + 1).
        begin: number of the first tick.
        out: by `CHANNELS`, shape (8, n); written.
    """
    h, m = p[_TICK], p[_MASS]
    ticks = out.shape[1]
    dt = h / _SUBSTEPS
    omega, xi, front, rear = p[_OMEGA], p[_XI], p[_FRONT], p[_REAR]
    k, c = p[_K], p[_C]
    e11, e12, e21, e22, b1, b2 = _transition(omega, xi, dt)
    lag = math.exp(-dt * p[_CUTOFF]) if p[_CUTOFF] > 0.0 else 0.0
    back = p[_TAU_S] / dt
    context_array = np.zeros(16)
    context_array[8], context_array[9], context_array[11] = k, c, m
    context, memory_at, theta_at = context_array.ctypes.data, memory.ctypes.data, theta.ctypes.data
    ring = np.zeros(_RING)
    received = commands.copy()
    if sites[_AT_COMMAND] < sites[_AT_COMMAND + 1]:
        for i in range(_HISTORY):
            context_array[10] = begin + i - _HISTORY
            received[i] = _apply(
                sites[_AT_COMMAND], sites[_AT_COMMAND + 1], laws, at, (begin + i - _HISTORY) * h, h,
                commands[i], context, memory_at, theta_at,
            )  # fmt: skip
    x, v, y = state[_X], state[_V], state[_Y]
    seen, contact = x, x
    started = False
    force = 0.0
    for n in range(ticks):
        tick = begin + n
        time = tick * h
        context_array[10] = tick
        encoder = seen + (inject[0, n] if closed else 0.0)
        if not started and sites[_AT_POSITION] < sites[_AT_POSITION + 1]:
            context_array[0], context_array[1] = x, v
            seen = _apply(
                sites[_AT_POSITION], sites[_AT_POSITION + 1], laws, at, time, 0.0, x, context, memory_at, theta_at
            )  # fmt: skip
            encoder = seen + (inject[0, n] if closed else 0.0)
        sample = y
        if sites[_AT_DELAYED] < sites[_AT_DELAYED + 1]:
            sample = _apply(
                sites[_AT_DELAYED], sites[_AT_DELAYED + 1], laws, at, time, 0.0, y, context, memory_at, theta_at
            )  # fmt: skip
        sample += p[_BIAS]
        if sites[_AT_SAMPLE] < sites[_AT_SAMPLE + 1]:
            sample = _apply(
                sites[_AT_SAMPLE], sites[_AT_SAMPLE + 1], laws, at, time, h, sample, context, memory_at, theta_at
            )  # fmt: skip
        sample += inject[1, n]
        out[2, n], out[3, n], out[6, n], out[7, n] = encoder, sample, force, contact
        if closed:
            _control(p, state, sample, encoder)
            compensated = state[_OUT] + inject[2, n]
            out[0, n], out[1, n] = state[_XD], state[_VD]
            out[4, n], out[5, n] = compensated, state[_KE]
            body = compensated
            if sites[_AT_BODY] < sites[_AT_BODY + 1]:
                context_array[0], context_array[1] = state[_XD], state[_VD]
                body = _apply(
                    sites[_AT_BODY], sites[_AT_BODY + 1], laws, at, time, h, body, context, memory_at, theta_at
                )  # fmt: skip
            state[_VD] += inject[3, n]
            for _ in range(4):
                state[_VD] += 0.25 * h * body / m
                state[_XD] += 0.25 * h * state[_VD]
            commands[_HISTORY + n] = state[_XD]
        received[_HISTORY + n] = commands[_HISTORY + n]
        if sites[_AT_COMMAND] < sites[_AT_COMMAND + 1]:
            received[_HISTORY + n] = _apply(
                sites[_AT_COMMAND], sites[_AT_COMMAND + 1], laws, at, time, h, commands[_HISTORY + n],
                context, memory_at, theta_at,
            )  # fmt: skip
        for sub in range(_SUBSTEPS):
            end = (sub + 1) * dt
            tau = p[_TAU]
            if sites[_AT_DELAY] < sites[_AT_DELAY + 1]:
                tau = _apply(
                    sites[_AT_DELAY], sites[_AT_DELAY + 1], laws, at, time + end, dt, tau, context, memory_at,
                    theta_at,
                )  # fmt: skip
            command = _delayed(received, n, end - tau, h, dt)
            acceleration = omega * omega * (command - x) - 2.0 * xi * omega * v
            extra = 0.0
            if sites[_AT_ACCELERATION] < sites[_AT_ACCELERATION + 1]:
                context_array[0], context_array[1], context_array[2] = x, v, acceleration
                context_array[3], context_array[4] = command, force
                changed = _apply(
                    sites[_AT_ACCELERATION], sites[_AT_ACCELERATION + 1], laws, at, time + end, dt, acceleration,
                    context, memory_at, theta_at,
                )  # fmt: skip
                extra = changed - acceleration
                acceleration = changed
            limited = acceleration
            if sites[_AT_LIMIT] < sites[_AT_LIMIT + 1]:
                limited = _apply(
                    sites[_AT_LIMIT], sites[_AT_LIMIT + 1], laws, at, time + end, dt, acceleration, context,
                    memory_at, theta_at,
                )  # fmt: skip
            if limited != acceleration:
                acceleration = limited
                v_next = v + dt * limited
                x_next = x + 0.5 * dt * (v + v_next)
            else:
                off = x - command
                x_next = command + e11 * off + e12 * v + b1 * extra
                v_next = e21 * off + e22 * v + b2 * extra
            if sites[_AT_RATE] < sites[_AT_RATE + 1]:
                limited = _apply(
                    sites[_AT_RATE], sites[_AT_RATE + 1], laws, at, time + end, dt, v_next, context, memory_at,
                    theta_at,
                )  # fmt: skip
                if limited != v_next:
                    x_next = x + 0.5 * dt * (v + limited)
                    v_next = limited
            x, v = x_next, v_next
            context_array[0], context_array[1], context_array[2] = x, v, acceleration
            seen_rate = v
            before = seen
            seen = x
            if sites[_AT_POSITION] < sites[_AT_POSITION + 1]:
                seen = _apply(
                    sites[_AT_POSITION], sites[_AT_POSITION + 1], laws, at, time + end, dt, x, context, memory_at,
                    theta_at,
                )  # fmt: skip
                seen_rate = (seen - before) / dt
            part = (sub + 1) / _SUBSTEPS
            correction = inject[0, n] + part * (inject[0, n + 1] - inject[0, n])
            contact_before = contact
            contact = seen + correction
            rate = seen_rate + (inject[0, n + 1] - inject[0, n]) / h
            if sites[_AT_STRUCTURE] < sites[_AT_STRUCTURE + 1]:
                contact = _apply(
                    sites[_AT_STRUCTURE], sites[_AT_STRUCTURE + 1], laws, at, time + end, dt, contact, context,
                    memory_at, theta_at,
                )  # fmt: skip
                if started:
                    rate = (contact - contact_before) / dt
            started = True
            side, depth = 0.0, 0.0
            if contact > front:
                side, depth = 1.0, contact - front
            elif contact < rear:
                side, depth = -1.0, rear - contact
            force = 0.0
            if side != 0.0:
                push = k * depth + c * side * rate
                if sites[_AT_CONTACT] < sites[_AT_CONTACT + 1]:
                    context_array[5], context_array[6], context_array[7] = depth, side * rate, side
                    push = _apply(
                        sites[_AT_CONTACT], sites[_AT_CONTACT + 1], laws, at, time + end, dt, push, context,
                        memory_at, theta_at,
                    )  # fmt: skip
                force = -side * max(push, 0.0)
            elif sites[_AT_CONTACT] < sites[_AT_CONTACT + 1]:
                context_array[5], context_array[6], context_array[7] = 0.0, 0.0, 0.0
                _apply(
                    sites[_AT_CONTACT], sites[_AT_CONTACT + 1], laws, at, time + end, dt, 0.0, context, memory_at,
                    theta_at,
                )  # fmt: skip
            if sites[_AT_FORCE] < sites[_AT_FORCE + 1]:
                context_array[5], context_array[6], context_array[7] = depth, side * rate, side
                force = _apply(
                    sites[_AT_FORCE], sites[_AT_FORCE + 1], laws, at, time + end, dt, force, context, memory_at,
                    theta_at,
                )  # fmt: skip
            context_array[4] = force
            index = n * _SUBSTEPS + sub + 1
            ring[index % _RING] = force
            y = lag * y + (1.0 - lag) * 0.5 * (_behind(ring, index - 1, back) + _behind(ring, index, back))
    state[_X], state[_V], state[_Y] = x, v, y


@njit(cache=True, error_model="numpy")
def _delayed(received, n, since, h, dt):
    """The command that acts on the servo over a sub-step, which ends `since` after tick n, delay included.

    Where it changes within the sub-step, it is the mean.
    """
    ticks = math.floor(since / h)
    index = min(max(_HISTORY + n + int(ticks), 0), received.shape[0] - 1)
    share = (since - ticks * h) / dt
    if share >= 1.0 or index == 0:
        return received[index]
    return share * received[index] + (1.0 - share) * received[index - 1]


@njit(cache=True, error_model="numpy")
def _behind(ring, index, back):
    """Force `back` sub-steps before an index, linear between sub-steps; zero before the run."""
    at = index - back
    if at < 0.0:
        return 0.0
    low = int(at)
    part = at - low
    if part == 0.0:
        return ring[low % _RING]
    return (1.0 - part) * ring[low % _RING] + part * ring[(low + 1) % _RING]


@njit(cache=True, error_model="numpy")
def _control(p, state, force, position):
    """The controller software at a tick; its output is left in the state."""
    h = p[_TICK]
    state[_G] += 0.35 * ((force - state[_FP]) / h - state[_G])
    state[_U] += 0.25 * ((position - state[_XP]) / h - state[_U])
    state[_FP], state[_XP] = force, position
    led = force + p[_LEAD] * state[_G]
    if abs(force) <= 4.0:
        state[_IN] = 0.0
        state[_OUT] = force
        return
    if state[_IN] == 0.0:
        state[_IN] = 1.0
        state[_X0] = position + force / max(state[_KE], 1000.0)
    if abs(led) > 15.0:
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
        state[_CE] = min(max(state[_CE], 0.0), 600.0)
    state[_OUT] = (
        led
        - (1.0 + p[_GAIN]) * state[_KE] * (state[_XD] - position)
        - state[_CE] * (state[_VD] - state[_U])
    )
