"""Check units of the equations of the compiler's flat representation.

A number or a variable without a unit fits everything. The radian counts as 1, as equations such as
v = omega*r need; so Hz and rad/s are not distinguished here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from orchestrator.base.units import BASE_NAMES, Unit, UnitError, parse_unit

from .flatten import Json
from .sources import Location

_SAME = frozenset("Pre NoEvent Smooth Abs Min Max Sum Delay Homotopy Floor Ceil Hold Fill".split())
_PLAIN = frozenset("Exp Log Log10 Sinh Cosh Tanh Asin Acos Atan".split())
_ANGLES = frozenset("Sin Cos Tan".split())
_SUMS = frozenset("Add Sub AddElem SubElem".split())
_RELATIONS = frozenset("Lt Le Gt Ge Eq Neq".split())


@dataclass(frozen=True)
class _Measure:
    """Exponents of the base units, but the radian; the factor to them, None where numbers blur it."""

    powers: tuple[Fraction, ...]
    factor: Fraction | None

    def times(self, other: _Measure, sign: int = 1) -> _Measure:
        powers = tuple(a + sign * b for a, b in zip(self.powers, other.powers, strict=True))
        if self.factor is None or other.factor is None:
            return _Measure(powers, None)
        return _Measure(powers, self.factor * other.factor**sign)

    def fits(self, other: _Measure) -> bool:
        same = self.powers == other.powers
        return same and (None in (self.factor, other.factor) or self.factor == other.factor)

    def __str__(self) -> str:
        parts = [f"{n}{'' if p == 1 else p}" for n, p in zip(BASE_NAMES, self.powers, strict=False) if p]
        text = ".".join(parts) or "1"
        return text if self.factor in (None, 1) else f"{float(self.factor or 1):g} {text}"


def _measure_of(unit: Unit) -> _Measure:
    return _Measure(tuple(map(Fraction, unit.exponents[:-1])), unit.factor)


_ONE = _Measure((Fraction(0),) * (len(BASE_NAMES) - 1), Fraction(1))
_SECOND = _Measure(tuple(Fraction(name == "s") for name in BASE_NAMES[:-1]), Fraction(1))
# A number fits all; None stands for what is not known.
_Found = _Measure | str | None
_NUMBER = "number"


def unit_faults(flat: Json, place: Callable[[Json], Location]) -> list[str]:
    """Messages, each with its place, about units that cannot be read and sides that do not fit.

    Args:
        flat: the flat representation.
        place: the place of a span.
    """
    checker = _Checker(flat, place)
    checker.all(flat)
    return list(dict.fromkeys(checker.faults))


class Measures:
    """What expressions of a flat representation measure."""

    def __init__(self, flat: Json) -> None:
        self._checker = _Checker(flat, lambda span: Location("", 0))

    def fit(self, body: Json, unit: str) -> bool:
        """Whether an expression is known to be in a unit."""
        found, wanted = self._checker.measure(body), _measure_of(parse_unit(unit))
        return isinstance(found, _Measure) and found.fits(wanted)


class _Checker:
    def __init__(self, flat: Json, place: Callable[[Json], Location]) -> None:
        self.faults: list[str] = []
        self._place = place
        self._units: dict[str, _Measure | None] = {}
        for name, body in flat["variables"].items():
            self._units[name] = self._declared(name, body)

    def _declared(self, name: str, body: Json) -> _Measure | None:
        unit = body.get("unit")
        if not isinstance(unit, str) or not unit:
            return None
        try:
            read = parse_unit(unit)
        except UnitError as error:
            span = body["source_span"]
            last = name.rpartition(".")[2].partition("[")[0]
            place = self._place({**span, "start": max(span["start"], span["end"] - len(last.encode()))})
            self.faults.append(f"{place}: the unit of {name}: {error}")
            return None
        return _measure_of(read)

    def all(self, json: Any) -> None:
        """Check every equation, binding and statement below a part of the representation."""
        if isinstance(json, list):
            for one in json:
                self.all(one)
            return
        if not isinstance(json, dict):
            return
        for key, value in json.items():
            if key == "residual":
                self._sides(value)
            elif key == "variables" and isinstance(value, dict):
                for name, body in value.items():
                    for attribute in ("binding", "start"):
                        if isinstance(body, dict) and body.get(attribute):
                            self._fits(self._units.get(name), body[attribute], f"{attribute} of {name}")
            elif key in ("Assign", "Reinit") and isinstance(value, dict):
                target = value.get("target") or value.get("state")
                if isinstance(target, str) and value.get("value"):
                    self._fits(self._units.get(target), value["value"], f"value for {target}")
            elif key == "condition" and isinstance(value, dict):
                self.measure(value)
            elif key not in ("functions", "binding", "start"):
                self.all(value)

    def _fits(self, wanted: _Found, body: Json, what: str) -> None:
        found = self.measure(body)
        if isinstance(wanted, _Measure) and isinstance(found, _Measure) and not wanted.fits(found):
            where = self._where(body)
            self.faults.append(f"{where}: the {what} is in {found}, the variable in {wanted}; correct one")

    def _sides(self, residual: Json) -> None:
        binary = residual.get("Binary") if isinstance(residual, dict) else None
        if not binary or binary["op"] not in ("Sub", "SubElem"):
            self.measure(residual)
            return
        self._both(binary, "the sides of this equation are")

    def _both(self, binary: Json, what: str) -> _Found:
        left, right = self.measure(binary["lhs"]), self.measure(binary["rhs"])
        if isinstance(left, _Measure) and isinstance(right, _Measure):
            if not left.fits(right):
                self.faults.append(
                    f"{self._where({'Binary': binary})}: {what} in {left} and {right}; correct the equation "
                    "or a declared unit"
                )
                return None
            return left if left.factor is not None else right
        return right if left == _NUMBER or (left is None and right != _NUMBER) else left

    def _where(self, json: Json) -> Location:
        spans = (one["span"] for one in json.values() if isinstance(one, dict) and one.get("span"))
        return self._place(next(spans, {}))

    def measure(self, json: Any) -> _Found:
        if not isinstance(json, dict) or len(json) != 1:
            return None
        ((kind, body),) = json.items()
        match kind:
            case "Literal":
                return _NUMBER
            case "VarRef":
                name = body["name"]["name"]
                # Of time numbers stand beside it that have units as well: sin(10*time).
                return None if name == "time" else self._units.get(name)
            case "Unary":
                return self.measure(body["rhs"])
            case "Binary":
                return self._binary(body)
            case "If":
                return self._agreeing([value for _, value in body["branches"]] + [body["else_branch"]])
            case "Array":
                return self._agreeing(body.get("elements", []))
            case "BuiltinCall":
                return self._call(body)
        return None

    def _agreeing(self, parts: list[Json]) -> _Found:
        found = [self.measure(one) for one in parts]
        known = [one for one in found if isinstance(one, _Measure)]
        for part, one in zip(parts, found, strict=True):
            if isinstance(one, _Measure) and not one.fits(known[0]):
                self.faults.append(
                    f"{self._where(part)}: in {one}, the part before it in {known[0]}; correct one"
                )
        return known[0] if known else None

    def _binary(self, body: Json) -> _Found:
        op = body["op"]
        if op in _SUMS:
            return self._both(body, "the terms here are")
        if op in _RELATIONS:
            self._both(body, "the sides of this relation are")
            return None
        left, right = self.measure(body["lhs"]), self.measure(body["rhs"])
        if op in ("Mul", "MulElem", "Div", "DivElem"):
            sign = 1 if op.startswith("Mul") else -1
            if left == _NUMBER and right == _NUMBER:
                return _NUMBER
            # Numbers often convert: what they multiply has no known factor any more.
            left = _Measure(_ONE.powers, None) if left == _NUMBER else left
            right = _Measure(_ONE.powers, None) if right == _NUMBER else right
            if isinstance(left, _Measure) and isinstance(right, _Measure):
                return left.times(right, sign)
            return None
        if op in ("Exp", "ExpElem"):
            power = _whole(body["rhs"])
            if isinstance(left, _Measure) and power is not None:
                factor = None if left.factor is None else left.factor**power
                return _Measure(tuple(one * power for one in left.powers), factor)
            return _NUMBER if left == right == _NUMBER else None
        return None

    def _call(self, body: Json) -> _Found:
        name, arguments = body["function"], body["args"]
        found = [self.measure(one) for one in arguments]
        first = found[0] if found else None
        if name == "Der":
            return first.times(_SECOND, -1) if isinstance(first, _Measure) else None
        if name == "Sqrt" and isinstance(first, _Measure):
            return _Measure(tuple(one / 2 for one in first.powers), None)
        if name in _PLAIN | _ANGLES and isinstance(first, _Measure):
            needs = "an angle in rad" if name in _ANGLES else "a number"
            if not first.fits(_ONE):
                where = self._where(arguments[0])
                self.faults.append(f"{where}: {name.lower()}() takes {needs}, this is in {first}")
            return _ONE
        if name in ("Min", "Max"):
            return self._agreeing(arguments)
        if name in _SAME:
            return found[-1] if name in ("NoEvent", "Smooth") else first
        return None


def _whole(json: Json) -> int | None:
    """The whole number that a literal holds."""
    value = json.get("Literal", {}).get("value", {}) if isinstance(json, dict) else {}
    for number in value.values():
        if isinstance(number, int | float) and number == int(number) and abs(number) < 20:
            return int(number)
    return None
