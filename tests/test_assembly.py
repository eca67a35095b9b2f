"""What a system is refused for, with the whole message each; and in what order it runs."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import replace
from fractions import Fraction

import pytest
import yaml
from doubles import FakeFmu, gain, mass, spring, variable

from orchestrator.assembly import Part, assemble, load_system
from orchestrator.config import Places, load_config
from orchestrator.errors import ConfigError
from orchestrator.fmi import Capabilities, Causality, Initial, Kind, Variability
from orchestrator.master import create_master
from orchestrator.system import Port
from orchestrator.units import Unit, parse_unit


def refusal(parts, connections=(), **options) -> str:
    with pytest.raises(ConfigError) as caught:
        assemble(parts, connections, places=Places("docking.yaml"), **options)
    return str(caught.value)


SATELLITE = FakeFmu(name="Satellite", inputs={"force": "N", "torque": "N.m"}, outputs={"position": "m"})
ROBOT = FakeFmu(name="Robot", inputs={"command": "m"}, outputs={"position": "m", "force": "N"})
IDLE = {"force": "0 N", "torque": "0 N.m"}


# Connections.


def test_unlike_units():
    message = refusal(
        [Part("robot", ROBOT, {"command": "0 m"}), Part("satellite", SATELLITE, {"force": "0 N"})],
        ["robot.force -> satellite.torque"],
    )
    assert message == (
        "docking.yaml: connections[0]: cannot connect robot.force [N] to satellite.torque [N.m]\n"
        "  units differ; satellite's inputs: force [N], torque [N.m]. Did you mean satellite.force?"
    )


def test_unlike_units_without_a_fitting_input():
    message = refusal(
        [Part("satellite", SATELLITE, IDLE), Part("robot", gain(unit_in="N", unit_out="N"))],
        ["satellite.position -> robot.u"],
    )
    assert message == (
        "docking.yaml: connections[0]: cannot connect satellite.position [m] to robot.u [N]\n"
        "  units differ; robot's inputs: u [N]"
    )


def test_units_of_one_dimension_are_converted_exactly_as_stated():
    system = assemble(
        [
            Part("a", gain(unit_in="mm", unit_out="mm"), {"u": "1 mm"}),
            Part("b", gain(unit_in="m", unit_out="m")),
        ],
        ["a.y -> b.u"],
        places=Places("x"),
    )
    assert (system.connections[0].gain, system.connections[0].offset) == (0.001, 0.0)
    assert system.notes == ("x: connections[0]: a.y [mm] -> b.u [m]: converted, 0.001 * value",)


def test_a_port_without_unit_is_noted():
    system = assemble(
        [Part("a", gain(unit_out="N"), {"u": 1.0}), Part("b", gain())], ["a.y -> b.u"], places=Places("x")
    )
    assert system.notes == ("x: connections[0]: a.y [N] -> b.u (no unit): units not checked",)


def test_unknown_instance_and_port():
    message = refusal(
        [Part("robot", ROBOT), Part("satellite", SATELLITE, IDLE)],
        [
            "satelite.position -> robot.command",
            "satellite.posision -> robot.comand",
            "satellite -> robot.command",
        ],
    )
    assert message.splitlines() == [
        "docking.yaml: connections[0]: no instance 'satelite' in satelite.position -> robot.command",
        "  instances: robot, satellite. Did you mean satellite?",
        "docking.yaml: connections[1]: satellite has no variable 'posision'",
        "  satellite's outputs: position [m]. Did you mean satellite.position?",
        "docking.yaml: connections[1]: robot has no variable 'comand'",
        "  robot's inputs: command [m]. Did you mean robot.command?",
        "docking.yaml: connections[2]: 'satellite' names no variable",
        "  written as satellite.variable",
    ]


def test_wrong_causality_at_either_end():
    message = refusal(
        [Part("robot", ROBOT, {"command": "0 m"}), Part("satellite", SATELLITE, IDLE)],
        ["robot.command -> satellite.position"],
    )
    assert message.splitlines() == [
        "docking.yaml: connections[0]: robot.command cannot be the source of a connection: "
        "its causality is input",
        "  robot's outputs: position [m], force [N]",
        "docking.yaml: connections[0]: satellite.position cannot be the target of a connection: "
        "its causality is output",
        "  satellite's inputs: force [N], torque [N.m]",
    ]


def test_two_sources_for_one_input():
    parts = [Part("a", gain(), {"u": 1}), Part("b", gain(), {"u": 2}), Part("c", gain())]
    assert refusal(parts, ["a.y -> c.u", "b.y -> c.u"]) == (
        "docking.yaml: connections[1]: c.u has two sources, a.y and b.y\n"
        "  connections[0] already feeds it; an input takes one connection. Remove one of the two, or add "
        "them up: from: [..., ...]."
    )


def test_a_start_value_for_a_connected_input():
    parts = [Part("a", gain(), {"u": 1}), Part("b", gain(), {"u": 2})]
    assert refusal(parts, ["a.y -> b.u"]) == (
        "docking.yaml: instances.b.start.u: b.u has two sources, a.y and a start value\n"
        "  connections[0] feeds it. Remove one of the two."
    )


def test_an_unconnected_mandatory_input():
    assert refusal([Part("satellite", SATELLITE, {"force": "0 N"})]) == (
        "docking.yaml: instances.satellite: "
        "input satellite.torque [N.m] is not connected and has no start value\n"
        "  Connect it, or give it a constant value under instances.satellite.start, as the FMU's own: "
        "{torque: 0 N.m}"
    )


def test_unlike_types():
    integer = variable(
        "count", Causality.INPUT, type="Int32", kind=Kind.INTEGER, variability=Variability.DISCRETE
    )
    counter = FakeFmu(name="Counter", extra=[integer])
    assert refusal([Part("a", gain(), {"u": 1}), Part("b", counter)], ["a.y -> b.count"]) == (
        "docking.yaml: connections[0]: cannot connect a.y (no unit) to b.count (Integer)\n"
        "  types differ; b's inputs: count (Integer)"
    )


def test_unlike_enumerations_and_arrays():
    def level(name, causality, **items):
        return variable(
            name,
            causality,
            type="Enumeration",
            kind=Kind.ENUMERATION,
            variability=Variability.DISCRETE,
            items=items,
        )

    a = FakeFmu(extra=[level("y", Causality.OUTPUT, low=1, high=2)])
    b = FakeFmu(extra=[level("u", Causality.INPUT, low=1)])
    c = FakeFmu(extra=[variable("u", Causality.INPUT, shape=(3,))])
    message = refusal([Part("a", a), Part("b", b), Part("c", c)], ["a.y -> b.u", "a.y -> c.u"])
    assert message.splitlines() == [
        "docking.yaml: connections[0]: cannot connect a.y (Enumeration) to b.u (Enumeration)",
        "  items differ: low, high against low",
        "docking.yaml: connections[1]: c.u is an array of shape (3,)",
        "  only scalars can be connected",
    ]


# Start values.

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
        (10**400, {}, f"one.p (no unit): {10**400} is beyond double precision"),
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
        ("00ff", {"causality": Causality.INPUT, "kind": Kind.BINARY, "type": "Binary"},
         "one.p cannot be set: values of type Binary are not supported\n  Leave it out."),
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


def test_all_problems_of_a_system_are_told_together():
    message = refusal(
        [Part("robot", ROBOT, {"comand": "0 m"}), Part("satellite", SATELLITE, {"force": 1})],
        ["robot.force -> satellite.torque", "robot.x -> satellite.y"],
        record=["robot.position", "robot.posit", "satellite.force", "moon.x"],
    )
    assert [line for line in message.splitlines() if not line.startswith(" ")] == [
        "docking.yaml: connections[0]: cannot connect robot.force [N] to satellite.torque [N.m]",
        "docking.yaml: connections[1]: robot has no variable 'x'",
        "docking.yaml: connections[1]: satellite has no variable 'y'",
        "docking.yaml: instances.robot.start.comand: robot has no variable 'comand'",
        "docking.yaml: instances.satellite.start.force: satellite.force [N]: 1 has no unit",
        "docking.yaml: run.record[1]: robot has no variable 'posit' to record",
        "docking.yaml: run.record[2]: satellite.force cannot be recorded",
        "docking.yaml: run.record[3]: no instance 'moon' to record moon.x of",
    ]


def test_an_fmu_that_stands_in_a_process_once_only():
    fmu = gain(capabilities=Capabilities(once_per_process=True))
    assert refusal([Part("a", fmu, {"u": 1}), Part("b", fmu, {"u": 1})]) == (
        "docking.yaml: instances.b: second instance of Gain\n"
        "  the FMU declares canBeInstantiatedOnlyOncePerProcess. "
        "Give it a process of its own: instances.b.isolate: process."
    )


def test_missing_fmu_with_suggestion(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "run: {master: jacobi, step_size: 1 ms, stop_time: 1 s}\n"
        "instances:\n  satellite: {fmu: SateliteDynamics}\n  robot: {fmu: parts/Robot.fmu}\n"
        "connections: [satellite.position -> robot.command]\n"
    )
    with pytest.raises(ConfigError) as caught:
        load_system(load_config(path))
    first, second = caught.value.problems
    assert first.what == "no FMU 'SateliteDynamics'" and first.place == "mine.yaml:3: instances.satellite.fmu"
    assert first.remedy == "Did you mean SatelliteDynamics or SatellitePair?"
    assert second.what == f"no file {tmp_path / 'parts/Robot.fmu'}"
    assert second.place == "mine.yaml:4: instances.robot.fmu"


# Feedthrough and order.


def test_an_algebraic_loop_is_told_hop_by_hop():
    parts = [Part("a", gain(feedthrough=None)), Part("b", gain())]
    assert refusal(parts, ["a.y -> b.u", "b.y -> a.u"]).splitlines() == [
        "docking.yaml: connections: algebraic loop",
        "  b.u is direct-feedthrough to b.y",
        "  b.y is connected to a.u",
        "  a.u is direct-feedthrough to a.y (assumed: the FMU does not say what it depends on)",
        "  a.y is connected to b.u",
        "  The master iterative solves it; or take a connection out of the loop, or put an instance without "
        "direct feedthrough into it.",
        "  If a.y does not depend on the inputs of the same instant, say so: "
        "instances.a.feedthrough: {y: []}",
    ]


def test_a_loop_that_is_only_assumed_is_a_note():
    parts = [Part("a", gain(feedthrough=None)), Part("b", gain(feedthrough=None))]
    loop = ["a.y -> b.u", "b.y -> a.u"]
    system = assemble(parts, loop, places=Places("docking.yaml"))
    assert system.notes == (
        "docking.yaml: connections: an algebraic loop that is only assumed: the FMUs do not say what a.y, "
        "b.y depend on. Its inputs hold their values over a step, one step of delay (under gauss-seidel only "
        "those from instances that step later); at the start, begun with start values, they are passed on "
        "until they agree. If the outputs do not depend on inputs of the same instant, say so: "
        "instances.a.feedthrough: {y: []}; instances.b.feedthrough: {y: []}. "
        "If they do, take the master iterative.",
    )
    assert system.loops == () and create_master("jacobi").check(system) == []
    # A master that solves loops solves this one.
    solved = assemble(parts, loop, loops=True)
    assert len(solved.loops) == 1 and not solved.notes and not solved.held
    # What the config says is declared: of no dependency, and of all.
    free = [parts[0], replace(parts[1], feedthrough={"y": []})]
    assert assemble(free, loop).notes == ()
    for stated in ([replace(one, feedthrough={"y": ["u"]}) for one in parts], [parts[0], Part("b", gain())]):
        assert "connections: algebraic loop\n" in refusal(stated, loop)


def test_inputs_without_values_are_one_problem_with_the_values_of_the_fmu():
    mode = variable("mode", Causality.INPUT, kind=Kind.ENUMERATION, type="Enumeration",
        items={"off": 1, "on": 2}, start=2)  # fmt: skip
    bare = variable("bare", Causality.INPUT, start=None)
    fmu = FakeFmu(inputs={"x[1,2]": "mm"}, extra=[mode, bare])
    message = refusal([Part("one", fmu)])
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

    def told(record=(), **given):
        return refusal([Part("s", fmu, start | given)], record=record)

    row = "  Give a list of its values, row by row, or single elements by their names."
    at = "docking.yaml: instances.s.start"
    assert told(u=[1, 2, 3]).splitlines() == [f"{at}.u: s.u is an array of 2 values, got [1, 2, 3]", row]
    assert told(u="1 N").splitlines()[0] == f"{at}.u: s.u is an array of 2 values, got '1 N'"
    assert (
        told(a=[1, 2, 3, 4]).splitlines()[0] == f"{at}.a: s.a is an array of 2 x 2 values, got [1, 2, 3, 4]"
    )
    assert told(a=[[1, 2], [3]]).splitlines()[0].endswith("2 x 2 values, got [[1, 2], [3]]")
    assert told(u=["1 N", "2 m"]).startswith(f"{at}.u[2]: s.u[2] [N]: cannot take '2 m'")
    assert told(**{"u[2]": "1 N"}).splitlines()[0] == f"{at}.u: s.u[2] is given twice, by itself and in u"
    assert told(["s.u"]).splitlines()[0] == "docking.yaml: run.record[0]: s.u[1] cannot be recorded"
    assert told(["s.x"]).splitlines()[0] == "docking.yaml: run.record[0]: s has no variable 'x' to record"


def test_what_a_loop_asks_to_be_said_can_be_pasted():
    bus = FakeFmu(inputs={"u[1]": "", "u[2]": ""}, outputs={"y[1]": "", "y[2]": ""}, feedthrough=None)
    parts = [Part("a", bus), Part("b", bus)]
    (note,) = assemble(parts, ["a.y -> b.u", "b.y -> a.u"]).notes
    pasted = re.search(r"instances\.a\.feedthrough: (\{.*?\})", note)[1]
    assert yaml.safe_load(pasted) == {"y[1]": [], "y[2]": []}


def test_a_declared_loop_among_assumed_ones_is_the_one_that_is_told():
    hub = FakeFmu(name="Hub", inputs={"u": "", "v": ""}, outputs={"y": ""}, feedthrough=None)
    parts = [Part("hub", hub), Part("a", gain(feedthrough=None)), Part("b", gain())]
    text = refusal(parts, ["hub.y -> a.u", "a.y -> hub.u", "hub.y -> b.u", "b.y -> hub.v"])
    assert "b.u is direct-feedthrough to b.y\n" in text and "a.u" not in text


def test_an_algebraic_loop_tells_effects_and_delays_that_are_too_short():
    parts = [Part("a", gain()), Part("b", gain())]

    def told(step_size, delay="1 ms"):
        through = [{"gain": 2}, {"delay": delay}]
        connections = ["a.y -> b.u", {"from": "b.y", "to": "a.u", "through": through}]
        with pytest.raises(ConfigError) as caught:
            assemble(parts, connections, step_size=step_size)
        return str(caught.value).splitlines()[1:]

    plain = "  b.y is connected to a.u through gain, delay"
    remedy = "  A delay that is no shorter than the step breaks the loop."
    short = told(5e-3)
    assert f"{plain} (shorter than the step of 0.005 s, hence passed at once)" in short
    assert short[-2] == remedy
    for lines in (told(None), told(5e-3, "0 s")):
        assert plain in lines and remedy not in lines
    # A delay of a step breaks the loop at communication points.
    assemble(
        parts, ["a.y -> b.u", {"from": "b.y", "to": "a.u", "through": [{"delay": "1 ms"}]}], step_size=1e-3
    )


def test_a_stated_feedthrough_opens_the_loop():
    parts = [Part("a", gain(feedthrough=None), feedthrough={"y": []}), Part("b", gain())]
    assert assemble(parts, ["a.y -> b.u", "b.y -> a.u"]).order == (0, 1)
    wrong = [Part("a", gain(), {"u": 1}, feedthrough={"z": [], "y": ["v"]})]
    assert refusal(wrong).splitlines() == [
        "docking.yaml: instances.a.feedthrough.z: a has no output 'z'",
        "  outputs: y",
        "docking.yaml: instances.a.feedthrough.y: a has no input 'v'",
        "  inputs: u",
    ]


def test_an_instance_fed_by_itself_is_a_loop():
    assert "b.u is direct-feedthrough to b.y\n  b.y is connected to b.u" in refusal(
        [Part("b", gain())], ["b.y -> b.u"]
    )


def test_order_follows_feedthrough_and_the_config_breaks_ties():
    #   mass -> spring -> gain -> other mass;  declared backwards
    parts = [
        Part("last", gain(unit_in="N", unit_out="N")),
        Part("middle", spring()),
        Part("mass", mass()),
        Part("other", mass()),
    ]
    system = assemble(
        parts,
        ["mass.position -> middle.position", "middle.force -> last.u", "last.y -> other.force",
         "last.y -> mass.force"],
    )  # fmt: skip
    assert [system.instances[index].name for index in system.order] == ["mass", "middle", "last", "other"]
    assert [[str(c) for c in level] for level in system.initial_levels] == [
        ["mass.position -> middle.position"],
        ["middle.force -> last.u"],
        ["last.y -> other.force", "last.y -> mass.force"],
    ]


def test_recorded_signals():
    parts = [Part("mass", mass(), {"force": "0 N"})]
    assert assemble(parts).recorded == (Port("mass", "position"), Port("mass", "velocity"))
    assert assemble(parts, record=["mass.velocity", "mass.velocity"]).recorded == (Port("mass", "velocity"),)
    assert assemble(parts, record=[], needed={"mass.position": ("measures", "m")}).recorded == (
        Port("mass", "position"),
    )
    assert refusal(parts, needed={"mass.positon": ("measures", "m")}) == (
        "docking.yaml: measures.m: mass has no variable 'positon' to record\n"
        "  it has position, velocity. Did you mean mass.position?"
    )


def test_the_work_of_checking_grows_with_the_number_of_connections():
    ports = 10
    fmu = FakeFmu(
        inputs={f"u{j}": "N" for j in range(ports)},
        outputs={f"y{j}": "N" for j in range(ports)},
        feedthrough={f"y{j}": [f"u{j}"] for j in range(1, ports)},
    )

    def calls(count: int) -> int:
        connections = [
            f"i{k}.y{j} -> i{(k * 7 + j + 1) % count}.u{(j + 1) % ports}"
            for k in range(count)
            for j in range(ports)
        ]
        made = 0

        def seen(frame, event, argument):
            nonlocal made
            made += event == "call"

        sys.setprofile(seen)
        try:
            system = assemble([Part(f"i{k}", fmu) for k in range(count)], connections)
        finally:
            sys.setprofile(None)
        assert len(system.order) == count and len(system.initial_levels) == ports
        return made

    # Of eight times as many instances and connections; were the work quadratic, it would be 64 times as much.
    assert calls(800) < 12 * calls(100)
