"""Units of measure, exactly: "176 N/mm" is 176000 N/m to the last bit, and Hz is not rad/s.

A unit is what FMI's BaseUnit makes it (FMI 2.0.4, 2.2.2): integer exponents of kg, m, s, A, K, mol, cd and
rad, a factor and an offset, with value_in_base_units = factor * value + offset. Factors are rational
numbers, so that no rounding happens before the one at the end. The radian is a dimension of its own here,
as in FMI: that keeps 75 Hz [s-1] from passing as 75 rad/s.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache

BASE_NAMES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_NO_DIMENSION = (0,) * len(BASE_NAMES)


class UnitError(ValueError):
    """A unit or quantity that cannot be read or converted; the message says why."""


@dataclass(frozen=True)
class Unit:
    """A unit of measure.

    Attributes:
        name: as written.
        exponents: of kg, m, s, A, K, mol, cd, rad.
        factor, offset: value in base units = factor * value + offset.
        difference: whether values are differences of two quantities, so that no origin counts: 1 degC is 1 K
            (FMI's relativeQuantity). The offset is then 0.
    """

    name: str = field(compare=False)
    exponents: tuple[int, ...] = _NO_DIMENSION
    factor: Fraction = Fraction(1)
    offset: Fraction = Fraction(0)
    difference: bool = False

    def same_dimension(self, other: Unit) -> bool:
        """Whether values can be converted between the two units."""
        return self.exponents == other.exponents

    def base(self) -> str:
        """The dimension in base units, for example "kg.s-2"."""
        parts = [
            name + (str(power) if power != 1 else "")
            for name, power in zip(BASE_NAMES, self.exponents, strict=True)
            if power
        ]
        return ".".join(parts) or "1"

    def of_differences(self) -> Unit:
        """The unit for differences of values in this one."""
        return replace(self, offset=Fraction(0), difference=True)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Quantity:
    """A number with its unit, exact as written."""

    value: Fraction
    unit: Unit
    text: str = field(default="", compare=False)

    def exactly(self, unit: Unit, difference: bool = False) -> Fraction:
        """The value in `unit`, not rounded. Raises: UnitError if the dimensions differ.

        Args:
            difference: whether it is a difference of two values, so that no origin counts: 1 degC is 1 K.
        """
        shift = Fraction(0) if difference or unit.difference else _shift(self.unit, unit)
        if not self.unit.same_dimension(unit):
            raise UnitError(_not_convertible(self.unit, unit))
        return (self.value * self.unit.factor + shift) / unit.factor

    def to(self, unit: Unit, difference: bool = False) -> float:
        """The value in `unit`, rounded once; as `exactly`."""
        return _to_float(self.exactly(unit, difference))


def convert(source: Unit, target: Unit) -> tuple[float, float]:
    """Gain and offset of target_value = gain * source_value + offset.

    Raises: UnitError if the dimensions differ, or if one holds differences and the other has an origin.
    """
    if not source.same_dimension(target):
        raise UnitError(_not_convertible(source, target))
    gain = source.factor / target.factor
    return _to_float(gain), _to_float(_shift(source, target) / target.factor)


def _not_convertible(source: Unit, target: Unit) -> str:
    return f"{source} [{source.base()}] cannot be converted to {target} [{target.base()}]"


def _shift(source: Unit, target: Unit) -> Fraction:
    """How far apart the origins of two units are, in base units."""
    if source.difference != target.difference and source.name == target.name:
        return Fraction(0)  # not all exporters declare what is a difference
    if source.difference != target.difference and (source.offset or target.offset):
        relative, absolute = (source, target) if source.difference else (target, source)
        raise UnitError(
            f"{source} cannot be converted to {target}: {relative} is a unit of differences here, "
            f"{absolute} has an origin"
        )
    return source.offset - target.offset


def _to_float(value: Fraction) -> float:
    try:
        return float(value)
    except OverflowError:
        exponent = math.log10(abs(value.numerator)) - math.log10(value.denominator)
        raise UnitError(
            f"about {'-' if value < 0 else ''}1e{exponent:.0f} is beyond double precision"
        ) from None


def _unit(
    name: str, factor: Fraction | str | int = 1, offset: Fraction | str | int = 0, **powers: int
) -> Unit:
    exponents = tuple(powers.get(base, 0) for base in BASE_NAMES)
    return Unit(name, exponents, Fraction(factor), Fraction(offset))


ONE = _unit("1")
_PI = Fraction(math.pi)

# Symbols that take SI prefixes, then those that do not. "g" stands for the gram: an acceleration of "1 g"
# is refused by its dimension.
_PREFIXABLE = {
    unit.name: unit
    for unit in (
        _unit("m", m=1),
        _unit("g", Fraction(1, 1000), kg=1),
        _unit("s", s=1),
        _unit("A", A=1),
        _unit("K", K=1),
        _unit("mol", mol=1),
        _unit("cd", cd=1),
        _unit("rad", rad=1),
        _unit("Hz", s=-1),
        _unit("N", kg=1, m=1, s=-2),
        _unit("Pa", kg=1, m=-1, s=-2),
        _unit("J", kg=1, m=2, s=-2),
        _unit("W", kg=1, m=2, s=-3),
        _unit("C", A=1, s=1),
        _unit("V", kg=1, m=2, s=-3, A=-1),
        _unit("F", kg=-1, m=-2, s=4, A=2),
        _unit("Ohm", kg=1, m=2, s=-3, A=-2),
        _unit("S", kg=-1, m=-2, s=3, A=2),
        _unit("Wb", kg=1, m=2, s=-2, A=-1),
        _unit("T", kg=1, s=-2, A=-1),
        _unit("H", kg=1, m=2, s=-2, A=-2),
        _unit("lm", cd=1),
        _unit("lx", cd=1, m=-2),
        _unit("bar", 100_000, kg=1, m=-1, s=-2),
        _unit("l", Fraction(1, 1000), m=3),
        _unit("L", Fraction(1, 1000), m=3),
        _unit("eV", "1.602176634e-19", kg=1, m=2, s=-2),
        _unit("t", 1000, kg=1),
    )
}
_PLAIN = {
    unit.name: unit
    for unit in (
        ONE,
        _unit("%", Fraction(1, 100)),
        _unit("min", 60, s=1),
        _unit("h", 3600, s=1),
        _unit("d", 86400, s=1),
        _unit("deg", _PI / 180, rad=1),
        _unit("rev", 2 * _PI, rad=1),
        _unit("rpm", 2 * _PI / 60, s=-1, rad=1),
        _unit("degC", 1, "273.15", K=1),
        _unit("degF", Fraction(5, 9), Fraction("459.67") * Fraction(5, 9), K=1),
        _unit("degR", Fraction(5, 9), K=1),
        _unit("in", "0.0254", m=1),
        _unit("ft", "0.3048", m=1),
        _unit("lb", "0.45359237", kg=1),
        _unit("lbf", Fraction("0.45359237") * Fraction("9.80665"), kg=1, m=1, s=-2),
    )
}
_ALIASES = {"°": "deg", "°C": "degC", "Ω": "Ohm", "ohm": "Ohm", "-": "1", "r/min": "rpm"}
_PREFIXES = {
    "Y": 24, "Z": 21, "E": 18, "P": 15, "T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "da": 1,
    "d": -1, "c": -2, "m": -3, "u": -6, "µ": -6, "μ": -6, "n": -9, "p": -12, "f": -15, "a": -18,
}  # fmt: skip

_LONGEST_NUMBER = 1000
_LARGEST_POWER = 30
_FACTOR = re.compile(r"((?:delta_)?[A-Za-zµμΩ°%]+|1)(?:\^?([+-]?\d+))?")
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S.*)?", re.DOTALL)


def _symbol(symbol: str, text: str) -> Unit:
    if symbol.startswith("delta_"):
        return replace(_symbol(symbol.removeprefix("delta_"), text).of_differences(), name=symbol)
    symbol = _ALIASES.get(symbol, symbol)
    if symbol in _PLAIN:
        return _PLAIN[symbol]
    if symbol in _PREFIXABLE:
        return _PREFIXABLE[symbol]
    for length in (2, 1):
        prefix, rest = symbol[:length], symbol[length:]
        if prefix in _PREFIXES and rest in _PREFIXABLE:
            unit = _PREFIXABLE[rest]
            return Unit(symbol, unit.exponents, unit.factor * Fraction(10) ** _PREFIXES[prefix])
    raise UnitError(f"unknown unit {symbol!r}" + (f" in {text!r}" if symbol != text else ""))


def _product(text: str, whole: str) -> tuple[list[int], Fraction, list[Unit]]:
    exponents, factor, units = [0] * len(BASE_NAMES), Fraction(1), []
    for part in re.split(r"\s*[.*·]\s*|\s+", text.strip()):
        match = _FACTOR.fullmatch(part)
        if match is None:
            raise UnitError(f"cannot read {part!r} in unit {whole!r}")
        unit = _symbol(match[1], whole)
        power = int(match[2] or 1) if len(match[2] or "") < 4 else _LARGEST_POWER + 1
        if abs(power) > _LARGEST_POWER:
            raise UnitError(f"the power of {match[1]} in unit {whole[:40]!r} is above {_LARGEST_POWER}")
        units.append(unit)
        factor *= unit.factor**power
        exponents = [total + power * own for total, own in zip(exponents, unit.exponents, strict=True)]
    return exponents, factor, units


@lru_cache(maxsize=1024)
def parse_unit(text: str) -> Unit:
    """Read a unit's name: "N/mm", "N.s/m", "N s/mm", "kg.m2", "rad/s", "W/(m2.K)", "deg", "1", "%".

    "delta_degC" is the unit of differences of temperatures in degC; "delta_" may precede any unit.

    Factors are joined by a dot, an asterisk or a space; one division at most, as in Modelica, and a
    denominator of several factors stands in parentheses, since "N/m.s" can be read in two ways.

    Raises: UnitError if it cannot be read.
    """
    stripped = _ALIASES.get(text.strip(), text.strip())
    if stripped in _PLAIN:
        return _PLAIN[stripped]
    numerator, *denominators = stripped.split("/")
    if not numerator.strip() or len(denominators) > 1:
        raise UnitError(f"cannot read unit {text!r}; write one division, as in N/(m.s)")
    if "(" in numerator or ")" in numerator:
        raise UnitError(f"cannot read unit {text!r}; parentheses stand in the denominator only")
    exponents, factor, units = _product(numerator, stripped)
    if denominators:
        denominator = denominators[0].strip()
        if denominator.startswith("(") and denominator.endswith(")"):
            denominator = denominator[1:-1]
        elif re.search(r"[.*·\s]", denominator):
            raise UnitError(f"unit {text!r} can be read in two ways; put the denominator in parentheses")
        below, divisor, others = _product(denominator, stripped)
        exponents = [up - down for up, down in zip(exponents, below, strict=True)]
        factor /= divisor
        units += others
    if len(units) > 1 and any(unit.offset for unit in units):
        raise UnitError(f"unit {text!r} holds a unit with an offset; use K or delta_degC")
    offset = units[0].offset if len(units) == 1 else Fraction(0)
    if offset and units[0] != Unit(stripped, tuple(exponents), factor, offset):
        raise UnitError(f"unit {text!r} is a power of a unit with an offset; use K or delta_degC")
    difference = len(units) == 1 and units[0].difference
    return Unit(stripped, tuple(exponents), factor, offset, difference)


def known_unit(text: str) -> Unit | None:
    """What `parse_unit` reads; None where it cannot."""
    try:
        return parse_unit(text)
    except UnitError:
        return None


def measures(unit: str, kinds: Iterable[str]) -> bool:
    """Whether a unit can be converted to one of these; not if it cannot be read."""
    known = known_unit(unit)
    return known is not None and any(known.same_dimension(parse_unit(one)) for one in kinds)


def parse_quantity(text: str) -> Quantity:
    """Read a number with a unit, for example "176 N/mm" or "2ms"; a bare number has the unit "1".

    Raises: UnitError if there is no number or the unit cannot be read.
    """
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise UnitError(f"{text!r} is not a number with a unit")
    if match[2] and match[2][0] in ".,":
        hint = "; decimals have a point" if match[2][0] == "," else ""
        raise UnitError(f"{text!r} is not a number with a unit{hint}")
    unit = parse_unit(match[2]) if match[2] else ONE
    return Quantity(_fraction(match[1]), unit, text.strip())


def _fraction(text: str) -> Fraction:
    """A number as written, exactly. Raises: UnitError if it is far beyond double precision."""
    exponent = re.split("[eE]", text)[1:] or ["0"]
    if len(text) > _LONGEST_NUMBER or len(exponent[0].lstrip("+-0")) > 3:
        shown = text if len(text) <= 30 else f"{text[:20]}... ({len(text)} characters)"
        raise UnitError(f"{shown} is beyond double precision")
    return Fraction(text)


def quantity_in(
    text: str, unit: Unit, display_units: Mapping[str, Unit] | None = None, difference: bool = False
) -> float:
    """The value of a written quantity in an FMU's unit.

    A unit that the FMU declares as a display unit of this very unit is read with the FMU's factor, which is
    how "75 Hz" can be 471.2 rad/s: nowhere else are the two taken for each other.

    Args:
        text: for example "176 N/mm".
        unit: the variable's unit.
        display_units: the display units that the FMU declares for it, by name.
        difference: see `Quantity.exactly`.
    Raises: UnitError, which states both readings where Hz and rad/s meet.
    """
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise UnitError(f"{text!r} is not a number with a unit")
    if match[2] is None:
        raise UnitError(f"{text!r} has no unit")
    declared = (display_units or {}).get(match[2].strip())
    if declared is not None:
        return Quantity(_fraction(match[1]), declared).to(unit, difference)
    quantity = parse_quantity(text)
    if quantity.unit.same_dimension(unit):
        return quantity.to(unit, difference)
    raise UnitError(_mismatch(quantity, match[1], unit))


def _mismatch(quantity: Quantity, number: str, unit: Unit) -> str:
    """Why a quantity does not fit, with both readings where only a radian stands between."""
    message = f"{quantity.unit} [{quantity.unit.base()}] cannot be converted to {unit} [{unit.base()}]"
    apart = [one - other for one, other in zip(quantity.unit.exponents, unit.exponents, strict=True)]
    if any(apart[:-1]) or abs(apart[-1]) != 1:
        return message
    value = quantity.value * quantity.unit.factor / unit.factor
    turns = 1 / (2 * _PI) if apart[-1] > 0 else 2 * _PI
    return (
        f"{message}: as a number of cycles it would be {_to_float(value * turns)!r} {unit} (factor "
        f"{'1/(2 pi)' if apart[-1] > 0 else '2 pi'}), as a bare number {_to_float(value)!r} {unit}"
    )
