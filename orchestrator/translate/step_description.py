"""Model descriptions of native components: the Python FMU's own, with what differs, in FMI 2.0 or 3.0.

Both forms of a component have the same variables with the same value references, units and start values.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import Any

from lxml import etree

from .component import ComponentProgram
from .package import LOG_CATEGORIES

_NEVER_TRUE = ("needsExecutionTool", "canRunAsynchronuously", "canBeInstantiatedOnlyOncePerProcess")
_TYPES3 = {"Real": "Float64", "Integer": "Int32", "Enumeration": "Int32", "Boolean": "Boolean"}


def describe_native(
    root: Any, program: ComponentProgram, fmi_version: str, token: str, source_files: Iterable[str]
) -> bytes:
    """Write modelDescription.xml.

    Args:
        root: the Python FMU's model description, completed.
        program: what was traced.
        fmi_version: "2.0" or "3.0".
        token: GUID (FMI 2.0) or instantiation token (FMI 3.0).
        source_files: names of the C files in sources/, listed by FMI 2.0.
    """
    second = _fmi2(root, program, token, sorted(source_files))
    result = second if fmi_version == "2.0" else _fmi3(second, token)
    etree.indent(result, "  ")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + etree.tostring(result, encoding="UTF-8") + b"\n"


def _fmi2(original: Any, program: ComponentProgram, token: str, source_files: Iterable[str]) -> Any:
    root = copy.deepcopy(original)
    root.set("guid", token)
    root.set("generationTool", "orchestrator")
    simulation = root.find("CoSimulation")
    for name in _NEVER_TRUE:
        simulation.attrib.pop(name, None)
    simulation.set("modelIdentifier", program.name)
    simulation.set("canHandleVariableCommunicationStepSize", "true")
    simulation.set("canGetAndSetFMUstate", "true")
    simulation.set("canSerializeFMUstate", "true")
    simulation.set("providesDirectionalDerivative", "true")
    files = etree.SubElement(simulation, "SourceFiles")
    for name in source_files:
        etree.SubElement(files, "File", name=name)
    categories = root.find("LogCategories")
    categories.clear()
    for name, text in LOG_CATEGORIES.items():
        etree.SubElement(categories, "Category", name=name, description=text)
    variables = root.find("ModelVariables")
    numbers = {node.get("name"): number for number, node in enumerate(variables, start=1)}
    for node in variables:
        # FMI's default is continuous, which only a Real can be.
        if node.find("Real") is None and not node.get("variability"):
            node.set("variability", "discrete")
    for name in program.set_up:
        node = variables[numbers[name] - 1]
        node.set("initial", "calculated")
        node[0].attrib.pop("start", None)
        if node.get("causality") == "output":
            _add_initial_unknown(root.find("ModelStructure"), numbers[name])
    time = etree.SubElement(variables, "ScalarVariable", name="time", valueReference=str(len(numbers)))
    time.set("description", "Simulation time")
    time.set("causality", "independent")
    time.set("variability", "continuous")
    etree.SubElement(time, "Real")
    return root


def _add_initial_unknown(structure: Any, number: int) -> None:
    group = structure.find("InitialUnknowns")
    if group is None:
        group = etree.SubElement(structure, "InitialUnknowns")
    place = sum(int(node.get("index")) < number for node in group)
    if all(node.get("index") != str(number) for node in group):
        group.insert(place, etree.Element("Unknown", index=str(number), dependencies=""))


def _fmi3(second: Any, token: str) -> Any:
    root = etree.Element("fmiModelDescription", fmiVersion="3.0", modelName=second.get("modelName"))
    root.set("instantiationToken", token)
    for name in ("description", "author", "version", "copyright", "license", "generationTool"):
        if second.get(name):
            root.set(name, second.get(name))
    root.set("variableNamingConvention", "structured")
    simulation = etree.SubElement(root, "CoSimulation")
    simulation.set("modelIdentifier", second.find("CoSimulation").get("modelIdentifier"))
    for name in (
        "canGetAndSetFMUState",
        "canSerializeFMUState",
        "providesDirectionalDerivatives",
        "providesAdjointDerivatives",
        "canHandleVariableCommunicationStepSize",
    ):
        simulation.set(name, "true")
    for name in ("UnitDefinitions", "LogCategories", "DefaultExperiment"):
        if second.find(name) is not None:
            root.append(copy.deepcopy(second.find(name)))
    items = {
        kind.get("name"): [(item.get("name"), item.get("value")) for item in kind.iter("Item")]
        for kind in second.iter("SimpleType")
    }
    group = etree.SubElement(root, "ModelVariables")
    references = {}
    for number, node in enumerate(second.find("ModelVariables"), start=1):
        references[str(number)] = node.get("valueReference")
        group.append(_variable3(node, items))
    structure = etree.SubElement(root, "ModelStructure")
    for name, member in (("Outputs", "Output"), ("InitialUnknowns", "InitialUnknown")):
        for unknown in second.iterfind(f"ModelStructure/{name}/Unknown"):
            depends = " ".join(references[index] for index in (unknown.get("dependencies") or "").split())
            element = etree.SubElement(structure, member, valueReference=references[unknown.get("index")])
            element.set("dependencies", depends)
    return root


def _variable3(node: Any, items: Mapping[str, list[tuple[str, str]]]) -> Any:
    (value,) = node
    description = node.get("description")
    attributes = {key: node.get(key) for key in ("name", "valueReference")}
    limits = dict(value.attrib)
    if value.tag == "Enumeration":
        # FMI 3.0 reads enumerations as Int64; the runtime's integers are Int32, so the names go here.
        choices = items[limits.pop("declaredType")]
        description += "; " + ", ".join(f"{number}: {name}" for name, number in choices)
        numbers = [int(number) for _, number in choices]
        limits |= {"min": str(min(numbers)), "max": str(max(numbers))}
    attributes["description"] = description
    attributes["causality"] = node.get("causality") or "local"
    default = "continuous" if value.tag == "Real" else "discrete"
    attributes["variability"] = node.get("variability") or default
    if node.get("initial"):
        attributes["initial"] = node.get("initial")
    elif attributes["causality"] == "parameter":
        attributes["initial"] = "exact"
    return etree.Element(_TYPES3[value.tag], {**attributes, **limits})
