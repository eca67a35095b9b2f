"""What FMUs show of themselves: page, picture, icon, provenance; and what a Python FMU says it misses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path

import build_extra  # noqa: F401
import fmpy
import matplotlib.image
import pytest
from fmpy.validation import validate_fmu

from orchestrator.base.errors import BuildError
from orchestrator.cli.translate import add_arguments
from orchestrator.cli.translate import main as build_main
from orchestrator.exchange.system_fmu import export_system_fmu
from orchestrator.fmi.bundled import find_fmu, fmu_names
from orchestrator.translate.description import written
from orchestrator.translate.presentation import dress, text_section
from orchestrator.translate.python_fmu import build_python_fmu

FMUS = Path(__file__).parents[2] / "fmus"
SHIPPED = sorted(FMUS.glob("*/*.fmu"))


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


class Page(HTMLParser):
    """The text of a page, and the files that it refers to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text, self.files, self.headings = "", [], []
        self._tag = ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self._tag = tag
        self.files += [value for key, value in attributes if key in ("src", "href")]

    def handle_data(self, data):
        self.text += data
        if self._tag in ("h1", "h2") and data.strip():
            self.headings.append(data)


def check(path: Path) -> Page:
    """Every FMU of ours holds these, and they belong to it."""
    content = members(path)
    description = fmpy.read_model_description(str(path))
    page = Page(content["documentation/index.html"].decode())
    assert page.files == ["ports.svg"]
    picture = "".join(ET.fromstring(content["documentation/ports.svg"]).itertext())
    for variable in description.modelVariables:
        if variable.causality in ("input", "output", "parameter"):
            assert variable.name in page.text
            assert variable.unit is None or variable.unit in page.text
    ports = [v.name for v in description.modelVariables if v.causality in ("input", "output")]
    shown = [name for name in ports if name in picture]
    assert shown == ports or "more" in picture
    second = description.fmiVersion == "2.0"
    icon = path.with_suffix(".png").name
    assert ("model.png" in content) is second
    assert ("terminalsAndIcons/icon.png" in content) is not second
    pixels = content["model.png" if second else "terminalsAndIcons/icon.png"]
    image = _image(pixels)
    assert image.shape == (96, 96, 4), icon
    assert image[0, 0, 3] == 0.0
    assert image[48, 48, 3] == 1.0
    assert "Structure" in page.headings
    provenance = json.loads(content["extra/orchestrator/provenance.json"])
    assert provenance["modelName"] == description.modelName
    return page


def _image(data: bytes):
    from io import BytesIO

    return matplotlib.image.imread(BytesIO(data), format="png")


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_fmus_show_and_explain_themselves(path):
    assert validate_fmu(str(path)) == []
    page = check(path)
    assert {"Equations", "Model"} & set(page.headings)


def test_provenance_names_the_sources():
    reported = json.loads(members(find_fmu("RobotResponse"))["extra/orchestrator/provenance.json"])
    source = FMUS.parent / "modelica" / "DockingHIL" / "RobotResponse.mo"
    assert reported["sources"] == {
        "DockingHIL/RobotResponse.mo": f"sha256:{sha256(source.read_bytes()).hexdigest()}"
    }
    assert set(reported["madeWith"]) == {"rumoca", "casadi", "ziglang"}
    reported = json.loads(members(find_fmu("ArmInverse"))["extra/orchestrator/provenance.json"])
    assert {"model.py", "shared/arm.py"} <= set(reported["sources"])
    assert set(reported["madeWith"]) == {"pythonfmu"}
    whole = json.loads(members(find_fmu("UncompensatedDocking"))["extra/orchestrator/provenance.json"])
    assert "DockingHIL/RobotResponse.mo" in whole["sources"]


def test_control_characters_do_not_reach_the_model_description():
    root = ET.Element("fmiModelDescription", description="tank\x13 of water")
    assert ET.fromstring(written(root)).get("description") == "tank\ufffd of water"


def test_documentation_and_equations_are_on_the_page():
    page = Page(members(find_fmu("RobotResponse"))["documentation/index.html"].decode())
    assert page.headings[:3] == ["DockingHIL.RobotResponse", "Documentation", "Equations"]
    assert "G(s) = omega_n^2 exp(-tau_m s)" in page.text
    assert "delayed_command = delay(command, tau_m);" in page.text
    assert "Derivatives of outputs by inputs: directional." in page.text


def test_a_system_s_fmu_explains_itself(tmp_path):
    for version in ("2.0", "3.0"):
        path = export_system_fmu("docking-1d", tmp_path / f"{version}.fmu", fmi_version=version).path
        page = check(path)
        assert "System" in page.headings
        assert "contact.force -> sensor.force" in page.text
        reported = json.loads(members(path)["extra/orchestrator/provenance.json"])
        digest = sha256(find_fmu("DockingContact").read_bytes()).hexdigest()
        assert reported["fmus"]["contact"] == f"sha256:{digest}"
        assert "Derivatives of outputs by inputs: none." in page.text


def test_texts_become_paragraphs_and_what_is_indented_stays():
    text = "One <two>.\n\n    a = b\n\nThree."
    assert text_section("Model", text, "") == [
        ("Model", "<p>One &lt;two&gt;.</p>\n<pre>    a = b</pre>\n<p>Three.</p>")
    ]
    assert text_section("Model", None, "") == []


def test_many_ports_are_counted_in_the_picture():
    rows = "".join(
        f'<Float64 name="u{n}" valueReference="{n}" causality="input" start="0"/>' for n in range(40)
    )
    xml = (
        '<fmiModelDescription fmiVersion="3.0" modelName="A &amp; B"><CoSimulation/>'
        f"<ModelVariables>{rows}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )
    picture = "".join(ET.fromstring(dress(xml.encode())["documentation/ports.svg"]).itertext())
    assert "A & B" in picture
    assert "u23" in picture
    assert "u24" not in picture
    assert "and 16 more" in picture


NEEDY = '''"""Needs what is not there."""

from __future__ import annotations

import absent_module
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Needy(Fmi2Slave):
    description = "y = 1"
    requirements = ("absent-package>=2.1",)
    type_attributes = {"y": {"unit": "1"}}
    dependencies = {"y": ()}
    initial_dependencies = {"y": ()}

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y = absent_module.one
        self.register_variable(Real("y", causality=Fmi2Causality.output, description="one"))

    def do_step(self, current_time, step_size):
        return True
'''
RUN = """
import sys
from pathlib import Path
from orchestrator.fmi import load_fmu
try:
    load_fmu(Path(sys.argv[1])).instantiate("one").free()
    print("made")
except Exception as error:
    print(error)
"""


def test_a_python_fmu_tells_what_it_misses(tmp_path, monkeypatch):
    model, installed = tmp_path / "Needy" / "model.py", tmp_path / "installed"
    model.parent.mkdir()
    model.write_text(NEEDY)
    information = installed / "absent_package-2.1.4.dist-info"
    information.mkdir(parents=True)
    (installed / "absent_module.py").write_text("one = 1.0\n")
    metadata = information / "METADATA"
    metadata.write_text("Metadata-Version: 2.1\nName: absent-package\nVersion: 2.1.4\n")
    monkeypatch.syspath_prepend(str(installed))
    fmu = build_python_fmu(model, tmp_path / "Needy.fmu")
    assert "absent-package&gt;=2.1" in members(fmu)["documentation/index.html"].decode()
    assert members(fmu)["resources/requirements.txt"] == b"absent-package>=2.1\n"

    def reported(*folders: Path) -> str:
        path = os.pathsep.join([str(FMUS.parent), *map(str, folders)])
        run = subprocess.run(
            [sys.executable, "-c", RUN, str(fmu)],
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": path},
        )
        assert run.returncode == 0, run.stderr
        return run.stdout

    assert reported(installed) == "made\n"
    missing = reported()
    assert "FMU Needy: in the Python" in missing
    assert "absent-package>=2.1 is not installed. Remedy: pip install" in missing
    metadata.write_text("Metadata-Version: 2.1\nName: absent-package\nVersion: 2.0.9\n")
    assert "absent-package>=2.1 is needed, 2.0.9 is installed. Remedy:" in reported(installed)


def test_requirements_that_cannot_be_checked_are_refused(tmp_path):
    model = tmp_path / "model.py"
    model.write_text(NEEDY.replace("absent-package>=2.1", "absent-package~=2.1"))
    with pytest.raises(BuildError, match=r"cannot read absent-package~=2\.1"):
        build_python_fmu(model, tmp_path / "x.fmu")


def test_options_of_compiled_fmus_are_refused_for_python_forms(tmp_path):
    import argparse

    (tmp_path / "model.py").write_text("")
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    arguments = parser.parse_args([str(tmp_path / "model.py"), "--fmi", "3.0"])
    with pytest.raises(BuildError, match="Take --form native"):
        build_main(arguments)


def test_every_bundled_fmu_is_among_those_checked():
    assert {path.stem for path in SHIPPED} >= set(fmu_names())
