"""Variables and units as fmpy reads them -> as they are used here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import product
from math import prod
from typing import Any

from ..base.units import Unit, known_unit
from .variable import Causality, Initial, Kind, Value, Variability, Variable

# Elements of larger arrays are no ports; the array is kept whole, and left alone.
LARGEST_ARRAY = 4096


def read_units(raw: Any) -> tuple[dict[str, Unit], dict[str, dict[str, Unit]]]:
    """Units by name, and the display units of each."""
    units: dict[str, Unit] = {}
    display_units: dict[str, dict[str, Unit]] = {}
    for item in raw.unitDefinitions:
        base = item.baseUnit
        if base is not None:
            exponents = (base.kg, base.m, base.s, base.A, base.K, base.mol, base.cd, base.rad)
            unit = Unit(item.name, exponents, _exact(base.factor), _exact(base.offset))
            if unit.factor == 0:
                continue
        else:
            known = known_unit(item.name)
            if known is None:
                continue
            unit = known
        units[item.name] = unit
        display_units[item.name] = {
            shown.name: _display_unit(unit, shown) for shown in item.displayUnits if shown.factor
        }
    return units, display_units


def _display_unit(unit: Unit, shown: Any) -> Unit:
    # FMI: value in the display unit = factor * value in the unit + offset.
    factor, offset = _exact(shown.factor), _exact(shown.offset)
    return Unit(shown.name, unit.exponents, unit.factor / factor, unit.offset - unit.factor * offset / factor)


def _exact(number: float) -> Fraction:
    # By way of the shortest decimal, so that a declared "0.001" is a thousandth and not its neighbour.
    return Fraction(repr(float(number)))


_KINDS = {
    "Real": Kind.REAL,
    "Integer": Kind.INTEGER,
    "Boolean": Kind.BOOLEAN,
    "String": Kind.STRING,
    "Enumeration": Kind.ENUMERATION,
    "Binary": Kind.BINARY,
    "Clock": Kind.CLOCK,
}


def _kind(fmi_type: str) -> Kind:
    if fmi_type.startswith("Float"):
        return Kind.REAL
    return _KINDS[fmi_type] if fmi_type in _KINDS else Kind.INTEGER


def read_variable(
    item: Any,
    units: Mapping[str, Unit],
    display_units: Mapping[str, dict[str, Unit]],
    negated: bool = False,
    intermediate: bool = False,
) -> Variable:
    """A variable; an array is still whole."""
    declared = item.declaredType
    unit_name = item.unit or (declared.unit if declared is not None else None) or ""
    unit = units.get(unit_name)
    if unit is None and unit_name:
        unit = known_unit(unit_name)
    shown = display_units.get(unit_name, {})
    if unit is not None and _relative(item, declared):
        unit, shown = unit.of_differences(), {name: one.of_differences() for name, one in shown.items()}
    kind = _kind(item.type)
    low = item.min if item.min is not None else getattr(declared, "min", None)
    high = item.max if item.max is not None else getattr(declared, "max", None)
    return Variable(
        name=item.name,
        reference=item.valueReference,
        type=item.type,
        kind=kind,
        causality=Causality(item.causality),
        variability=Variability(item.variability),
        initial=Initial(item.initial) if item.initial else None,
        unit=unit,
        unit_name=unit_name,
        display_units=shown,
        start=_start(item.start, kind, tuple(item.shape or ())),
        nominal=_nominal(item.nominal, getattr(declared, "nominal", None)),
        minimum=number(low),
        maximum=number(high),
        items=_items(declared) if kind is Kind.ENUMERATION else {},
        shape=tuple(item.shape or ()),
        description=item.description or "",
        negated=negated,
        intermediate=intermediate,
        clocks=tuple(clock.name for clock in item.clocks or ()),
    )


def _relative(item: Any, declared: Any) -> bool:
    """Whether offsets of units are no part of a variable's values (FMI 2.0.4, 2.2.3: relativeQuantity)."""
    own = item.relativeQuantity
    return bool(getattr(declared, "relativeQuantity", False) if own is None else own)


def _items(declared: Any) -> dict[str, int]:
    return {entry.name: int(entry.value) for entry in declared.items} if declared is not None else {}


def number(text: Any) -> float | None:
    """A number, or None where there is none."""
    return None if text is None else float(text)


def _nominal(*texts: Any) -> float:
    """The first that is given and usable: FMI demands more than 0, exporters also write 0."""
    for text in texts:
        value = abs(float(text)) if text is not None else 0.0
        if 0.0 < value < float("inf"):
            return value
    return 1.0


def _start(text: str | None, kind: Kind, shape: tuple[int, ...]) -> Value | None:
    if text is None or shape:
        return None
    if kind is Kind.REAL:
        return float(text)
    if kind in (Kind.INTEGER, Kind.ENUMERATION):
        return int(text)
    if kind is Kind.BOOLEAN:
        return text in ("true", "1")
    return text


def elements(whole: Variable, start: str | None) -> list[Variable]:
    """The elements of an array, x[1], x[2] or x[1,1], x[1,2], row by row; a scalar stays as it is."""
    count = prod(whole.shape)
    if not whole.shape or count > LARGEST_ARRAY or whole.kind is Kind.BINARY:
        return [whole]
    starts = (start or "").split() if whole.kind is not Kind.STRING else []
    if len(starts) == 1:
        starts *= count  # one value stands for all elements (FMI 3.0, 2.4.7.5)
    made = []
    for place, index in enumerate(product(*(range(1, size + 1) for size in whole.shape))):
        value = _start(starts[place], whole.kind, ()) if len(starts) == count else None
        name = f"{whole.name}[{','.join(map(str, index))}]"
        made.append(replace(whole, name=name, start=value, shape=(), element=place, elements=count))
    return made
