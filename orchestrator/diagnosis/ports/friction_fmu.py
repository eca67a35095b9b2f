"""Laws of friction as an FMU made from Modelica, for systems that are to be exported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from ...effects import Effect as ConnectionEffect
from ...effects.gain import split
from . import laws
from .effect import PortEffect, unit_at
from .study import PortStudy

__all__ = ["FMU", "Placed", "form_of", "to_instances"]

FMU = "FrictionForce"
# Options of each law: the FMU's parameter and its unit.
_WIDTH = {"width": ("width", "m/s")}
_STRIBECK = {"excess": ("excess", "1"), "speed": ("stribeck_velocity", "m/s")}
_BUILT = {"level": ("level", "N"), "distance": ("distance", "m")}
_FORMS: dict[type[ConnectionEffect], dict[str, tuple[str, str]]] = {
    laws.Coulomb: {"level": ("level", "N"), **_WIDTH},
    laws.Stribeck: {"level": ("level", "N"), **_STRIBECK, **_WIDTH},
    laws.Viscous: {"damping": ("viscous", "N.s/m")},
    laws.OneSided: {"damping": ("one_sided", "N.s/m")},
    laws.Drag: {"drag": ("drag", "N.s2/m2")},
    laws.Spring: {"stiffness": ("stiffness", "N/m")},
    laws.Dahl: _BUILT,
    laws.LuGre: {**_BUILT, **_STRIBECK},
    laws.MaxwellSlip: {"level": ("slip_level", "N"), "distance": ("slip_distance", "m")},
}


class Placed(NamedTuple):
    """An effect that was found, and its entry under `through` of a config's connections."""

    effect: PortEffect
    made: ConnectionEffect
    entry: dict[str, Any]


def form_of(law: ConnectionEffect) -> dict[str, Any] | None:
    """Start values of the FMU that make it a law; None for what it has no form for.

    Laws that soften the friction of a component are a part of that component: no force that can be added.
    """
    options = _FORMS.get(type(law))
    if options is None:
        return None
    return {
        name: float(getattr(law, key)) if unit == "1" else f"{float(getattr(law, key))!r} {unit}"
        for key, (name, unit) in options.items()
    }


def to_instances(
    study: PortStudy, data: dict[str, Any], connections: list[dict[str, Any]], placed: Sequence[Placed]
) -> dict[str, str]:
    """Put laws that stand as effects in a config into it as instances of the FMU, added to what is fed.

    Only where the force does not depend on what is added first: where all else that acts is added, too.

    Args:
        connections: of the config, with their sources as lists.
        placed: the effects that were found, in it.
    Returns: laws that stand as effects still, and why.
    """
    added = [one.entry for one in placed if form_of(one.made) is not None]
    kept: dict[str, str] = {}
    for one in placed:
        if not one.effect.reads:
            continue
        at = [to for to in connections if any(entry is one.entry for entry in to["through"])]
        others = [
            (entry.get("effect", next(iter(entry))), to["to"])
            for to in at
            for entry in to["through"]
            if next(iter(entry)) != "offset" and not any(entry is other for other in added)
        ]
        port, (read,) = one.effect.port, one.effect.reads
        assert port is not None
        if form_of(one.made) is None:
            kept[one.effect.id] = f"{FMU} has no such law"
        elif (unit_at(study, port), unit_at(study, read)) != ("N", "m/s"):
            kept[one.effect.id] = f"{FMU} takes m/s and gives N"
        elif others:
            kept[one.effect.id] = "{} acts at {}, too, and would act on the sum".format(*others[0])
        else:
            _add_instance(data, connections, at, one)
    return kept


def _add_instance(
    data: dict[str, Any], connections: list[dict[str, Any]], at: Sequence[dict[str, Any]], law: Placed
) -> None:
    """Add the force of an instance at some connections, in place of an effect."""
    port, (read,) = law.effect.port, law.effect.reads
    assert port is not None
    name = f"friction_{port.instance}"
    while name in data["instances"]:
        name += "_"
    data["instances"][name] = {"fmu": FMU, "start": form_of(law.made)}
    leg = {"port": f"{name}.force", "gain": float(getattr(law.made, "sign", -1))}
    source = next((one["from"][0]["port"] for one in connections if one["to"] == str(read)), str(read))
    velocity = {"from": [{"port": source}], "to": f"{name}.velocity", "through": []}
    for one in at:
        # A source that nothing comes from only gave effects a signal to act on.
        one["from"] = [*(other for other in one["from"] if split(other.get("gain", 1))[0] != 0.0), leg]
        one["through"] = [entry for entry in one["through"] if entry is not law.entry]
    connections.append(velocity)
