"""Studies of the positioning system that tests of several subjects share."""

from __future__ import annotations

from pathlib import Path

import pytest
from ports_bench import study


@pytest.fixture(scope="module")
def noiseless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study whose logs the system itself made, without noise."""
    return study(tmp_path_factory.mktemp("noiseless"), seed=None)
