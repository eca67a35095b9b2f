"""Configs: YAML files that say which FMUs run, how they are connected and what is measured."""

from .load import Config, json_schema, load_config, validation_problems
from .models import ConnectionModel, InstanceModel, RunModel, Scalar, SystemModel, endpoints
from .text import Place, Places, dump, parse, path_text

__all__ = [
    "Config",
    "ConnectionModel",
    "InstanceModel",
    "Place",
    "Places",
    "RunModel",
    "Scalar",
    "SystemModel",
    "dump",
    "endpoints",
    "json_schema",
    "load_config",
    "parse",
    "path_text",
    "validation_problems",
]
