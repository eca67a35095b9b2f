"""The commands `orchestrator list` and `orchestrator schema`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from .arguments import print_json

if TYPE_CHECKING:
    import argparse


def list_known(args: argparse.Namespace) -> int:
    """Print names of what is bundled or registered."""
    from ..effects import effect_names
    from ..fmi import bundled
    from ..master import master_names
    from ..results.measures import measure_names

    known = {
        "systems": bundled.system_names(),
        "FMUs": bundled.fmu_names(),
        "masters": master_names(),
        "effects": effect_names(),
        "measures": measure_names(),
    }
    if print_json(args, known):
        return 0
    for title, names in known.items():
        print(f"{title}:")
        for name in names:
            print(f"  {name}")
    return 0


def schema(args: argparse.Namespace) -> int:
    """Print the JSON Schema of configs."""
    from ..config import json_schema

    print(json.dumps(json_schema(), indent=2))
    return 0
