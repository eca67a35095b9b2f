"""Configs: file -> models -> file is the identity; every problem is reported with its place."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.base.errors import ConfigError
from orchestrator.config import Places, dump, json_schema, load_config, parse
from orchestrator.fmi import bundled

MINIMAL = """
run: {master: jacobi, step_size: 1 ms, stop_time: 1 s}
instances:
  one: {fmu: One, start: {a: 1.5 N, b: off, c: true, d: 3, e: 1e-3}}
  two: {fmu: Two}
connections:
  - one.y -> two.u
  - {from: two.y, to: one.u}
"""


def refusal(data, overrides=()) -> str:
    with pytest.raises(ConfigError) as caught:
        load_config(data, overrides)
    return str(caught.value)


def data(**changes):
    value, _ = parse(MINIMAL, "minimal.yaml")
    for path, item in changes.items():
        *above, last = path.split("__")
        target = value
        for part in above:
            target = target[part]
        target[last] = item
    return value


@pytest.mark.parametrize("name", bundled.system_names())
def test_bundled_systems_survive_the_round_trip(name):
    path = bundled.find_system(name)
    written, _ = parse(path.read_text(encoding="utf-8"), path.name)
    config = load_config(name)
    if "extends" in written:
        assert load_config(parse(config.text(), "again")[0]).model == config.model
        return
    assert config.model.to_data() == written
    assert parse(config.text(), "again")[0] == written


def test_a_config_survives_the_round_trip_types_included():
    config = load_config(data())
    again, _ = parse(config.text(), "again")
    assert again == data()
    assert [type(v) for v in again["instances"]["one"]["start"].values()] == [str, str, bool, int, float]


scalars = st.one_of(
    st.booleans(),
    st.integers(-(10**18), 10**18),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text("abeä :#'\"{}[]-?,&*!|>%@`~=\n\t01.", max_size=12),
    st.sampled_from(
        ["off", "no", "1e-3", "null", "~", "true", "0x10", "1:30", "2020-01-01", " x ", "", "- a", ".5"]
    ),
)


@settings(max_examples=200)
@given(st.dictionaries(st.text("abcxyz_", min_size=1), scalars, max_size=5))
def test_start_values_of_any_kind_survive_the_round_trip(start):
    config = load_config(data(instances__one__start=start))
    again = load_config(parse(config.text(), "again")[0])
    assert again.model == config.model
    assert {k: (type(v), v) for k, v in again.model.instances["one"].start.items()} == {
        k: (type(v), v) for k, v in start.items()
    }


def test_places_are_lines_of_the_file():
    _, places = parse(MINIMAL, "minimal.yaml")
    assert places.text(("connections", 1)) == "minimal.yaml:8: connections[1]"
    assert places.text(("instances", "one", "start", "b")) == "minimal.yaml:4: instances.one.start.b"
    assert Places("x").text(("run",)) == "x: run"


def test_all_problems_are_reported_at_once():
    wrong = data(
        run__step_size=0.1,
        run__stop_time="4",
        run__stpe=1,
        run__record_every=0,
        instances__one__start={"x": {"a": 1}},
        instances__two__fmus="Two",
        connections=["a.y - b.u", {"from": "a.y", "too": "b.u"}, 3],
        meazures={},
    )
    wrong["instances"]["3 bad"] = {"fmu": "X"}
    del wrong["run"]["master"]
    assert refusal(wrong).splitlines() == [
        "config: run: master is missing",
        "  it has no default",
        "config: run.step_size: 0.1 has no unit; write it as in '0.1 s' or '0.1 ms'",
        "config: run.stop_time: '4' has no unit; write it as in '4 s' or '4 ms'",
        "config: run.record_every: input should be greater than or equal to 1, got 0",
        "config: run.stpe: unknown key 'stpe'",
        "  allowed: master, step_size, stop_time, start_time, record, record_every, loop, "
        "unconnected, realtime. "
        "Did you mean stop_time or master?",
        "config: instances.one.start.x: {'a': 1} is no start value",
        "  a number, a quantity such as 6 ms, true, false or text, of an array a list of those",
        "config: instances.two.fmus: unknown key 'fmus'",
        "  allowed: fmu, form, start, step_size, feedthrough, interface, tolerance, event_mode, any_step, "
        "isolate, time_limit. Did you mean fmu?",
        "config: instances.3 bad: '3 bad' cannot name an instance",
        "  letters, digits, _ and -, beginning with a letter or _",
        "config: connections[0]: cannot read connection 'a.y - b.u'",
        "  written as a.output -> b.input or {from: a.output, to: b.input}",
        "config: connections[1].too: unknown key 'too'",
        "  allowed: from, to, through. Did you mean to?",
        "config: connections[2]: cannot read connection 3",
        "  written as a.output -> b.input or {from: a.output, to: b.input}",
        "config: meazures: unknown key 'meazures'",
        "  allowed: title, run, instances, external, connections, bonds, measures. Did you mean measures?",
    ]


def test_a_key_given_twice_is_refused_with_both_lines(tmp_path):
    path = tmp_path / "twice.yaml"
    path.write_text(MINIMAL + "run: {}\n")
    assert refusal(path) == "twice.yaml:9: run: given twice\n  first in line 2. Remove one of them."


def test_text_that_is_no_yaml(tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text("run: {master: jacobi\ninstances: [\n")
    assert refusal(path).startswith("bad.yaml:2: not YAML: ")


def test_missing_config_with_suggestion():
    first, second = refusal("docking-1").splitlines()
    assert first == "no config 'docking-1'"
    names = ", ".join(bundled.system_names())
    start = f"  neither a file nor a bundled system; bundled: {names}. Did you mean docking-1d"
    assert second.startswith(start) and second.endswith("?")


# Overrides.


def test_overrides_reach_start_values_run_and_measures():
    config = load_config(
        data(measures={"docking": {"robot": "one"}}),
        [
            "one.a=2 N",
            "two.new.part[1]=6 ms",
            "run.step_size=50 us",
            "run.record=[one.y]",
            "measures.docking.robot=two",
            "one.fmu=Other",
            "instances.two.start.q=off",
            "instances.one.feedthrough.y=[]",
            "title=a = b",
        ],
    )
    model = config.model
    assert model.instances["one"].start["a"] == "2 N"
    assert model.instances["two"].start == {"new.part[1]": "6 ms", "q": "off"}
    assert model.run.step_size == "50 us"
    assert model.run.record == ["one.y"]
    assert model.measures == {"docking": {"robot": "two"}}
    assert model.instances["one"].fmu == "Other"
    assert model.instances["one"].feedthrough == {"y": []}
    assert model.title == "a = b"
    assert config.places.text(("run", "step_size")) == "--set run.step_size=50 us: run.step_size"


def test_what_an_override_holds_has_its_place(tmp_path):
    (tmp_path / "one.yaml").write_text(
        "run: {master: jacobi, step_size: 1 ms, stop_time: 1 s}\n"
        "instances: {one: {fmu: RobotResponse}}\n"
        "connections:\n  - {from: one.position, to: one.command, through: [{delay: 5 ms}]}\n",
        encoding="utf-8",
    )
    place = ("connections", 0, "through", 0, "delay")
    assert load_config(tmp_path / "one.yaml").places.text(place).startswith("one.yaml:4: ")
    text = "connections[0].through=[{delay: 6 ms}]"
    assert load_config(tmp_path / "one.yaml", [text]).places.text(place).startswith(f"--set {text}: ")


def test_overrides_that_lead_nowhere_are_refused_together():
    message = refusal(data(), ["on.a=1 N", "run.stepsize=1 ms", "rubbish", "measures.docking.x=1"])
    assert message.splitlines() == [
        "--set on.a=1 N: no 'on.a' to set",
        "  instances: one, two; sections: run, external, connections[...].through, bonds, measures, title. "
        "Did you mean one.a or one.e or one.d?",
        "--set run.stepsize=1 ms: no 'run.stepsize' to set",
        "  instances: one, two; sections: run, external, connections[...].through, bonds, measures, title. "
        "Did you mean run.step_size or run.stop_time or run.master?",
        "--set rubbish: not an override",
        '  written as path=value, for example robot.tau_m="6 ms"',
        "--set measures.docking.x=1: no 'measures.docking.x' to set",
        "  instances: one, two; sections: run, external, connections[...].through, bonds, measures, title",
    ]


def test_an_override_without_an_instance_names_one():
    message = refusal(data(), ["stiffness=3 N"])
    assert message.endswith(" Write one.stiffness for a start value of the instance.")


def test_an_override_is_judged_like_the_file():
    assert refusal(data(), ["run.step_size=5 V"]) == (
        "--set run.step_size=5 V: run.step_size: V [kg.m2.s-3.A-1] cannot be converted to s [s]"
    )


# extends


def test_extends_merges_mappings_replaces_lists_and_removes_with_null(tmp_path):
    (tmp_path / "base.yaml").write_text(MINIMAL)
    (tmp_path / "change.yaml").write_text(
        "extends: base.yaml\n"
        "run: {step_size: 2 ms}\n"
        "instances: {two: null, one: {start: {a: 3 N}}}\n"
        "connections: []\n"
    )
    config = load_config(tmp_path / "change.yaml")
    assert config.model.run.step_size == "2 ms" and config.model.run.stop_time == "1 s"
    assert list(config.model.instances) == ["one"]
    assert config.model.instances["one"].start["a"] == "3 N"
    assert config.model.instances["one"].start["d"] == 3
    assert config.model.connections == []
    assert config.places.text(("run", "step_size")) == "change.yaml:2: run.step_size"
    assert config.places.text(("run", "stop_time")) == "base.yaml:2: run.stop_time"


def test_extends_a_bundled_system(tmp_path):
    (tmp_path / "mine.yaml").write_text("extends: docking-1d-uncompensated\nrun: {master: jacobi}\n")
    base, mine = load_config("docking-1d-uncompensated"), load_config(tmp_path / "mine.yaml")
    assert mine.model.run.master == "jacobi"
    assert mine.model.instances == base.model.instances


def test_extends_in_a_circle_or_nothing(tmp_path):
    (tmp_path / "a.yaml").write_text("extends: b.yaml\n")
    (tmp_path / "b.yaml").write_text("extends: a.yaml\n")
    assert refusal(tmp_path / "a.yaml").splitlines() == [
        "b.yaml:1: extends: 'a.yaml' extends itself",
        "Not checked because of these problems: instances, connections and measures, for want of 'a.yaml'.",
    ]
    (tmp_path / "c.yaml").write_text("extends: docking\n")
    first, second, _ = refusal(tmp_path / "c.yaml").splitlines()
    assert first == "c.yaml:1: extends: no config 'docking'"
    names = ", ".join(bundled.system_names())
    assert second.startswith(f"  no file {tmp_path / 'docking'}; bundled: {names}. Did you mean docking-")
    assert second.endswith("?")


# JSON Schema


def test_the_schema_is_json_and_describes_every_key():
    schema = json.loads(json.dumps(json_schema()))
    sections = {"title", "run", "instances", "external", "connections", "bonds", "measures"}
    assert set(schema["properties"]) == sections | {"extends"}
    assert schema["additionalProperties"] is False
    assert set(schema["$defs"]["RunModel"]["required"]) == {"master", "step_size", "stop_time"}


@pytest.mark.parametrize("name", bundled.system_names())
def test_bundled_systems_fit_the_schema(name):
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(load_config(name).model.to_data(), json_schema())
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**load_config(name).model.to_data(), "extra": 1}, json_schema())


def test_dumped_text_reads_the_same_for_other_yaml_readers():
    yaml = pytest.importorskip("yaml")
    value = {
        "a": "off",
        "b": "1e-3",
        "c": 1e-05,
        "d": "1:30",
        "e": True,
        "f": "2020-01-01",
        "g": -0.0,
        "h": 1e300,
    }
    assert yaml.safe_load(dump(value)) == value == parse(dump(value), "x")[0]
