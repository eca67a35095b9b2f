"""Broken and hostile packages: each is refused with what, where and why, and nothing is written."""

from __future__ import annotations

import io
import re
import stat
import zipfile
from time import process_time

import pytest
from archives import repack
from ssp_files import (
    CONTACT,
    FMUS,
    ROBOT,
    binding,
    bindings,
    component,
    mapping,
    package,
    real,
    ssd,
    ssv,
    system,
    wire,
)

from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.exchange.ssp.load import import_ssp

ONE = system("rig", component("robot", "robot.fmu", ROBOT))
LAUGHS = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]>'
OUTSIDE = '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>'


def refused(path, tmp_path):
    """The message; nothing may have been written."""
    folder = tmp_path / "target"
    folder.mkdir(exist_ok=True)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ConfigError) as caught:
        import_ssp(path, folder / "new.yaml")
    assert sorted(tmp_path.rglob("*")) == before
    return re.sub(r"(\.ss[dvm]):\d+:", r"\1:LINE:", str(caught.value))


def of(root, tmp_path, files=FMUS):
    return refused(package(tmp_path / "X.ssp", root, files), tmp_path)


def described(text, tmp_path):
    """Refusal of a package with that description, within a frame."""
    return of(f'<?xml version="1.0"?>\n{text}', tmp_path)


def test_no_zip_and_half_a_zip(tmp_path):
    path = tmp_path / "X.ssp"
    path.write_bytes(b"no zip")
    assert refused(path, tmp_path) == (
        "X.ssp: no system structure package, since it is no whole zip archive (File is not a zip file)\n"
        "  Export or download it again."
    )
    package(path, ONE, FMUS)
    path.write_bytes(path.read_bytes()[:-1000])
    assert "no whole zip archive" in refused(path, tmp_path)


def test_content_that_was_damaged_on_the_way(tmp_path):
    path = package(tmp_path / "X.ssp", ONE, FMUS)
    data = bytearray(path.read_bytes())
    at = data.index(b"robot.fmu") + 5000
    data[at : at + 50] = bytes(one ^ 255 for one in data[at : at + 50])
    path.write_bytes(data)
    assert "X.ssp: SystemStructure.ssd:LINE: resources/robot.fmu cannot be unpacked (Bad CRC-32" in refused(
        path, tmp_path
    )


@pytest.mark.parametrize(
    "name", ["../evil.fmu", "/evil.fmu", "resources/../../evil.fmu", "C:/evil.fmu", "..\\x"]
)
def test_entries_that_would_be_written_elsewhere(name, tmp_path):
    path = package(tmp_path / "X.ssp", ONE, FMUS)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, b"x")
    assert refused(path, tmp_path) == f"X.ssp: refused, its entry {name!r} would be written elsewhere"


def test_symbolic_links(tmp_path):
    path = package(tmp_path / "X.ssp", ONE)
    with zipfile.ZipFile(path, "a") as archive:
        link = zipfile.ZipInfo("resources/robot.fmu")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc/passwd")
    assert refused(path, tmp_path) == "X.ssp: refused, its entry 'resources/robot.fmu' is a symbolic link"


def test_a_folder_with_a_link_to_the_outside(tmp_path):
    folder = tmp_path / "folder"
    (folder / "resources").mkdir(parents=True)
    (tmp_path / "robot.fmu").write_bytes(FMUS["robot.fmu"])
    (folder / "resources" / "robot.fmu").symlink_to(tmp_path / "robot.fmu")
    (folder / "X.ssd").write_text(ssd(ONE))
    assert refused(folder / "X.ssd", tmp_path) == (
        "X.ssd: X.ssd:LINE: no file 'resources/robot.fmu'\n  X.ssd holds X.ssd"
    )


def test_bombs_and_doubles_and_locks(tmp_path):
    path = package(tmp_path / "X.ssp", ONE, FMUS)
    bomb = tmp_path / "bomb.ssp"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", ssd(ONE))
        archive.writestr("resources/robot.fmu", bytes(300 * 2**20))
    assert refused(bomb, tmp_path).startswith("bomb.ssp: refused, its ")
    bomb.unlink()
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("SystemStructure.ssd", ssd(ONE))
    assert refused(path, tmp_path) == (
        "X.ssp: refused, two of its entries are called 'SystemStructure.ssd'\n"
        "  each name may stand once. Export or download it again."
    )
    with zipfile.ZipFile(tmp_path / "lzma.ssp", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("SystemStructure.ssd", ssd(ONE))
    assert refused(tmp_path / "lzma.ssp", tmp_path) == (
        "lzma.ssp: refused, its entry 'SystemStructure.ssd' is packed by method 14\n"
        "  allowed: stored (0) and deflated (8)"
    )


def test_descriptions_that_expand_too_far(tmp_path):
    with zipfile.ZipFile(tmp_path / "X.ssp", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", ssd(ONE) + " " * (100 * 2**20))
        archive.writestr("resources/robot.fmu", FMUS["robot.fmu"])
    begin = process_time()
    assert re.match(r"X.ssp: refused, the \d+ bytes of SystemStructure.ssd unpack to", refused_of(tmp_path))
    assert process_time() - begin < 10.0


def test_references_that_make_much_of_a_small_package(tmp_path):
    """Each use of a file counts: packages within it, and sets of parameters."""
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", ssd(ONE) + " " * (3 * 2**20))
        archive.writestr("resources/robot.fmu", FMUS["robot.fmu"])
    nested = "".join(component(f"n{number}", "inner.ssp") for number in range(500))
    given = ssv({f"p{number}": real("1") for number in range(20_000)})
    bound = bindings('<ssd:ParameterBinding source="resources/p.ssv"/>' * 500)
    for root, files in (
        (system("rig", nested), {"inner.ssp": inner.getvalue()}),
        (system("rig", component("robot", "robot.fmu", ROBOT + bound)), {**FMUS, "p.ssv": given}),
    ):
        with zipfile.ZipFile(tmp_path / "X.ssp", "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("SystemStructure.ssd", ssd(root))
            for name, content in files.items():
                archive.writestr(f"resources/{name}", content)
        begin = process_time()
        said = refused_of(tmp_path)
        assert "what the package refers to comes to more than" in said and said.count("\n") == 1
        assert "at most 20 times its size, or 8388608 bytes, are read" in said
        assert process_time() - begin < 20.0


def refused_of(tmp_path):
    """Refusal of X.ssp, which is removed."""
    said = refused(tmp_path / "X.ssp", tmp_path)
    (tmp_path / "X.ssp").unlink()
    return said


@pytest.mark.parametrize("document", [LAUGHS, OUTSIDE])
@pytest.mark.parametrize("where", ["ssd", "ssv", "ssm"])
def test_document_types_are_refused_in_every_file(document, where, tmp_path):
    inner = '<ssd:ParameterMapping source="resources/m.ssm"/>'
    own = bindings(f'<ssd:ParameterBinding source="resources/p.ssv">{inner}</ssd:ParameterBinding>')
    files = {
        "p.ssv": ssv({"tau_m": real("1")}),
        "m.ssm": mapping('<ssm:MappingEntry source="tau_m" target="tau_m"/>', inline=False),
    }
    root = ssd(system("rig", component("robot", "robot.fmu", ROBOT + own)))
    if where == "ssd":
        root = root.replace("\n", f"\n{document}", 1)
    else:
        name = {"ssv": "p.ssv", "ssm": "m.ssm"}[where]
        files[name] = document + files[name]
    named = {"ssd": "SystemStructure.ssd", "ssv": "resources/p.ssv", "ssm": "resources/m.ssm"}[where]
    assert of(root, tmp_path, FMUS | files) == (
        f"X.ssp: {named} declares a document type, which SSP has no use for; refused"
    )


def test_missing_and_wrong_descriptions(tmp_path):
    path = tmp_path / "X.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("Other.ssd", ssd(ONE))
    assert refused(path, tmp_path) == (
        "X.ssp: no SystemStructure.ssd at the top, hence no system structure package\n"
        "  descriptions in it: Other.ssd"
    )
    assert described("<x/>", tmp_path) == (
        "X.ssp: SystemStructure.ssd:LINE: its root element is 'x'\n"
        "  SystemStructureDescription of the namespace "
        "http://ssp-standard.org/SSP1/SystemStructureDescription is needed"
    )
    assert "is not well-formed XML" in described("<x>", tmp_path)
    assert of(ssd(ONE, version="3.0"), tmp_path) == (
        "X.ssp: SystemStructure.ssd:LINE: it follows version '3.0' of SSP\n  versions: 1.0, 2.0"
    )
    assert "unknown element 'Elephant'" in of(
        ONE.replace("<ssd:Elements>", "<ssd:Elephant/><ssd:Elements>"), tmp_path
    )
    assert of(system("rig", ""), tmp_path) == (
        "X.ssp: SystemStructure.ssd: no components\n  there is nothing to run"
    )


PLACE = "X.ssp: SystemStructure.ssd:LINE: "
DANGLING = {
    "a file": (
        system("rig", component("robot", "rbot.fmu", ROBOT)),
        "no file 'resources/rbot.fmu'\n"
        "  X.ssp holds SystemStructure.ssd, resources/robot.fmu, resources/contact.fmu. "
        "Did you mean resources/robot.fmu or resources/contact.fmu?",
    ),
    "an element": (
        system("rig", component("robot", "robot.fmu", ROBOT), wire("robt.position", "robot.command")),
        "no element 'robt' in system rig\n  elements: robot. Did you mean robot?",
    ),
    "a connector": (
        system("rig", component("robot", "robot.fmu", ROBOT), wire("robot.positio", "robot.command")),
        "no connector 'positio' of robot\n  connectors: command, position, velocity. Did you mean position?",
    ),
    "a variable": (
        system("rig", component("robot", "robot.fmu", ROBOT.replace('"position"', '"positio"'))),
        "robot's FMU has no variable 'positio'\n"
        "  a connector has a variable's name. Did you mean position or der(position)?",
    ),
    "the web": (
        system("rig", component("robot", "http://example.com/robot.fmu", ROBOT)),
        "'http://example.com/robot.fmu' refers to something outside of the package\n"
        "  references lead to files of the same package, such as resources/Model.fmu. "
        "Put the file into the package, and refer to it there.",
    ),
    "the folder above": (
        system("rig", component("robot", "resources/../../robot.fmu", ROBOT)),
        "'resources/../../robot.fmu' leads out of the package\n"
        "  references lead to files of the same package",
    ),
    "nothing": (
        system("rig", component("robot", "robot.fmu", ROBOT).replace(' source="resources/robot.fmu"', "")),
        "component robot has no source\n"
        "  there is nothing to run. Give it a source, such as resources/Model.fmu.",
    ),
    "Modelica": (
        system("rig", component("robot", "robot.mo", ROBOT, type="text/x-modelica")),
        "component robot is of type 'text/x-modelica'\n"
        "  types: application/x-fmu-sharedlibrary, application/x-ssp-definition, application/x-ssp-package",
    ),
    "a dictionary": (
        system(
            "rig",
            component("robot", "robot.fmu", ROBOT)
            + '<ssd:SignalDictionaryReference name="ref" dictionary="bus"><ssd:Connectors>'
            '<ssd:Connector name="x" kind="inout"/></ssd:Connectors></ssd:SignalDictionaryReference>',
            wire("robot.position", "ref.x"),
        ),
        "no signal dictionary 'bus'\n  in this system and those around: none",
    ),
}


@pytest.mark.parametrize("what", DANGLING)
def test_dangling_references(what, tmp_path):
    root, expected = DANGLING[what]
    assert of(root, tmp_path) == PLACE + expected


def test_all_problems_are_reported_at_once(tmp_path):
    root = system(
        "rig",
        component("robot", "robot.fmu", ROBOT),
        wire("a.x", "robot.command") + wire("b.x", "robot.command"),
    )
    text = of(root, tmp_path)
    assert "no element 'a'" in text and "no element 'b'" in text


def test_names_that_stand_twice(tmp_path):
    twice = component("robot", "robot.fmu", ROBOT)
    assert "two elements of rig are called 'robot'" in of(system("rig", twice + twice), tmp_path)
    doubled = ROBOT.replace('name="velocity"', 'name="position"')
    root = system("rig", component("robot", "robot.fmu", doubled))
    assert "two connectors of robot are called 'position'" in of(root, tmp_path)
    own = binding({"tau_m": real("1")}).replace(
        "</ssv:Parameters>", f'<ssv:Parameter name="tau_m">{real("2")}</ssv:Parameter></ssv:Parameters>'
    )
    root = system("rig", component("robot", "robot.fmu", ROBOT + bindings(own)))
    assert "two parameters of this set are called 'tau_m'" in of(root, tmp_path)


def test_connections_that_cannot_be(tmp_path):
    elements = component("robot", "robot.fmu", ROBOT) + component("contact", "contact.fmu", CONTACT)
    assert of(system("rig", elements, wire("robot.position", "contact.force")), tmp_path) == (
        f"{PLACE}cannot connect robot.position to contact.force: both give values\n"
        "  one end is an output of an element, or an input of the system around"
    )
    twice = wire("robot.position", "contact.position") * 2
    assert "contact.position is fed twice" in of(system("rig", elements, twice), tmp_path)
    assert of(system("rig", elements, wire("contact.force", "robot.command")), tmp_path) == (
        f"{PLACE}contact.force to robot.command: units differ, N [kg.m.s-2] and m [m], and their conversion "
        "is not suppressed"
    )


def test_systems_that_contain_themselves(tmp_path):
    inner = component("again", "a.ssd", type="application/x-ssp-definition")
    files = {"a.ssd": ssd(system("a", inner.replace("resources/", "")))}
    text = of(system("rig", inner), tmp_path, files)
    assert text == (
        "X.ssp: resources/a.ssd:LINE: component again contains itself: SystemStructure.ssd > resources/a.ssd "
        "> resources/a.ssd\n  systems within systems must end"
    )
    ring = system("rig", component("again", "#me", type="application/x-ssp-definition"), id="me")
    assert "component again contains itself" in of(ring, tmp_path)
    assert "no system with the id 'you'" in of(ring.replace("#me", "#you"), tmp_path)


def test_connectors_in_a_ring(tmp_path):
    ports = '<ssd:Connector name="{}" kind="input"/><ssd:Connector name="{}" kind="output"/>'
    ports = f"<ssd:Connectors>{ports}</ssd:Connectors>"
    inner = system(
        "one",
        component("robot", "robot.fmu", ROBOT),
        wire(".in", ".out") + wire(".in", "robot.command"),
        ports.format("in", "out"),
    )
    assert "feeds itself" in of(system("rig", inner, wire("one.out", "one.in")), tmp_path)


def test_values_that_do_not_fit(tmp_path):
    def given(value):
        own = bindings(binding({"tau_m": value}))
        return of(system("rig", component("robot", "robot.fmu", ROBOT + own)), tmp_path)

    assert given(real("x")).startswith(f"{PLACE}robot.tau_m cannot take 'x' (Real)")
    assert "N [kg.m.s-2] is no unit for it" in given(real("1", "N"))
    assert "'INF' is not finite" in given(real("INF"))
    assert "has no value" in given("<ssv:Real/>")
    assert "has 0 values" in given("")


def test_an_fmu_that_is_none(tmp_path):
    text = of(ONE, tmp_path, {"robot.fmu": b"no zip"})
    assert text.startswith(PLACE) and "not an FMU, since it is no zip archive" in text


def test_what_exists_is_not_overwritten_by_an_fmu(tmp_path):
    path = package(tmp_path / "X.ssp", ONE, FMUS)
    folder = tmp_path / "new-fmus"
    folder.mkdir()
    (folder / "robot.fmu").write_bytes(b"mine")
    with pytest.raises(ConfigError, match="exists, and is not the file of this package"):
        import_ssp(path, tmp_path / "new.yaml")
    assert (folder / "robot.fmu").read_bytes() == b"mine"
    assert not (tmp_path / "new.yaml").exists()


def test_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["export", "docking-1d-uncompensated", "-o", "X.ssp", "--set", "run.stop_time=0.05 s"]) == 0
    assert capsys.readouterr().out == (
        "X.ssp: SSP 1.0\n  SSP has no word for, carried as annotation: run.master, run.step_size, measures\n"
    )
    assert main(["check", "X.ssp"]) == 0
    assert "X: 3 instances, 4 connections" in capsys.readouterr().out
    assert main(["import", "X.ssp", "-o", "new.yaml"]) == 0
    assert capsys.readouterr().out == "new.yaml: 3 instances, 4 connections\n"
    made = (tmp_path / "new.yaml").read_bytes()
    (tmp_path / "new.yaml").write_text("# by hand")
    assert main(["import", "X.ssp", "-o", "new.yaml"]) == 2
    assert capsys.readouterr().err == (
        "orchestrator: --output: new.yaml is there already\n"
        "  Name another file, or give --overwrite: what was changed in that one by hand is lost then.\n"
    )
    assert (tmp_path / "new.yaml").read_text() == "# by hand"
    assert main(["import", "X.ssp", "-o", "new.yaml", "--overwrite"]) == 0
    assert (tmp_path / "new.yaml").read_bytes() == made
    capsys.readouterr()
    assert main(["run", "X.ssp", "--out", "out", "--quiet", "--no-figures", "--no-halving"]) == 0
    assert main(["stability", "X.ssp"]) == 0
    capsys.readouterr()
    assert main(["export", "X.ssp", "-o", "Y.zip"]) == 2
    assert "Y.zip: cannot derive the format from the file name\n  suffixes: " in capsys.readouterr().err
    assert main(["import", "new.yaml", "-o", "Y.yaml"]) == 2
    assert (
        "new.yaml: cannot recognise the kind of this file\n  suffixes: .ssp, .ssd" in capsys.readouterr().err
    )


def test_a_run_keeps_the_fmus_of_a_foreign_package(tmp_path):
    contact = component("contact", "contact.fmu", CONTACT)
    changed = repack_fmu(tmp_path)
    path = package(tmp_path / "X.ssp", system("rig", contact), {"contact.fmu": changed})
    more = ["--set", "run.master=jacobi", "--set", "run.step_size=1 ms", "--no-figures", "--no-halving"]
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--quiet", *more]) == 0
    assert (tmp_path / "out" / "fmus" / "resources" / "contact.fmu").read_bytes() == changed
    assert main(["run", str(tmp_path / "out" / "config.yaml"), "--quiet", "--no-halving"]) == 0


def repack_fmu(tmp_path):
    """An FMU that is not the bundled one."""
    old = tmp_path / "old.fmu"
    old.write_bytes(FMUS["contact.fmu"])
    return repack(old, tmp_path / "other.fmu", lambda name, data: (name, data)).read_bytes()


def test_references_that_multiply(tmp_path):
    levels = [system("last", component("robot", "robot.fmu", ROBOT), id="s0")]
    for level in range(1, 20):
        two = "".join(
            component(name, f"#s{level - 1}", type="application/x-ssp-definition") for name in ("a", "b")
        )
        levels.append(system(f"level{level}", two, id=f"s{level}"))
    assert "references make more than 2000 systems of it" in of(system("rig", "".join(levels)), tmp_path)


def test_numbers_that_are_none(tmp_path):
    text = of(ssd(ONE, experiment='<ssd:DefaultExperiment startTime="x" stopTime="INF"/>'), tmp_path)
    assert "startTime: 'x' is no finite number" in text and "stopTime: 'INF' is no finite number" in text
    broken = '<ssd:Units><ssc:Unit name="m"><ssc:BaseUnit m="x"/></ssc:Unit></ssd:Units>'
    assert "cannot read unit 'm'" in of(ssd(ONE, broken), tmp_path)
    items = '<ssc:Enumeration name="E"><ssc:Item name="a" value="x"/></ssc:Enumeration>'
    items = f"<ssd:Enumerations>{items}</ssd:Enumerations>"
    assert "cannot read enumeration 'E'" in of(ssd(ONE, items), tmp_path)
    root = system("rig", component("robot", "http://[/x.fmu", ROBOT))
    assert "'http://[/x.fmu' is no reference (Invalid IPv6 URL)" in of(root, tmp_path)
