"""modelDescription.xml of a hybrid model, for FMI 2.0 and 3.0, co-simulation and model exchange."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence

from ..declared_units import derivative_unit, used_units
from ..description import add_preamble, written
from .layout import Layout, Port, margins_of

_FMI2 = {"real": "Real", "boolean": "Boolean"}
_FMI3 = {"real": "Float64", "boolean": "Boolean"}


def describe_hybrid(
    layout: Layout,
    experiment: Mapping[str, float],
    *,
    fmi_version: str,
    identifier: str,
    token: str,
    source_files: Iterable[str],
) -> bytes:
    """Write the model description.

    Args:
        layout: the FMU's variables.
        experiment: numbers of the model's annotation.
        fmi_version: "2.0" or "3.0".
        identifier, token: of the FMU.
        source_files: names of the C files in sources/, listed by FMI 2.0.
    """
    second = fmi_version == "2.0"
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": fmi_version,
            "modelName": layout.system.model.name,
            "guid" if second else "instantiationToken": token,
            "generationTool": "orchestrator",
            "variableNamingConvention": "structured",
        },
    )
    # States that constraints bind are no independent ones, as a linearisation takes them for.
    derivatives = "false" if layout.system.constraints else "true"
    indicators = len(margins_of(layout.system.model.modes))
    version = {
        "canGetAndSetFMUstate" if second else "canGetAndSetFMUState": "true",
        "canSerializeFMUstate" if second else "canSerializeFMUState": "true",
        "providesDirectionalDerivative" if second else "providesDirectionalDerivatives": derivatives,
    }
    exchange, steps = {}, {"canHandleVariableCommunicationStepSize": "true"}
    if second:
        root.set("numberOfEventIndicators", str(indicators))
        version["canNotUseMemoryManagementFunctions"] = "true"
    else:
        exchange["needsCompletedIntegratorStep"] = "true"
        steps["mightReturnEarlyFromDoStep"] = "true"
    for kind, able in (("ModelExchange", exchange), ("CoSimulation", steps)):
        if kind == "ModelExchange" and layout.system.model.delays:
            continue  # the history of a delay is recorded by its own steps
        element = ET.SubElement(root, kind, {"modelIdentifier": identifier, **version, **able})
        if second:
            files = ET.SubElement(element, "SourceFiles")
            for name in sorted(source_files):
                ET.SubElement(files, "File", name=name)
    units = used_units((_unit(one), "", one.name) for one in layout.ports)
    add_preamble(root, units, experiment)
    variables = ET.SubElement(root, "ModelVariables")
    places = {
        port.scalar.name: number
        for number, port in enumerate(layout.ports)
        if port.kind == "STATE" and port.scalar is not None
    }
    for number, port in enumerate(layout.ports):
        _variable(variables, number, port, second, places)
    _structure(root, layout.ports, second)
    ET.indent(root)
    return written(root)


def _unit(port: Port) -> str:
    if port.scalar is None:
        return "s"
    return derivative_unit(port.scalar.unit) if port.order else port.scalar.unit


def _variable(
    variables: ET.Element, number: int, port: Port, second: bool, places: Mapping[str, int]
) -> None:
    scalar = port.scalar
    kind = "real" if scalar is None or port.order else scalar.type
    identity = {"name": port.name, "valueReference": str(number)}
    value: dict[str, str] = {}
    if scalar is None:
        identity |= {
            "description": "Simulation time",
            "causality": "independent",
            "variability": "continuous",
        }
    else:
        text = f"Time derivative of {scalar.name}" if port.order else scalar.description
        if text:
            identity["description"] = text
        identity |= _attributes(port, kind)
        if port.start is not None:
            value["start"] = _text(kind, port.start)
        if port.order:
            value["derivative"] = str(places[scalar.name] + (1 if second else 0))
    if kind == "real" and _unit(port):
        value["unit"] = _unit(port)
    if second:
        element = ET.SubElement(variables, "ScalarVariable", identity)
        ET.SubElement(element, _FMI2.get(kind, "Integer"), value)
    else:
        ET.SubElement(variables, _FMI3.get(kind, "Int32"), {**identity, **value})


def _attributes(port: Port, kind: str) -> dict[str, str]:
    scalar = port.scalar
    assert scalar is not None
    changing = "continuous" if kind == "real" and scalar.role != "discrete" else "discrete"
    role = "output" if scalar.causality == "output" and not port.order else "local"
    match port.kind:
        case "INPUT":
            return {"causality": "input", "variability": changing}
        case "PARAMETER":
            return {"causality": "parameter", "variability": "fixed", "initial": "exact"}
        case "STATE":
            initial = "exact" if port.start is not None else "calculated"
            return {"causality": role, "variability": "continuous", "initial": initial}
    if scalar.role in ("dependent", "free"):
        return {"causality": "calculatedParameter", "variability": "fixed", "initial": "calculated"}
    return {"causality": role, "variability": changing, "initial": "calculated"}


def _text(kind: str, value: float) -> str:
    if kind == "boolean":
        return "true" if value else "false"
    return repr(float(value)) if kind == "real" else str(int(value))


def _structure(root: ET.Element, ports: Sequence[Port], second: bool) -> None:
    """Outputs; without dependencies each may depend on everything, which is safe."""
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [
        number
        for number, one in enumerate(ports)
        if one.scalar is not None
        and one.scalar.causality == "output"
        and not one.order
        and one.kind != "INPUT"
    ]
    initial = [
        number
        for number, one in enumerate(ports)
        if one.start is None
        and one.scalar is not None
        and (
            number in outputs or one.order or one.kind == "STATE" or one.scalar.role in ("dependent", "free")
        )
    ]
    slopes = [number for number, one in enumerate(ports) if one.order]
    if second:
        for name, numbers in (("Outputs", outputs), ("Derivatives", slopes), ("InitialUnknowns", initial)):
            if numbers:
                group = ET.SubElement(structure, name)
                for number in numbers:
                    ET.SubElement(group, "Unknown", index=str(number + 1))
        return
    indicators = [number for number, one in enumerate(ports) if one.indicator]
    groups = (
        ("Output", outputs),
        ("ContinuousStateDerivative", slopes),
        ("InitialUnknown", initial),
        ("EventIndicator", indicators),
    )
    for name, numbers in groups:
        for number in numbers:
            ET.SubElement(structure, name, valueReference=str(number))
