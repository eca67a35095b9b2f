"""Studies of the positioning system that tests of several subjects share."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from ports_bench import COULOMB, TIED, study

from orchestrator.diagnosis.effect import Effect
from orchestrator.diagnosis.ports.candidates import candidates
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import measure
from orchestrator.diagnosis.ports.study import PortStudy

EXPERIMENTS = [
    {"name": "the same again", "set": ["run.stop_time=2 s", "path.stroke=0.2 m", "path.frequency=0.5 Hz"]},
    {
        "name": "slow",
        "description": "a slow motion",
        "set": ["run.stop_time=2 s", "path.stroke=10 mm", "path.frequency=0.5 Hz"],
    },
]


@pytest.fixture(scope="module")
def noiseless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study whose logs the system itself made, without noise."""
    return study(tmp_path_factory.mktemp("noiseless"), seed=None)


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory: pytest.TempPathFactory) -> PortStudy:
    """A study with hidden friction."""
    path = study(tmp_path_factory.mktemp("rubbing"), [COULOMB], candidates=TIED, experiments=EXPERIMENTS)
    return load_port_study(path)


@pytest.fixture(scope="module")
def effects(rubbing: PortStudy) -> Mapping[str, Effect]:
    """Its candidates, by id."""
    return {one.id: one for one in candidates(rubbing, measure(rubbing, rubbing.runs[0]))}
