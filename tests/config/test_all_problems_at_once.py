"""All problems of a config are reported at once, whatever stage finds it, and nothing that only follows."""

from __future__ import annotations

import json
import pickle
import random
from copy import deepcopy

import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.config import load_config, parse, read_config
from orchestrator.simulation.comparison import run_each
from orchestrator.simulation.run import prepare

RIGHT = """
run: {master: gauss-seidel, step_size: 0.1 ms, stop_time: 4 s}
instances:
  satellite: {fmu: SatelliteDynamics, start: {mass: 279 kg, position: 0 m, velocity: 20 mm/s}}
  robot: {fmu: RobotResponse, start: {omega_n: 75 Hz, xi_n: 0.8, tau_m: 2 ms}}
  contact: {fmu: DockingContact, start: {stiffness: 176 N/mm, damping: 0 N.s/mm, front: 5 mm, rear: -5 mm}}
connections:
  - satellite.position -> robot.command
  - robot.position -> contact.position
  - robot.velocity -> contact.velocity
  - contact.force -> satellite.force
"""

WRONG = """\
title: Mistakes of every stage
run:
  master: gaus-seidel
  step_size: 0.1
  stop_time: 4 s
  record: [satellite.posision, moon.x]
  recordevery: 10
instances:
  satellite:
    fmu: SatelliteDynamics
    start: {mass: 279 kN, position: 0 m, velocty: 20 mm/s}
  robot:
    fmu: RobotRespons
    start: {omega_n: 75 Hz}
  sensor:
    fmuu: ForceSensor
  contact:
    fmu: DockingContact
    step_size: 2 fortnights
    start: {stiffness: [176], damping: 0 N.s/mm, front: 5 mm, rear: -5 mm}
  other:
    fmu: DockingContact
    start: {stiffness: 176 N/mm, damping: 0 N.s/mm, front: 5 mm, rear: -5 mm}
connections:
  - satellite.position -> robot.command
  - {from: robot.velocity, to: contact.velocty}
  - {from: contact.force, to: satellite.force, through: [{delya: 1 ms}], comment: 3}
  - satellite.position - other.position
  - satelite.velocity -> other.velocity
  - {form: other.force, to: satellite.position}
  - satellite.position -> contact.velocity
  - {from: other.force, to: sensor.force, through: [{low-pass: 5 m}]}
measures:
  docking: {satellite: satellite, robot: robot, contakt: contact}
  dockin: {}
"""


UNFED = ("  - satellite.position -> robot.command\n", "")
ROBOT = "{fmu: RobotResponse"
STEP = "step_size: 0.1 ms"


def reported(text: str, overrides=()) -> ConfigError:
    """What is reported about a config as text."""
    with pytest.raises(ConfigError) as caught:
        prepare(parse(text, "config")[0], overrides)
    return caught.value


def lines(error: ConfigError) -> list[str]:
    return [f"{one.place.removeprefix('config: ')}: {one.what}" for one in error.problems]


def changed(*pairs: tuple[str, str]) -> str:
    text = RIGHT
    for old, new in pairs:
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


def test_the_config_that_others_are_made_of_is_right():
    assert prepare(parse(RIGHT, "config")[0]).grid.steps == 40000


@pytest.fixture
def wrong(tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text(WRONG)
    return path


def test_mistakes_of_every_stage_are_reported_once_in_the_order_of_the_file(wrong):
    with pytest.raises(ConfigError) as caught:
        prepare(wrong, ["robt.tau_m=6 ms", "contact.dampin=1 N.s/m"])
    assert [f"{one.place}: {one.what}" for one in caught.value.problems] == [
        "--set robt.tau_m=6 ms: no 'robt.tau_m' to set",
        "--set contact.dampin=1 N.s/m: instances.contact.start.dampin: contact has no variable 'dampin'",
        "wrong.yaml:3: run.master: no master 'gaus-seidel'",
        "wrong.yaml:4: run.step_size: 0.1 has no unit; write it as in '0.1 s' or '0.1 ms'",
        "wrong.yaml:6: run.record[0]: satellite has no variable 'posision' to record",
        "wrong.yaml:6: run.record[1]: no instance 'moon' to record moon.x of",
        "wrong.yaml:7: run.recordevery: unknown key 'recordevery'",
        "wrong.yaml:11: instances.satellite.start.mass: satellite.mass [kg]: cannot take '279 kN', "
        "kN [kg.m.s-2] cannot be converted to kg [kg]",
        "wrong.yaml:11: instances.satellite.start.velocty: satellite has no variable 'velocty'",
        "wrong.yaml:13: instances.robot.fmu: no FMU 'RobotRespons'",
        "wrong.yaml:16: instances.sensor.fmuu: unknown key 'fmuu'",
        "wrong.yaml:19: instances.contact.step_size: unknown unit 'fortnights'",
        "wrong.yaml:20: instances.contact.start.stiffness: contact.stiffness [N/m] must be a number, "
        "got [176]",
        "wrong.yaml:26: connections[1]: contact has no variable 'velocty'",
        "wrong.yaml:27: connections[2].comment: unknown key 'comment'",
        "wrong.yaml:27: connections[2].through[0].delya: no effect 'delya'",
        "wrong.yaml:28: connections[3]: cannot read connection 'satellite.position - other.position'",
        "wrong.yaml:29: connections[4]: no instance 'satelite' in satelite.velocity -> other.velocity",
        "wrong.yaml:30: connections[5].form: unknown key 'form'",
        "wrong.yaml:30: connections[5]: satellite.position cannot be the target of a connection: "
        "its causality is output",
        "wrong.yaml:31: connections[6]: cannot connect satellite.position [m] to contact.velocity [m/s]",
        "wrong.yaml:32: connections[7].through[0].low-pass: low-pass: cutoff: cannot take '5 m', "
        "m [m] cannot be converted to Hz [s-1]",
        "wrong.yaml:34: measures.docking.contakt: unknown key 'contakt'",
        "wrong.yaml:35: measures.dockin: no measure 'dockin'",
    ]
    assert str(caught.value).splitlines()[-1] == (
        "Not checked because of these problems: whether the run is a whole number of steps; signals of "
        "measures.docking; ports and start values of robot, sensor; whether all inputs are connected; "
        "what the master asks of the system; step sizes of FMUs."
    )
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.problems, again.unchecked) == (caught.value.problems, caught.value.unchecked)


def test_notes_are_printed_beside_problems(tmp_path, capsys):
    path = tmp_path / "wrong.yaml"
    path.write_text("extends: docking-1d\nconnections: []\nmeasures: {}\nrun: {stop_tme: 1 s}\n")
    assert main(["check", str(path)]) == 2
    out, err = capsys.readouterr()
    assert "stop_tme" in err and out.startswith("note: ") and "have no connection" in out
    assert main(["check", str(path), "--json"]) == 2
    (line,) = capsys.readouterr().out.splitlines()
    notes = json.loads(line)["error"]["notes"]
    assert [f"note: {one}" for one in notes] == out.splitlines()


def test_they_are_all_in_what_is_reported_to_machines(wrong, capsys):
    assert main(["check", "--json", str(wrong)]) == 2
    out, err = capsys.readouterr()
    error = json.loads(out)["error"]
    assert len(error["problems"]) == 22
    assert error["unchecked"][0] == "whether the run is a whole number of steps"
    assert f"orchestrator: {error['message']}\n" == err
    with pytest.raises(ConfigError) as caught:
        list(run_each([wrong, "docking-1e"]))
    assert len(caught.value.problems) == 23
    assert caught.value.unchecked[0] == f"{wrong}: whether the run is a whole number of steps"


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        # An instance of which nothing is known: what is connected to it is not blamed.
        ([("fmu: RobotResponse", "fmu: 3")], ["instances.robot.fmu: input should be a valid string, got 3"]),
        ([("fmu: RobotResponse, ", "")], ["instances.robot: fmu is missing"]),
        ([(ROBOT, "{fmuu: RobotResponse")], ["instances.robot.fmuu: unknown key 'fmuu'"]),
        # Keys that others were meant for.
        ([("connections:", "conections:")], ["conections: unknown key 'conections'"]),
        ([("instances:", "parts:")], ["instances is missing", "parts: unknown key 'parts'"]),
        ([("step_size:", "stepsize:")], ["run.stepsize: unknown key 'stepsize'"]),
        (
            [("robot.command", "robot.comand")],
            ["connections[0]: robot has no variable 'comand'"],
        ),
        (
            [("-> robot.command", "-> robt.command")],
            ["connections[0]: no instance 'robt' in satellite.position -> "],
        ),
        (
            [("satellite.position -> robot.command", "{from: satellite.position, too: robot.command}")],
            ["connections[0].too: unknown key 'too'"],
        ),
        (
            [UNFED, ("tau_m: 2 ms}", "tau_m: 2 ms, comand: 1 m}")],
            ["instances.robot.start.comand: robot has no variable 'comand'"],
        ),
        (
            [UNFED, ("tau_m: 2 ms}", "tau_m: 2 ms, command: {a: 1}}")],
            ["instances.robot.start.command: {'a': 1} is no start value"],
        ),
        # One end of a connection, or its effects, can be judged without the other.
        (
            [("contact.force -> satellite.force", "{to: satellite.forces}")],
            ["connections[3]: from is missing", "connections[3]: satellite has no variable 'forces'"],
        ),
        (
            [("contact.force -> satellite.force", "{from: [contact.forces, {prt: x}], to: satellite.force}")],
            ["connections[3].prt: unknown key 'prt'", "connections[3]: contact has no variable 'forces'"],
        ),
        (
            [
                ("fmu: RobotResponse", "fmu: 3"),
                ("robot.velocity -> contact.velocity", "robot.velocity -> contact.x"),
            ],
            ["instances.robot.fmu: input should", "connections[2]: contact has no variable 'x'"],
        ),
        # What the name of a step size needs.
        (
            [(STEP, "step_size: 0.1"), (ROBOT, "{step_size: 3 ms, fmu: RobotResponse")],
            ["run.step_size: 0.1 has no unit"],
        ),
        (
            [(STEP, "step_size: 0.1"), ("4 s", "-4 s")],
            ["run.step_size: 0.1 has", "run: stop_time -4 s is not"],
        ),
        (
            [(STEP, "step_size: 0 s"), ("4 s", "-4 s")],
            ["run: step_size 0 s is not", "run: stop_time -4 s is not"],
        ),
        # Keys that go together, beside one that is unknown, and where one of them is not known.
        (
            [(ROBOT, "{time_limit: 1 s, foo: 1, fmu: RobotResponse")],
            ["instances.robot.foo: unknown key", "instances.robot: time_limit needs isolate: process"],
        ),
        (
            [(ROBOT, "{time_limit: 1 s, isolate: proces, fmu: RobotResponse")],
            ["instances.robot.isolate: input should be 'process', got 'proces'"],
        ),
    ],
)
def test_what_only_follows_is_not_reported(changes, what):
    found = lines(reported(changed(*changes)))
    assert len(found) == len(what), found
    for one, begin in zip(found, what, strict=True):
        assert begin in one


def test_what_stands_deep_within_an_external_one_is_reported_once():
    rig = "external: {rig: {listen: '127.0.0.1:1', peer: '127.0.0.1:2', receive: {f: {unit: N, strt: 0 N}}, "
    error = reported(f"{RIGHT}{rig}exchange: lockstep}}}}\n")
    assert lines(error) == ["external.rig.receive.f.strt: unknown key 'strt'"]
    assert error.unchecked == ("ports and start values of rig",)


BONDS = """
bonds:
  - {effort: contact.force -> satellite.force, flow: satellite.velocity}
"""


def test_bonds_are_not_blamed_for_connections_with_problems():
    assert lines(reported(changed(("contact.force ->", "contact.forse ->")) + BONDS)) == [
        "connections[3]: contact has no variable 'forse'"
    ]
    assert lines(reported(changed(("connections:", "conections:")) + BONDS)) == [
        "conections: unknown key 'conections'"
    ]
    assert lines(
        reported(changed(("279 kg", "279 N")) + BONDS.replace("satellite.force", "contact.velocity"))
    )[1:] == ["bonds[0]: no connection 'contact.force -> contact.velocity'"]
    assert lines(reported(RIGHT + BONDS.replace("contact.force -> satellite.force", "[]"))) == [
        "bonds[0].effort: list should have at least 1 item after validation, not 0, got []"
    ]


def test_inputs_that_nothing_feeds_are_reported_beside_what_else_is_wrong():
    error = reported(changed(UNFED, ("master:", "mister: 3, unconnected: error, master:")))
    assert lines(error) == [
        "run.mister: unknown key 'mister'",
        "instances.robot: input robot.command [m] is not connected and has no start value",
    ]
    assert error.unchecked == ()


def test_a_measure_is_judged_beside_one_that_is_wrong():
    measures = "measures: {docking: {satellite: moon, robot: robot, contact: contact}, dockin: {}}\n"
    assert lines(reported(RIGHT + measures)) == [
        "measures.dockin: no measure 'dockin'",
        "measures.docking: no instance 'moon' to record moon.velocity of",
        "measures.docking: no instance 'moon' to record moon.position of",
    ]


LOOP = """
run: {master: jacobi, step_size: 1 ms, stop_time: 1 s}
instances:
  a: {fmu: DockingContact, start: {position: 0 m, damping: 1 N.s/m}}
  b: {fmu: DockingContact, start: {position: 0 m, damping: 1 N.s/m}}
connections:
  - {from: a.force, to: b.velocity, through: [{gain: 1 m/(N.s)}]}
  - {from: b.force, to: a.velocity, through: [{gain: 1 m/(N.s)}, {delay: 5 ms}]}
"""


def test_loops_are_reported_beside_other_problems_but_not_where_they_may_be_broken():
    loop = "connections: algebraic loop"
    short = LOOP.replace(", {delay: 5 ms}", "")
    assert lines(reported(short))[0] == loop
    assert loop in lines(reported(short.replace("run: {", "run: {foo: 1, ")))
    prepare(parse(LOOP, "config")[0])
    error = reported(LOOP.replace("step_size: 1 ms", "step_size: 1"))
    assert lines(error) == ["run.step_size: 1 has no unit; write it as in '1 s' or '1 ms'"]
    assert "algebraic loops by way of effects or instances that are not known" in error.unchecked
    for broken in ("{forc: []}", "{force: 3}", "3"):
        error = reported(short.replace("a: {", f"a: {{feedthrough: {broken}, "))
        assert len(error.problems) == 1 and loop not in lines(error), broken


def test_keys_given_twice_hide_nothing_else(tmp_path):
    path = tmp_path / "twice.yaml"
    path.write_text(
        changed(
            ("start: {omega_n: 75 Hz", "start: {omega_n: 75 Hz, omega_n: 7 Hz"), ("tau_m: 2 ms", "tau: 2 ms")
        )
        + "connections:\n  - contact.force -> robot.command\n"
    )
    with pytest.raises(ConfigError) as caught:
        prepare(path)
    assert [(one.place, one.what) for one in caught.value.problems] == [
        ("twice.yaml:5: instances.robot.start.omega_n", "given twice"),
        ("twice.yaml:5: instances.robot.start.tau", "robot has no variable 'tau'"),
        ("twice.yaml:12: connections", "given twice"),
    ]


def test_a_config_whose_base_is_missing_is_read_by_itself(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("extends: base.yaml\nrun: {step_size: 1}\ninstances: {robot: {start: {tau_m: {a: 1}}}}\n")
    with pytest.raises(ConfigError) as caught:
        prepare(path)
    assert [one.place for one in caught.value.problems] == [
        "mine.yaml:1: extends",
        "mine.yaml:2: run.step_size",
        "mine.yaml:3: instances.robot.start.tau_m",
    ]
    assert caught.value.unchecked == ("instances, connections and measures, for want of 'base.yaml'",)


MISSPELT = """\
run: {master: gauss-seidel, step_size: 0.1 ms, stop_time: 4 s}
instnaces:
  satellite: {fmu: SatelliteDynamics, start: {mass: 279 kN, mass: 3 kg, velosity: 1 m/s}}
  robot: {fmu: RobotRespons}
conections:
  - satellite.posision -> robot.command
  - {from: robot.position, to: satellite.force, comment: 3}
"""


def test_what_is_in_misspelt_sections_is_reported_with_their_names(tmp_path):
    (tmp_path / "wrong.yaml").write_text(MISSPELT)
    (tmp_path / "over.yaml").write_text("extends: wrong.yaml\nrum: {step_size: 1}\n")
    known = "allowed: title, run, instances, external, connections, bonds, measures. Did you mean"
    found = {}
    for name in ("wrong.yaml", "over.yaml"):
        with pytest.raises(ConfigError) as caught:
            prepare(tmp_path / name, ["robot.tau_m=1 s"])
        found[name] = [f"{one.place}: {one.what}" for one in caught.value.problems]
        assert f"unknown key 'instnaces'\n  {known} instances?\n" in str(caught.value)
    assert found["wrong.yaml"] == [
        "wrong.yaml:2: instnaces: unknown key 'instnaces'",
        "wrong.yaml:3: instnaces.satellite.start.mass: given twice",
        "wrong.yaml:3: instances.satellite.start.velosity: satellite has no variable 'velosity'",
        "wrong.yaml:4: instances.robot.fmu: no FMU 'RobotRespons'",
        "wrong.yaml:5: conections: unknown key 'conections'",
        "wrong.yaml:6: connections[0]: satellite has no variable 'posision'",
        "wrong.yaml:7: connections[1].comment: unknown key 'comment'",
    ]
    assert found["over.yaml"] == [
        *found["wrong.yaml"],
        "over.yaml:2: run.step_size: 1 has no unit; write it as in '1 s' or '1 ms'",
        "over.yaml:2: rum: unknown key 'rum'",
    ]


def test_sections_that_may_be_meant_otherwise_are_not_read():
    """Of two that may be meant neither; not one beside what it may be meant for, and not of another kind."""
    for text, found in (
        (RIGHT.replace("run:", "runs: {stp: 1}\nrun:"), ["runs: unknown key 'runs'"]),
        (RIGHT + "measurs: [1]\n", ["measurs: unknown key 'measurs'"]),
    ):
        assert lines(reported(text)) == found


def test_an_override_that_cannot_be_made_hides_nothing_else():
    error = reported(changed(("4 s", "4 m")), ["run.stepsize=1 ms", "robot.tau_m={", "robot.xi=1"])
    assert lines(error) == [
        "--set run.stepsize=1 ms: no 'run.stepsize' to set",
        "--set robot.tau_m={:2: not YAML: did not find expected node content",
        "run.stop_time: m [m] cannot be converted to s [s]",
        "--set robot.xi=1: instances.robot.start.xi: robot has no variable 'xi'",
    ]


def test_of_a_config_with_problems_what_is_known_can_be_read():
    draft = read_config(parse(changed((STEP, "step_size: 0.1")), "config")[0])
    assert draft.config is not None and len(draft.problems) == 1
    assert draft.config.model.run.stop_time == "4 s" and not hasattr(draft.config.model.run, "step_size")
    assert not draft.gaps.knows("run", "step_size") and draft.gaps.knows("run", "stop_time")
    assert draft.config.model.instances == load_config(parse(RIGHT, "config")[0]).model.instances


def paths(data, above=()):
    """Where values stand in a config."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield (*above, key)
        if isinstance(value, dict | list):
            yield from paths(value, (*above, key))


JUNK = (None, 3, "x", [], {}, [1], {"a": 1}, True, "1 foo", "a.b -> c.d", -1)
SETS = (
    "robot.tau_m=1 ms",
    "run.stpe=3",
    "connections[0].through=[{delay: 1 ms}]",
    "run.master.tolerance=3",
    "x",
)


@pytest.mark.parametrize("seed", range(80))
def test_whatever_stands_where_is_reported_once_beside_all_of_the_form(seed):
    draw = random.Random(seed)
    measures = "measures: {docking: {satellite: satellite, robot: robot, contact: contact}}\n"
    data = parse(RIGHT + BONDS + measures, "config")[0]
    for _ in range(3):
        *above, last = draw.choice(list(paths(data)))
        inner = data
        for part in above:
            inner = inner[part]
        if isinstance(inner, dict) and draw.random() < 0.3:
            inner[f"{last}s"] = inner.pop(last)
        else:
            inner[last] = deepcopy(draw.choice(JUNK))
    overrides = [draw.choice(SETS)]
    try:
        prepare(deepcopy(data), overrides)
    except ConfigError as error:
        reported = list(map(str, error.problems))
        assert reported and len(set(reported)) == len(reported)
        try:
            load_config(data, overrides)
        except ConfigError as form:
            assert set(map(str, form.problems)) <= set(reported)
