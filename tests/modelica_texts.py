"""FMUs of models that tests write as Modelica texts."""

from __future__ import annotations

from pathlib import Path

import pytest

import orchestrator as orc


def built_models(folder: Path, *texts: str) -> dict[str, str]:
    """Paths of the FMUs of models, by the models' names; skips where the extra build is not installed."""
    pytest.importorskip("casadi", reason="needs the extra build")
    built = {}
    for text in texts:
        name = text.split()[1]
        (folder / f"{name}.mo").write_text(text, encoding="utf-8")
        built[name] = str(orc.build(folder / f"{name}.mo", folder / f"{name}.fmu").path)
    return built
