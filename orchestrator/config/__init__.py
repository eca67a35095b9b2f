"""Configs: YAML files that say which FMUs run, how they are connected and what is measured.

Imports `base`, `fmi` and `effects`.
"""

from .external import ExternalModel, RealtimeModel
from .files import file_of, move_effects, move_value
from .load import Config, Draft, json_schema, load_config, read_config
from .models import BondModel, ConnectionModel, InstanceModel, RunModel, Scalar, SourceModel, SystemModel
from .overrides import override_path, put_value, unknown_path
from .partial_config import correct_spelling
from .problems import path_within, validation_problems
from .text import Place, Places, compose, copied, dump, parse, path_text
from .unresolved import Absent, Gaps

__all__ = [
    "Absent",
    "BondModel",
    "Config",
    "ConnectionModel",
    "Draft",
    "ExternalModel",
    "Gaps",
    "InstanceModel",
    "Place",
    "Places",
    "RealtimeModel",
    "RunModel",
    "Scalar",
    "SourceModel",
    "SystemModel",
    "compose",
    "copied",
    "correct_spelling",
    "dump",
    "file_of",
    "json_schema",
    "load_config",
    "move_effects",
    "move_value",
    "override_path",
    "parse",
    "path_text",
    "path_within",
    "put_value",
    "read_config",
    "unknown_path",
    "validation_problems",
]
