"""Systems of parts and connections without a config, and what is reported of those that are none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from orchestrator.base.errors import ConfigError, Problem
from orchestrator.config import Absent, BondModel, ConnectionModel, Gaps, Places
from orchestrator.system.assembly import Part, assemble_instances
from orchestrator.system.system import System


def assemble(
    parts: Iterable[Part],
    connections: Iterable[str | ConnectionModel | Mapping[str, Any]] = (),
    *,
    record: Sequence[str] | None = None,
    needed: Mapping[str, tuple[str, ...]] | None = None,
    places: Places | None = None,
    problems: Iterable[Problem] = (),
    absent: frozenset[str] = frozenset(),
    loops: bool = False,
    step_size: float | None = None,
    folder: Path | None = None,
    bonds: Sequence[BondModel] | None = None,
    keep: bool = True,
) -> System:
    """As `assemble_instances`; `problems` were found earlier. Raises: ConfigError with all problems."""
    judged = assemble_instances(
        list(parts),
        connections,
        record=None if record is None else {one: ("run", "record", n) for n, one in enumerate(record)},
        needed=needed,
        places=places or Places("system"),
        absent=Absent(absent),
        loops=loops,
        step_size=step_size,
        folder=folder or Path.cwd(),
        bonds=bonds,
        gaps=Gaps(),
        keep=keep,
    )
    if found := [*problems, *judged.problems]:
        raise ConfigError(found, judged.unchecked)
    return judged.system


def refusal(parts, connections=(), **options) -> str:
    """What is reported about them, as of a config docking.yaml."""
    with pytest.raises(ConfigError) as caught:
        assemble(parts, connections, places=Places("docking.yaml"), **options)
    return str(caught.value)
