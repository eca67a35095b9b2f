"""Config -> package -> config is the identity; without our annotation it is on all that SSP has words for."""

from __future__ import annotations

import re
import shutil
import zipfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from foreign import arrays
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.base.errors import ConfigError
from orchestrator.config import dump, load_config
from orchestrator.exchange.ssp.load import import_ssp
from orchestrator.exchange.ssp.write import write_ssp
from orchestrator.fmi import bundled
from orchestrator.simulation.run import prepare, run

# Those with a partner over UDP are no systems of FMUs.
SYSTEMS = [name for name in bundled.system_names() if not load_config(name).model.external]


def stripped(path: Path, target: Path) -> Path:
    """A package without our annotation."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == "SystemStructure.ssd":
                text = data.decode()
                assert "orchestrator.config" in text
                data = re.sub(
                    r'<ssc:Annotation type="orchestrator.config">.*?</ssc:Annotation>', "", text, flags=re.S
                )
                data = data.replace("<ssd:Annotations>\n      \n    </ssd:Annotations>", "").encode()
            new.writestr(entry, data)
    return target


def same_system(one, other):
    """Whether two systems have the same instances, start values and linear connections."""
    assert [a.name for a in one.instances] == [b.name for b in other.instances]
    for a, b in zip(one.instances, other.instances, strict=True):
        assert a.start == b.start
        assert a.fmu.checksum() == b.fmu.checksum()
    assert [(a.source, a.target) for a in one.connections] == [
        (b.source, b.target) for b in other.connections
    ]
    for a, b in zip(one.connections, other.connections, strict=True):
        assert line(a) == pytest.approx(line(b), rel=1e-12, abs=1e-15)


def test_fmus_that_were_equal_at_an_earlier_export_are_distinguished(tmp_path):
    """In one process: a file may be another one by then, under the same name."""
    files = [tmp_path / name / "X.fmu" for name in ("a", "b")]
    for file in files:
        file.parent.mkdir()
        shutil.copy(bundled.find_fmu("RobotResponse"), file)
    start = {"omega_n": "75 Hz", "xi_n": 0.8, "tau_m": "2 ms", "command": "0 m"}
    instances = {name: {"fmu": str(file), "start": start} for name, file in zip("ab", files, strict=True)}
    run_ = {"master": "jacobi", "step_size": "1 ms", "stop_time": "0.1 s"}
    for count in (1, 2):
        write_ssp({"run": run_, "instances": instances}, tmp_path / "x.ssp")
        with zipfile.ZipFile(tmp_path / "x.ssp") as package:
            packed = [package.read(name) for name in package.namelist() if name.endswith(".fmu")]
        assert sorted(packed) == sorted({file.read_bytes() for file in files}) and len(packed) == count
        if count == 1:
            with zipfile.ZipFile(files[1], "a") as archive:
                archive.writestr("extra/note.txt", "another one")


def line(connection):
    """What a linear connection gives for 0 and 1."""
    found = []
    for value in (0.0, 1.0):
        if connection.wire is not None:
            (leg,) = connection.wire.legs
            value = leg.gain * value + leg.offset
            for link in connection.wire.links:
                value = link.effect.kernel(0.0, [value], link.effect.numbers(), np.zeros(4), False)
        found.append(connection.gain * value + connection.offset)
    return found


@pytest.mark.skipif(find_spec("pyssp_standard") is None, reason="pyssp-standard is not installed")
@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_what_is_written_keeps_to_the_schemas(version, tmp_path):
    from lxml import etree

    origin = find_spec("pyssp_standard").origin
    folder = Path(origin).parent / "resources" / ("ssp2" if version == "2.0" else "")
    kinds = {".ssd": "SystemStructureDescription", ".ssv": "SystemStructureParameterValues"}
    for name in ("docking-1d", "docking-6d"):
        write_ssp(name, tmp_path / "X.ssp", version=version)
        with zipfile.ZipFile(tmp_path / "X.ssp") as archive:
            for entry in archive.namelist():
                if Path(entry).suffix in kinds:
                    schema = etree.XMLSchema(file=str(folder / f"{kinds[Path(entry).suffix]}.xsd"))
                    schema.assertValid(etree.fromstring(archive.read(entry)))


@pytest.mark.parametrize("name", SYSTEMS)
def test_bundled_systems_come_back(name, tmp_path):
    path = tmp_path / "X.ssp"
    write_ssp(name, path)
    back, config = load_config(path), load_config(name)
    assert back.text() == config.text()
    assert back.notes == ()
    again = tmp_path / "Y.ssp"
    write_ssp(name, again)
    assert again.read_bytes() == path.read_bytes()


def test_a_system_with_a_partner_over_udp_is_refused(tmp_path):
    with pytest.raises(ConfigError) as caught:
        write_ssp("docking-1d-station", tmp_path / "X.ssp")
    assert str(caught.value) == "docking-1d-station: rig is no FMU\n  SSP knows systems of FMUs only"
    assert not (tmp_path / "X.ssp").exists()


@pytest.mark.parametrize("name", SYSTEMS)
def test_without_annotation_the_numbers_come_back(name, tmp_path):
    path = tmp_path / "X.ssp"
    written = write_ssp(name, path)
    prepared = prepare(name)
    master = prepared.config.model.run.master
    config = load_config(stripped(path, tmp_path / "Y.ssp"), ["run.master=gauss-seidel"])
    back = prepare({**config.model.to_data(), "run": {**config.model.to_data()["run"], "master": master}})
    assert back.grid == prepared.grid
    delayed = [
        index
        for index, one in enumerate(prepared.config.model.to_data()["connections"])
        if isinstance(one, dict) and any("delay" in effect for effect in one.get("through", ()))
    ]
    assert written.lost == tuple(
        f"connections[{index}]: other tools carry the value without delay" for index in delayed
    )
    if not delayed:
        same_system(prepared.system, back.system)


# FMU -> inputs and what may feed or set them: dimension by unit.
_PORTS = {
    "RobotResponse": ({"command": "m"}, {"position": "m", "velocity": "m/s"}),
    "DockingContact": ({"position": "m", "velocity": "m/s"}, {"force": "N", "penetration": "m"}),
    "ForceSensor": ({"force": "N"}, {"measured_force": "N"}),
}
_UNITS = {"m": ["m", "mm", "cm"], "m/s": ["m/s", "mm/s"], "N": ["N", "kN"]}
_START = {
    "RobotResponse": {"omega_n": ["75 Hz", "471.3 rad/s"], "xi_n": [0.8, 1], "tau_m": ["2 ms", "0.002 s"]},
    "DockingContact": {"stiffness": ["176 N/mm", "1e5 N/m"], "front": ["5 mm"], "rear": ["-0.5 cm"]},
    "ForceSensor": {"tau_s": ["0 ms", "1.5 ms"], "cutoff": ["0 Hz", "0.2 kHz"]},
}
_NUMBERS = st.one_of(st.integers(-9, 9), st.floats(-1e3, 1e3, allow_nan=False).map(lambda x: round(x, 4)))


@st.composite
def configs(draw):
    """Systems of one to four instances, with connections between what fits, through linear effects."""
    kinds = draw(st.lists(st.sampled_from(list(_START)), min_size=1, max_size=4))
    names = [f"{draw(st.sampled_from(['a', 'B-', '_c', 'robot']))}{i}" for i in range(len(kinds))]
    instances, connections = {}, []
    for name, kind in zip(names, kinds, strict=True):
        start = {}
        for key, values in _START[kind].items():
            if draw(st.booleans()):
                start[key] = draw(st.sampled_from(values))
        for port, unit in _PORTS[kind][0].items():
            sources = [
                f"{other}.{output}"
                for other, that in zip(names, kinds, strict=True)
                for output, its in _PORTS[that][1].items()
                if its == unit
            ]
            if sources and draw(st.booleans()):
                connections.append(draw(_connection(st.sampled_from(sources), f"{name}.{port}", unit)))
            else:
                start[port] = f"{draw(_NUMBERS)} {draw(st.sampled_from(_UNITS[unit]))}"
        instance = {"fmu": kind}
        if start or draw(st.booleans()):
            instance["start"] = start
        if draw(st.booleans()):
            instance["isolate"] = "process"
        instances[name] = instance
    run_ = {"master": {"name": "iterative", "tolerance": 1e-6}, "step_size": "1 ms"}
    run_["stop_time"] = draw(st.sampled_from(["10 ms", "0.25 s", "1 s"]))
    if draw(st.booleans()):
        run_["start_time"] = draw(st.sampled_from(["0 s", "5 ms"]))
    config = {"run": run_, "instances": instances}
    if connections or draw(st.booleans()):
        config["connections"] = draw(st.permutations(connections))
    if draw(st.booleans()):
        config["title"] = draw(st.sampled_from(["", "A <title> & more", "Überschrift"]))
    return config


@st.composite
def _connection(draw, sources, target, unit):
    source = draw(sources)
    effects = st.one_of(
        st.builds(lambda x: {"gain": x}, _NUMBERS),
        st.builds(lambda x, u: {"offset": f"{x} {u}"}, _NUMBERS, st.sampled_from(_UNITS[unit])),
    )
    through = draw(st.lists(effects, max_size=3))
    if not through:
        return draw(st.sampled_from([f"{source} -> {target}", {"from": source, "to": target}]))
    return {"from": source, "to": target, "through": through}


@settings(max_examples=25, deadline=None)
@given(config=configs())
def test_generated_systems_come_back(config, tmp_path_factory):
    folder = tmp_path_factory.mktemp("generated")
    path = folder / "X.ssp"
    assert write_ssp(config, path).lost == ()
    back = load_config(path)
    assert back.model.to_data() == load_config(config).model.to_data()
    plain = load_config(stripped(path, folder / "Y.ssp"), ["run.master=jacobi"]).model.to_data()
    plain["run"]["master"] = config["run"]["master"]
    same_system(prepare(config).system, prepare(plain).system)


def test_arrays_of_fmi_3_come_back(tmp_path):
    arrays(tmp_path / "Arrays.fmu")
    fmu = str(tmp_path / "Arrays.fmu")
    config = {
        "run": {"master": "jacobi", "step_size": "1 ms", "stop_time": "5 ms"},
        "instances": {
            "a": {"fmu": fmu, "start": {"u[1]": 1.5, "u[2]": 2, "u[3]": -1, "gain[2,1]": 7}},
            "b": {"fmu": fmu, "start": {"u[3]": 0}},
        },
        "connections": ["a.y[1] -> b.u[2]", {"from": "a.y[2]", "to": "b.u[1]", "through": [{"gain": 2}]}],
    }
    path = tmp_path / "X.ssp"
    with pytest.raises(ConfigError, match=r"SSP 1.0 has no arrays, which FMUs of a, b have"):
        write_ssp(config, path, version="1.0")
    assert write_ssp(config, path).version == "2.0"
    ours = run(config, halving=False).results
    back = import_ssp(path, tmp_path / "new.yaml")
    assert [one.pop("fmu") for one in back.data["instances"].values()] == ["new-fmus/Arrays.fmu"] * 2
    again = run(tmp_path / "new.yaml", halving=False).results
    other = run(stripped(path, tmp_path / "Y.ssp"), overrides=["run.master=jacobi"], halving=False).results
    for name, column in ours.signals.items():
        np.testing.assert_array_equal(again[name], column)
        np.testing.assert_array_equal(other[name], column)
    for one in config["instances"].values():
        del one["fmu"]
    assert back.data == config


def test_effects_that_ssp_lacks_come_back_and_are_named(tmp_path):
    config = load_config("docking-1d-uncompensated").model.to_data()
    config["connections"][3] = {
        "from": "contact.force",
        "to": "satellite.force",
        "through": [{"delay": "1 ms"}],
    }
    config["connections"][1] = {
        "from": ["robot.position", {"port": "satellite.position", "gain": 0.0}], "to": "contact.position",
    }  # fmt: skip
    config["instances"]["satellite"]["form"] = "native"
    path = tmp_path / "X.ssp"
    written = write_ssp(config, path)
    assert written.lost == (
        "connections[1]: SSP has no sums: contact.position is fed by nothing in other tools",
        "connections[3]: other tools carry the value without delay",
    )
    assert written.carried == (
        "run.master", "run.step_size", "instances.satellite.form", "connections[1]", "connections[3]",
        "measures",
    )  # fmt: skip
    assert load_config(path).model.to_data() == config


def test_a_package_that_another_tool_has_changed_counts_as_it_is(tmp_path):
    path, changed = tmp_path / "X.ssp", tmp_path / "Y.ssp"
    write_ssp("docking-1d-uncompensated", path)
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(changed, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == "resources/contact.ssv":
                data = data.replace(b'value="176000"', b'value="180000"')
            if entry.filename == "SystemStructure.ssd":
                data = data.replace(b'stopTime="4"', b'stopTime="3"')
                data = re.sub(rb'<ssd:Component name="robot".*?</ssd:Component>', _renamed, data, flags=re.S)
                data = data.replace(b'Element="robot"', b'Element="arm"')
            new.writestr(entry, data)
    config = load_config(changed, ["measures.docking.robot=arm"])
    assert config.model.instances["contact"].start["stiffness"] == "180000 N/m"
    assert config.model.instances["contact"].start["front"] == "5 mm"
    assert config.model.run.stop_time == "3 s"
    assert "arm.position -> contact.position" in config.model.connections
    assert config.notes == (
        "Y.ssp: run.stop_time was changed after the export: the file counts",
        "Y.ssp: instance arm was changed after the export: the file counts",
        "Y.ssp: contact.stiffness was changed after the export: the file counts",
    )


def _renamed(match):
    return match[0].replace(b'name="robot"', b'name="arm"')


def test_a_broken_annotation_is_ignored(tmp_path):
    path, changed = tmp_path / "X.ssp", tmp_path / "Y.ssp"
    write_ssp("docking-1d-uncompensated", path)
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(changed, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == "SystemStructure.ssd":
                data = data.replace(b'"instances"', b'"instanzen"')
            new.writestr(entry, data)
    config = load_config(changed, ["run.master=jacobi"])
    assert config.notes[0] == (
        "Y.ssp: its annotation orchestrator.config is broken and ignored (KeyError: 'instances')"
    )
    assert config.model.run.step_size == "0.0001 s"


def test_an_imported_package_runs_as_the_config_did(tmp_path):
    overrides = ["run.stop_time=0.3 s", "satellite.form=native"]
    path = tmp_path / "X.ssp"
    write_ssp("docking-1d-uncompensated", path, overrides)
    import_ssp(path, tmp_path / "new.yaml")
    ours = run("docking-1d-uncompensated", overrides=overrides, halving=False).results
    for other in (path, tmp_path / "new.yaml"):
        back = run(other, halving=False).results
        assert back.signals.keys() == ours.signals.keys()
        for name, column in ours.signals.items():
            np.testing.assert_array_equal(back[name], column)


def test_the_augmented_model_of_a_diagnosis_is_exported(tmp_path):
    config = tmp_path / "augmented.yaml"
    config.write_text(
        "extends: docking-lab\n"
        "instances:\n  contact: {start: {stiffness: 171.3 N/mm}}\n"
        "connections:\n"
        "  - satellite.command -> robot.command\n"
        "  - {from: robot.position, to: contact.position, through: [{offset: 0.02 mm}]}\n"
        "  - robot.velocity -> contact.velocity\n"
        "  - contact.force -> sensor.force\n"
        "  - {from: sensor.measured_force, to: controller.measured_force, through: [{gain: 0.97}]}\n"
        "  - robot.position -> controller.position\n"
        "  - robot.velocity -> controller.velocity\n"
        "  - satellite.position -> controller.desired_position\n"
        "  - satellite.velocity -> controller.desired_velocity\n"
        "  - controller.force -> satellite.force\n",
        encoding="utf-8",
    )
    path = tmp_path / "X.ssp"
    assert write_ssp(config, path).lost == ()
    assert load_config(path).text() == load_config(config).text()


OWN = """
from orchestrator.effects import Effect
from pydantic import Field


class Half(Effect):
    factor: float = Field(0.5)

    @staticmethod
    def kernel(time, x, options, memory, commit):
        return options[0] * x[0]
"""


def with_own_effect(folder):
    """A package of a config with an effect in a file of its own."""
    (folder / "mine").mkdir()
    (folder / "mine" / "own.py").write_text(OWN, encoding="utf-8")
    config = load_config("docking-1d-uncompensated").model.to_data()
    config["connections"][3] = {
        "from": "contact.force",
        "to": "satellite.force",
        "through": [{"effect": "mine/own.py:Half", "factor": 0.25}],
    }
    path = folder / "X.ssp"
    (folder / "config.yaml").write_text(dump(config), encoding="utf-8")
    return config, path, write_ssp(folder / "config.yaml", path)


def test_code_of_effects_goes_along_and_comes_back_where_asked_for(tmp_path):
    config, path, written = with_own_effect(tmp_path)
    assert written.code == ("resources/own.py",)
    (tmp_path / "there").mkdir()
    import_ssp(path, tmp_path / "there" / "new.yaml", with_code=True)
    assert (tmp_path / "there" / "new-fmus" / "own.py").read_text(encoding="utf-8") == OWN
    back = load_config(tmp_path / "there" / "new.yaml")
    (effect,) = back.model.to_data()["connections"][3]["through"]
    assert effect == {"effect": "new-fmus/own.py:Half", "factor": 0.25}
    effect["effect"] = "mine/own.py:Half"
    assert back.model.to_data() | {"connections": config["connections"]} == config
    (tmp_path / "mine" / "own.py").unlink()  # it needs nothing of where it came from
    short = ["run.stop_time=10 ms"]
    assert run(tmp_path / "there" / "new.yaml", overrides=short, halving=False).results["contact.force"].size


def test_code_of_effects_is_not_run_unasked(tmp_path):
    _, path, _ = with_own_effect(tmp_path)
    changed = tmp_path / "Y.ssp"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(changed, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == "resources/own.py":
                data += f"\nopen({str(tmp_path / 'ran')!r}, 'w').close()\n".encode()
            new.writestr(entry, data)
    with pytest.raises(ConfigError) as caught:
        load_config(changed)
    assert str(caught.value) == (
        "Y.ssp: SystemStructure.ssd: resources/own.py is Python code, of an effect: it would run with your "
        "rights\n"
        "  Read it; if you trust it, `orchestrator import Y.ssp -o CONFIG --with-code`."
    )
    with pytest.raises(ConfigError, match="would run with your rights"):
        import_ssp(changed, tmp_path / "new.yaml")
    assert not (tmp_path / "ran").exists() and not (tmp_path / "new.yaml").exists()


@pytest.mark.parametrize("file", ["../own.py", "/tmp/own.py", "resources/../../own.py", "resources/none.py"])
def test_code_from_outside_of_the_package_is_never_taken(file, tmp_path):
    _, path, _ = with_own_effect(tmp_path)
    changed = tmp_path / "Y.ssp"
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(changed, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == "SystemStructure.ssd":
                data = data.replace(b"resources/own.py", file.encode())
            new.writestr(entry, data)
    for asked in (False, True):
        with pytest.raises(ConfigError, match="which is not in the package"):
            import_ssp(changed, tmp_path / "new.yaml", with_code=asked)
    assert not (tmp_path / "new.yaml").exists()
