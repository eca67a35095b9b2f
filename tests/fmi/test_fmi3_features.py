"""FMI 3.0: arrays whose size a structural parameter sets, binary values between instances, clocks."""

from __future__ import annotations

import foreign
import pytest
import yaml

from orchestrator.base.errors import ConfigError, FmuError
from orchestrator.cli.main import main
from orchestrator.fmi import Interface, read_description
from orchestrator.master.running_instances import instantiate
from orchestrator.simulation.run import prepare, run

CLOCK = '<Clock name="tick" valueReference="9" causality="{0}" intervalVariability="triggered"/>'
each_kind = pytest.mark.parametrize("instance", [{}, {"isolate": "process"}])


@pytest.fixture
def fmu(tmp_path):
    return str(foreign.flexible(tmp_path / "Flexible.fmu"))


def config(fmu, start=None, master="gauss-seidel", connections=(), **instance):
    return {
        "run": {"master": master, "step_size": "0.1 s", "stop_time": "0.5 s"},
        "instances": {
            "one": {"fmu": fmu, "start": start or {}, **instance},
            "two": {"fmu": fmu, "start": {"n": 3}, **instance},
        },
        "connections": list(connections),
    }


@each_kind
def test_structural_parameters_set_the_sizes_of_arrays(fmu, instance):
    made = run(config(fmu, {"n": 4, "u": [1, 2, 3, 4]}, **instance), halving=False).results
    assert [name for name in made.signals if name.startswith("one.y")] == [
        f"one.y[{n}]" for n in (1, 2, 3, 4)
    ]
    assert [made[f"one.y[{n}]"][-1] for n in (1, 2, 3, 4)] == [2.0, 4.0, 6.0, 8.0]
    assert made["one.sum"][-1] == 10.0
    assert made["two.sum"][-1] == 3.0 and "two.y[4]" not in made.signals


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_arrays_of_such_a_size_are_connected_whole(fmu, master):
    start = {"n": 3, "u": [1, 2, 3]}
    made = run(config(fmu, start, master, ["one.y -> two.u"]), halving=False).results
    assert [made[f"two.y[{n}]"][-1] for n in (1, 2, 3)] == [4.0, 8.0, 12.0]
    with pytest.raises(ConfigError, match=r"one\.y"):
        prepare(config(fmu, {"n": 4}, master, ["one.y -> two.u"]))


@pytest.mark.parametrize(
    ("value", "said"),
    [(0, "between 1 and 16"), (17, "between 1 and 16"), ("3 m", "a whole number"), (2.5, "a whole number")],
)
def test_sizes_that_cannot_be_are_refused(fmu, value, said, tmp_path, capsys):
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(config(fmu, {"n": value})))
    assert main(["check", str(tmp_path / "c.yaml")]) == 2
    said_all = capsys.readouterr().err
    assert said in said_all and "instances.one.start.n" in said_all


@each_kind
@pytest.mark.parametrize(
    "master", ["jacobi", "gauss-seidel", {"name": "iterative", "tolerance": 1e-6}], ids=lambda m: str(m)[:12]
)
def test_binary_values_go_from_instance_to_instance(fmu, master, instance):
    wanted = config(fmu, None, master, ["one.message -> two.heard"], **instance)
    prepared = prepare(wanted)
    with instantiate(prepared.system) as instances:
        signals = instances.initialise(0.0, 0.5)
        for point in prepared.grid:
            if not point.last:
                signals, _ = prepared.master.step(prepared.system, instances, point, signals)
        values = instances.running[1].get_values(["heard", "message"])
    assert values == {"heard": b"\x01\x00\x02", "message": b"\x02\x00\x01"}


def test_binary_start_values_are_hexadecimal(fmu, tmp_path, capsys):
    made = prepare(config(fmu, {"heard": "00ff10"}, connections=["one.message -> two.heard"]))
    assert made.system.instances[0].start["heard"] == b"\x00\xff\x10"
    assert len(run(made, halving=False).results) == 6
    with pytest.raises(ConfigError, match="hexadecimal digits"):
        prepare(config(fmu, {"heard": "wumm"}))


@pytest.mark.parametrize("causality", ["input", "output"])
def test_clocks_are_left_to_the_fmu_in_co_simulation_and_said(causality, tmp_path):
    fmu = str(foreign.flexible(tmp_path / "Clocked.fmu", CLOCK.format(causality)))
    made = run(config(fmu, {"n": 2}), halving=False)
    (note, *_) = [one for one in made.summary["notes"] if "clocks tick" in one]
    assert "ticks are not passed on between instances" in note
    assert ("tick never ticks" in note) == (causality == "input")
    assert made.results["one.sum"][-1] == 2.0


def test_clocked_inputs_are_neither_set_nor_connected(tmp_path, capsys):
    clocked = '<Float64 name="held" valueReference="8" causality="input" variability="discrete" '
    clocked += 'clocks="9" start="1"/>'
    fmu = str(foreign.flexible(tmp_path / "Clocked.fmu", CLOCK.format("output") + clocked))
    made = run(config(fmu), halving=False)  # its fmi3SetFloat64 refuses the reference 8
    (note, *_) = [one for one in made.summary["notes"] if "one.held" in one]
    assert note.endswith("one.held (Float64) keeps its value: it may be set only while its clock tick ticks")
    with pytest.raises(ConfigError, match=r"two\.held may be set only while its clock tick ticks"):
        prepare(config(fmu, connections=["one.sum -> two.held"]))


def test_arrays_of_binary_values_are_refused_by_name(tmp_path):
    array = '<Binary name="many" valueReference="8" causality="{}" variability="discrete">'
    array += '<Dimension start="2"/></Binary>'
    source = str(foreign.flexible(tmp_path / "Source.fmu", array.format("output")))
    target = str(foreign.flexible(tmp_path / "Target.fmu", array.format("input")))
    wanted = config(source, connections=["one.many -> two.many"])
    wanted["instances"]["two"]["fmu"] = target
    with pytest.raises(ConfigError, match="of binary variables only scalars can be connected"):
        prepare(wanted)


def test_clocks_are_refused_in_model_exchange_with_the_reason(tmp_path):
    path = foreign.flexible(tmp_path / "Clocked.fmu", CLOCK.format("output"))
    text = foreign.document("flexible").replace("MORE", CLOCK.format("output"))
    text = text.replace(
        '<CoSimulation modelIdentifier="Flexible" canHandleVariableCommunicationStepSize="true"/>',
        '<ModelExchange modelIdentifier="Flexible"/>',
    )
    path = foreign.pack(tmp_path / "Exchange.fmu", "flexible.c", 3, "Flexible", text)
    with pytest.raises(FmuError, match="in model exchange they are not supported, since"):
        read_description(path, Interface.MODEL_EXCHANGE)
