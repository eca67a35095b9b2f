"""What the README shows as configs and studies is taken as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from orchestrator.__main__ import main
from orchestrator.campaign import Study

README = Path(__file__).parents[1] / "README.md"


def block(begin: str) -> str:
    """The one block of YAML that begins with a line."""
    blocks = re.findall(r"```yaml\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    (found,) = [one for one in blocks if one.startswith(begin)]
    return found


def test_the_config_of_the_readme_is_one(tmp_path, capsys):
    path = tmp_path / "my-system.yaml"
    path.write_text(block("# my-system.yaml"), encoding="utf-8")
    assert main(["check", str(path), "--set", "run.step_size=50 us"]) == 0
    assert capsys.readouterr().out.startswith("my-system: 3 instances, 4 connections")


def test_the_study_of_the_readme_is_one(tmp_path):
    path = tmp_path / "delays.yaml"
    path.write_text(block("# delays.yaml"), encoding="utf-8")
    assert len(Study.load(path)) == 600


@pytest.mark.parametrize(
    "name", sorted(set(re.findall(r"\]\(([^):#]+)\)", README.read_text(encoding="utf-8"))))
)
def test_links_of_the_readme_lead_somewhere(name):
    assert (README.parent / name).exists()


def test_the_contents_of_the_readme_name_its_sections():
    text = README.read_text(encoding="utf-8")
    heads = [
        re.sub(r"[^a-z0-9 -]", "", one.lower()).replace(" ", "-")
        for one in re.findall(r"^## (.*)$", text, re.M)
    ]
    assert re.findall(r"\]\(#([^)]*)\)", text) == [one for one in heads if one != "licence"]
