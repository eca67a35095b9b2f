"""Write modelDescription.xml for FMI 2.0 and FMI 3.0 co-simulation."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from .declared_units import UnitTable, derivative_unit, used_units
from .flat import Role, Type
from .generate import TableEntry
from .package import LOG_CATEGORIES
from .program import Program
from .structure import Structure, Unknown, model_structure

# Control characters, which XML 1.0 cannot hold.
_UNWRITABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")


def written(root: ET.Element) -> bytes:
    """A model description as text; characters that XML cannot hold are replaced."""
    text = _UNWRITABLE.sub("\ufffd", ET.tostring(root, encoding="unicode"))
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


@dataclass(frozen=True)
class Description:
    """A model description and what it leaves to say.

    Attributes:
        xml: content of modelDescription.xml, with the token of `guid`.
        notes: remarks for the author of the model.
    """

    xml: bytes
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Port:
    """FMI attributes of one variable."""

    causality: str
    variability: str
    initial: str | None
    unit: str
    display_unit: str


def describe(
    program: Program,
    table: Sequence[TableEntry],
    *,
    fmi_version: str,
    identifier: str,
    token: str,
    source_files: Iterable[str],
) -> Description:
    """Write the model description.

    Args:
        program: the model's functions.
        table: its variables in the order of value references.
        fmi_version: "2.0" or "3.0".
        identifier: model identifier.
        token: GUID (FMI 2.0) or instantiation token (FMI 3.0).
        source_files: names of the C files in sources/, listed by FMI 2.0.
    Raises: BuildError if a display unit does not fit its unit.
    """
    ports = [_port(entry) for entry in table]
    units = used_units(
        (port.unit, port.display_unit, "time" if entry.variable is None else str(entry.variable.location))
        for port, entry in zip(ports, table, strict=True)
    )
    structure = model_structure(program, table)
    write = _fmi2 if fmi_version == "2.0" else _fmi3
    root = write(program, table, ports, units, structure, identifier, token, sorted(source_files))
    ET.indent(root)
    xml = written(root)
    notes = tuple(f"the unit {name!r} cannot be read and gets no base unit" for name in units.unknown)
    return Description(xml, notes)


def _port(entry: TableEntry) -> _Port:
    variable = entry.variable
    if variable is None:
        return _Port("independent", "continuous", None, "s", "")
    unit, display = variable.unit, variable.display_unit
    changing = "continuous" if entry.type is Type.REAL else "discrete"
    role = "output" if variable.role is Role.OUTPUT else "local"
    match entry.kind:
        case "DERIVATIVE":
            return _Port("local", "continuous", "calculated", derivative_unit(unit), "")
        case "INPUT":
            return _Port("input", changing, None, unit, display)
        case "STATE":
            return _Port(role, "continuous", "calculated" if entry.start is None else "exact", unit, display)
        case "PARAMETER" if entry.constant:
            return _Port("local", "constant", "exact", unit, display)
        case "PARAMETER" if entry.settable:
            return _Port("parameter", "fixed", "exact", unit, display)
        case "PARAMETER":
            return _Port("calculatedParameter", "fixed", "calculated", unit, display)
    return _Port(role, changing, "calculated", unit, display)


def _start(entry: TableEntry, port: _Port) -> str | None:
    if entry.start is None or port.initial == "calculated":
        return None
    return _value(entry.type, entry.start)


def _value(kind: Type, value: float) -> str:
    if kind is Type.BOOLEAN:
        return "true" if value else "false"
    return str(int(value)) if kind is Type.INTEGER else repr(float(value))


def _limits(entry: TableEntry) -> dict[str, str]:
    """Attributes min, max and nominal of a number."""
    variable = entry.variable
    if variable is None or entry.kind == "DERIVATIVE" or entry.type is Type.BOOLEAN:
        return {}
    found = {"min": variable.minimum, "max": variable.maximum}
    if entry.type is Type.REAL and entry.kind != "PARAMETER":
        found["nominal"] = variable.nominal
    return {key: _value(entry.type, value) for key, value in found.items() if value is not None}


def _real_attributes(entry: TableEntry, port: _Port) -> dict[str, str]:
    variable = entry.variable
    quantity = variable.quantity if variable is not None and entry.kind != "DERIVATIVE" else ""
    attributes = {"quantity": quantity, "unit": port.unit, "displayUnit": port.display_unit}
    if port.display_unit == port.unit:
        attributes["displayUnit"] = ""
    return {key: value for key, value in attributes.items() if value}


def _description(entry: TableEntry) -> str:
    if entry.variable is None:
        return "Simulation time"
    if entry.kind == "DERIVATIVE":
        return f"Time derivative of {entry.variable.name}"
    return entry.variable.description


def _attributes(
    entry: TableEntry, number: int, port: _Port, position: Mapping[str, int]
) -> tuple[dict[str, str], dict[str, str]]:
    """What identifies a variable and what is said of its values, which FMI 2 writes into two elements.

    Args:
        position: of each variable, in the numbers by which the version refers to others.
    """
    identity = {"name": entry.name, "valueReference": str(number)}
    if _description(entry):
        identity["description"] = _description(entry)
    identity["causality"] = port.causality
    identity["variability"] = port.variability
    if port.initial is not None:
        identity["initial"] = port.initial
    value = _real_attributes(entry, port) if entry.type is Type.REAL else {}
    value.update(_limits(entry))
    start = _start(entry, port)
    if start is not None:
        value["start"] = start
    if entry.kind == "DERIVATIVE" and entry.variable is not None:
        value["derivative"] = str(position[entry.variable.name])
    return identity, value


def _head(program: Program, identifier: str, token_name: str, token: str, version: str) -> ET.Element:
    flat = program.model.symbols.flat
    attributes = {"fmiVersion": version, "modelName": flat.name, token_name: token}
    if flat.description:
        attributes["description"] = flat.description
    attributes["generationTool"] = "orchestrator"
    attributes["variableNamingConvention"] = "structured"
    return ET.Element("fmiModelDescription", attributes)


def add_preamble(root: ET.Element, units: UnitTable, experiment: Mapping[str, float]) -> None:
    """What stands between the interface and the variables.

    Args:
        experiment: numbers of the model's annotation by their names in Modelica.
    """
    if (definitions := units.element()) is not None:
        root.append(definitions)
    categories = ET.SubElement(root, "LogCategories")
    for name, text in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=text)
    names = {
        "startTime": "StartTime", "stopTime": "StopTime", "tolerance": "Tolerance", "stepSize": "Interval",
    }  # fmt: skip
    if found := {name: repr(experiment[key]) for name, key in names.items() if key in experiment}:
        ET.SubElement(root, "DefaultExperiment", found)


def _fmi2(
    program: Program,
    table: Sequence[TableEntry],
    ports: Sequence[_Port],
    units: UnitTable,
    structure: Structure,
    identifier: str,
    token: str,
    source_files: Sequence[str],
) -> ET.Element:
    root = _head(program, identifier, "guid", token, "2.0")
    root.set("numberOfEventIndicators", "0")
    simulation = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=identifier,
        canHandleVariableCommunicationStepSize="true",
        canInterpolateInputs="true",
        maxOutputDerivativeOrder="0",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative="true",
    )
    files = ET.SubElement(simulation, "SourceFiles")
    for name in source_files:
        ET.SubElement(files, "File", name=name)
    add_preamble(root, units, program.model.symbols.flat.experiment)
    variables = ET.SubElement(root, "ModelVariables")
    position = {entry.name: number + 1 for number, entry in enumerate(table)}
    for number, (entry, port) in enumerate(zip(table, ports, strict=True)):
        identity, value = _attributes(entry, number, port, position)
        scalar = ET.SubElement(variables, "ScalarVariable", identity)
        ET.SubElement(scalar, entry.type.value, value)
    model_structure_element = ET.SubElement(root, "ModelStructure")
    for name, unknowns in (
        ("Outputs", structure.outputs),
        ("Derivatives", structure.derivatives),
        ("InitialUnknowns", structure.initial_unknowns),
    ):
        if unknowns:
            group = ET.SubElement(model_structure_element, name)
            for unknown in unknowns:
                ET.SubElement(
                    group, "Unknown", {"index": str(unknown.reference + 1), **_dependencies(unknown, 1)}
                )
    return root


def _fmi3(
    program: Program,
    table: Sequence[TableEntry],
    ports: Sequence[_Port],
    units: UnitTable,
    structure: Structure,
    identifier: str,
    token: str,
    source_files: Sequence[str],
) -> ET.Element:
    root = _head(program, identifier, "instantiationToken", token, "3.0")
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=identifier,
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        providesDirectionalDerivatives="true",
        providesAdjointDerivatives="true",
        canHandleVariableCommunicationStepSize="true",
        maxOutputDerivativeOrder="0",
    )
    add_preamble(root, units, program.model.symbols.flat.experiment)
    variables = ET.SubElement(root, "ModelVariables")
    position = {entry.name: number for number, entry in enumerate(table)}
    element_names = {Type.REAL: "Float64", Type.INTEGER: "Int32", Type.BOOLEAN: "Boolean"}
    for number, (entry, port) in enumerate(zip(table, ports, strict=True)):
        identity, value = _attributes(entry, number, port, position)
        ET.SubElement(variables, element_names[entry.type], {**identity, **value})
    model_structure_element = ET.SubElement(root, "ModelStructure")
    for name, unknowns in (
        ("Output", structure.outputs),
        ("ContinuousStateDerivative", structure.derivatives),
        ("InitialUnknown", structure.initial_unknowns),
    ):
        for unknown in unknowns:
            ET.SubElement(
                model_structure_element,
                name,
                {"valueReference": str(unknown.reference), **_dependencies(unknown, 0)},
            )
    return root


def _dependencies(unknown: Unknown, base: int) -> dict[str, str]:
    attributes = {"dependencies": " ".join(str(reference + base) for reference in unknown.dependencies)}
    if unknown.kinds:
        attributes["dependenciesKind"] = " ".join(unknown.kinds)
    return attributes
