"""The real rig, tick by tick: software at the ticks, the plant between them, and what the lab logs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ....base.arrays import Array
from ....base.compiled_functions import njit
from .contact import contact_force, lifted, output
from .plant import FORWARD, fresh, integrate, past
from .rig_parameters import rig_parameters
from .sensor import age_of, beside_force, digits, first_amplifier, read, rubbed
from .series import HISTORY, TICK, Series
from .software import compensate, first_controller, first_satellite, move_satellite

COLUMNS = (
    "desired_position",
    "desired_velocity",
    "encoder_position",
    "sensor_force",
    "compensated_force",
    "stiffness_estimate",
)
LIMIT = 0.08  # a run that leaves this range is stopped [m]
POSITION_RESOLUTION, FORCE_RESOLUTION = 1e-6, 0.1
_FAST = 0.02  # at which it is reported how loud the drive is [m/s]
_STOP_WIDTH = 5e-5  # over which a soft stop sets in [m]
_SUBSTEPS = 40  # per tick
_DRIVEN_SUBSTEPS = 12  # enough where differences between two runs are wanted, not the runs


@dataclass(frozen=True)
class Lab:
    """What the lab believes of its rig: calibrated numbers by the names of case.yaml, SI."""

    nominal: Mapping[str, float]

    @property
    def lead(self) -> float:
        """Lead time of the controller [s]."""
        return self.nominal["sensor_delay"] + 1.0 / self.nominal["sensor_cutoff"]

    def begin(self, speed: float) -> float:
        """Position of the robot at the start [m]."""
        lag = 2.0 * self.nominal["damping_ratio"] / self.nominal["natural_frequency"]
        return -(lag + self.nominal["response_delay"]) * speed


def simulate(
    lab: Lab, values: Mapping[str, float], mass: float, speed: float, ticks: int, series: Series
) -> Array:
    """Run the rig in closed loop.

    Args:
        values: parameters of the real rig; mass [kg], speed of approach [m/s]: of the satellite software.
        series: what chance does in this run.
    Returns: what is logged, rows by `COLUMNS`, shape (6, n) with n <= ticks, SI.
    """
    none = np.zeros((6, 0))
    return _run(lab, values, mass, speed, ticks, series, none, _SUBSTEPS)


def drive(
    lab: Lab,
    values: Mapping[str, float],
    mass: float,
    speed: float,
    logged: Array,
    series: Series,
    substeps: int = _DRIVEN_SUBSTEPS,
) -> Array:
    """Run the rig's blocks apart from each other, each driven by what was logged, shape (6, n).

    Nothing is rounded, so that small differences of two such runs are those of what was changed.

    Returns: what each would have given, rows by `COLUMNS`, shape (6, n); the satellite's position and
        velocity at a tick are those one tick after the logged ones.
    """
    driver = np.ascontiguousarray(logged)
    return _run(lab, values, mass, speed, logged.shape[1], series, driver, substeps)


def _run(
    lab: Lab,
    values: Mapping[str, float],
    mass: float,
    speed: float,
    ticks: int,
    series: Series,
    logged: Array,
    substeps: int,
) -> Array:
    nominal = lab.nominal
    believed = np.array(
        [nominal["contact_stiffness"], nominal["contact_damping"], lab.lead, lab.begin(speed), speed]
    )
    out = np.zeros((6, ticks))
    done = _ticks(rig_parameters(values), believed, mass, series, logged, TICK / substeps, out)
    return out[:, :done]


@njit(error_model="numpy", nogil=True)
def _ticks(p, believed, mass, series, logged, longest, out):
    """Fill `out`; returns how many ticks were run."""
    (
        arrival, encoder, force, held, missed, body, wall, payload, corruption, supply, floor, zero,
        lost, scrape, cycle, skipped, key, bridged, sampling, hits, buzz,
    ) = series  # fmt: skip
    k, c, lead, start, speed = believed
    driven = logged.shape[1] > 0
    ticks = out.shape[1]
    s, memory, work, times, sensed = fresh()
    s[0], s[1] = start, speed
    memory[0] = start
    satellite, controller = first_satellite(speed), first_controller(k, c, start, speed)
    commands = np.empty(HISTORY + ticks)
    for i in range(HISTORY):
        commands[i] = _rounded(p, speed * TICK * (i + 1 - HISTORY))
    active = HISTORY - 1
    while active > 0 and arrival[active] > 0.0:
        active -= 1
    count, contact, touching = 0, 0, False
    memory[2], memory[10], memory[23] = wall[0], floor, lifted(p, speed)
    s[13] = -p.plate_gap
    s[15], s[16] = start, speed
    s[22], s[23] = start, speed
    s[24] = 2.0 * p.xi * p.omega * speed
    memory[28], memory[36] = hits[0], math.copysign(1.0, speed)
    missing, before, pace, straight = 0.0, 0.0, speed * TICK, speed * TICK
    if p.busy > 0.0 or p.text > 0.0:
        arrival = arrival.copy()
    s[25], s[26] = 2.0 * math.cos(floor), -2.0 * p.hammer_omega * math.sin(floor)
    tracked = np.array([commands[HISTORY - 1], speed * TICK])
    s[27] = commands[active] - speed * FORWARD
    reading, amplifier = 0.0, first_amplifier(start)
    for n in range(ticks):
        now = n * TICK
        if lost[n] != 0.0:
            # The servo follows its encoder: the rod stays where it is, until it is moved by as much.
            s[0] -= lost[n]
            memory[0] -= lost[n]
            memory[11] += lost[n]
        memory[12] = scrape[n]
        flange, rate = output(p, s, memory)
        position = s[22] if p.resolver > 0.0 else flange
        position += p.encoder_wave * math.sin(2.0 * math.pi * position / p.encoder_pitch) + encoder[n]
        if not driven:
            position = POSITION_RESOLUTION * round(position / POSITION_RESOLUTION)
        age, new = age_of(p, now, TICK, cycle)
        if (new and not held[n]) or n == 0:
            strained = past(times, sensed, count, now - p.tau_s - age - sampling[n]) * (1.0 + supply[n])
            beside = beside_force(p, flange, rate, s[24])
            if p.buzz > 0.0:
                beside += buzz[n] * abs(rate) / _FAST
            if p.tribo != 0.0:
                beside += rubbed(p, now - amplifier[1], flange, amplifier)
            reading = read(p, now, strained, memory, amplifier) + beside + zero[contact]
            reading = digits(p, reading + force[n], 0.0 if driven else FORCE_RESOLUTION)
        out[2, n], out[3, n] = position, reading
        seen_force, seen_position, acting = reading, position, 0.0
        if driven:
            seen_force, seen_position = logged[3, n], logged[2, n]
            satellite[0], satellite[1] = logged[0, n], logged[1, n]
        else:
            out[0, n], out[1, n] = satellite[0], satellite[1]
        if not missed[n]:
            compensate(p, k, lead, TICK, seen_force, seen_position, satellite[0], satellite[1], controller)
        out[4, n], out[5, n] = controller[11], controller[6]
        satellite[11] = seen_position
        acting = logged[4, n] if driven else controller[11]
        move_satellite(p, mass, now, TICK, acting, body[n], satellite)
        sent = satellite[0]
        if driven:
            out[0, n], out[1, n] = satellite[0], satellite[1]
            if n + 1 < ticks:
                sent = logged[0, n + 1]
        if not driven and (abs(satellite[0]) > LIMIT or abs(position) > LIMIT):
            return n + 1
        # A lost increment is missing until a complete command arrives.
        step = sent - before
        missing = 0.0 if key[n] else missing + skipped[n] * step
        before = sent
        last = commands[HISTORY + n - 1]
        commands[HISTORY + n] = _rounded(p, sent) + corruption[n] - missing
        if bridged[n]:
            commands[HISTORY + n] = last + pace  # as if all went on as it did
        elif n == 0 or not bridged[n - 1]:
            pace = commands[HISTORY + n] - last
        if abs(commands[HISTORY + n] - last) < p.change:
            commands[HISTORY + n] = last  # not worth a message
        if p.sparse > 0.0:
            # The receiver extrapolates, and receives only deviations from that.
            if abs(commands[HISTORY + n] - last - straight) > p.sparse:
                straight = step
            else:
                commands[HISTORY + n] = last + straight
        if p.standby > 0.0 and n % round(p.standby_every) == 0:
            # The computer that stands by sends, too, and runs behind.
            going = logged[1, n + 1] if driven and n + 1 < ticks else satellite[1]
            commands[HISTORY + n] -= p.standby * going
        if p.tracker > 0.0:
            commands[HISTORY + n] = _tracked(p, commands[HISTORY + n], tracked)
        if p.text > 0.0:
            arrival[HISTORY + n] += p.text * _characters(sent)
        if p.busy > 0.0 and abs(seen_force) > p.busy_force:
            arrival[HISTORY + n] += p.busy  # a sensor that has news goes first
        end = (n + 1) * TICK
        while now < end - 1e-12:
            for i in range(HISTORY + n, active, -1):
                if arrival[i] <= now + 1e-12:
                    active = i
                    break
            stop = end
            for i in range(active + 1, HISTORY + n + 1):
                if now + 1e-12 < arrival[i] < stop:
                    stop = arrival[i]
            command = _shaped(p, commands, payload[active])
            command += _cogging(p, command)
            command -= _stopped(p, command)
            count = integrate(p, now, stop, longest, s, memory, command, work, times, sensed, count)
            now = stop
        f, _, _, _ = contact_force(p, end, s, memory)
        if abs(f) > 1.0:
            touching = True
        elif touching and f == 0.0:
            touching = False
            contact = min(contact + 1, wall.shape[0] - 1)
            memory[2], memory[28] = wall[contact], hits[contact]
    return ticks


@njit(error_model="numpy")
def _rounded(p, command):
    if p.command_step > 0.0:
        return p.command_step * round((command - p.command_phase) / p.command_step) + p.command_phase
    return command


@njit(error_model="numpy")
def _tracked(p, command, tracked):
    """Where a filter that knows of position and rate [m per tick] takes the command to be."""
    ahead = tracked[0] + tracked[1]
    off = command - ahead
    tracked[0] = ahead + (1.0 - p.tracker * p.tracker) * off
    tracked[1] += (1.0 - p.tracker) ** 2 * off
    return tracked[0]


@njit(error_model="numpy")
def _characters(command):
    """How many characters a command [m] takes as a text of whole micrometres."""
    count, left = 1, math.floor(abs(command) * 1e6 / 10.0)
    while left > 0:
        count, left = count + 1, left // 10
    return count + 1 if command < 0.0 else count


@njit(error_model="numpy")
def _shaped(p, commands, index):
    """A command with a share that is delayed, so that the arm does not swing."""
    command = commands[index]
    if p.shaper > 0.0:
        back = p.shaper_time / TICK
        whole = math.floor(back)
        older, newer = commands[max(index - whole - 1, 0)], commands[max(index - whole, 0)]
        command += p.shaper * (newer + (back - whole) * (older - newer) - command)
    return command


@njit(error_model="numpy")
def _cogging(p, position):
    return p.cogging * math.sin(2.0 * math.pi * position / p.cogging_pitch) if p.cogging != 0.0 else 0.0


@njit(error_model="numpy")
def _stopped(p, command):
    """By how much a command is held back towards the end of the robot's range [m]."""
    if p.stop <= 0.0:
        return 0.0
    beyond = abs(command) - p.stop_at
    return math.copysign(0.5 * p.stop * (beyond + math.hypot(beyond, _STOP_WIDTH)), command)
