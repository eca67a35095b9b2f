"""How logs are fed, as signals of other instances are, how candidates are made from all of them, and how what
acts on a sum stands in the augmented system."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from ports_bench import LAWS, UNITS, change_log, study, system

from orchestrator.base.errors import ConfigError
from orchestrator.diagnosis.finding import NOMINAL, Augmented, Finding
from orchestrator.diagnosis.ports import player
from orchestrator.diagnosis.ports.apart import closed
from orchestrator.diagnosis.ports.augmented import augmented_config
from orchestrator.diagnosis.ports.diagnose import diagnose_ports
from orchestrator.diagnosis.ports.given import check_logs
from orchestrator.diagnosis.ports.page import _assumed
from orchestrator.diagnosis.ports.player import Inserted
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay, candidates_of, measure
from orchestrator.diagnosis.ports.study import Role
from orchestrator.diagnosis.verdict import AUGMENTED, EXPORTABLE
from orchestrator.effects.gain import Gain
from orchestrator.effects.offset import Offset
from orchestrator.simulation.loop import simulate
from orchestrator.simulation.run import run
from orchestrator.system.system import Port


@pytest.mark.parametrize("loop", ["native", "python"])
@pytest.mark.parametrize(("master", "late"), [("gauss-seidel", 0), ("jacobi", 1)])
def test_a_log_arrives_as_signals_of_instances_do(tmp_path, monkeypatch, master, late, loop):
    """What passes at once to an output is as old there as its log, under Gauss-Seidel."""
    draw = np.random.default_rng(5)
    columns = {name: draw.standard_normal(200) for name in ("reference", "position", "velocity")}
    voltage = 240.0 * (160.0 * (columns["reference"] - columns["position"]) - columns["velocity"])
    units = {"reference": "m", "position": "m", "velocity": "m/s", "voltage": "V"}
    table = np.column_stack([2e-3 * np.arange(200.0), *columns.values(), voltage])
    header = ",".join(["time [s]", *(f"{name} [{unit}]" for name, unit in units.items())])
    rows = "\n".join(",".join(map(repr, row)) for row in table.tolist())
    (tmp_path / "run.csv").write_text(f"{header}\n{rows}\n")
    controller = {
        "fmu": "CascadeControl",
        "start": {
            "position_gain": "160 1/s",
            "velocity_gain": "240 V.s/m",
            "reference": "0 m",
            "position": "0 m",
            "velocity": "0 m/s",
        },
    }
    system = {
        "run": {"master": master, "step_size": "2 ms", "stop_time": "1 s"},
        "instances": {"controller": controller},
        "connections": [],
    }
    (tmp_path / "system.yaml").write_text(yaml.safe_dump(system))
    fed = {f"controller.{name}": {"column": name, "hold": True} for name in columns}
    compared = {"controller.voltage": {"column": "voltage", "noise": "1 mV"}}
    (tmp_path / "study.yaml").write_text(yaml.safe_dump({
        "format": "port-study/1", "system": "system.yaml", "columns": {"time": "time", **fed, **compared},
        "runs": [{"file": "run.csv", "role": "train"}],
    }))  # fmt: skip
    monkeypatch.setattr(player, "simulate", lambda *one, **more: simulate(*one, **more | {"loop": loop}))
    own = load_port_study(tmp_path)
    run = own.runs[0]
    found = PortReplay(own, [run]).player.run(run.logs, len(run))[Port("controller", "voltage")]
    assert found[1:] == pytest.approx(voltage[1 - late : 200 - late], rel=1e-12)
    assert found[0] == pytest.approx(voltage[0], rel=1e-12)


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    """Logs of the system itself, the second of a shorter stroke, and one of it at rest."""
    path = study(tmp_path_factory.mktemp("moving"), seed=None)
    (path / "rest.csv").write_text((path / "run-0.csv").read_text())
    with change_log(path / "rest.csv") as columns:
        for name, values in columns.items():
            if name != "time":
                values[:] = 0.0
    return path


def trained(path, *files):
    """The study with these train runs, in this order."""
    data = yaml.safe_load((path / "study.yaml").read_text())
    data["runs"] = [{"file": f"{name}.csv", "role": "train"} for name in files]
    (path / "trained.yaml").write_text(yaml.safe_dump(data))
    return load_port_study(path / "trained.yaml")


@pytest.mark.parametrize("files", [("run-1", "run-0"), ("rest", "run-0", "run-1")])
def test_candidates_do_not_depend_on_which_run_stands_first(moving, files):
    first, second = (candidates_of(trained(moving, *order)) for order in (files, files[::-1]))
    assert [(one.id, one.equation) for one in first] == [(one.id, one.equation) for one in second]
    for one, other in zip(first, second, strict=True):
        for a, b in zip(one.parameters, other.parameters, strict=True):
            assert (a.scale, *a.starts) == pytest.approx((b.scale, *b.starts), rel=1e-9), one.id
    assert {"drive.voltage.saturate", "drive.coulomb", "drive.load.offset"} <= {one.id for one in first}


def test_of_a_signal_of_few_values_no_resolution_can_be_told(moving):
    """It gives each of them an error of its own, as any law does."""
    own = trained(moving, "run-0")
    path = "drive.voltage.quantise"
    assert path in {one.id for one in candidates_of(own)}
    log = own.runs[0].logs[VOLTAGE]
    for values, known in ((8, False), (9, True)):
        log[:] = np.resize(np.linspace(-1.0, 1.0, values), len(log))
        assert (path in {one.id for one in candidates_of(own)}) == known
    log[:] = np.resize([-1.0, 1.0], len(log))
    with pytest.raises(
        ConfigError, match=r"no resolution can be identified from signals of 8 values or fewer: drive\.v"
    ):
        candidates_of(replace(own, only=(path,)))


def test_limits_that_cut_nothing_are_absent_from_all_train_runs(moving):
    """Those of a run with a smaller peak would cut off what is larger in another."""
    own = trained(moving, "run-1", "run-0")
    replay = PortReplay(own, own.of(Role.TRAIN))
    before = replay.of(NOMINAL)
    limits = [one for one in candidates_of(own) if one.id.endswith((".saturate", ".rate-limit"))]
    assert len(limits) >= 8
    for effect in limits:
        after = replay.of(Augmented({}, (effect,), np.zeros(1)))
        assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True)), effect.id


VELOCITY = {"port": "path.velocity", "gain": "0.1 kN.s/m"}
OTHER = {"port": "drive.velocity", "gain": "-20 N.s/m"}
LEGS = [[VELOCITY], [VELOCITY, OTHER], [OTHER, VELOCITY]]
LOAD, VOLTAGE = Port("drive", "load"), Port("controller", "voltage")


DAMPER = {"fmu": "CoulombDamper", "start": {"level": "10 N", "width": "1 mm/s"}}


def summed(path, legs, through=(), **columns):
    """A study, and its system, whose load is a sum of velocities, or damper.force; its log is the system's
    own."""
    machine = system(0.2, [{"from": legs, "to": "drive.load", "through": list(through)}])
    if legs == ["damper.force"]:
        machine["instances"]["damper"] = DAMPER
        machine["connections"].append("path.velocity -> damper.velocity")
    (path / "system.yaml").write_text(yaml.safe_dump(machine, sort_keys=False))
    results = run(machine, halving=False).results
    units = UNITS | {"path.velocity": "m/s", "drive.velocity": "m/s"}
    table = {"time [s]": results.time, **{f"{name} [{unit}]": results[name] for name, unit in units.items()}}
    rows = np.column_stack([np.asarray(values) for values in table.values()]).tolist()
    (path / "run.csv").write_text("\n".join([",".join(table), *(",".join(map(repr, row)) for row in rows)]))
    seen = {"column": "controller.voltage", "noise": "5 mV", "feed": False}
    data = {"format": "port-study/1", "system": "system.yaml", "settle": "50 ms",
            "columns": {"time": "time", "controller.voltage": seen, **columns},
            "runs": [{"file": "run.csv", "role": "train"}]}  # fmt: skip
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    return load_port_study(path), results


@pytest.mark.parametrize("loop", ["native", "python"])
@pytest.mark.parametrize("legs", LEGS)
def test_what_is_fed_into_a_sum_has_its_gain(tmp_path, monkeypatch, legs, loop):
    """One source with a gain is a sum, too."""
    own, _ = summed(tmp_path, legs, **{"path.velocity": {"column": "path.velocity"}})
    monkeypatch.setattr(player, "simulate", lambda *one, **more: simulate(*one, **more | {"loop": loop}))
    log = own.runs[0].logs[VOLTAGE]
    assert np.array_equal(PortReplay(own, own.runs).signals(own.runs[0], {}, (), np.zeros(0))[VOLTAGE], log)
    twice = {port: values * (2.0 if port.variable == "velocity" else 1.0)
             for port, values in own.runs[0].logs.items()}  # fmt: skip
    moved = PortReplay(own, own.runs).player.run(twice, len(log))[VOLTAGE]
    assert np.abs(moved - log).max() > 0.1 * np.std(log)


@pytest.mark.parametrize("legs", LEGS)
def test_effects_act_on_an_output_before_its_gain(tmp_path, legs):
    own, _ = summed(tmp_path, legs)
    replay = PortReplay(own, own.runs)

    def given(*inserted):
        return replay.player.run(own.runs[0].logs, len(own.runs[0]), {}, inserted)[VOLTAGE]

    at_output = given(Inserted(Offset(value=0.1), Port("path", "velocity")))
    assert at_output == pytest.approx(given(Inserted(Offset(value=10.0), LOAD)), rel=1e-9, abs=1e-9)
    assert np.abs(at_output - given()).max() > 0.1
    # A gain of the output is one of its leg alone.
    tenth = [leg | ({"gain": "10 N.s/m"} if leg is VELOCITY else {}) for leg in legs]
    (tmp_path / "tenth").mkdir()
    _, results = summed(tmp_path / "tenth", tenth)
    expected = pytest.approx(np.asarray(results["controller.voltage"]), rel=1e-9, abs=1e-9)
    assert given(Inserted(Gain(factor=0.1), Port("path", "velocity"))) == expected


@pytest.mark.parametrize("legs", LEGS)
def test_candidates_at_a_sum_are_of_its_size(tmp_path, legs):
    own, results = summed(tmp_path, legs)
    load = 100.0 * np.asarray(results["path.velocity"])
    load -= 20.0 * np.asarray(results["drive.velocity"]) if len(legs) > 1 else 0.0
    sizes = measure(own, *own.runs)
    assert sizes.peak[LOAD] == pytest.approx(np.abs(load).max(), rel=1e-9)
    assert sizes.spread[LOAD] == pytest.approx(load[own.settled :].std(), rel=1e-9)
    (limit,) = (one for one in candidates_of(own) if one.id == "drive.load.saturate")
    assert limit.equation.endswith(" N")
    replay = PortReplay(own, own.runs)
    (before,) = replay.of(NOMINAL)
    absent, half = (replay.of(Augmented({}, (limit,), np.array([cut])))[0] for cut in (0.0, 0.5))
    # An input may take what belongs to two instants, and a little more than either.
    assert np.abs(absent - before).max() < 0.01
    assert np.abs(half - before).max() > 50.0


@pytest.mark.parametrize("legs", LEGS)
def test_the_augmented_system_has_effects_before_gains(tmp_path, legs):
    """Where a sum leaves no place for it, an effect is left out, and why is reported."""
    velocity = {"column": "path.velocity", "noise": "1 mm/s", "feed": False}
    own, _ = summed(tmp_path, legs, [{"offset": "1 N"}], **{"path.velocity": velocity})
    known = {one.id: one for one in candidates_of(own)}
    names = ("path.velocity.saturate", "path.velocity.offset", "drive.load.gain")
    model = Augmented({}, tuple(known[name] for name in names), np.array([0.4, 0.01, 0.1]))
    finding = Finding((), names, (), "", (), model)
    text, left_out = augmented_config(own, finding)
    if len(legs) > 1:
        reason = "drive.load is fed a sum, and effects act on sums, not on path.velocity alone"
        assert left_out == dict.fromkeys(names[:2], reason)
        return
    assert left_out == {}
    given = PortReplay(own, own.runs).signals(own.runs[0], {}, model.effects, model.theta)[VOLTAGE]
    found = np.asarray(run(yaml.safe_load(text), halving=False).results["controller.voltage"])
    assert found == pytest.approx(given, rel=1e-9, abs=1e-9 * np.abs(given).max())
    assert np.abs(given - own.runs[0].logs[VOLTAGE]).max() > 0.1


@pytest.mark.parametrize(
    ("through", "names", "theta", "beside"),
    [
        ([], ["drive.coulomb"], [20.0, 1e-3], ""),
        ([{"offset": "1 N"}], ["drive.load.offset", "drive.coulomb"], [2.0, 20.0, 1e-3], ""),
        ([], ["drive.load.gain", "drive.coulomb"], [1.0, 20.0, 1e-3], "gain"),
        ([], ["drive.coulomb", "drive.load.gain"], [20.0, 1e-3, 1.0], "gain"),
        ([{"saturate": {"high": "15 N"}}], ["drive.coulomb"], [20.0, 1e-3], "saturate"),
        ([], ["path.velocity.gain", "drive.coulomb"], [0.2, 20.0, 1e-3], "gain"),
    ],
)
def test_friction_stands_as_an_fmu_where_it_is_added_all_the_same(tmp_path, through, names, theta, beside):
    """Both augmented systems give what the answer does, as far as the step lets a sum be taken early."""
    velocity = {"column": "path.velocity", "noise": "1 mm/s", "feed": False}
    own, _ = summed(tmp_path, [VELOCITY], through, **{"path.velocity": velocity})
    known = {one.id: one for one in candidates_of(own)}
    model = Augmented({}, tuple(known[name] for name in names), np.array(theta))
    finding = Finding((), tuple(names), (), "", (), model)
    given = PortReplay(own, own.runs).signals(own.runs[0], {}, model.effects, model.theta)[VOLTAGE]
    told = {"drive.coulomb": f"{beside} acts at drive.load, too, and would act on the sum"} if beside else {}
    for fmus, expected in ((False, {}), (True, told)):
        text, left_out = augmented_config(own, finding, fmus)
        assert left_out == expected
        config = yaml.safe_load(text)
        assert ("friction_drive" in config["instances"]) is (fmus and not beside)
        found = np.asarray(run(config, halving=False).results["controller.voltage"])
        assert np.abs(found - given).max() < 1e-6 * np.std(given)


@pytest.mark.parametrize("names", [["damper.viscous"], ["damper.velocity.gain", "damper.viscous"]])
def test_what_a_law_reads_behind_an_effect_is_no_output(tmp_path, names):
    own, _ = summed(tmp_path, ["damper.force"])
    known = {one.id: one for one in candidates_of(own)}
    model = Augmented({}, tuple(known[name] for name in names), np.array([0.5, 100.0][-len(names) :]))
    given = PortReplay(own, own.runs).signals(own.runs[0], {}, model.effects, model.theta)[VOLTAGE]
    for fmus in (False, True):
        text, left_out = augmented_config(own, Finding((), tuple(names), (), "", (), model), fmus)
        if len(names) > 1:
            reason = "it reads damper.velocity behind damper.velocity.gain, and effects read outputs"
            assert left_out == {"damper.viscous": reason}
            continue
        assert left_out == {} and ("friction_damper" in text) is fmus
        found = np.asarray(run(yaml.safe_load(text), halving=False).results["controller.voltage"])
        # An instance of its own takes its place in the order of the steps.
        assert np.abs(found - given).max() < (0.01 if fmus else 1e-6) * np.std(given)
        assert np.abs(found - own.runs[0].logs[VOLTAGE]).max() > 0.1


def test_a_report_tells_which_friction_is_no_fmu(tmp_path):
    through = [{"gain": 0.5}]
    hidden = {
        "effect": f"{LAWS}:Coulomb",
        "level": "20 N",
        "width": "1 mm/s",
        "read": {"velocity": "drive.velocity"},
    }
    summed(tmp_path, [VELOCITY], [*through, hidden])
    believed = yaml.safe_load((tmp_path / "system.yaml").read_text())
    believed["connections"][-1]["through"] = through
    (tmp_path / "system.yaml").write_text(yaml.safe_dump(believed, sort_keys=False))
    data = yaml.safe_load((tmp_path / "study.yaml").read_text())
    data["candidates"] = {"only": ["drive.coulomb"]}
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(data))
    made = diagnose_ports(tmp_path, lambda stage: None, report=False)
    assert made.finding.effects == ("drive.coulomb",)
    (said,) = [one.what for one in made.diagnosis.data if one.place == EXPORTABLE]
    reason = "gain acts at drive.load, too, and would act on the sum"
    assert said == f"drive.coulomb stands as an effect, not as an FMU: {reason}"
    assert AUGMENTED in made.files and EXPORTABLE not in made.files


@pytest.mark.parametrize("plain", [True, False])
def test_a_log_may_be_given_to_one_reader_alone(tmp_path, plain):
    """The controller was given a position that is off; the drive, which others read, is not."""
    measured = {"from": "drive.position", "to": "controller.position"}
    folder = study(tmp_path, [{**measured, "through": [{"effect": "offset", "value": "2 mm"}]}], seed=None)
    data = yaml.safe_load((folder / "study.yaml").read_text())
    if not plain:  # whatever the model makes of the position
        config = system(
            0.2, [{"from": [{"port": "drive.position", "gain": 0.5}], "to": "controller.position"}]
        )
        (folder / "plant.yaml").write_text(yaml.safe_dump(config))
        data["system"] = "plant.yaml"
    column = data["columns"]["drive.position"]["column"]
    data["columns"]["controller.position"] = {"column": column, "offset": "2 mm"}
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    found = load_port_study(folder)
    reader, runs = Port("controller", "position"), found.of(Role.TRAIN)
    assert reader in found.fed and (reader in found.given) is not plain

    def most(study) -> float:
        return max(float(np.abs(r).max()) for r in PortReplay(study, runs).of(NOMINAL))

    assert most(found) < 1e-6
    # Where loops are closed, the controller reads what the drive gives.
    assert most(closed(found)) > 1e3 if plain else most(closed(found)) < 1e-6


def test_an_output_that_is_fed_for_want_of_a_noise_is_told(tmp_path):
    """Not a source, of which nothing could be compared, nor what is meant to be fed."""
    file = study(tmp_path) / "study.yaml"
    data = yaml.safe_load(file.read_text())

    def told(voltage):
        data["columns"]["controller.voltage"] = {"column": "controller.voltage", **voltage}
        file.write_text(yaml.safe_dump(data))
        found = load_port_study(file)
        about = SimpleNamespace(left_out={}, numerics=None)
        assumed = _assumed(found, about, SimpleNamespace(effects=()), {})
        return [one.place for one in check_logs(found)[1] if "`noise`" in one.what], assumed[0]

    places, assumed = told({})
    assert places == ["controller.voltage"]
    assert assumed.endswith(" Fed, not compared, for want of a `noise`: controller.voltage.")
    for meant in ({"feed": True}, {"noise": "5 mV", "feed": False}):
        places, assumed = told(meant)
        assert places == [] and "want of" not in assumed


def test_the_title_of_what_was_found_tells_effects_only_where_there_are_any(tmp_path):
    own = load_port_study(study(tmp_path))
    (coulomb,) = (one for one in candidates_of(own) if one.id == "drive.coulomb")
    rubbing = Augmented({}, (coulomb,), np.array([12.0, 1e-3]))
    for model, names, said in (
        (NOMINAL, (), "as calibrated by logs"),
        (rubbing, (coulomb.id,), "with the effects found"),
    ):
        text, _ = augmented_config(own, Finding((), names, (), "", (), model))
        assert yaml.safe_load(text)["title"].endswith(f", {said}")
