"""A system with the effects that were found, as a config that runs."""

from __future__ import annotations

from typing import Any

from ...config.text import dump
from ...effects import Effect as ConnectionEffect
from ...effects import OfSignal, Pure
from ...effects.choose import BUILT_IN, built_in
from ...effects.gain import split
from ...fmi import Causality
from ...system.connection import Port
from ..effect import by_effect
from ..finding import Augmented, Finding
from .effect import PortEffect
from .friction_fmu import Placed, to_instances
from .study import PortStudy

__all__ = ["augmented_config", "config_data", "long_form", "parameter_values", "short_form", "with_unit"]


def augmented_config(study: PortStudy, finding: Finding, fmus: bool = False) -> tuple[str, dict[str, str]]:
    """The config with the answer's effects and calibration, as YAML; and what it does not hold, and why.

    Effects stand under `through` of the connections that they act on. An effect at an output acts on all
    connections from it, before their gains; one at a free input is fed by a connection of its own.

    Args:
        fmus: whether laws of friction that are added to a force stand as instances of FrictionForce, so that
            the system can be exported; what they give is added from one communication point to the next.
            Those that cannot, and stand as effects in it, are reported with what it does not hold.
    """
    data = config_data(study)
    _calibrate(study, data, finding.answer)
    connections = [long_form(one) for one in data.get("connections", [])]
    left_out: dict[str, str] = {}
    placed: list[Placed] = []
    for effect, theta in by_effect(finding.answer.effects, finding.answer.theta):
        if isinstance(effect, PortEffect) and effect.port is not None and effect.make is not None:
            made = effect.make(theta)
            entry = _entry(made, effect, study)
            reason = _unread(study, effect, finding.answer) or _insert(
                study, data, connections, effect, entry
            )
            if reason:
                left_out[effect.id] = reason
            else:
                placed.append(Placed(effect, made, entry))
    if fmus:
        left_out |= to_instances(study, data, connections, placed)
    data["connections"] = [short_form(one) for one in connections]
    found = "with the effects found" if finding.answer.effects else "as calibrated by logs"
    data["title"] = f"{data.get('title', study.prepared.config.name)}, {found}"
    return dump(data), left_out


def config_data(study: PortStudy) -> dict[str, Any]:
    """The study's config as data to change; FMUs beside it stand with their full path."""
    config = study.prepared.config
    data = config.model.to_data()
    data["instances"] = {name: dict(one) for name, one in data["instances"].items()}
    for one in data["instances"].values():
        one["start"] = dict(one.get("start", {}))
        if (config.folder / one["fmu"]).is_file():
            one["fmu"] = str((config.folder / one["fmu"]).resolve())
    return data


def parameter_values(study: PortStudy, answer: Augmented) -> dict[str, float]:
    """All calibrated parameters and those that the answer's effects change, as they are with the answer."""
    values = {name: answer.calibrated.get(name, one.value) for name, one in study.nominal.items()}
    for effect, theta in by_effect(answer.effects, answer.theta):
        for name in effect.changes:
            before = values[name] if name in values else study.prepared.system.start(Port.of(name))
            values[name] = before + float(theta[0])
    return values


def _calibrate(study: PortStudy, data: dict[str, Any], answer: Augmented) -> None:
    for name, value in parameter_values(study, answer).items():
        port = Port.of(name)
        data["instances"][port.instance]["start"][port.variable] = with_unit(value, study.unit(port))


def long_form(one: Any) -> dict[str, Any]:
    """A connection with its sources as a list, each with its port, and how many of its effects act ahead of
    its own.
    """
    if isinstance(one, str):
        source, _, target = one.partition("->")
        one = {"from": source.strip(), "to": target.strip()}
    legs = one["from"] if isinstance(one["from"], list) else [one["from"]]
    legs = [dict(leg) if isinstance(leg, dict) else {"port": leg} for leg in legs]
    return {**one, "from": legs, "through": list(one.get("through", [])), "ahead": 0}


def short_form(one: dict[str, Any]) -> Any:
    """A connection as one writes it."""
    one = {key: value for key, value in one.items() if key != "ahead"}
    legs = [leg if "gain" in leg else leg["port"] for leg in one["from"]]
    if len(legs) > 1 or isinstance(legs[0], dict):
        return {**one, "from": legs}
    return {**one, "from": legs[0]} if one["through"] else f"{legs[0]} -> {one['to']}"


def _unread(study: PortStudy, effect: PortEffect, answer: Augmented) -> str:
    """Why what an effect reads cannot be read from an output; "" if it can."""
    system = study.prepared.system
    for port in effect.reads:
        if system.variable(port).causality is Causality.OUTPUT:
            continue
        feeding = next((one for one in system.connections if one.target == port), None)
        if feeding is None or feeding.wire is not None:
            return f"it reads {port}, which is no output as it comes"
        for one in answer.effects:
            if isinstance(one, PortEffect) and one.port in (port, feeding.source):
                return f"it reads {port} behind {one.id}, and effects read outputs"
    return ""


def _insert(
    study: PortStudy,
    data: dict[str, Any],
    connections: list[dict[str, Any]],
    effect: PortEffect,
    entry: dict[str, Any],
) -> str:
    """Put an effect where it acts; why there is no such place, "" if there is."""
    port = effect.port
    assert port is not None
    name = str(port)
    if study.prepared.system.variable(port).causality is Causality.OUTPUT:
        fed = [one for one in connections if any(leg["port"] == name for leg in one["from"])]
        for one in fed:
            if len(one["from"]) > 1:
                return f"{one['to']} is fed a sum, and effects act on sums, not on {port} alone"
        for one in fed:
            (leg,) = one["from"]
            # What acts on one connection alone, its gain and effects, comes after.
            if "gain" in leg:
                one["through"].insert(one["ahead"], {"gain": leg.pop("gain")})
            one["through"].insert(one["ahead"], entry)
            one["ahead"] += 1
        return "" if fed else f"{port} feeds nothing in this system"
    feeding = next((one for one in connections if one["to"] == name), None)
    if feeding is None:
        own = next(one for one in study.prepared.system.recorded if one.instance == port.instance)
        unit, source = study.unit(port), study.unit(own)
        start = data["instances"][port.instance]["start"].pop(port.variable, None)
        # Nothing of the source comes through: effects need a signal to act on.
        zero = {"port": str(own), "gain": f"0 {unit}/{source}" if "/" not in source else _per(unit, source)}
        through = [{"offset": start}] if start is not None and split(start)[0] != 0.0 else []
        feeding = {"from": [zero], "to": name, "through": through, "ahead": 0}
        connections.append(feeding)
    feeding["through"].append(entry)
    return ""


def _per(unit: str, source: str) -> str:
    """Zero, in a unit over another that is a quotient itself."""
    above, _, below = source.partition("/")
    return f"0 {unit}.{below}/{above}"


def _entry(made: ConnectionEffect, effect: PortEffect, study: PortStudy) -> dict[str, Any]:
    """An effect as an entry of `through`."""
    names = {built_in(name): name for name in BUILT_IN}
    options: dict[str, Any] = {}
    port = effect.port
    assert port is not None
    unit = next((one.unit for one in effect.parameters if one.name in ("level", "offset")), study.unit(port))
    for key, field in type(made).model_fields.items():
        value = getattr(made, key)
        if value is None or (field.exclude and key == "unit"):
            continue
        marks = [mark for mark in field.metadata if isinstance(mark, Pure | OfSignal)]
        if not marks:
            options[key] = value
        elif isinstance(marks[0], Pure):
            options[key] = with_unit(value, marks[0].unit)
        else:
            parameter = next((one for one in effect.parameters if one.name == key), None)
            own = parameter.unit if parameter is not None and marks[0].per else unit
            options[key] = with_unit(
                value, f"{own}/{marks[0].per}" if marks[0].per and parameter is None else own
            )
    kind = type(made)
    if kind in names:
        return {names[kind]: options}
    read = {name: str(_source(study, one)) for name, one in zip(kind.reads, effect.reads, strict=True)}
    return {"effect": f"{kind.__module__}:{kind.__qualname__}", **options, "read": read}


def _source(study: PortStudy, port: Port) -> Port:
    """The output in which a port shows."""
    for one in study.prepared.system.connections:
        if one.target == port:
            return one.source
    return port


def with_unit(value: float, unit: str) -> Any:
    """A number with its unit, as configs have it."""
    return float(value) if unit in ("", "1") else f"{float(value)!r} {unit}"
