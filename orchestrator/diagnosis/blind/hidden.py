"""Laws to hide, written anew: where each is physical, its numbers by the size of signals, its value."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...base.arrays import Array
from ...base.units import measures
from .plant import Acting, Plant

_FORCES, _RATES, _TRAVELS = ("N", "N.m"), ("m/s", "rad/s"), ("m", "rad")
_STEFAN = 5.670374419e-8
Random = np.random.Generator


@dataclass(frozen=True)
class Sizes:
    """Mean, spread and largest size of all signals [x, u, y] without a law."""

    mean: Array
    spread: Array
    most: Array
    interval: float
    length: float


@dataclass(frozen=True)
class _At:
    """A place and a signal there.

    Attributes:
        sign: +1 where a positive w of the law's own sense adds to the place; what opposes motion has -1 at a
            force on a body, +1 at the force of a spring or damper.
        slope: of the output by the signal, 0 elsewhere. own: whether the signal is the place's.
    """

    place: str
    kind: str
    index: int
    signal: str
    reads: int
    sign: float
    slope: float
    own: bool
    w_unit: str
    u_unit: str
    at: int


def _places(plant: Plant, sizes: Sizes) -> Iterator[_At]:
    """Inputs and outputs with each signal of their component, and the signs by differences."""
    nx, nu = len(plant.states), len(plant.inputs)
    names = [*plant.states, *plant.inputs, *plant.outputs]
    size = np.maximum(sizes.spread, 1e-9 * np.maximum(1.0, sizes.most))

    def moved(kind: str, index: int, step: float) -> Any:
        place = (plant.inputs if kind == "input" else plant.outputs)[index]
        push = Acting("", "", place, kind, index, "", (0,), {}, lambda t, s, z: step)
        return plant.at_rest(sizes.mean, push)

    rest = plant.at_rest(sizes.mean)
    for kind, group, first in (("input", plant.inputs, nx), ("output", plant.outputs, nx + nu)):
        for index, place in enumerate(group):
            instance = place.split(".")[0]
            own_states = [k for k, one in enumerate(plant.states) if one.split(".")[0] == instance]
            step = float(size[first + index]) * 1e-4
            pushed = moved(kind, index, step)
            for reads, signal in enumerate(names):
                mine = signal.split(".")[0] == instance
                if not mine or (signal in plant.outputs and reads < nx + nu and reads >= nx):
                    continue
                if reads >= nx + nu and reads != first + index:
                    continue
                own = reads == first + index
                sign, slope = 1.0, 0.0
                if kind == "input" and reads < nx:
                    push = [pushed[0][k] - rest[0][k] for k in own_states]
                    sign = -math.copysign(1.0, max(push, key=abs, default=-1.0))
                elif kind == "output" and nx <= reads < nx + nu:
                    lifted = moved("input", reads - nx, float(size[reads]) * 1e-4)
                    slope = (lifted[1][first + index] - rest[1][first + index]) / (float(size[reads]) * 1e-4)
                    sign = math.copysign(1.0, slope) if slope else 1.0
                yield _At(
                    place, kind, index, signal, reads, sign, slope, own, plant.units[place],
                    plant.units[signal], first + index,
                )  # fmt: skip


@dataclass(frozen=True)
class _Here:
    """What conditions and numbers of a law look at: the place, sizes of w and of the signal, and kinds.

    Attributes:
        w, u: spreads of the place and the signal; mean, most: of the signal. share: of w that a law takes.
        friction, spring: whether a force meets a speed, or a travel, of its component that passes zero.
        moving: as `friction`, at any mean. zero: whether the signal passes it. source, sensor: whether laws
        of actuators or sensors are physical; external, unread: of the place. path: travel beside a speed.
        h, length: interval and length of the logs. draw: uniform numbers. sign: random.
    """

    at: _At
    w: float
    u: float
    mean: float
    most: float
    share: float
    moving: bool
    friction: bool
    spring: bool
    zero: bool
    source: bool
    external: bool
    sensor: bool
    unread: bool
    path: float
    h: float
    length: float
    draw: Callable[[float, float], float]
    sign: Callable[[], float]

    def units(self, w: str, u: str) -> bool:
        """Whether it is an input of unit w beside a signal of unit u."""
        return self.at.kind == "input" and measures(self.at.w_unit, (w,)) and measures(self.at.u_unit, (u,))


_Values = Sequence[float]


@dataclass(frozen=True)
class _Law:
    """A law: its family, where it is physical, its numbers (the amplitude first), w of (t, u, z, numbers).

    Attributes:
        opposing: whether it takes from the place what opposes the signal. rate: derivative of its state.
        ours: its numbers from those that the library has of the same law, but for numbers that only it has.
    """

    family: str
    fits: Callable[[_Here], bool]
    numbers: Callable[[_Here], dict[str, float]]
    value: Callable[[float, float, _Values, _Values], float]
    opposing: bool = True
    rate: Callable[[float, _Values, _Values], float] | None = None
    ours: Callable[[_Values], Sequence[float]] = tuple


def _friction(c: _Here) -> bool:
    return c.friction


def _spring(c: _Here) -> bool:
    return c.spring


def _clip(u: float, most: float) -> float:
    return min(max(u, -most), most)


def _drift(c: _Here) -> dict[str, float]:
    return {"change per time": c.sign() * c.share / c.length}


def _factor(power: float) -> Callable[[_Here], dict[str, float]]:
    return lambda c: {"factor": c.share * c.w / c.u**power}


_LAWS = {
    "coulomb": _Law(
        "dry friction", _friction, lambda c: {"level": c.share * c.w, "corner": c.draw(0.01, 0.06) * c.u},
        lambda t, s, z, n: n[0] * math.tanh(s / n[1])),
    "stribeck": _Law(
        "dry friction", _friction,
        lambda c: {"level": c.share * c.w, "more": c.draw(0.5, 1.5) * c.share * c.w,
                   "corner": c.draw(0.01, 0.04) * c.u, "speed": c.draw(0.1, 0.4) * c.u},
        lambda t, s, z, n: math.tanh(s / n[2]) * (n[0] + n[1] * math.exp(-((s / n[3]) ** 2))),
        ours=lambda v: (v[0], v[0] * v[1], v[3], v[2])),
    "quadratic drag": _Law("drag", lambda c: c.moving, _factor(2.0), lambda t, s, z, n: n[0] * s * abs(s)),
    "power drag": _Law(
        "drag", lambda c: c.moving,
        lambda c: {"factor": c.share * c.w / c.u ** (n := c.draw(1.3, 1.7)), "exponent": n},
        lambda t, s, z, n: n[0] * math.copysign(abs(s) ** n[1], s)),
    "one-sided damping": _Law(
        "one-sided damping", _friction, _factor(1.0), lambda t, s, z, n: n[0] * max(s, 0.0)),
    "one-sided damping, backward": _Law(
        "one-sided damping", _friction, _factor(1.0), lambda t, s, z, n: n[0] * min(s, 0.0)),
    "eddy-current brake": _Law(
        "viscous friction", lambda c: c.moving,
        lambda c: {"factor": c.share * c.w / c.u, "speed": c.draw(0.5, 2.0) * c.u},
        lambda t, s, z, n: n[0] * s / (1.0 + (s / n[1]) ** 2)),
    "cubic stiffness": _Law("stiffness", _spring, _factor(3.0), lambda t, s, z, n: n[0] * s**3),
    "progressive stiffness": _Law("stiffness", _spring, _factor(2.0), lambda t, s, z, n: n[0] * s * abs(s)),
    "stop": _Law(
        "stiffness", _spring,
        lambda c: {"stiffness": 6.0 * c.share * c.w / c.u, "travel": c.draw(0.8, 1.5) * c.u},
        lambda t, s, z, n: n[0] * (s - _clip(s, n[1]))),
    "dead band": _Law(
        "play", lambda c: c.spring and c.at.slope > 0.0,
        lambda c: {"stiffness": -c.at.slope, "band": c.draw(0.05, 0.4) * c.u},
        lambda t, s, z, n: n[0] * _clip(s, n[1]), opposing=False),
    "ripple": _Law(
        "ripple", lambda c: measures(c.at.w_unit, ("N.m",)) and measures(c.at.u_unit, ("rad",)) and c.u > 1.0,
        lambda c: {"level": c.share * c.w, "phase": c.draw(0.0, 6.28)},
        lambda t, s, z, n: n[0] * math.sin(s + n[1])),
    "saturation": _Law(
        "saturation", lambda c: c.source, lambda c: {"limit": c.draw(0.55, 0.85) * c.most},
        lambda t, s, z, n: _clip(s, n[0]) - s, opposing=False),
    "dead zone": _Law(
        "dead zone", lambda c: c.source and c.zero, lambda c: {"half width": c.draw(0.05, 0.35) * c.u},
        lambda t, s, z, n: -_clip(s, n[0]), opposing=False),
    "gain curve": _Law(
        "gain curve", lambda c: c.source, lambda c: {"factor": -c.share / c.most},
        lambda t, s, z, n: n[0] * s * abs(s), opposing=False),
    "lag": _Law(
        "lag", lambda c: c.source or c.sensor, lambda c: {"time constant": c.draw(2.0, 12.0) * c.h},
        lambda t, s, z, n: z[0] - s, False, lambda s, z, n: (s - z[0]) / n[0]),
    "delay": _Law(
        "lag", lambda c: (c.source and c.external) or (c.sensor and c.unread),
        lambda c: {"time": c.draw(2.0, 10.0) * c.h}, lambda t, s, z, n: 0.0, opposing=False),
    "gain that drifts": _Law(
        "drift", lambda c: c.source, _drift, lambda t, s, z, n: n[0] * t * s, opposing=False),
    "drift": _Law(
        "drift", lambda c: c.sensor, lambda c: {"change per time": c.sign() * c.share * c.w / c.length},
        lambda t, s, z, n: n[0] * t, opposing=False),
    "offset": _Law(
        "offset",
        lambda c: (
            c.at.kind == "input" and c.at.own and not c.external and measures(c.at.w_unit, (*_FORCES, "A"))
        ),
        lambda c: {"value": c.sign() * c.share * c.w}, lambda t, s, z, n: n[0], opposing=False),
    "root of the signal": _Law(
        "root", lambda c: c.units("m3/s", "m"),
        lambda c: {"factor": c.share * c.w / math.sqrt(max(abs(c.mean), c.u))},
        lambda t, s, z, n: n[0] * math.copysign(math.sqrt(abs(s)), s)),
    "overflow": _Law(
        "overflow", lambda c: c.units("m3/s", "m"),
        lambda c: {"factor": 8.0 * c.share * c.w / c.u, "level": c.mean + c.draw(0.2, 0.9) * c.u},
        lambda t, s, z, n: n[0] * max(s - n[1], 0.0)),
    "loss": _Law(
        "loss", lambda c: c.units("W", "K"),
        lambda c: {"factor": c.share * c.w / c.u, "surroundings": c.mean - c.draw(0.5, 3.0) * c.u},
        lambda t, s, z, n: n[0] * (s - n[1])),
    "radiation": _Law(
        "radiation", lambda c: c.units("W", "K"),
        lambda c: {"factor": c.share * c.w / (4.0 * _STEFAN * c.mean**3 * c.u), "surroundings": 293.0},
        lambda t, s, z, n: n[0] * _STEFAN * (s**4 - n[1] ** 4)),
    "hysteresis": _Law(
        "hysteresis", _friction, lambda c: {"level": c.share * c.w, "travel": c.draw(0.02, 0.2) * c.path},
        lambda t, s, z, n: n[0] * z[0], True,
        lambda s, z, n: s / n[1] * (1.0 - math.copysign(1.0, s) * z[0])),
    # The follower moves where the play is used up; the output does not see its short lag.
    "backlash": _Law(
        "backlash", lambda c: c.sensor, lambda c: {"half width": c.draw(0.03, 0.2) * c.u, "time": 0.2 * c.h},
        lambda t, s, z, n: -_clip(s - z[0], n[0]), False,
        lambda s, z, n: (s - z[0] - _clip(s - z[0], n[0])) / n[1]),
}  # fmt: skip


def _here(at: _At, plant: Plant, sizes: Sizes, random: Random) -> _Here:
    w, u, mean = float(sizes.spread[at.at]), float(sizes.spread[at.reads]), float(sizes.mean[at.reads])
    force, moving = measures(at.w_unit, _FORCES), measures(at.u_unit, _RATES) and not at.own
    instance, zero = at.place.split(".")[0], abs(mean) < 0.5 * u
    part = getattr(getattr(plant, "drawing", None), "parts", {}).get(instance)
    external = at.place in plant.external
    names = [*plant.states, *plant.inputs, *plant.outputs]
    paths = [
        float(sizes.spread[k]) for k, one in enumerate(names)
        if one.split(".")[0] == instance and measures(plant.units[one], _TRAVELS)
    ]  # fmt: skip
    return _Here(
        at, w, u, mean, float(sizes.most[at.reads]),
        float(np.exp(random.uniform(math.log(0.04), math.log(0.4)))),
        moving=force and moving, friction=force and moving and zero, zero=zero,
        spring=force and measures(at.u_unit, _TRAVELS) and not at.own and zero,
        source=at.own and (external or (part is not None and part.source and at.kind == "output")),
        external=external,
        sensor=at.own and at.kind == "output" and at.place in plant.compared
        and (part is None or part.sensor),
        unread=at.place not in {one for legs in plant.legs.values() for one, _ in legs},
        path=min(paths, default=10.0 * u * sizes.interval), h=sizes.interval, length=sizes.length,
        draw=random.uniform, sign=lambda: (-1.0) ** int(random.integers(2)),
    )  # fmt: skip


def choices(plant: Plant, sizes: Sizes, random: Random) -> dict[str, list[Acting]]:
    """Laws that are physical in a system, by name, each at all of its places."""
    made: dict[str, list[Acting]] = {}
    for at in _places(plant, sizes):
        for name, law in _LAWS.items():
            here = _here(at, plant, sizes, random)
            if (here.w > 0.0 and here.u > 0.0) and law.fits(here):
                numbers = {key: float(f"{value:.5g}") for key, value in law.numbers(here).items()}
                where = at.place, at.kind, at.index, at.signal, at.reads
                sign = at.sign if law.opposing else 1.0
                made.setdefault(name, []).append(_acting(name, *where, numbers, sign))
    return made


def _acting(
    name: str, place: str, kind: str, index: int, signal: str, reads: int, numbers: dict[str, float],
    sign: float = 1.0,
) -> Acting:  # fmt: skip
    law, n = _LAWS[name], list(numbers.values())
    rate = law.rate
    return Acting(
        name, law.family, place, kind, index, signal, (reads,), numbers,
        lambda t, s, z: sign * law.value(t, s[0], z, n), int(rate is not None),
        None if rate is None else (lambda t, s, z: (rate(s[0], z, n),)),
        abs(n[0]) if name == "delay" else 0.0, follows=name in ("lag", "backlash"),
    )  # fmt: skip


def scaled(one: Acting, factor: float) -> Acting:
    """A law whose w is larger, for those where that makes sense."""
    if one.states or one.delay or one.name in ("saturation", "dead zone", "dead band"):
        return one
    first = next(iter(one.numbers))
    numbers = {**one.numbers, first: one.numbers[first] * factor}
    if one.name == "stribeck":
        numbers["more"] *= factor
    value = one.value
    return Acting(
        one.name, one.family, one.place, one.kind, one.index, one.signal, one.reads, numbers,
        lambda t, s, z: factor * value(t, s, z), outside=one.outside,
    )  # fmt: skip


def outside(plant: Plant, sizes: Sizes, random: Random) -> Acting:
    """Something that no library holds, at a random input that something drives."""
    nx, nu = len(plant.states), len(plant.inputs)
    every = [
        k for k in range(nu)
        if sizes.spread[nx + k] > 0.0
        and measures(plant.units[plant.inputs[k]], ("N", "N.m", "m3/s", "W", "A", "V"))
        and plant.inputs[k].split(".")[-1] not in ("reference", "measured")
    ]  # fmt: skip
    index = int(random.choice(every))
    w = float(sizes.spread[nx + index]) * random.uniform(0.15, 0.6)
    length, h = sizes.length, sizes.interval
    kind = str(random.choice(["knocks", "wandering", "product", "chirp", "wear", "oscillator"]))
    others = [k for k in range(nx) if sizes.spread[k] > 0.0] or [nx + index]
    reads = tuple(int(k) for k in random.choice(others, 2))
    m, d = [float(sizes.mean[k]) for k in reads], [float(sizes.spread[k]) for k in reads]
    states, rate = 0, None
    tones: list[tuple[float, float]] = [(0.02 / h, 0.0)]
    times: list[float] = []
    if kind == "knocks":
        times = np.sort(random.uniform(0.0, length, 12)).tolist()
    elif kind == "wandering":
        tones = [(random.uniform(0.02, 0.15) / h, random.uniform(0.0, 6.3)) for _ in range(7)]
    elif kind == "wear":
        states, rate = 1, lambda t, s, z: (abs(s[0] - m[0]) / d[0],)
    elif kind == "oscillator":
        # Van der Pol's, which the signal pulls.
        pace = 0.12 / h
        states = 2
        rate = lambda t, s, z: (  # noqa: E731
            z[1], 1.5 * pace * (1.0 - z[0] ** 2) * z[1] - pace**2 * (z[0] - 0.3 - 0.5 * (s[0] - m[0]) / d[0]),
        )  # fmt: skip
    bend = 0.04 / (h * length) if kind == "chirp" else 0.0
    values: dict[str, Callable[[float, Any, Any], float]] = {
        "knocks": lambda t, s, z: 3.0 * w * sum(math.exp(-(((t - one) / (12.0 * h)) ** 2)) for one in times),
        "wandering": lambda t, s, z: (
            w * math.sqrt(2.0 / len(tones)) * sum(math.sin(a * t + 0.5 * bend * t * t + b) for a, b in tones)
        ),
        "product": lambda t, s, z: (
            w * math.sin(2.5 * (s[0] - m[0]) / d[0]) * math.cos(1.7 * (s[1] - m[1]) / d[1] + 0.6)
        ),
        # Grows and falls with the way that the signal has gone.
        "wear": lambda t, s, z: w * math.sin(40.0 / length * z[0]) * math.tanh((s[0] - m[0]) / d[0]),
        "oscillator": lambda t, s, z: 0.7 * w * z[0],
    }
    value = values["wandering" if kind == "chirp" else kind]
    names = [*plant.states, *plant.inputs, *plant.outputs]
    return Acting(
        kind, "outside", plant.inputs[index], "input", index, names[reads[0]], reads, {"size": w}, value,
        states, rate, outside=True,
    )  # fmt: skip


def renamed(name: str) -> tuple[str, ...]:
    """Other names under which a library may hold a law."""
    return {
        "hysteresis": ("Dahl friction", "Bouc-Wen hysteresis", "LuGre friction"),
        # A spring that is slack within a band has a dead zone of its travel.
        "dead band": ("dead zone",),
        "one-sided damping, backward": ("one-sided damping",),
    }.get(name, ())  # fmt: skip


def named(
    plant: Plant, law: str, place: str, kind: str, signal: str, numbers: Sequence[float],
    like: Acting | None = None,
) -> Acting | None:  # fmt: skip
    """A law as a verdict names it; None if it cannot be simulated here.

    Args:
        like: the hidden law, which gives numbers that the library does not have.
    """
    groups = {"input": plant.inputs, "output": plant.outputs, "rate": [f"der({one})" for one in plant.states]}
    names = [*plant.states, *plant.inputs, *plant.outputs]
    # The library's name of the same equations.
    law = "hysteresis" if law == "Dahl friction" else law
    if law not in _LAWS or place not in groups[kind] or signal not in names:
        return None
    if law == "delay" and place not in plant.external and not (kind == "output" and place in plant.compared):
        return None
    index, reads = groups[kind].index(place), names.index(signal)
    if kind != "rate" and signal == place:
        reads = index + len(plant.states) + (0 if kind == "input" else len(plant.inputs))
    made = _LAWS[law].ours(numbers)
    made = (*made, *list(like.numbers.values() if like else ())[len(made) :])
    return _acting(law, place, kind, index, signal, reads, {str(k): one for k, one in enumerate(made)})
