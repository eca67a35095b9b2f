"""FMUs and studies that tests of several subjects share."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from ports_bench import study


@pytest.fixture(scope="module")
def fmus(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the FMUs of the Modelica models that the module of a test lists as MODELS."""
    folder = tmp_path_factory.mktemp("fmus")
    for name, text in request.module.MODELS.items():
        (folder / f"{name}.mo").write_text(text, encoding="utf-8")
        subprocess.run(
            [sys.executable, "-m", "orchestrator", "build", f"{name}.mo"],
            cwd=folder, check=True, capture_output=True,
        )  # fmt: skip
    return folder


@pytest.fixture(scope="module")
def noiseless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study whose logs the system itself made, without noise."""
    return study(tmp_path_factory.mktemp("noiseless"), seed=None)
