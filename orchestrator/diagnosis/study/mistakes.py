"""What is wrong with a log, or worth a warning: single mistakes, as of signs and units, once for all runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sized
from dataclasses import dataclass, replace
from itertools import permutations

from pydantic import BaseModel, ConfigDict

from ...base.errors import Problem
from ...base.units import UnitError, convert, known_unit, measures, parse_unit

# What the unit of a column is taken for, by mistake, the factor that this makes, and units of what it may
# happen to: none, to all.
_FACTORS: dict[float, tuple[str, tuple[str, ...]]] = {
    -1.0: ("its sign is reversed", ()),
    1e3: ("it is 1000 times too large, as if logged in thousandths of its unit", ()),
    1e-3: ("it is 1000 times too small, as if logged in thousands of its unit", ()),
    1e6: ("it is a million times too large, as if logged in millionths of its unit", ()),
    1e-6: ("it is a million times too small, as if logged in millions of its unit", ()),
    39.37007874015748: ("it is 39.37 times too large, as if logged in inches", ("m", "m/s", "m/s2")),
    0.22480894309971052: ("it is 4.45 times too small, as if logged in pounds-force", ("N",)),
}

# The same of any system's ports: units that a value was logged in and taken for, and the factor that this
# makes. Of 9.81 and 10, which both may help, the one that fits best is reported.
_PAIRS: dict[float, tuple[str, tuple[str, ...]]] = {
    10.0: ("mm, not in cm", ("m", "m/s", "m/s2")),
    100.0: ("cm, not in m, or in percent, not in 1", ("m", "m/s", "m/s2", "1")),
    60.0: ("1/min, not in 1/s, or in s, not in min", ("s", "1/s", "m/s", "rad/s", "K/s", "m3/s", "kg/s")),
    180.0 / math.pi: ("deg, not in rad", ("rad", "rad/s", "rad/s2")),
    2.0 * math.pi: ("rad, not in turns, or in rad/s, not in Hz", ("rad", "rad/s", "1/s")),
    30.0 / math.pi: ("rpm, not in rad/s", ("rad/s",)),
    6e4: ("L/min, not in m3/s", ("m3/s",)),
    9.81: ("N, not in kgf", ("N", "N.m")),
    1e5: ("Pa, not in bar", ("Pa",)),
    6894.757293168361: ("Pa, not in psi", ("Pa",)),
}

# Scales of temperature, which differ by more than a factor.
_SCALES = ("K", "degC", "degF")


class Warned(BaseModel):
    """Something about the logs that a reader should know."""

    model_config = ConfigDict(extra="forbid")

    place: str
    what: str
    remedy: str = ""


class WarnedOfMaster(Warned):
    """What matters only where the master simulates the system, not in state form."""


@dataclass(frozen=True)
class Mistake(Problem):
    """A problem of a run without which all fits; the remedy says so. The place is "run: column"."""


def wrong_factors(
    sign: int = 1, unit: str | None = None, own: str | None = None
) -> Iterator[tuple[float, str]]:
    """Factors by which a column may be too large, its sign included, each with its remedy.

    Args:
        sign, unit: that a study file gives the column.
        own: unit in which its values stand by now, if units that are no power of a thousand apart are meant,
            too: those that it may be taken for.
    """
    correct = _corrected(unit)
    turn = "Correct its values, or give `sign: -1` in a study file."
    if sign < 0:
        turn = "The study file says `sign: -1`: take that out."
    for factor, (text, units) in _FACTORS.items():
        if _may_be(own, units):
            yield factor, f"All fits if {text}. {turn if factor < 0.0 else correct}"
    for factor, (pair, units) in _PAIRS.items() if own is not None else ():
        if not _may_be(own, units):
            continue
        yield factor, f"All fits if it is {factor:.4g} times too large, as if logged in {pair}. {correct}"
        less = f"it is {factor:.4g} times too small, as if it should be in {pair}"
        yield 1.0 / factor, f"All fits if {less}. {correct}"


def _may_be(unit: str | None, units: Iterable[str]) -> bool:
    """Whether a unit is one of these, up to a factor; so is one that nobody knows, or a bare number."""
    if unit is None or known_unit(unit) in (None, parse_unit("1")):
        return True
    return not units or measures(unit, units)


def wrong_scales(own: str, unit: str | None = None) -> Iterator[tuple[float, float, str]]:
    """Gain and offset that convert a temperature to another scale, with the remedy.

    Args:
        own: unit in which the column's values stand by now; unit: that a study file gives the column.
    """
    try:
        scales = {name: convert(parse_unit(name), parse_unit(own)) for name in _SCALES}
    except UnitError:
        return
    for said, meant in permutations(_SCALES, 2):
        if unit in (None, said):
            gain = scales[meant][0] / scales[said][0]
            remedy = f"All fits if its values are in {meant}, not in {said}. {_corrected(unit)}"
            yield gain, scales[meant][1] - gain * scales[said][1], remedy


def _corrected(unit: str | None) -> str:
    """Where to correct a unit; None: the study file gives none."""
    if unit is not None:
        return f"The study file says `unit: {unit}`: correct that."
    return "Correct the unit in its header, or give `unit` in a study file."


def plural(things: Sized) -> str:
    """Ending of a plural: "s" unless there is one."""
    return "" if len(things) == 1 else "s"


def merged_problems(problems: Iterable[Problem], more: str, kind: type[Problem] = Problem) -> list[Problem]:
    """Problems, with those of several runs merged if column and remedy are equal.

    Args:
        more: what is said of further ones, with `{}` for how many and `{s}` for the plural.
        kind: of those that are reported as one; others are reported one by one.
    """
    kinds: dict[object, list[Problem]] = {}
    for one in problems:
        column = one.place.partition(": ")[2] or one.place
        kinds.setdefault((column, one.remedy) if isinstance(one, kind) else id(one), []).append(one)
    return [
        replace(first, what=f"{first.what}; {more.format(len(others), s=plural(others))}")
        if others
        else first
        for first, *others in kinds.values()
    ]
