"""Laws of friction as an FMU made from Modelica, for systems that are to be exported."""

from __future__ import annotations

from typing import Any

from ...effects import Effect as ConnectionEffect
from . import laws
from .effect import PortEffect

__all__ = ["FMU", "add_instance", "form_of"]

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


def add_instance(
    data: dict[str, Any], connections: list[dict[str, Any]], effect: PortEffect, law: ConnectionEffect
) -> None:
    """Put a law into a config as an instance of the FMU, its force added where the law acts.

    Args:
        connections: of the config, in the long form.
    """
    port, (read,) = effect.port, effect.reads
    assert port is not None
    form, sign = form_of(law), float(getattr(law, "sign", -1))
    assert form is not None
    name = f"friction_{port.instance}"
    while name in data["instances"]:
        name += "_"
    data["instances"][name] = {"fmu": FMU, "start": form}
    leg = {"port": f"{name}.force", "gain": sign}
    fed = [one for one in connections if one["to"] == str(port)]
    given = [one for one in connections if any(before["port"] == str(port) for before in one["from"])]
    source = next((one["from"] for one in connections if one["to"] == str(read)), [{"port": str(read)}])
    connections.append({"from": source, "to": f"{name}.velocity", "through": []})
    for one in fed or given:
        one["from"] = [*one["from"], leg]
    if not fed and not given:
        start = data["instances"][port.instance]["start"].pop(port.variable, None)
        constant = [{"offset": start}] if start is not None and _size(start) != 0.0 else []
        connections.append({"from": [leg], "to": str(port), "through": constant})


def _size(start: Any) -> float:
    return float(str(start).split()[0])
