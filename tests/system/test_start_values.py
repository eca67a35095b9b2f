"""Start values and inputs without one: what is taken, and what is reported about the rest."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import pytest
import yaml
from assembled import assemble, refusal
from doubles import FakeFmu, variable

from orchestrator.base.errors import ConfigError
from orchestrator.base.units import Unit, parse_unit
from orchestrator.config import Places
from orchestrator.fmi import Causality, Initial, Kind, Variability
from orchestrator.system.assembly import Part

RAD = parse_unit("rad/s")
HZ = Unit("Hz", RAD.exponents, 1 / Fraction("0.15915494309189535"))


def lone(name: str, value, **attributes) -> str | float:
    """The start value that an instance with this variable ends up with, or the message."""
    unit = attributes.pop("unit_name", "")
    made = variable(name, attributes.pop("causality", Causality.PARAMETER), unit, **attributes)
    part = Part("one", FakeFmu(extra=[made]), {name: value})
    try:
        return assemble([part], places=Places("x")).instances[0].start[name]
    except ConfigError as error:
        return str(error).removeprefix(f"x: instances.one.start.{name}: ")


@pytest.mark.parametrize(
    ("value", "attributes", "expected"),
    [
        ("2 ms", {"unit_name": "s"}, 0.002),
        (0.8, {"unit_name": "1"}, 0.8),
        ("80 %", {"unit_name": "1"}, 0.8),
        (3, {}, 3.0),
        ("75 Hz", {"unit_name": "rad/s", "display_units": {"Hz": HZ}}, 471.23889803846896),
        ("5 furlong", {}, "one.p (no unit): cannot take '5 furlong'\n"
            "  the FMU declares no unit for it. Give a bare number."),
        (0.002, {"unit_name": "s"}, "one.p [s]: 0.002 has no unit\n"
            "  a unit must be given, for zero too; its unit is s. Write 0.002 s."),
        ("5 N", {"unit_name": "s"}, "one.p [s]: cannot take '5 N', "
            "N [kg.m.s-2] cannot be converted to s [s]\n  its unit is s"),
        ("75 Hz", {"unit_name": "rad/s"}, "one.p [rad/s]: cannot take '75 Hz', "
            "Hz [s-1] cannot be converted to rad/s [s-1.rad]: as a number of cycles it would be "
            "471.23889803846896 rad/s (factor 2 pi), as a bare number 75.0 rad/s\n  its unit is rad/s"),
        (True, {"unit_name": "1"}, "one.p [1] must be a number, got true"),
        ("-1 s", {"unit_name": "s", "minimum": 0.0},
            "one.p = -1 s is out of range\n  allowed: at least 0.0 s"),
        (7, {"minimum": 0.0, "maximum": 5.0}, "one.p = 7 is out of range\n"
            "  allowed: at least 0.0 and at most 5.0"),
        (4, {"kind": Kind.INTEGER, "type": "Int32"}, 4),
        (4.5, {"kind": Kind.INTEGER, "type": "Int32"}, "one.p must be a whole number, got 4.5"),
        (300, {"kind": Kind.INTEGER, "type": "UInt8"}, "one.p = 300 is out of range\n"
            "  allowed: at least 0 and at most 255; its type is UInt8"),
        (2**32 + 1, {"kind": Kind.INTEGER, "type": "Integer", "minimum": 1.0}, "one.p = 4294967297 is out of "
            "range\n  allowed: at least 1.0 and at most 2147483647; its type is Integer"),
        (2**64 - 1, {"kind": Kind.INTEGER, "type": "UInt64"}, 2**64 - 1),
        (-(2**63) - 1, {"kind": Kind.INTEGER, "type": "Int64"}, "one.p = -9223372036854775809 is out of "
            "range\n  allowed: at least -9223372036854775808 and at most 9223372036854775807; "
            "its type is Int64"),
        (300, {"kind": Kind.INTEGER, "type": "Int8"}, "one.p = 300 is out of range\n"
            "  allowed: at least -128 and at most 127; its type is Int8"),
        (1e39, {"type": "Float32"}, "one.p = 1e+39 is out of range\n"
            "  allowed: at least -3.4028235e+38 and at most 3.4028235e+38; its type is Float32"),
        (3.4028235e38, {"type": "Float32"}, 3.4028235e38),
        (1e39, {}, 1e39),
        ("1e400 s", {"unit_name": "s"}, "one.p [s]: cannot take '1e400 s', about 1e400 is beyond "
            "double precision\n  its unit is s"),
        ("-1e400 s", {"unit_name": "s"}, "one.p [s]: cannot take '-1e400 s', about -1e400 is beyond double "
            "precision\n  its unit is s"),
        ("1e99999 s", {"unit_name": "s"}, "one.p [s]: cannot take '1e99999 s', 1e99999 is beyond double "
            "precision\n  its unit is s"),
        ("1 s999999999", {"unit_name": "s"}, "one.p [s]: cannot take '1 s999999999', the power of s in unit "
            "'s999999999' is above 30\n  its unit is s"),
        (10**400, {}, "one.p (no unit): about 1e400 is beyond double precision"),
        (math.nan, {}, "one.p (no unit) must be a finite number, got nan"),
        (-math.inf, {"unit_name": "1", "minimum": -math.inf},
            "one.p [1] must be a finite number, got -inf"),
        (".nan", {}, "one.p (no unit) must be a finite number, got .nan"),
        ("-.inf", {"unit_name": "s"}, "one.p [s] must be a finite number, got -.inf"),
        (True, {"kind": Kind.INTEGER, "type": "Int32"}, "one.p must be a whole number, got True"),
        (False, {"kind": Kind.BOOLEAN, "type": "Boolean"}, False),
        ("off", {"kind": Kind.BOOLEAN, "type": "Boolean"}, "one.p must be true or false, got 'off'"),
        ("off", {"kind": Kind.STRING, "type": "String"}, "off"),
        (3, {"kind": Kind.STRING, "type": "String"}, "one.p must be text, got 3\n  Put it in quotes: '3'."),
        ("active", {"kind": Kind.ENUMERATION, "type": "Enumeration", "items": {"off": 1, "active": 2}}, 2),
        (1, {"kind": Kind.ENUMERATION, "type": "Enumeration", "items": {"off": 1, "active": 2}}, 1),
        ("actve", {"kind": Kind.ENUMERATION, "type": "Enumeration", "items": {"off": 1, "active": 2}},
            "one.p has no item 'actve'\n  allowed: off, active. Did you mean active?"),
        (1, {"variability": Variability.CONSTANT}, "one.p cannot be set: it is causality parameter, "
            "variability constant, initial exact"),
        (1, {"causality": Causality.OUTPUT, "initial": Initial.CALCULATED}, "one.p cannot be set: it is "
            "causality output, variability continuous, initial calculated"),
        (1.5, {"causality": Causality.OUTPUT, "initial": Initial.EXACT}, 1.5),
        (1, {"shape": (2,)}, "one.p cannot be set: it is an array of shape (2,)"),
        ("00ff", {"causality": Causality.INPUT, "kind": Kind.BINARY, "type": "Binary"}, b"\x00\xff"),
        ("x", {"causality": Causality.INPUT, "kind": Kind.BINARY, "type": "Binary"},
         "one.p is binary, got 'x'\n  hexadecimal digits in quotes are needed, as '00ff'"),
    ],
)  # fmt: skip
def test_start_values(value, attributes, expected):
    found = lone("p", value, **attributes)
    assert found == expected and type(found) is type(expected)


def test_unknown_unit_name_takes_only_itself():
    made = replace(variable("p", Causality.PARAMETER), unit_name="furlong")
    fmu = FakeFmu(extra=[made])
    assert assemble([Part("one", fmu, {"p": "5 furlong"})]).instances[0].start == {"p": 5.0}
    assert refusal([Part("one", fmu, {"p": "5 m"})]) == (
        "docking.yaml: instances.one.start.p: one.p [furlong]: cannot take '5 m'\n"
        "  its unit, furlong, is not known here: give the number in that unit. Write it as <number> furlong."
    )


def test_unknown_variable_in_start():
    fmu = FakeFmu(parameters={"tau_m": "s", "xi_n": "1"})
    assert refusal([Part("robot", fmu, {"tau_n": "2 ms"})]) == (
        "docking.yaml: instances.robot.start.tau_n: robot has no variable 'tau_n'\n"
        "  variables that can be set: tau_m, xi_n. Did you mean robot.tau_m?"
    )


def test_inputs_without_values_are_one_problem_with_the_values_of_the_fmu():
    mode = variable("mode", Causality.INPUT, kind=Kind.ENUMERATION, type="Enumeration",
        items={"off": 1, "on": 2}, start=2)  # fmt: skip
    bare = variable("bare", Causality.INPUT, start=None)
    fmu = FakeFmu(inputs={"x[1,2]": "mm"}, extra=[mode, bare])
    message = refusal([Part("one", fmu)], keep=False)
    assert message == (
        "docking.yaml: instances.one: inputs one.x[1,2] [mm], one.mode (Enumeration), one.bare (no unit) are "
        "not connected and have no start values\n"
        "  Connect them, or give them constant values under instances.one.start, as the FMU's own: "
        "{'x[1,2]': 0 mm, mode: 'on'}"
    )
    pasted = yaml.safe_load(message.partition("own: ")[2])
    assert assemble([Part("one", fmu, {**pasted, "bare": 1})]).instances[0].start == {
        "x[1,2]": 0.0, "mode": 2, "bare": 1.0
    }  # fmt: skip


def test_whole_arrays_start_and_are_recorded():
    sizes = {"u[1]": "N", "u[2]": "N", "a[1,1]": "", "a[1,2]": "", "a[2,1]": "", "a[2,2]": ""}
    fmu = FakeFmu(inputs=sizes, outputs={"y[1]": "", "y[2]": "", "z": ""})
    start = {"u": ["1 kN", "2 N"], "a": [[1, 2], [3, 4]]}
    system = assemble([Part("s", fmu, start)], record=["s.y"])
    assert list(system.instances[0].start.values()) == [1000.0, 2.0, 1.0, 2.0, 3.0, 4.0]
    assert list(system.instances[0].start) == list(sizes)
    assert [str(port) for port in system.recorded] == ["s.y[1]", "s.y[2]"]

    def reported(record=(), **given):
        return refusal([Part("s", fmu, start | given)], record=record)

    row = "  Give a list of its values, row by row, or single elements by their names."
    at = "docking.yaml: instances.s.start"
    assert reported(u=[1, 2, 3]).splitlines() == [f"{at}.u: s.u is an array of 2 values, got [1, 2, 3]", row]
    assert reported(u="1 N").splitlines()[0] == f"{at}.u: s.u is an array of 2 values, got '1 N'"
    assert (
        reported(a=[1, 2, 3, 4]).splitlines()[0]
        == f"{at}.a: s.a is an array of 2 x 2 values, got [1, 2, 3, 4]"
    )
    assert reported(a=[[1, 2], [3]]).splitlines()[0].endswith("2 x 2 values, got [[1, 2], [3]]")
    assert reported(u=["1 N", "2 m"]).startswith(f"{at}.u[2]: s.u[2] [N]: cannot take '2 m'")
    assert reported(**{"u[2]": "1 N"}).splitlines()[0] == f"{at}.u: s.u[2] is given twice, by itself and in u"
    assert reported(["s.u"]).splitlines()[0] == "docking.yaml: run.record[0]: s.u[1] cannot be recorded"
    assert reported(["s.x"]).splitlines()[0] == "docking.yaml: run.record[0]: s has no variable 'x' to record"
