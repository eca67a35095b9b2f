"""The effects that a case can hide: ids of the catalogue, and how the rig's parameters are drawn for each."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

# Places of software: it replays to its last digit, so that what it hides shows at any size.
SOFTWARE = ("dynamics", "controller")
# One turn [rad].
TURN = 2.0 * math.pi

Draw = Callable[[np.random.Generator, float], dict[str, float]]

# Indistinguishable in theory on these logs: no pair is drawn within one of these.
TIED = (
    {"dynamics.mass", "dynamics.mass-offset"},
    {"sensor.gain", "contact.stiffness", "structure.compliance"},
    {"robot.delay", "robot.bandwidth", "robot.damping"},
    {"sensor.delay", "sensor.low-pass", "contact.damping"},
    {"dynamics.appendage", "dynamics.slosh"},
    {"structure.offset", "contact.wall-offset"},
)


@dataclass(frozen=True)
class Hidden:
    """One effect, or a kind outside the catalogue.

    Attributes:
        id: place and name.
        draw: parameters of the rig at a magnitude, where 1 is strong and 0 is absent.
        relative: calibrated parameters that it multiplies by one plus what is drawn; others are added to.
        chance: whether it is drawn again at each sample or contact.
    """

    id: str
    draw: Draw
    relative: frozenset[str] = frozenset()
    chance: bool = False

    @property
    def place(self) -> str:
        """The component of the effect."""
        return self.id.partition(".")[0]


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """A positive number, its logarithm uniform between those of the bounds."""
    return float(low * (high / low) ** rng.random())


def signed(rng: np.random.Generator) -> float:
    """One or minus one."""
    return 1.0 if rng.random() < 0.5 else -1.0


Number = Callable[[np.random.Generator, float], float]


@dataclass(frozen=True)
class _Draws:
    """Draws parameters one after the other."""

    parameters: Mapping[str, Number]

    def __call__(self, rng: np.random.Generator, size: float) -> dict[str, float]:
        return {name: number(rng, size) for name, number in self.parameters.items()}


def draws(**parameters: Number) -> Draw:
    """An effect whose parameters are drawn in this order."""
    return _Draws(parameters)


# How a parameter is drawn at a magnitude. Partial functions, unlike lambdas, go from process to process.


def sized(low: float, high: float, *, sign: str = "", least: float = 0.0, most: float = math.inf) -> Number:
    """The magnitude, within bounds, times a number between others.

    Args:
        sign: "first" or "last" draws a sign before or after the number; "" draws none.
    """
    return partial(_sized, low, high, sign, least, most)


def _sized(
    low: float, high: float, sign: str, least: float, most: float, rng: np.random.Generator, size: float
) -> float:
    first = signed(rng) if sign == "first" else 1.0
    number = min(max(size, least), most) * first * between(rng, low, high)
    return number * signed(rng) if sign == "last" else number


def free(low: float, high: float, unit: float = 1.0) -> Number:
    """A number between others, whatever the magnitude."""
    return partial(_free, low, high, unit)


def _free(low: float, high: float, unit: float, rng: np.random.Generator, size: float) -> float:
    return unit * between(rng, low, high)


def turns(low: float, high: float) -> Number:
    """An angular frequency [rad/s] between two frequencies [Hz]."""
    return free(low, high, TURN)


def even(low: float, high: float, unit: float = 1.0) -> Number:
    """A number that is uniform between others, whatever the magnitude."""
    return partial(_even, low, high, unit)


def _even(low: float, high: float, unit: float, rng: np.random.Generator, size: float) -> float:
    return unit * rng.uniform(low, high)


def phase(most: float = TURN) -> Number:
    """An angle [rad]."""
    return partial(_phase, most)


def _phase(most: float, rng: np.random.Generator, size: float) -> float:
    return most * rng.random()


def inverse(low: float, high: float, *, least: float, power: float = 0.5, unit: float = 1.0) -> Number:
    """A number between others that falls with a power of the magnitude, which counts as `least` or more."""
    return partial(_inverse, low, high, least, power, unit)


def _inverse(
    low: float, high: float, least: float, power: float, unit: float, rng: np.random.Generator, size: float
) -> float:
    return unit * between(rng, low, high) / max(size, least) ** power


def rooted(low: float, high: float) -> Number:
    """The root of the magnitude times a number between others."""
    return partial(_rooted, low, high)


def _rooted(low: float, high: float, rng: np.random.Generator, size: float) -> float:
    return float(np.sqrt(size)) * between(rng, low, high)


def whole(low: float, high: float) -> Number:
    """As `sized`, rounded."""
    return partial(_whole, low, high)


def _whole(low: float, high: float, rng: np.random.Generator, size: float) -> float:
    return float(round(size * between(rng, low, high)))


def integer(low: int, high: int) -> Number:
    """A whole number from `low` to below `high`, whatever the magnitude."""
    return partial(_integer, low, high)


def _integer(low: int, high: int, rng: np.random.Generator, size: float) -> float:
    return float(rng.integers(low, high))


def kinds(
    found: Mapping[str, Draw], chance: Collection[str], relative: Collection[str] = ()
) -> dict[str, Hidden]:
    """Effects by id.

    Args:
        found: how they are drawn.
        chance, relative: see `Hidden`; relative: parameters of any of them.
    """
    multiplied = {
        name: frozenset(relative).intersection(draw.parameters) if isinstance(draw, _Draws) else frozenset()
        for name, draw in found.items()
    }
    return {name: Hidden(name, draw, multiplied[name], name in chance) for name, draw in found.items()}


def _hold(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"hold": 2.0 + float(np.floor(size * rng.uniform(1.0, 6.0)))}


def _rate_limit(rng: np.random.Generator, size: float) -> dict[str, float]:
    # The slowest run approaches at 14 mm/s, the fastest at 24 mm/s.
    return {"rate_limit": 0.0245 - min(size, 1.2) * rng.uniform(0.006, 0.0105)}


def _acceleration_limit(rng: np.random.Generator, size: float) -> dict[str, float]:
    # Rebounds take 0.4 to 1.5 m/s2.
    return {"acceleration_limit": 1.3 * (between(rng, 0.06, 0.2) / 1.3) ** min(size, 1.2)}


def _force_step(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"force_step": max(round(10.0 * size * between(rng, 0.8, 3.0)), 2) / 10.0}


def _command_step(rng: np.random.Generator, size: float) -> dict[str, float]:
    step = max(size * between(rng, 1e-5, 5e-5), 1e-6)
    return {"command_step": step, "command_phase": 0.02 * step * rng.uniform(-1.0, 1.0)}


_DRAWS: dict[str, Draw] = {
    "link.sample-and-hold": _hold,
    "link.clock-skew": draws(skew=sized(1.2e-4, 5e-4, sign="last")),
    "link.packet-loss": draws(loss=sized(0.04, 0.15)),
    "link.jitter": draws(jitter=sized(6e-4, 2e-3)),
    "robot.delay": draws(tau=sized(1e-3, 4e-3)),
    "robot.bandwidth": draws(omega=sized(0.15, 0.5, sign="last")),
    "robot.damping": draws(xi=sized(0.15, 0.5, sign="last")),
    "robot.rate-limit": _rate_limit,
    "robot.acceleration-limit": _acceleration_limit,
    "robot.backlash": draws(backlash=sized(1e-4, 4e-4)),
    "robot.friction": draws(
        coulomb=sized(0.5, 1.8), stribeck=free(0.3, 0.9), stribeck_rate=free(1.5e-3, 3e-3)
    ),
    "robot.resonance": draws(
        resonance=sized(0.2, 0.8), resonance_omega=free(50.0, 280.0), resonance_xi=free(0.02, 0.05)
    ),
    "robot.command-quantisation": _command_step,
    "robot.load-sensitivity": draws(load=sized(0.03, 0.12)),
    "structure.compliance": draws(compliance=sized(4e-7, 2e-6)),
    "structure.kinematic-scale": draws(scale=sized(0.006, 0.02, sign="last")),
    "structure.offset": draws(offset=sized(1.2e-4, 4e-4, sign="last")),
    "sensor.delay": draws(tau_s=sized(3e-4, 1.5e-3)),
    "sensor.low-pass": draws(filter_time=sized(6e-4, 2e-3)),
    "sensor.bias": draws(bias=sized(0.8, 3.0, sign="last")),
    "sensor.drift": draws(drift=sized(0.25, 1.0, sign="last")),
    "sensor.gain": draws(gain=sized(0.08, 0.25, sign="last")),
    "sensor.coloured-noise": draws(coloured=sized(1.2, 4.0), coloured_keep=free(0.8, 0.97)),
    "sensor.quantisation": _force_step,
    "sensor.dropout": draws(dropout=sized(0.08, 0.25)),
    "sensor.tool-inertia": draws(tool=sized(2.5, 9.0)),
    "contact.stiffness": draws(k=sized(0.1, 0.35, sign="last")),
    "contact.damping": draws(c=sized(60.0, 300.0)),
    "contact.hertz": draws(hertz=sized(0.15, 0.6)),
    "contact.cubic": draws(cubic=sized(0.12, 0.5)),
    "contact.hunt-crossley": draws(crossley=sized(8e4, 3e5)),
    "contact.wall-offset": draws(front=sized(1.5e-4, 5e-4, sign="last")),
    "contact.adhesion": draws(adhesion=sized(1.2, 5.0), adhesion_range=free(2e-5, 8e-5)),
    "contact.plasticity": draws(plasticity=sized(0.03, 0.1)),
    "contact.friction": draws(friction=sized(0.02, 0.08), friction_rate=free(5e-4, 2e-3)),
    "contact.second-contact": draws(second=sized(0.3, 0.9), second_depth=free(2e-4, 6e-4)),
    "contact.asymmetry": draws(asymmetry=sized(0.04, 0.14, sign="last")),
    "contact.softening": draws(softening=sized(0.03, 0.12)),
    "contact.viscoelastic": draws(maxwell=sized(0.2, 0.6), maxwell_time=free(6e-3, 5e-2)),
    "dynamics.mass": draws(mass=sized(0.02, 0.1, sign="last")),
    "dynamics.mass-offset": draws(mass_offset=rooted(0.2, 0.55)),
    "dynamics.residual-gravity": draws(gravity=sized(1e-3, 5e-3, sign="last")),
    "dynamics.cable": draws(cable=sized(500.0, 2000.0)),
    "dynamics.drag": draws(drag=sized(30.0, 150.0)),
    # Software is textbook to its last digit: unlike the plant's, its effects keep the catalogue's form.
    "dynamics.appendage": draws(
        appendage=sized(0.04, 0.15),
        appendage_omega=free(TURN * 1.5, TURN * 8.0),
        appendage_xi=free(0.01, 0.01),
    ),
    "dynamics.slosh": draws(
        appendage=sized(0.07, 0.25),
        appendage_omega=free(TURN * 0.25, TURN * 0.9),
        appendage_xi=free(0.12, 0.12),
    ),
    "controller.lead": draws(lead=sized(5e-4, 2e-3, sign="last")),
    "controller.stiffness-gain": draws(stiffness_gain=sized(0.08, 0.3, sign="last")),
}

_CHANCE = {"link.packet-loss", "link.jitter", "sensor.coloured-noise", "sensor.dropout"}

HIDDEN = kinds(_DRAWS, _CHANCE, relative={"omega", "xi", "k"})
# Those of hardware.
HARDWARE = tuple(one for one in HIDDEN.values() if one.place not in SOFTWARE)
