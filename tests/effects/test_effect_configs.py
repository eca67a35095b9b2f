"""Connections with effects in configs: what is written, what is refused, what becomes of it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from assembled import assemble
from doubles import FakeFmu, gain, variable

from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.config import dump, json_schema, load_config
from orchestrator.effects.choose import BUILT_IN
from orchestrator.fmi import Causality, Kind
from orchestrator.simulation.run import prepare, run
from orchestrator.system.assembly import Part

# The docking FMUs bring a pythonfmu of their own, without what building takes: find the installed one first.
pytest.importorskip("pythonfmu")

DOCKING = """
extends: docking-1d-uncompensated
run: {stop_time: 20 ms}
connections:
  - {from: satellite.position, to: robot.command, through: [{sample-and-hold: 4 ms}]}
  - robot.position -> contact.position
  - {from: robot.velocity, to: contact.velocity}
  - from: [contact.force, {port: contact.force, gain: -0.25}]
    to: satellite.force
    through: [{delay: 1 ms}, {low-pass: 200 Hz}, {quantise: 0.1 N}, {noise: 0 N, period: 1 ms, seed: 4}]
"""


@pytest.fixture
def docking(tmp_path):
    path = tmp_path / "wired.yaml"
    path.write_text(DOCKING)
    return path


def refusal(connections, parts=None) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        assemble(parts or three(), connections)
    return str(caught.value).splitlines()


def three():
    return [
        Part("a", gain(1.0, "m", "m"), {"u": "1 m"}),
        Part("b", gain(1.0, "N", "N")),
        Part("c", gain(), {"u": 1.0}),
    ]


def test_file_to_models_to_file_is_the_identity(docking):
    config = load_config(docking)
    text = dump(config.model.to_data())
    again = load_config(docking.parent / _written(docking.parent / "again.yaml", text))
    assert again.model == config.model and dump(again.model.to_data()) == text
    given = config.model.to_data()["connections"]
    assert given[3]["from"] == ["contact.force", {"port": "contact.force", "gain": -0.25}]
    assert given[3]["through"][3] == {"noise": "0 N", "period": "1 ms", "seed": 4}
    assert given[1] == "robot.position -> contact.position"


def _written(path, text):
    path.write_text(text)
    return path.name


def test_it_runs_with_half_the_step_too_and_tells_its_effects(docking, tmp_path):
    result = run(docking, out=tmp_path / "out", figures=False)
    assert set(result.summary["numerics"]["signals"]) == set(result.results.signals)
    assert result.summary["config"]["connections"][0]["through"] == [{"sample-and-hold": "4 ms"}]
    # The config as run runs again, to the bit.
    again = run(tmp_path / "out" / "config.yaml", halving=False)
    assert again.results["robot.position"].tolist() == result.results["robot.position"].tolist()


def test_options_are_overridden_by_number_and_by_target(docking):
    changes = [
        "connections[3].through[0].delay=2ms",
        "connections[satellite.force].through[1].low-pass=50 Hz",
        "connections[1].through=[{gain: 1.5}]",
        "connections[contact.velocity].through=[{offset: 1 mm/s}]",
    ]
    prepared = prepare(docking, changes)
    given = prepared.config.model.to_data()["connections"]
    assert given[3]["through"][:2] == [{"delay": "2ms"}, {"low-pass": "50 Hz"}]
    assert given[1] == {
        "from": "robot.position", "to": "contact.position", "through": [{"gain": 1.5}],
    }  # fmt: skip
    (delay, *_), wired = prepared.system.connections[3].wire.links, prepared.system.connections[2].wire
    assert delay.effect.time == 2e-3 and not delay.at_once
    assert wired.links[0].effect.value == 1e-3
    for wrong in ("connections[9].through=[]", "connections[3].through[7].delay=1 ms", "connections[3].to=x"):
        with pytest.raises(ConfigError, match="no 'connections"):
            load_config(docking, [wrong])
    with pytest.raises(ConfigError) as caught:
        prepare(docking, ["connections[3].through[0].dealy=1 ms"])
    assert str(caught.value).splitlines() == [
        "--set connections[3].through[0].dealy=1 ms: connections[3].through[0].dealy: effect delay has no "
        "option 'dealy'",
        "  options: time, before",
    ]


def test_all_that_is_wrong_is_reported_at_once():
    wrong = [
        {
            "from": "a.y",
            "to": "b.u",
            "through": [
                {"delya": "1 ms"},
                {"delay": "1 m"},
                {"delay": "-1 ms"},
                {"low-pass": "10 Hz", "time_constant": "1 s"},
                {"quantise": 0.1},
                {"saturate": "1 m"},
                {"noise": "1 mm", "period": "1 ms"},
                {"gain": 1, "delay": "1 ms"},
                "delay",
                {"effect": "nowhere.py:X"},
                {"saturate": {"low": "2 m", "high": "1 m"}},
                {"rate-limit": "1 m", "raet": 3},
            ],
        }
    ]
    reported = refusal(wrong)
    place = "system: connections[0].through"
    assert reported[:3] == [
        f"{place}[0].delya: no effect 'delya'",
        f"  effects: {', '.join(BUILT_IN)}. Did you mean delay or relay?",
        f"{place}[1].delay: delay: time: cannot take '1 m', m [m] cannot be converted to s [s]",
    ]
    heads = [line.removeprefix(place).partition(":")[0] for line in reported if not line.startswith("  ")]
    # Behind the first, whose unit nobody knows, options in the signal's unit are not judged.
    assert heads == [
        "[0].delya", "[1].delay", "[2].delay", "[3]", "[5].saturate", "[6].seed", "[7]", "[8]",
        "[9].effect", "[11].raet",
    ]  # fmt: skip
    wrong[0]["through"] = wrong[0]["through"][1:]
    heads = [line.removeprefix(place).partition(":")[0] for line in refusal(wrong) if line[0] != " "]
    assert heads[3:5] == ["[3].quantise", "[4].saturate"]
    text = "\n".join(reported)
    for part in (
        "effect delay: time: input should be greater than or equal to 0, got -0.001",
        "low-pass takes either a cutoff or a time_constant",
        "effect saturate has no single value, got '1 m'",
        "effect noise: seed is missing",
        "2 effects in one entry: gain, delay",
        "cannot read the effect 'delay'",
        "cannot load the effect 'nowhere.py:X': FileNotFoundError",
        "effect rate-limit has no option 'raet'",
    ):
        assert part in text, part


def test_units_are_followed_through_the_chain():
    ends = {"from": "a.y", "to": "b.u"}
    system = assemble(three(), [{**ends, "through": [{"gain": "2 N/mm"}, {"offset": "1 kN"}]}])
    connection = system.connections[0]
    assert connection.gain == 1000.0  # what comes out is in m.N/mm
    assert connection.wire.links[1].effect.value == 1.0
    assert refusal([{**ends, "through": [{"gain": 2}]}]) == [
        "system: connections[0]: cannot connect a.y -> gain -> b.u: what comes out is in m",
        "  b.u [N] is [kg.m.s-2], not [m]. A gain with a unit changes the unit: {gain: 2 N/m}.",
    ]
    assert refusal([{**ends, "through": [{"gain": "2 N/m"}, {"quantise": "1 m"}]}])[0] == (
        "system: connections[0].through[1].quantise: quantise: resolution: cannot take '1 m', "
        "m [m] cannot be converted to m times N/m [kg.m.s-2]"
    )
    reported = refusal([{"from": ["a.y", "b.y"], "to": "b.u", "through": [{"gain": "1 N/m"}]}])
    assert reported[0] == "system: connections[0]: cannot add b.y [N] to a.y [m]"


def test_effects_and_sums_take_real_numbers_only():
    count = FakeFmu(extra=[variable("n", Causality.OUTPUT, kind=Kind.INTEGER, type="Int32")])
    parts = [Part("count", count), Part("sink", gain())]
    reported = refusal([{"from": "count.n", "to": "sink.u", "through": [{"delay": "1 ms"}]}], parts)
    assert reported == [
        "system: connections[0]: count.n is of type Integer",
        "  effects and sums take real numbers only, except map",
    ]


def vectors(names, causality):
    return FakeFmu(extra=[variable(name, causality, "m") for name in names])


def test_arrays_connect_element_by_element():
    source = vectors([f"x[{n}]" for n in (1, 2, 3)], Causality.OUTPUT)
    sink = vectors([f"u[{n}]" for n in (1, 2, 3)], Causality.INPUT)
    parts = [Part("one", source), Part("two", sink)]
    plain = assemble(parts, ["one.x -> two.u"])
    assert [str(one) for one in plain.connections] == [f"one.x[{n}] -> two.u[{n}]" for n in (1, 2, 3)]
    noisy = assemble(
        parts,
        [{"from": "one.x", "to": "two.u", "through": [{"noise": "1 mm", "period": "1 s", "seed": 1}]}],
    )
    drawn = [one.wire.links[0].effect for one in noisy.connections]
    values = {float(one.kernel(0.0, [0.0], one.numbers(), np.zeros(2), False)) for one in drawn}
    assert len(values) == 3
    parts = [Part("one", source), Part("two", vectors(["u[1]", "u[2]"], Causality.INPUT))]
    assert refusal(["one.x -> two.u"], parts) == [
        "system: connections[0]: cannot connect one.x (elements [1], [2], [3]) to two.u (elements [1], [2])",
        "  arrays are connected element by element, and need the same elements on both sides. Connect single "
        "elements by their names.",
    ]
    reported = refusal([{"from": "one.x[1]", "to": "two.u"}], parts)
    assert (
        reported[0]
        == "system: connections[0]: cannot connect one.x[1] (no array) to two.u (elements [1], [2])"
    )
    assert len(reported) == 2


def test_problems_of_an_array_are_reported_once():
    source = vectors(["x[1]", "x[2]"], Causality.OUTPUT)
    sink = vectors(["u[1]", "u[2]"], Causality.INPUT)
    reported = refusal(
        [{"from": "one.x", "to": "two.u", "through": [{"delay": 3}]}],
        [Part("one", source), Part("two", sink)],
    )
    assert reported == [
        "system: connections[0].through[0].delay: delay: time: 3 has no unit",
        "  a unit must be given, for zero too; its unit is s. Write 3 s.",
    ]


def test_a_gain_with_a_unit_needs_a_signal_with_one():
    parts = [Part("one", FakeFmu(outputs={"y": ""})), Part("two", FakeFmu(inputs={"u": ""}))]
    assert refusal([{"from": "one.y", "to": "two.u", "through": [{"gain": "2 N/m"}]}], parts) == [
        "system: connections[0].through[0]: effect gain on a signal in no unit",
        "  the signal's unit is not known, so that a factor with a unit makes no known one. Give a bare "
        "number, the factor in the units of both ends: the unit is not checked then.",
    ]
    # As it says.
    assemble(parts, [{"from": "one.y", "to": "two.u", "through": [{"gain": 2}]}])


def test_effects_of_a_file_move_with_the_config(tmp_path):
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "mine.py").write_text(
        "from orchestrator.effects import Effect\n"
        "class Twice(Effect):\n"
        "    '''Twice the signal.'''\n"
        "    @staticmethod\n"
        "    def kernel(time, x, options, memory, commit):\n"
        "        return 2.0 * x[0]\n"
    )
    text = DOCKING.replace("sample-and-hold: 4 ms", "effect: 'mine.py:Twice'")
    (folder / "wired.yaml").write_text(text)
    one = run(folder / "wired.yaml", out=tmp_path / "out", halving=False, figures=False)
    assert one.results["robot.position"][-1] != 0.0
    again = run(tmp_path / "out" / "config.yaml", halving=False)
    assert again.results["robot.position"].tolist() == one.results["robot.position"].tolist()
    (tmp_path / "other.yaml").write_text("extends: here/wired.yaml\n")
    assert prepare(tmp_path / "other.yaml").system.connections[0].wire.links[0].name.endswith("mine.py:Twice")
    (folder / "wired.yaml").write_text(text.replace("Twice", "Twise"))
    with pytest.raises(ConfigError) as caught:
        prepare(folder / "wired.yaml")
    assert str(caught.value) == (
        "wired.yaml:5: connections[0].through[0].effect: mine.py has no 'Twise'\n"
        "  effects in it: Twice. Did you mean Twice?"
    )


def test_effects_of_installed_packages_are_found_by_name(tmp_path, monkeypatch):
    from orchestrator.effects import choose

    package = tmp_path / "squarer-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: squarer\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[orchestrator.effects]\nsquare = squarer_effects:Square\n")
    (tmp_path / "squarer_effects.py").write_text(
        "from orchestrator.effects import Effect\n"
        "class Square(Effect):\n"
        "    @staticmethod\n"
        "    def kernel(time, x, options, memory, commit):\n"
        "        return x[0] * x[0]\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    choose._offered.cache_clear()
    try:
        assert "square" in choose.effect_names()
        system = assemble(three(), [{"from": "c.y", "to": "b.u", "through": [{"square": None}]}])
        assert type(system.connections[0].wire.links[0].effect).__name__ == "Square"
    finally:
        choose._offered.cache_clear()


def test_effects_are_listed_and_stand_in_the_schema(capsys):
    assert main(["list"]) == 0
    assert "effects:\n  gain\n  offset\n  delay\n" in capsys.readouterr().out
    items = json.loads(json.dumps(json_schema()))["$defs"]["ConnectionModel"]["properties"]["through"][
        "items"
    ]
    assert [next(iter(one["required"])) for one in items["anyOf"]] == [*BUILT_IN, "effect"]
    (noise,) = (one for one in items["anyOf"] if one["required"] == ["noise"])
    assert set(noise["properties"]) == {"noise", "period", "seed", "correlation"}
