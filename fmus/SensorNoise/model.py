"""Noise of a six-axis force/torque sensor: white, normally distributed, sampled and held, seeded."""

from __future__ import annotations

import math
from typing import Any

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Integer, Real

# Combined generator of L'Ecuyer, "Efficient and Portable Combined Random Number Generators", Communications
# of the ACM 31 (1988): factors and moduli; period 2.3e18, and products that a double holds exactly.
FACTORS = (40014, 40692)
MODULI = (2147483563, 2147483399)
# Of a sample period: far above the rounding of a communication point's time, far below any step.
GRID_TOLERANCE = 1e-6
CHANNELS = tuple(f"{kind}_noise[{i}]" for kind in ("force", "torque") for i in (1, 2, 3))


def advance(first: int, second: int) -> tuple[int, int, float]:
    """The generator's next state, and a number above 0 and below 1."""
    first, second = (first * FACTORS[0]) % MODULI[0], (second * FACTORS[1]) % MODULI[1]
    difference = (first - second) % (MODULI[0] - 1)
    return first, second, (difference + 0.5) / (MODULI[0] - 1)


class SensorNoise(Fmi2Slave):
    """A new value for every channel at every multiple of sample_period."""

    description = (
        "Noise of a six-axis force/torque sensor: white, normally distributed, sampled and held, seeded"
    )
    requirements = ()

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.seed, self.sample_period = 1, 5e-4
        self.force_sigma, self.torque_sigma = 0.0, 0.0
        self.first, self.second, self.samples = 0, 0, 0
        self.start_time = 0.0
        self.values = (0.0,) * 6
        self.type_attributes: dict[str, dict[str, str]] = {
            "seed": {"min": "1"},
            "sample_period": {"unit": "s", "min": "0"},
            "force_sigma": {"unit": "N", "min": "0"},
            "torque_sigma": {"unit": "N.m", "min": "0"},
            "state.start_time": {"unit": "s"},
        }
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        self.register_variable(Integer("seed", description="Seed, 1 to 2147483398", **fixed))
        for name, meaning in (
            ("sample_period", "Time for which a value is held"),
            ("force_sigma", "Standard deviation of each component of the force"),
            ("torque_sigma", "Standard deviation of each component of the torque"),
        ):
            self.register_variable(Real(name, description=meaning, **fixed))
        held = {"variability": Fmi2Variability.discrete, "initial": Fmi2Initial.exact}
        for place, name in enumerate(CHANNELS):
            self.type_attributes[name] = {"unit": "N" if place < 3 else "N.m"}
            self.register_variable(
                Real(
                    name,
                    causality=Fmi2Causality.output,
                    description=f"Noise of the {name.partition('_')[0]}",
                    getter=lambda place=place: self.values[place],
                    setter=lambda value, place=place: self._put(place, value),
                    **held,
                )
            )
        local = {"causality": Fmi2Causality.local, **held}
        for name, meaning in (("first", "Generator, first part"), ("second", "Generator, second part")):
            self.register_variable(
                Integer(
                    f"state.{name}",
                    description=meaning,
                    getter=lambda name=name: getattr(self, name),
                    setter=lambda value, name=name: setattr(self, name, value),
                    **local,
                )
            )
        self.register_variable(
            Integer(
                "state.samples",
                description="Samples taken; the next: start_time + samples*sample_period",
                getter=lambda: self.samples,
                setter=lambda value: setattr(self, "samples", value),
                **local,
            )
        )
        self.register_variable(
            Real(
                "state.start_time",
                description="Start time, where the sample grid begins",
                getter=lambda: self.start_time,
                setter=lambda value: setattr(self, "start_time", value),
                **local,
            )
        )
        self.dependencies: dict[str, tuple[str, ...]] = dict.fromkeys(CHANNELS, ())
        self.initial_dependencies: dict[str, tuple[str, ...]] = {}

    def _put(self, place: int, value: float) -> None:
        self.values = (*self.values[:place], value, *self.values[place + 1 :])

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """The sample grid begins at the start time."""
        self.start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Check the parameters and draw the first values. Raises: ValueError for a parameter out of range."""
        if not 1 <= self.seed < MODULI[1]:
            raise ValueError(f"{self.instance_name}: seed is {self.seed!r}; allowed: 1 to {MODULI[1] - 1}")
        if not (math.isfinite(self.sample_period) and self.sample_period > 0.0):
            raise ValueError(
                f"{self.instance_name}: sample_period is {self.sample_period!r} s; allowed: finite, above 0 s"
            )
        if not (math.isfinite(self.force_sigma) and self.force_sigma >= 0.0):
            raise ValueError(
                f"{self.instance_name}: force_sigma is {self.force_sigma!r} N; allowed: finite, not negative"
            )
        if not (math.isfinite(self.torque_sigma) and self.torque_sigma >= 0.0):
            raise ValueError(
                f"{self.instance_name}: torque_sigma is {self.torque_sigma!r} N.m; allowed: finite, not "
                "negative"
            )
        self.first = self.second = self.seed
        # Seeds that lie side by side begin alike; a few rounds on they have nothing in common.
        for _ in range(8):
            self.first, self.second, _ = advance(self.first, self.second)
        self.samples = 0
        self._draw()

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Draw if a sample is due at the step's end; samples that lie within the step are left out."""
        elapsed = current_time + step_size - self.start_time
        if math.floor(elapsed / self.sample_period + GRID_TOLERANCE) >= self.samples:
            self._draw()
            self.samples = math.floor(elapsed / self.sample_period + GRID_TOLERANCE) + 1
        return True

    def _draw(self) -> None:
        """Six normal numbers, by Box and Muller's method in pairs."""
        numbers: tuple[float, ...] = ()
        for _ in range(3):
            self.first, self.second, radius = advance(self.first, self.second)
            self.first, self.second, angle = advance(self.first, self.second)
            size = math.sqrt(-2.0 * math.log(radius))
            turn = 2.0 * math.pi * angle
            numbers = (*numbers, size * math.cos(turn), size * math.sin(turn))
        self.values = (
            *(self.force_sigma * number for number in numbers[:3]),
            *(self.torque_sigma * number for number in numbers[3:]),
        )
        self.samples += 1
