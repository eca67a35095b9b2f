"""The shipped Modelica FMUs are what their sources give, byte for byte."""

from __future__ import annotations

import zipfile
from pathlib import Path

import build_extra  # noqa: F401
import fmpy
import modelica_bench as bench
import pytest
from fmpy.validation import validate_fmu

from orchestrator.base.errors import BuildError
from orchestrator.translate.build import translate
from orchestrator.translate.library import LIBRARY, build_library

REBUILD = "python -m orchestrator.translate.library"


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.mark.parametrize("item", LIBRARY, ids=lambda item: item.file)
def test_shipped_sources_are_up_to_date(item):
    """Everything but the binaries; the token in them ties the binaries to these sources."""
    shipped = members(bench.FMUS / item.file)
    made, _ = translate(bench.ROOT / "modelica" / item.source, fmi_version=item.fmi_version)
    names = {name for name in shipped if not name.startswith("binaries/")}
    assert names == set(made), REBUILD
    assert {name for name in names if shipped[name] != made[name]} == set(), REBUILD


@pytest.mark.parametrize("name", ["ForceSensor"])
def test_rebuilding_gives_the_shipped_bytes(name, tmp_path):
    """All platforms, both FMI versions."""
    build_library(bench.ROOT, output=tmp_path, names=[name])
    for item in LIBRARY:
        if item.name == name:
            rebuilt, shipped = members(tmp_path / item.file), members(bench.FMUS / item.file)
            differing = {
                key for key in rebuilt.keys() | shipped.keys() if rebuilt.get(key) != shipped.get(key)
            }
            assert differing == set(), REBUILD
            assert (tmp_path / item.file).read_bytes() == (bench.FMUS / item.file).read_bytes()


@pytest.mark.parametrize("item", LIBRARY, ids=lambda item: item.file)
def test_shipped_fmus_are_valid_and_complete(item):
    path = bench.FMUS / item.file
    assert validate_fmu(str(path)) == []
    binaries = sorted(name for name in members(path) if name.startswith("binaries/"))
    folders = {
        "2.0": ["darwin64", "linux64", "win64"],
        "3.0": ["aarch64-darwin", "x86_64-darwin", "x86_64-linux", "x86_64-windows"],
    }
    assert [name.split("/")[1] for name in binaries] == folders[item.fmi_version]
    for variable in fmpy.read_model_description(str(path)).modelVariables:
        # A constant of nature, such as 2 pi, says what it is by its name.
        assert variable.description or variable.variability == "constant", variable.name
        assert variable.unit or variable.type == "Boolean", variable.name


@pytest.mark.parametrize("item", LIBRARY, ids=lambda item: item.file)
def test_every_port_and_parameter_is_in_the_readme(item):
    """Scalars by their names, arrays in one row: `name[size]`, and the units of the elements."""
    readme = (bench.FMUS / item.name / "README.md").read_text(encoding="utf-8")
    arrays: dict[tuple[str, str], list[str]] = {}
    for variable in fmpy.read_model_description(str(bench.FMUS / item.file)).modelVariables:
        if variable.causality in ("input", "output", "parameter"):
            name, bracket, _ = variable.name.partition("[")
            if bracket:
                arrays.setdefault((name, variable.causality), []).append(variable.unit)
            else:
                assert f"| `{variable.name}` | {variable.causality} | {variable.unit or '-'} |" in readme
    for (name, causality), units in arrays.items():
        assert f"| `{name}[{len(units)}]` | {causality} | {', '.join(dict.fromkeys(units))} |" in readme


def test_unknown_name():
    with pytest.raises(BuildError) as caught:
        build_library(bench.ROOT, names=["Robot"])
    assert str(caught.value) == (
        f"no shipped FMU Robot; shipped: {', '.join(dict.fromkeys(item.name for item in LIBRARY))}"
    )
