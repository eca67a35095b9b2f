"""Exact closed loop of the docking simulator around a sampled controller, for tests of it alone.

Satellite and robot are linear and the controller's force is piecewise constant, so both are integrated
exactly (matrix exponential); all delays are whole numbers of steps. No code is shared with the product.
Signs as in modelica/DockingHIL/SignConventions.mo.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm

EFFECTIVE_MASS = 300.0 * 4000.0 / 4300.0

# measured force, rod position, rod velocity, desired position, desired velocity -> force on the satellite
Controller = Callable[[float, float, float, float, float], float]


def restitution(mass: float, stiffness: float, damping: float) -> float:
    """Coefficient of restitution of an ideal spring-damper contact that ends where its force is zero."""
    zeta = damping / (2.0 * math.sqrt(stiffness * mass))
    return math.exp(-2.0 * zeta * math.acos(zeta) / math.sqrt(1.0 - zeta * zeta))


@dataclass
class DockingBench:
    """Satellite, robot (second order plus delay), contact between two frames, force sensor; SI units."""

    mass: float = EFFECTIVE_MASS
    stiffness: float = 176e3
    damping: float = 0.0
    omega_n: float = 2.0 * math.pi * 75.0
    xi_n: float = 0.8
    tau_m: float = 2e-3
    tau_s: float = 0.0
    front: float = 5e-3
    rear: float = -5e-3
    speed: float = 20e-3
    noise: float = 0.0
    resolution: float = 0.0
    seed: int = 0
    step: float = 5e-4
    _robot: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # Robot states and the desired position with its two derivatives, constant acceleration over a step.
        system = np.zeros((5, 5))
        system[0, 1] = system[2, 3] = system[3, 4] = 1.0
        system[1] = [-(self.omega_n**2), -2.0 * self.xi_n * self.omega_n, self.omega_n**2, 0.0, 0.0]
        self._robot = expm(system * self.step)[:2]

    def contact_force(self, position: float, velocity: float) -> float:
        """Force of the frames on the rod [N]."""
        if position > self.front:
            return -max(0.0, self.stiffness * (position - self.front) + self.damping * velocity)
        if position < self.rear:
            return max(0.0, self.stiffness * (self.rear - position) - self.damping * velocity)
        return 0.0

    def run(self, controller: Controller, sample_period: float, contacts: int) -> np.ndarray:
        """Free velocities after each contact over the approach speed, signed.

        Args:
            controller: called at every multiple of sample_period.
            sample_period: a multiple of `step` [s].
            contacts: number to wait for; the run gives up once the speed has grown tenfold.
        Returns: shape (contacts,) or shorter.
        """
        every = _whole(sample_period, self.step)
        in_command, in_sensor = _whole(self.tau_m, self.step), _whole(self.tau_s, self.step)
        noise = np.random.default_rng(self.seed)
        desired, desired_velocity, force = 0.0, self.speed, 0.0
        lag = self.tau_m + 2.0 * self.xi_n / self.omega_n
        position, velocity = desired - lag * self.speed, self.speed
        past = [desired - (in_command - i) * self.step * self.speed for i in range(in_command)]
        commands = [(place, self.speed, 0.0) for place in past]
        readings = [0.0] * in_sensor
        ratios: list[float] = []
        touched = False
        step = 0
        while len(ratios) < contacts and abs(desired_velocity) < 10.0 * self.speed:
            acceleration = force / self.mass
            commands.append((desired, desired_velocity, acceleration))
            state = np.array([position, velocity, *commands.pop(0)])
            position, velocity = (float(x) for x in self._robot @ state)
            desired += desired_velocity * self.step + 0.5 * acceleration * self.step**2
            desired_velocity += acceleration * self.step
            readings.append(self.contact_force(position, velocity))
            reading = readings.pop(0) + self.noise * noise.standard_normal()
            if self.resolution:
                reading = self.resolution * math.floor(reading / self.resolution + 0.5)
            step += 1
            if step % every == 0:
                force = controller(reading, position, velocity, desired, desired_velocity)
            # Rod and satellite are both free once the rod is back in the middle of the gap.
            if self.front < position or position < self.rear:
                touched = True
            elif touched and abs(position) < 0.5 * self.front:
                ratios.append(desired_velocity / self.speed)
                touched = False
        return np.array(ratios)


def _whole(time: float, step: float) -> int:
    number = round(time / step)
    assert abs(number * step - time) < 1e-9 * step, f"{time} s is no multiple of {step} s"
    return number
