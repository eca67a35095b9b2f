"""What the README and the pages under docs/ show as configs and studies is taken as it stands there."""

from __future__ import annotations

import inspect
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

import orchestrator
from orchestrator.campaign import Study
from orchestrator.cli.main import COMMANDS, main
from orchestrator.config import json_schema

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGES = sorted(ROOT.glob("docs/*.md"))
GUIDE = ROOT / "CONTRIBUTING.md"
TEXTS = {one.relative_to(ROOT).as_posix(): one.read_text(encoding="utf-8") for one in (README, GUIDE, *PAGES)}


def blocks() -> list[str]:
    """All blocks of YAML, of the README and of the pages."""
    found = (re.findall(r"```yaml\n(.*?)```", one, flags=re.DOTALL) for one in TEXTS.values())
    return [block for page in found for block in page]


def block(begin: str) -> str:
    """The one block of YAML that begins with a line, which is the same wherever it stands."""
    (found,) = {one for one in blocks() if one.startswith(begin)}
    return found


def prose(text: str) -> str:
    """A page without its blocks of code and the code within its lines."""
    return re.sub(r"`[^`\n]*`", "", re.sub(r"```.*?```", "", text, flags=re.DOTALL))


def links(text: str) -> list[str]:
    """What a page's links point at, other sites aside."""
    return [one for one in re.findall(r"\]\(([^)]+)\)", prose(text)) if "://" not in one]


def anchors(text: str) -> set[str]:
    """What a link can name of a page: its headings, as they are turned into anchors."""
    heads = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.M)
    return {re.sub(r"[^a-z0-9 _-]", "", one.lower()).replace(" ", "-") for one in heads}


def test_the_config_of_the_readme_is_one(tmp_path, capsys):
    path = tmp_path / "my-system.yaml"
    path.write_text(block("# my-system.yaml"), encoding="utf-8")
    assert main(["check", str(path), "--set", "run.step_size=50 us"]) == 0
    assert capsys.readouterr().out.startswith("my-system: 3 instances, 4 connections")


def test_the_study_of_the_pages_is_one(tmp_path):
    path = tmp_path / "delays.yaml"
    path.write_text(block("# delays.yaml"), encoding="utf-8")
    assert len(Study.load(path)) == 600


def test_blocks_of_yaml_are_yaml():
    assert all(isinstance(yaml.safe_load(one), dict) for one in blocks())


@pytest.mark.parametrize(
    ("page", "link"), [(page, link) for page, text in TEXTS.items() for link in sorted(set(links(text)))]
)
def test_links_lead_somewhere(page, link):
    name, _, anchor = link.partition("#")
    target = (ROOT / page).parent / name if name else ROOT / page
    assert target.exists()
    if anchor:
        assert anchor in anchors(target.read_text(encoding="utf-8"))


def test_every_page_is_reached_from_the_readme_and_has_a_place_on_the_site():
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    placed = {f"docs/{one}" for one in _leaves(nav)}
    pages = {one for one in TEXTS if one.startswith("docs/")}
    assert placed - {"docs/contributing.md"} == pages
    assert pages - set(links(TEXTS["README.md"])) == set()


def _leaves(nav: Any) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    return [leaf for one in (nav.values() if isinstance(nav, dict) else nav) for leaf in _leaves(one)]


def test_the_readme_is_one_screen():
    assert len(TEXTS["README.md"].splitlines()) <= 120


def test_the_python_of_the_pages_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for page in ("docs/index.md", "docs/python.md", "docs/frequency.md"):
        code = re.findall(r"```python\n(.*?)```", TEXTS[page], flags=re.DOTALL)
        assert code
        exec("\n".join(code), {})


def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("mkdocs", reason="mkdocs-material is not installed")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for name, content in (
        ("python", "to_dataframe"),
        ("reference-config", "record_every"),
        ("commands", "--at-time"),
    ):
        page = (tmp_path / "site" / name / "index.html").read_text(encoding="utf-8")
        assert content in page
        sources = re.findall(r'(?:src|href)="(https?://[^"]+)"', page)
        assert [one for one in sources if "squidfunk" not in one] == []
    for name in ("diagnosis", "frequency", "masters", "diagnosis-any-system", "fmus/PointContact"):
        page = (tmp_path / "site" / name / "index.html").read_text(encoding="utf-8")
        shown = re.findall(r'class="arithmatex">(.*?)</(?:span|div)>', page, re.S)
        assert shown and all(one.startswith("<math ") for one in shown)
        assert "$" not in re.sub(r"<(script|pre|code).*?</\1>", "", page, flags=re.S)


@pytest.fixture(scope="module")
def reference() -> dict[str, str]:
    """The generated parts of the pages by name."""
    pages = runpy.run_path(str(ROOT / "docs" / "reference.py"))["PAGES"]
    return {name: make() for name, make in pages.items()}


def test_the_reference_gives_type_default_and_meaning_of_every_key(reference):
    for name in ("config-keys", "study-keys"):
        rows = re.findall(r"^\| `(.*)$", reference[name], re.M)
        cells = [re.split(r"(?<!\\)\|", row) for row in rows]
        assert {len(one) for one in cells} == {6}
        incomplete = [one[0] for one in cells if not all(one[place].strip() for place in (0, 1, 3, 4))]
        assert incomplete == []


def test_the_reference_holds_every_key_of_the_schema(reference):
    schema = json_schema()
    parts = [schema, *schema["$defs"].values()]
    keys = {key for one in parts for key in one.get("properties", {})} - {"extends"}
    assert {key for key in keys if f"| `{key}` |" not in reference["config-keys"]} == set()


def test_the_reference_holds_units_and_defaults(reference):
    assert "| `timeout` | quantity | s | `1 s` |" in reference["config-keys"]
    assert "| `rate` | quantity | of the signal, per s | required |" in reference["config-keys"]
    assert (
        "| `count` | integer |  | required | Number of values, both ends included. Allowed: at least 2"
        in (reference["study-keys"])
    )


def test_the_reference_holds_every_command_and_option(reference, capsys):
    for name in COMMANDS:
        with pytest.raises(SystemExit):
            main([name, "--help"])
        options = set(re.findall(r"^  (?:-\w, )?(--[\w-]+)", capsys.readouterr().out, re.M)) - {"--help"}
        (section,) = re.findall(
            rf"^### orchestrator {name}\n.*?(?=^### |\Z)", reference["commands"], re.M | re.S
        )
        assert {one for one in options if one not in section} == set()


def test_the_reference_holds_every_public_name_and_argument(reference):
    for name in orchestrator.__all__:
        if name == "__version__":
            continue
        one = getattr(orchestrator, name)
        head = name if isinstance(one, type) else f"orc.{name}"
        (section,) = re.findall(rf"^### {head}\n.*?(?=^##|\Z)", reference["python-api"], re.M | re.S)
        if not isinstance(one, type):
            assert {key for key in inspect.signature(one).parameters if f"`{key}`" not in section} == set(), (
                name
            )
