"""The effects that a case can hide: ids of the catalogue, and how the rig's parameters are drawn for each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

__all__ = ["HARDWARE", "HIDDEN", "SOFTWARE", "TIED", "Hidden", "between", "signed"]

# Places of software: it replays to its last digit, so that what it hides shows at any size.
SOFTWARE = ("dynamics", "controller")

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


@dataclass(frozen=True)
class _Sized:
    """An effect whose parameter is proportional to the magnitude; shape parameters do not depend on it."""

    parameter: str
    low: float
    high: float
    sign: bool = False
    shape: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __call__(self, rng: np.random.Generator, size: float) -> dict[str, float]:
        found = {
            self.parameter: size * between(rng, self.low, self.high) * (signed(rng) if self.sign else 1.0)
        }
        return found | {name: between(rng, *bounds) for name, bounds in self.shape.items()}


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


def _mass_offset(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"mass_offset": float(np.sqrt(size)) * between(rng, 0.2, 0.55)}


def _command_step(rng: np.random.Generator, size: float) -> dict[str, float]:
    step = max(size * between(rng, 1e-5, 5e-5), 1e-6)
    return {"command_step": step, "command_phase": 0.02 * step * rng.uniform(-1.0, 1.0)}


def _hung(masses: tuple[float, float], hertz: tuple[float, float], xi: float) -> Draw:
    # Software is textbook to its last digit: unlike the plant's, its effects keep the catalogue's form.
    turns = (2.0 * np.pi * hertz[0], 2.0 * np.pi * hertz[1])
    return _Sized("appendage", *masses, shape={"appendage_omega": turns, "appendage_xi": (xi, xi)})


_ALL = (
    Hidden("link.sample-and-hold", _hold),
    Hidden("link.clock-skew", _Sized("skew", 1.2e-4, 5e-4, sign=True)),
    Hidden("link.packet-loss", _Sized("loss", 0.04, 0.15), chance=True),
    Hidden("link.jitter", _Sized("jitter", 6e-4, 2e-3), chance=True),
    Hidden("robot.delay", _Sized("tau", 1e-3, 4e-3)),
    Hidden("robot.bandwidth", _Sized("omega", 0.15, 0.5, sign=True), frozenset({"omega"})),
    Hidden("robot.damping", _Sized("xi", 0.15, 0.5, sign=True), frozenset({"xi"})),
    Hidden("robot.rate-limit", _rate_limit),
    Hidden("robot.acceleration-limit", _acceleration_limit),
    Hidden("robot.backlash", _Sized("backlash", 1e-4, 4e-4)),
    Hidden(
        "robot.friction",
        _Sized("coulomb", 0.5, 1.8, shape={"stribeck": (0.3, 0.9), "stribeck_rate": (1.5e-3, 3e-3)}),
    ),
    Hidden(
        "robot.resonance",
        _Sized("resonance", 0.2, 0.8, shape={"resonance_omega": (50.0, 280.0), "resonance_xi": (0.02, 0.05)}),
    ),
    Hidden("robot.command-quantisation", _command_step),
    Hidden("robot.load-sensitivity", _Sized("load", 0.03, 0.12)),
    Hidden("structure.compliance", _Sized("compliance", 4e-7, 2e-6)),
    Hidden("structure.kinematic-scale", _Sized("scale", 0.006, 0.02, sign=True)),
    Hidden("structure.offset", _Sized("offset", 1.2e-4, 4e-4, sign=True)),
    Hidden("sensor.delay", _Sized("tau_s", 3e-4, 1.5e-3)),
    Hidden("sensor.low-pass", _Sized("filter_time", 6e-4, 2e-3)),
    Hidden("sensor.bias", _Sized("bias", 0.8, 3.0, sign=True)),
    Hidden("sensor.drift", _Sized("drift", 0.25, 1.0, sign=True)),
    Hidden("sensor.gain", _Sized("gain", 0.08, 0.25, sign=True)),
    Hidden(
        "sensor.coloured-noise",
        _Sized("coloured", 1.2, 4.0, shape={"coloured_keep": (0.8, 0.97)}),
        chance=True,
    ),
    Hidden("sensor.quantisation", _force_step),
    Hidden("sensor.dropout", _Sized("dropout", 0.08, 0.25), chance=True),
    Hidden("sensor.tool-inertia", _Sized("tool", 2.5, 9.0)),
    Hidden("contact.stiffness", _Sized("k", 0.1, 0.35, sign=True), frozenset({"k"})),
    Hidden("contact.damping", _Sized("c", 60.0, 300.0)),
    Hidden("contact.hertz", _Sized("hertz", 0.15, 0.6)),
    Hidden("contact.cubic", _Sized("cubic", 0.12, 0.5)),
    Hidden("contact.hunt-crossley", _Sized("crossley", 8e4, 3e5)),
    Hidden("contact.wall-offset", _Sized("front", 1.5e-4, 5e-4, sign=True)),
    Hidden("contact.adhesion", _Sized("adhesion", 1.2, 5.0, shape={"adhesion_range": (2e-5, 8e-5)})),
    Hidden("contact.plasticity", _Sized("plasticity", 0.03, 0.1)),
    Hidden("contact.friction", _Sized("friction", 0.02, 0.08, shape={"friction_rate": (5e-4, 2e-3)})),
    Hidden("contact.second-contact", _Sized("second", 0.3, 0.9, shape={"second_depth": (2e-4, 6e-4)})),
    Hidden("contact.asymmetry", _Sized("asymmetry", 0.04, 0.14, sign=True)),
    Hidden("contact.softening", _Sized("softening", 0.03, 0.12)),
    Hidden("contact.viscoelastic", _Sized("maxwell", 0.2, 0.6, shape={"maxwell_time": (6e-3, 5e-2)})),
    Hidden("dynamics.mass", _Sized("mass", 0.02, 0.1, sign=True)),
    Hidden("dynamics.mass-offset", _mass_offset),
    Hidden("dynamics.residual-gravity", _Sized("gravity", 1e-3, 5e-3, sign=True)),
    Hidden("dynamics.cable", _Sized("cable", 500.0, 2000.0)),
    Hidden("dynamics.drag", _Sized("drag", 30.0, 150.0)),
    Hidden("dynamics.appendage", _hung((0.04, 0.15), (1.5, 8.0), 0.01)),
    Hidden("dynamics.slosh", _hung((0.07, 0.25), (0.25, 0.9), 0.12)),
    Hidden("controller.lead", _Sized("lead", 5e-4, 2e-3, sign=True)),
    Hidden("controller.stiffness-gain", _Sized("stiffness_gain", 0.08, 0.3, sign=True)),
)

HIDDEN = {one.id: one for one in _ALL}
# Those of hardware.
HARDWARE = tuple(one for one in _ALL if one.place not in SOFTWARE)
