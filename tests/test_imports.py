"""Imports point up the list of layers, and FMU sources and the package never import each other."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from orchestrator.cli.main import COMMANDS, function

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "orchestrator"

# From the bottom up: a module imports only from layers that stand before its own.
LAYERS = [
    "errors", "digests", "whole_file", "folder_lock", "scratch", "bundled", "provenance", "machine_code",
    "units", "quantities", "effects", "config", "fmi", "graph", "fixed_point", "system", "bonds", "checks",
    "arrays", "loops",
    "connecting", "histogram", "external", "parts", "requested", "settling", "assembly", "signals", "wires",
    "initialisation", "culprits", "instance_pool", "instances", "ledger", "master", "native", "pacing",
    "simulate", "stream", "formats", "recorded", "results", "progress", "measures", "plotting", "page",
    "workers", "run_folder", "prepared", "run", "compare", "table", "commands",
    "fmu_tools", "translate", "exchange", "frequency", "docking", "diagnosis", "campaign", "report",
    "__main__",
]  # fmt: skip
# Of the package itself, which stands below them all.
OWN = ("LOADED",)


def layer(module: tuple[str, ...]) -> str | None:
    return module[0] if module else None


def imports(path: Path) -> set[tuple[str, ...]]:
    """Modules of the package that a file imports, as paths within the package; type-only imports left out."""
    package = path.relative_to(PACKAGE).parent.parts
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            node.body = []
    found: set[tuple[str, ...]] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {
                tuple(name.name.split(".")[1:])
                for name in node.names
                if name.name.split(".")[0] == "orchestrator"
            }
        elif isinstance(node, ast.ImportFrom):
            inner = tuple((node.module or "").split(".")) if node.module else ()
            if node.level:
                base = package[: len(package) - node.level + 1]
                target = base + inner
            elif inner[:1] == ("orchestrator",):
                target = inner[1:]
            else:
                continue
            found |= {(*target, name.name) for name in node.names} if not target else {target}
    return found


FILES = sorted(PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_up(path):
    own = path.relative_to(PACKAGE).with_suffix("").parts
    if own == ("__init__",):
        return
    assert layer(own) in LAYERS, f"{path.name} belongs to no layer"
    for module in imports(path):
        used = layer(module)
        if used is None or used == own[0] or used in OWN:
            continue
        assert used in LAYERS, f"{module} belongs to no layer"
        assert LAYERS.index(used) < LAYERS.index(own[0]), f"{'.'.join(own)} imports {'.'.join(module)}"


def test_the_reader_of_imports_sees_them():
    assert ("errors",) in imports(PACKAGE / "assembly.py")
    assert ("bundled",) in imports(PACKAGE / "parts.py")
    assert ("units",) in imports(PACKAGE / "fmi" / "variable.py")


@pytest.mark.parametrize("name", COMMANDS)
def test_what_commands_name_as_text_is_there(name):
    _, declares, runs = COMMANDS[name]
    for place in filter(None, (declares, runs)):
        assert callable(function(place)), place


def test_fmu_sources_and_the_package_are_strangers():
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
    for path in FILES:
        assert "import fmus" not in path.read_text(encoding="utf-8")
