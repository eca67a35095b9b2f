"""Parts and connections that no system is made of."""

from __future__ import annotations

import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.config import Places
from orchestrator.system.assembly import assemble


def refusal(parts, connections=(), **options) -> str:
    """What is reported about them, as of a config docking.yaml."""
    with pytest.raises(ConfigError) as caught:
        assemble(parts, connections, places=Places("docking.yaml"), **options)
    return str(caught.value)
