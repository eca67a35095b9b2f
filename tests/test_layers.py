"""Packages import only packages of lower layers, modules form no circles, and FMU sources stand alone."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import grimp
import pytest

from orchestrator.base import graph
from orchestrator.cli.main import COMMANDS, function

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "orchestrator"


@pytest.fixture(scope="module")
def imports() -> grimp.ImportGraph:
    return grimp.build_graph("orchestrator", cache_dir=None)


def test_the_layers_are_kept(monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(ROOT)
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    assert all("ignore_imports" not in one for one in contracts["contracts"])
    from importlinter.cli import lint_imports

    assert lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True) == 0


def test_modules_form_no_circles(imports):
    modules = sorted(imports.modules)
    place = {name: index for index, name in enumerate(modules)}
    after = [
        sorted(place[one] for one in imports.find_modules_directly_imported_by(name)) for name in modules
    ]
    rounds = [one for one in graph.strong_components(after) if len(one) > 1]
    assert not rounds, [[modules[index] for index in one] for one in rounds]


def test_packages_say_what_they_own():
    entries = sorted(one for one in PACKAGE.iterdir() if (one / "__init__.py").exists())
    assert len(entries) <= 17
    for entry in entries:
        text = ast.get_docstring(ast.parse((entry / "__init__.py").read_text(encoding="utf-8")))
        assert text and "import" in text.lower(), f"{entry.name}: what it owns and what it may import"


@pytest.mark.parametrize("name", COMMANDS)
def test_what_commands_name_as_text_is_there(name):
    _, declares, runs = COMMANDS[name]
    for place in filter(None, (declares, runs)):
        assert callable(function(place)), place


def test_fmu_sources_and_the_package_do_not_import_each_other():
    for path in (ROOT / "fmus").rglob("*.py"):
        names = {
            name.split(".")[0]
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            for name in (
                [one.name for one in node.names]
                if isinstance(node, ast.Import)
                else [node.module or ""]
                if isinstance(node, ast.ImportFrom)
                else []
            )
        }
        assert "orchestrator" not in names, path
    for path in PACKAGE.rglob("*.py"):
        assert "import fmus" not in path.read_text(encoding="utf-8")
