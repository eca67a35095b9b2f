"""What a system is refused for, with the whole message each; and what of it is recorded."""

from __future__ import annotations

import sys

import pytest
from assembled import assemble, refusal
from doubles import FakeFmu, gain, mass, variable

from orchestrator.base.errors import ConfigError
from orchestrator.config import Places
from orchestrator.fmi import Capabilities, Causality, Kind, Variability
from orchestrator.simulation.run import prepare
from orchestrator.system.assembly import Part
from orchestrator.system.system import Port

SATELLITE = FakeFmu(name="Satellite", inputs={"force": "N", "torque": "N.m"}, outputs={"position": "m"})
ROBOT = FakeFmu(name="Robot", inputs={"command": "m"}, outputs={"position": "m", "force": "N"})
IDLE = {"force": "0 N", "torque": "0 N.m"}


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


def test_an_input_without_a_connection_keeps_the_start_value_that_its_fmu_declares():
    system = assemble([Part("satellite", SATELLITE, {"force": "0 N"})])
    (satellite,) = system.instances
    assert satellite.unconnected == {"torque"} and satellite.start["torque"] == 0.0
    assert system.notes == (
        "input satellite.torque has no connection and keeps the start value that the FMU declares; "
        "`orchestrator check -v` lists such inputs, `run.unconnected: error` refuses them",
    )


def test_inputs_without_a_connection_are_refused_where_that_is_asked_for():
    assert refusal([Part("satellite", SATELLITE, {"force": "0 N"})], keep=False) == (
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


def test_all_problems_of_a_system_are_reported_together():
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
        prepare(path)
    first, second = caught.value.problems
    assert first.what == "no FMU 'SateliteDynamics'" and first.place == "mine.yaml:3: instances.satellite.fmu"
    assert first.remedy == "Did you mean SatelliteDynamics or SatellitePair?"
    assert second.what == f"no file {tmp_path / 'parts/Robot.fmu'}"
    assert second.place == "mine.yaml:4: instances.robot.fmu"


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
