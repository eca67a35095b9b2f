"""modelDescription.xml of a system that becomes one FMU, in FMI 2.0 or 3.0."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

from ..base.units import BASE_NAMES, Unit
from ..fmi import Causality, Kind, Value, Variable
from ..system.connection import Port
from ..system.system import System
from ..translate.package import LOG_CATEGORIES
from .system_contents import Inside, Outer
from .system_text import TIME

_TYPES3 = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}
# A name in the standard's structured convention: identifiers with indices, joined by dots.
_STRUCTURED = re.compile(r"[A-Za-z_]\w*(\[\d+(, ?\d+)*\])?(\.[A-Za-z_]\w*(\[\d+(, ?\d+)*\])?)*", re.ASCII)


def describe_system(inside: Inside, name: str, identifier: str, token: str, fmi_version: str) -> bytes:
    """Write the description.

    Args:
        name, identifier: of the exported FMU, and of its binaries.
        token: GUID or instantiation token.
        fmi_version: "2.0" or "3.0".
    """
    outers = (*inside.inputs, *inside.outputs, *inside.parameters)
    root = _head(inside, name, token, fmi_version)
    step = float(inside.prepared.grid.step_size)
    capabilities = [one.fmu.description.capabilities for one in inside.system.instances]
    flags = {
        "canHandleVariableCommunicationStepSize": False,  # only whole multiples of its own step
        "GetAndSet": all(one.save_state for one in capabilities),
        "Serialize": all(one.save_state and one.serialise_state for one in capabilities),
        "canBeInstantiatedOnlyOncePerProcess": any(one.once_per_process for one in capabilities),
        "needsExecutionTool": any(one.execution_tool for one in capabilities),
    }
    _simulation(root, identifier, flags, step, fmi_version)
    units = _Units()
    named = [units.add(one.variable) for one in outers]
    if units.element is not None:
        root.append(units.element)
    categories = ET.SubElement(root, "LogCategories")
    for category, text in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=category, description=text)
    grid = inside.prepared.grid
    times = {"startTime": float(grid.start), "stopTime": float(grid.stop), "stepSize": step}
    ET.SubElement(root, "DefaultExperiment", {key: repr(value) for key, value in times.items()})
    variables = ET.SubElement(root, "ModelVariables")
    second = fmi_version == "2.0"
    _variable(variables, second, 0, TIME, "Simulation time", "Real", _TIME_ATTRIBUTES, {})
    for reference, (one, unit) in enumerate(zip(outers, named, strict=True), start=1):
        _outer(variables, second, reference, one, unit)
    _structure(root, inside, second)
    ET.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


_TIME_ATTRIBUTES = {"causality": "independent", "variability": "continuous"}


def _head(inside: Inside, name: str, token: str, fmi_version: str) -> ET.Element:
    ports = (*inside.inputs, *inside.outputs, *inside.parameters)
    structured = all(_STRUCTURED.fullmatch(str(one.port)) for one in ports)
    attributes = {"fmiVersion": fmi_version, "modelName": name}
    attributes["guid" if fmi_version == "2.0" else "instantiationToken"] = token
    title = inside.prepared.config.model.title
    if title:
        attributes["description"] = title
    attributes["generationTool"] = "orchestrator"
    attributes["variableNamingConvention"] = "structured" if structured else "flat"
    return ET.Element("fmiModelDescription", attributes)


def _simulation(
    root: ET.Element, identifier: str, flags: dict[str, bool], step: float, fmi_version: str
) -> None:
    element = ET.SubElement(root, "CoSimulation", modelIdentifier=identifier)
    state = "canGetAndSetFMUstate" if fmi_version == "2.0" else "canGetAndSetFMUState"
    serialise = "canSerializeFMUstate" if fmi_version == "2.0" else "canSerializeFMUState"
    for name, value in flags.items():
        element.set({"GetAndSet": state, "Serialize": serialise}.get(name, name), str(value).lower())
    if fmi_version == "3.0":
        element.set("fixedInternalStepSize", repr(step))


class _Units:
    """Unit definitions, as the inner FMUs declare them.

    Attributes:
        element: UnitDefinitions; None while there are no units.
    """

    def __init__(self) -> None:
        self.element: ET.Element | None = None
        self._known: dict[str, Unit | None] = {}

    def add(self, variable: Variable) -> str:
        """Enter a variable's unit. Returns: its name; empty where two FMUs mean different things by it."""
        name, unit = variable.unit_name, variable.unit
        if not name:
            return ""
        if name in self._known:
            known = self._known[name]
            if known is not None and unit is not None and unit.difference != known.difference:
                known, unit = known.of_differences(), unit.of_differences()
            return name if known == unit else ""
        self._known[name] = unit
        if self.element is None:
            self.element = ET.Element("UnitDefinitions")
        element = ET.SubElement(self.element, "Unit", name=name)
        if unit is None:
            return name
        ET.SubElement(element, "BaseUnit", _base(unit))
        for display, other in sorted(variable.display_units.items()):
            if display == name or not unit.factor or not other.factor:
                continue
            attributes = {"name": display, "factor": repr(float(unit.factor / other.factor))}
            if unit.offset != other.offset:
                attributes["offset"] = repr(float((unit.offset - other.offset) / other.factor))
            ET.SubElement(element, "DisplayUnit", attributes)
        return name


def _base(unit: Unit) -> dict[str, str]:
    attributes = {base: str(power) for base, power in zip(BASE_NAMES, unit.exponents, strict=True) if power}
    if unit.factor != 1:
        attributes["factor"] = repr(float(unit.factor))
    if unit.offset:
        attributes["offset"] = repr(float(unit.offset))
    return attributes


def _outer(parent: ET.Element, second: bool, reference: int, one: Outer, unit: str) -> None:
    variable = one.variable
    attributes = {"causality": str(one.causality)}
    values: dict[str, str] = {}
    if one.causality is Causality.PARAMETER:
        attributes |= {"variability": str(variable.variability), "initial": "exact"}
    else:
        continuous = variable.kind is Kind.REAL and variable.variability == "continuous"
        attributes["variability"] = "continuous" if continuous else "discrete"
        if one.causality is Causality.OUTPUT:
            attributes["initial"] = "calculated"
    if one.type == "Real":
        if unit:
            values["unit"] = unit
            if variable.unit is not None and variable.unit.difference:
                values["relativeQuantity"] = "true"
        if one.causality is not Causality.PARAMETER and variable.nominal not in (0.0, 1.0):
            values["nominal"] = repr(float(variable.nominal))
    if one.type != "Boolean" and one.causality is not Causality.OUTPUT:
        limits = {"min": variable.minimum, "max": variable.maximum}
        values |= {key: _number(one.type, value) for key, value in limits.items() if value is not None}
    if one.start is not None:
        values["start"] = _number(one.type, one.start)
    text = variable.description
    if variable.items:
        items = ", ".join(f"{number}: {name}" for name, number in variable.items.items())
        text = f"{text}; {items}" if text else items
    _variable(parent, second, reference, str(one.port), text, one.type, attributes, values)


def _number(kind: str, value: Value) -> str:
    if kind == "Boolean":
        return "true" if value else "false"
    return str(int(value)) if kind == "Integer" else repr(float(value))


def _variable(
    parent: ET.Element,
    second: bool,
    reference: int,
    name: str,
    text: str,
    kind: str,
    attributes: dict[str, str],
    values: dict[str, str],
) -> None:
    identity = {"name": name, "valueReference": str(reference)}
    if text:
        identity["description"] = text
    if second:
        ET.SubElement(ET.SubElement(parent, "ScalarVariable", identity | attributes), kind, values)
    else:
        ET.SubElement(parent, _TYPES3[kind], identity | attributes | values)


def _structure(root: ET.Element, inside: Inside, second: bool) -> None:
    """What outputs depend on: at a communication point the inputs that reach them within one, at
    initialisation those that reach them then, and every parameter.
    """
    references = {one.port: number for number, one in enumerate(inside.inputs, start=1)}
    first = 1 + len(inside.inputs)
    behind = first + len(inside.outputs)
    parameters = range(behind, behind + len(inside.parameters))
    element = ET.SubElement(root, "ModelStructure")
    for initial, group, single in ((False, "Outputs", "Output"), (True, "InitialUnknowns", "InitialUnknown")):
        reached = _reached(inside.system, references, initial)
        parent = ET.SubElement(element, group) if second and inside.outputs else element
        for reference, one in enumerate(inside.outputs, start=first):
            known = [references[port] for port in reached.get(one.port, ())]
            depends = [*sorted(known), *(parameters if initial else ())]
            if second:
                listing = " ".join(str(number + 1) for number in depends)
                ET.SubElement(parent, "Unknown", index=str(reference + 1), dependencies=listing)
            else:
                listing = " ".join(map(str, depends))
                ET.SubElement(parent, single, valueReference=str(reference), dependencies=listing)


def _reached(system: System, inputs: Iterable[Port], initial: bool) -> dict[Port, Sequence[Port]]:
    """The inputs of the exported FMU that each port depends on at one instant."""
    after: dict[Port, list[Port]] = {}
    for connection in system.connections:
        for port in connection.sources if initial else connection.passed_at_once:
            after.setdefault(port, []).append(connection.target)
    for one in system.instances:
        for output, names in (one.initial_feedthrough if initial else one.feedthrough).items():
            for name in names:
                after.setdefault(Port(one.name, name), []).append(Port(one.name, output))
    found: dict[Port, list[Port]] = {}
    for begin in inputs:
        seen, waiting = {begin}, [begin]
        while waiting:
            for port in after.get(waiting.pop(), ()):
                if port not in seen:
                    seen.add(port)
                    waiting.append(port)
        for port in seen:
            found.setdefault(port, []).append(begin)
    return found
