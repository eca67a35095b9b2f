"""Solutions, by scipy or by hand, of models of "Modelica by Example" that rumoca's simulator does not run.

Their equations are written down here anew: nothing of the translator is used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

Signals = dict[str, np.ndarray]
Solution = Callable[[np.ndarray], Signals]

# Two inertias of 0.4 and 1, springs of 11 and 5, dampers of 0.2 and 1: angles, then velocities.
_MASSES = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-27.5, 27.5, -0.5, 0.5], [11, -16, 0.2, -1.2]])
_START = np.array([0.0, 1.0, 0.0, 0.0])


def _masses(times: Any) -> np.ndarray:
    """States of the two inertias; [4][times]."""
    return np.stack([expm(_MASSES * one) @ _START for one in np.ravel(times)], 1)


def _teeth(stop: float, angle: float) -> list[float]:
    """Times at which the first inertia has turned by a tooth since the last one, either way."""
    turned = lambda t: float(_masses(t)[0, 0])  # noqa: E731
    grid = np.linspace(0, stop, 4001)
    phi, found, last = _masses(grid)[0], [], 0.0
    for a, b, end in zip(grid, grid[1:], phi[1:], strict=False):
        while abs(end - last) >= angle:
            last += angle * np.sign(end - last)
            found.append(
                float(brentq(lambda t, to=last: turned(t) - to, max(a, found[-1] if found else 0), b))
            )
    return found


def _intervals(name: str, angle: float) -> Solution:
    def made(times: np.ndarray) -> Signals:
        events = np.array([0.0, *_teeth(times[-1], angle)])
        speeds = np.array([0.0, *(angle / np.diff(events))])
        return {name: speeds[np.searchsorted(events, times, side="right") - 1]}

    return made


def _pulses(name: str, angle: float) -> Solution:
    def made(times: np.ndarray) -> Signals:
        events = _teeth(times[-1], angle)
        last = np.floor(times / 0.125 + 1e-9) * 0.125
        counts = [sum(one - 0.125 <= event < one for event in events) for one in last]
        return {name: np.array(counts) * angle / 0.125}

    return made


def _held(times: np.ndarray) -> Signals:
    last = np.floor(times / 0.125 + 1e-9) * 0.125
    return {"sampleHold.w": _masses(last)[2], "idealSensor.w": _masses(times)[2]}


def _integrated(
    slopes: Callable[[float, Any], Any], start: Any, names: dict[str, int], step: float
) -> Solution:
    def made(times: np.ndarray) -> Signals:
        found = solve_ivp(
            slopes, (0, times[-1]), start, "LSODA", times, rtol=1e-11, atol=1e-12, max_step=step
        )  # fmt: skip
        return {name: found.y[place] for name, place in names.items()}

    return made


def _backlash(t: float, y: Any) -> list[float]:
    torque = 1.0 if t % 0.8 < 0.4 else -1.0
    angle, speed = 4 * y[1] - y[0], 4 * y[3] - y[2]
    free = 0.17453292519943 / 2
    spring, damper = 1000 * (angle - np.sign(angle) * free), 2 * speed
    tau = 0.0
    if abs(angle) > free and spring * (spring + damper) > 0:
        tau = spring + (min(spring, damper) if spring > 0 else max(spring, damper))
    return [y[2], y[3], (torque + tau) / 0.01, (-4 * tau - 2 * y[3]) / 0.12]


_SHAFT = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-1000, 1000, -30, 30], [1000 / 3, -1000 / 3, 10, -70 / 3]])


def _sampled_control(times: np.ndarray) -> Signals:
    """A motor and a load on a shaft; every 10 ms the load's speed is measured for a controller."""
    system = np.zeros((5, 5))
    system[:4, :4], system[2, 4] = _SHAFT, 10.0
    y, measured, phi, speed = np.zeros(4), 0.0, [], []
    step = expm(system * 0.01)
    places = np.floor(times / 0.01 + 1e-9).astype(int)
    for k in range(places[-1] + 1):
        measured = y[3]
        command = 20 * ((1.0 if k * 0.01 % 1.0 < 0.5 - 1e-9 else 0.0) - measured)
        for t in times[places == k]:
            at = expm(system * (t - k * 0.01)) @ [*y, command]
            phi.append(at[1])
            speed.append(at[3])
        y = (step @ [*y, command])[:4]
    return {"plant.inertia1.phi": np.array(phi), "plant.inertia1.w": np.array(speed)}


def _limited_control(k: float, ti: float, td: float, most: float, strongest: float) -> Solution:
    """As `_sampled_control`, with a limited PID controller (LimPID) and a limited torque, late by 5 ms."""

    def made(times: np.ndarray) -> Signals:
        h, late, sampled = 2.5e-5, 200, 400  # [s], steps of the delay and of the sensor
        system = np.zeros((6, 6))  # the torque is linear within a step
        system[:4, :4], system[2, 4], system[4, 5] = _SHAFT * h, 10.0 * h, 1.0
        step = expm(system)
        y, measured, state, held, found = (
            np.zeros(4),
            0.0,
            np.zeros(2),
            list[tuple[float, float]](),
            list[Any](),
        )

        def command(state: np.ndarray, target: float) -> tuple[float, float]:
            free = k * (target - measured + state[0] + 10 * (-measured - state[1]))
            return free, float(np.clip(free, -most, most))

        def slope(state: np.ndarray, target: float) -> np.ndarray:
            free, limited = command(state, target)
            windup = (limited - free) / (0.9 * k)
            return np.array([(target - measured + windup) / ti, (-measured - state[1]) * 10 / td])

        for n in range(int(times[-1] / h) + 2):
            measured = y[3] if n % sampled == 0 else measured
            target = 1.0 if n * h % 1.0 < 0.5 - 1e-9 else 0.0
            found.append((n * h, y[1], y[3]))
            before = command(state, target)[1]
            a = slope(state, target)
            b = slope(state + h / 2 * a, target)
            c = slope(state + h / 2 * b, target)
            state = state + h / 6 * (a + 2 * b + 2 * c + slope(state + h * c, target))
            held.append((before, command(state, target)[1]))
            first, last = np.clip(held[n - late] if n >= late else (held[0][0],) * 2, -strongest, strongest)
            y = (step @ [*y, first, last - first])[:4]
        table = np.array(found).T
        return {
            "plant.inertia1.phi": np.interp(times, table[0], table[1]),
            "plant.inertia1.w": np.interp(times, table[0], table[2]),
        }

    return made


def _ticks(*names: str) -> Solution:
    """Of the times that a clock of 0.1 s samples: x, y and e = x - y of them, and z of every second one."""

    def made(times: np.ndarray) -> Signals:
        count = np.floor(times / 0.1 + 1e-9)
        held, slow = 0.1 * count, 0.2 * np.floor(count / 2)
        return {"x": held, "y": held, "z": slow, "e": 0 * held, "tick": count + 1}

    return lambda times: {name: made(times)[name] for name in names}


def _constant(**values: float) -> Solution:
    return lambda times: {name.replace("_", "."): np.full(len(times), one) for name, one in values.items()}


def _volterra(_: float, y: Any) -> list[float]:
    return [y[0] * (0.1 - 0.02 * y[1]), y[1] * (0.02 * y[0] - 0.4)]


def _interpolated(times: np.ndarray) -> Signals:
    y = np.interp(times, [0, 2, 4, 6], [0, 0, 2, 0])
    rise, fall = np.clip(times - 2, 0, 2), np.clip(times - 4, 0, 2)
    return {"y": y, "z": rise**2 / 2 + 2 * fall - fall**2 / 2}


def _polynomial(times: np.ndarray) -> Signals:
    value, slope = times**2 - 2 * times + 2, 2 * times - 2
    return {"yf": value, "yp": value, "d_yf": slope, "d_yp": slope}


_STATES = {f"x[{k + 1}]": k for k in range(4)}
SOLUTIONS: dict[str, Solution] = {
    "ArrayEquations.StateSpace.Examples.LotkaVolterra": _integrated(
        _volterra, [10, 10], {"x[1]": 0, "x[2]": 1}, 1.0
    ),
    "ArrayEquations.StateSpace.Examples.RotationalSMD": lambda times: {
        name: _masses(times)[k] for name, k in _STATES.items()
    },
    "ArrayEquations.StateSpace.Examples.RotationalSMD_Concat": lambda times: {
        name: _masses(times)[k] for name, k in _STATES.items()
    },
    "BasicEquations.LotkaVolterra.QuiescentModelWithModifications": _constant(x=30, y=5),
    "Components.LotkaVolterra.Examples.ThreeSpecies_Quiescent": _constant(
        rabbits_population=20, foxes_population=5, wolves_population=0
    ),  # of several steady states the one that Newton's method finds from 10, 10, 10
    "Components.SpeedMeasurement.Examples.PlantWithIntervalMeasure": _intervals(
        "intervalMeasure.w", 2 * np.pi / 200
    ),
    "DiscreteBehavior.SpeedMeasurement.IntervalMeasure": _intervals("omega1_measured", 2 * 3.14159 / 200),
    "Components.SpeedMeasurement.Examples.PlantWithPulseCounter": _pulses("pulseCounter.w", 2 * np.pi / 200),
    "DiscreteBehavior.SpeedMeasurement.CounterWithAlgorithm": _pulses("omega1_measured", 2 * 3.14159 / 200),
    "Components.SpeedMeasurement.Examples.PlantWithSampleHold": _held,
    "DiscreteBehavior.SynchronousSystems.IndependentSampling": _ticks("x", "y", "e"),
    "DiscreteBehavior.SynchronousSystems.SynchronizedSampling": _ticks("tick", "x", "y", "e"),
    "DiscreteBehavior.SynchronousSystems.SubsamplingWithIntegers": _ticks("tick", "x", "y", "z"),
    "Functions.Interpolation.IntegrateInterpolatedVector": _interpolated,
    "Functions.Polynomials.Differentiation1": _polynomial,
    "Functions.Polynomials.Differentiation2": _polynomial,
    "Subsystems.GearSubsystemModel.Examples.BacklashExample": _integrated(
        _backlash, [0.0] * 4,
        {"gearWithBacklash.inertia_a.phi": 0, "inertia.phi": 1, "gearWithBacklash.inertia_a.w": 2,
         "inertia.w": 3}, 1e-4,
    ),
    "Architectures.SensorComparison.Examples.HierarchicalSystem_Variant1": _sampled_control,
    "Architectures.SensorComparison.Examples.Variant1": _sampled_control,
    "Architectures.SensorComparison.Examples.Variant2": _limited_control(20, 0.1, 0.1, 15, 10),
    "Architectures.SensorComparison.Examples.Variant2_tuned": _limited_control(4, 0.07, 0.01, 50, 50),
}  # fmt: skip
"""By names within the package: signals of a model at ascending times from 0 [s]."""
