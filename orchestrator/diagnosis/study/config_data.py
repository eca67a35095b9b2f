"""A study's config as data that can be changed and written again."""

from __future__ import annotations

from typing import Any

from .study import PortStudy


def config_data(study: PortStudy) -> dict[str, Any]:
    """The study's config as data; FMUs beside it stand with their full path."""
    config = study.prepared.config
    data = config.model.to_data()
    data["instances"] = {name: dict(one) for name, one in data["instances"].items()}
    for one in data["instances"].values():
        one["start"] = dict(one.get("start", {}))
        if (config.folder / one["fmu"]).is_file():
            one["fmu"] = str((config.folder / one["fmu"]).resolve())
    return data


def long_form(one: Any) -> dict[str, Any]:
    """A connection with its sources as a list, each with its port, and its effects as a list."""
    if isinstance(one, str):
        source, _, target = one.partition("->")
        one = {"from": source.strip(), "to": target.strip()}
    legs = one["from"] if isinstance(one["from"], list) else [one["from"]]
    legs = [dict(leg) if isinstance(leg, dict) else {"port": leg} for leg in legs]
    return {**one, "from": legs, "through": list(one.get("through", []))}


def short_form(one: dict[str, Any]) -> Any:
    """A connection as one writes it."""
    legs = [leg if "gain" in leg else leg["port"] for leg in one["from"]]
    if len(legs) > 1 or isinstance(legs[0], dict):
        return {**one, "from": legs}
    return {**one, "from": legs[0]} if one["through"] else f"{legs[0]} -> {one['to']}"


def with_unit(value: float, unit: str) -> Any:
    """A number with its unit, as configs have it."""
    return float(value) if unit in ("", "1") else f"{float(value)!r} {unit}"
