"""Plain numbers from Python code, which are in SI units, as the texts with units that configs have."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from functools import cached_property
from math import isfinite
from typing import Any

from ..base.units import ONE
from ..config import Config, Draft, read_config
from ..config.overrides import override_path
from ..config.text import copied, flow
from ..effects.choose import with_units
from ..fmi import Variable
from .instance_models import configured_instances

_TIMES = ("start_time", "stop_time", "step_size")


def in_config_units(source: Mapping[str, Any]) -> dict[str, Any]:
    """A config from Python code, whose plain numbers are in SI units, as a config file has it.

    Times, start values and options of effects receive their units. What has not the form of a config stays
    as it is: reading the config reports it.
    Raises: ConfigError if it cannot be read.
    """
    data = copied(source)
    instances = data.get("instances")
    parts = {"": data.get("run"), **(instances if isinstance(instances, dict) else {})}
    for part in parts.values():
        for name in _TIMES if isinstance(part, dict) else ():
            if _is_number(part.get(name)):
                part[name] = f"{part[name]!r} s"
    for link in data.get("connections") or ():
        if isinstance(link, dict) and isinstance(link.get("through"), list):
            link["through"] = [with_units(one) for one in link["through"]]
    starts = {name: part["start"] for name, part in parts.items() if name and _has_numbers(part)}
    config = read_config(data).config if starts else None
    if config is not None:
        numbers = SiNumbers(config)
        for name, start in starts.items():
            start.update({key: numbers.start(name, key, one) for key, one in start.items()})
    return data


def _has_numbers(part: Any) -> bool:
    start = part.get("start") if isinstance(part, dict) else None
    return isinstance(start, dict) and not all(isinstance(one, str) for one in start.values())


class SiNumbers:
    """Convert SI numbers to the texts with units that a config has. Texts stay as they are."""

    def __init__(self, config: Config) -> None:
        """
        Args:
            config: its FMUs say in which units their variables are.
        """
        self._config = config

    @cached_property
    def _data(self) -> dict[str, Any]:
        return self._config.model.to_data()

    @cached_property
    def _variables(self) -> Mapping[str, Mapping[str, Variable]]:
        # What is wrong with FMUs is reported when the system is checked.
        parts = configured_instances(Draft(self._config)).parts
        return {part.name: part.fmu.description.variables for part in parts}

    def override(self, path: str, value: Any) -> str:
        """An override as the command line takes it: "robot.tau_m=0.006 s"."""
        made = self.value(path, value)
        return f"{path}={made if isinstance(made, str) else flow({'value': made})[len('{value: ') : -1]}"

    def value(self, path: str, value: Any) -> Any:
        """What a config has at a path for a text, a number or a list of numbers."""
        value = value.tolist() if hasattr(value, "tolist") else value
        where = override_path(self._data, path)
        if where is None:
            return value
        if where[0] == "run" and where[-1] in _TIMES and _is_number(value):
            return f"{value!r} s"
        if where[0] == "instances" and len(where) > 3 and where[2] == "start":
            return self.start(str(where[1]), str(where[3]), value)
        return value

    def start(self, instance: str, name: str, value: Any) -> Any:
        """What a config has for a start value of an instance."""
        value = value.tolist() if hasattr(value, "tolist") else value
        if isinstance(value, list | tuple):
            return [self.start(instance, name, one) for one in value]
        variables = self._variables.get(instance, {})
        # An element of an array, x[1], has the array's unit.
        variable = variables.get(name) or variables.get(name.partition("[")[0])
        if variable is None or not _is_number(value) or not variable.unit_name or variable.unit == ONE:
            return value
        if variable.unit is None or not isfinite(value):
            return f"{value!r} {variable.unit_name}"
        own = (Fraction(value) - variable.unit.offset) / variable.unit.factor
        return f"{float(own)!r} {variable.unit_name}"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
