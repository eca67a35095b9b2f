"""Units are exact, distinguish dimensions, and never take Hz for rad/s."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.base.units import (
    ONE,
    Unit,
    UnitError,
    convert,
    measures,
    parse_quantity,
    parse_unit,
    quantity_in,
)

KNOWN = [
    "1", "%", "m", "mm", "km", "kg", "g", "s", "ms", "us", "min", "N", "kN", "N/m", "N/mm", "N.s/m", "N.s/mm",
    "kg.m2", "rad", "deg", "rad/s", "rpm", "Hz", "kHz", "Pa", "bar", "W/(m2.K)", "m/s2", "1/s", "s-1",
    "degC", "K",
    "J", "V", "Ohm", "mm/s", "N2.s2/m2",
]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("2 ms", "s", 0.002),
        ("2ms", "s", 0.002),
        ("176 N/mm", "N/m", 176000.0),
        ("0.1 ms", "s", 0.0001),
        ("50 us", "s", 5e-05),
        ("20 mm/s", "m/s", 0.02),
        ("0.5 N.s/mm", "N.s/m", 500.0),
        ("0.5 N s/mm", "N.s/m", 500.0),
        ("3e-1 kN", "N", 300.0),
        ("-5 mm", "m", -0.005),
        ("80 %", "1", 0.8),
        ("20 degC", "K", 293.15),
        ("180 deg", "rad", math.pi),
        ("60 rpm", "rad/s", 2 * math.pi),
        ("1 m2", "mm2", 1e6),
        ("1 1/s", "Hz", 1.0),
        ("3.6 km/h", "m/s", 1.0),
    ],
)
def test_quantities_convert_to_the_last_bit(text, unit, value):
    assert quantity_in(text, parse_unit(unit)) == value


@pytest.mark.parametrize("name", KNOWN)
def test_every_unit_reads_the_same_as_its_own_description(name):
    unit = parse_unit(name)
    assert unit.name == name
    if not unit.offset:
        assert unit.same_dimension(parse_unit(unit.base()))


@given(
    value=st.floats(-1e12, 1e12, allow_nan=False),
    one=st.sampled_from(KNOWN),
    other=st.sampled_from(KNOWN),
)
def test_there_and_back_is_exact(value, one, other):
    source, target = parse_unit(one), parse_unit(other)
    quantity = parse_quantity(f"{value!r} {one}")
    assert quantity.value == Fraction(value) or Fraction(repr(value)) == quantity.value
    if not source.same_dimension(target):
        with pytest.raises(UnitError):
            quantity.exactly(target)
        return
    there = type(quantity)(quantity.exactly(target), target)
    assert there.exactly(source) == quantity.value
    gain, offset = convert(source, target)
    assert gain * value + offset == pytest.approx(quantity.to(target), rel=1e-12, abs=1e-9)


RAD = parse_unit("rad/s")
# As an FMU declares it: value in Hz = 0.159... * value in rad/s.
HZ = Unit("Hz", RAD.exponents, 1 / Fraction("0.15915494309189535"))


def test_hz_is_refused_for_rad_per_second_with_both_readings():
    with pytest.raises(UnitError) as caught:
        quantity_in("75 Hz", RAD)
    assert str(caught.value) == (
        "Hz [s-1] cannot be converted to rad/s [s-1.rad]: as a number of cycles it would be "
        "471.23889803846896 rad/s (factor 2 pi), as a bare number 75.0 rad/s"
    )


def test_hz_is_taken_where_the_fmu_declares_it_as_display_unit():
    assert quantity_in("75 Hz", RAD, {"Hz": HZ}) == 2 * math.pi * 75
    with pytest.raises(UnitError):
        quantity_in("75 kHz", RAD, {"Hz": HZ})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("3 foo", "unknown unit 'foo'"),
        ("3 N/foo", "unknown unit 'foo' in 'N/foo'"),
        ("3 N/m.s", "unit 'N/m.s' can be read in two ways; put the denominator in parentheses"),
        ("3 N/m/s", "cannot read unit 'N/m/s'; write one division, as in N/(m.s)"),
        ("3 (N)/m", "cannot read unit '(N)/m'; parentheses stand in the denominator only"),
        ("3 degC/s", "unit 'degC/s' holds a unit with an offset; use K or delta_degC"),
        ("3 degC2", "unit 'degC2' is a power of a unit with an offset; use K or delta_degC"),
        ("three N", "'three N' is not a number with a unit"),
        ("3.2.1 N", "'3.2.1 N' is not a number with a unit"),
        ("3,2 N", "'3,2 N' is not a number with a unit; decimals have a point"),
        ("1 m$", "cannot read 'm$' in unit 'm$'"),
    ],
)
def test_what_cannot_be_read_is_refused(text, message):
    with pytest.raises(UnitError) as caught:
        parse_quantity(text)
    assert str(caught.value) == message


def test_a_number_without_unit_is_the_unit_one():
    assert parse_quantity("0.8").unit == ONE
    with pytest.raises(UnitError, match=r"^'0.8' has no unit$"):
        quantity_in("0.8", RAD)


def test_a_unit_measures_what_it_can_be_converted_to():
    assert measures("mm/s", ("N", "m/s"))
    assert not measures("Hz", ("rad/s",)) and not measures("parsnip", ("m",))
