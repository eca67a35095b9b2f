"""The model description of an FMU, reduced to what co-simulation needs."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

from ..errors import FmuError
from ..units import Unit, UnitError, parse_unit
from .variable import Causality, Initial, Kind, Value, Variability, Variable

__all__ = ["Capabilities", "ModelDescription", "read_description"]

_LARGEST_XML = 512 * 2**20


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What the FMU's co-simulation interface declares to be able to do."""

    variable_step_size: bool = False
    save_state: bool = False
    serialise_state: bool = False
    directional_derivatives: bool = False
    interpolate_inputs: bool = False
    output_derivative_order: int = 0
    once_per_process: bool = False
    execution_tool: bool = False
    fixed_internal_step: float | None = None
    event_mode: bool = False


@dataclass(frozen=True)
class ModelDescription:
    """What an FMU says of itself.

    Attributes:
        name, description: of the model.
        fmi_version: "2.0" or "3.0".
        token: GUID or instantiation token.
        model_identifier: stem of the binary.
        variables: by name, in the file's order.
        feedthrough: per output, the inputs on which it depends at a communication point.
        initial_feedthrough: the same during initialisation.
        assumed: outputs whose dependencies the FMU does not declare: they count as depending on every input.
        capabilities: see Capabilities.
        deviations: rules of FMI that the description breaks without harm here.
    """

    name: str
    fmi_version: str
    token: str
    model_identifier: str
    variables: Mapping[str, Variable]
    feedthrough: Mapping[str, tuple[str, ...]]
    initial_feedthrough: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    assumed: frozenset[str] = frozenset()
    capabilities: Capabilities = Capabilities()
    description: str = ""
    deviations: tuple[str, ...] = ()

    @cached_property
    def inputs(self) -> tuple[Variable, ...]:
        """Variables of causality input."""
        return tuple(v for v in self.variables.values() if v.causality is Causality.INPUT)

    @cached_property
    def outputs(self) -> tuple[Variable, ...]:
        """Variables of causality output."""
        return tuple(v for v in self.variables.values() if v.causality is Causality.OUTPUT)

    @cached_property
    def parameters(self) -> tuple[Variable, ...]:
        """Variables of causality parameter."""
        return tuple(v for v in self.variables.values() if v.causality is Causality.PARAMETER)


def read_description(path: Path) -> ModelDescription:
    """Read and check an FMU's model description without unpacking the FMU.

    Args:
        path: a .fmu file.
    Raises: FmuError if it is missing, no FMU, or has no co-simulation interface of FMI 2.0 or 3.0.
    """
    if not path.is_file():
        raise FmuError(f"{path}: no such file")
    xml = _read_xml(path)
    version, directional = _inspect(path, xml)
    raw, deviations = _parsed(path, version)
    if raw.coSimulation is None:
        raise FmuError(
            f"{path}: the FMU offers no co-simulation interface; it offers {_interfaces(raw)}\n"
            "  Export it again for co-simulation."
        )
    return _reduce(raw, directional, deviations)


def _parsed(path: Path, version: str) -> tuple[Any, tuple[str, ...]]:
    """fmpy's description, and where it breaks a rule of FMI that is not part of the XML schema.

    Such deviations are common in the field and harmless here; what breaks the schema is refused.
    """
    # fmpy costs 0.1 s to import, which a config with a mistake in it should not have to wait for.
    from fmpy.model_description import ValidationError, read_model_description

    try:
        # The whole FMU is passed on, since FMI 3 spreads the description over several files.
        try:
            return read_model_description(str(path), validate=True), ()
        except ValidationError as error:
            if any(re.match(r"(FATAL|ERROR|WARNING) \(line", problem) for problem in error.problems):
                raise
            return read_model_description(str(path), validate=False), tuple(error.problems)
    except Exception as error:
        raise FmuError(
            f"{path}: its modelDescription.xml is not valid FMI {version}\n{_indented(error)}"
        ) from error


def _read_xml(path: Path) -> bytes:
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            if "modelDescription.xml" not in names:
                content = ", ".join(names[:10]) or "nothing"
                raise FmuError(
                    f"{path}: not an FMU, it has no modelDescription.xml at the top\n  it holds {content}"
                )
            if archive.getinfo("modelDescription.xml").file_size > _LARGEST_XML:
                raise FmuError(f"{path}: modelDescription.xml is larger than {_LARGEST_XML} bytes")
            return archive.read("modelDescription.xml")
    except zipfile.BadZipFile as error:
        raise FmuError(
            f"{path}: not an FMU, since it is no zip archive ({error})\n  Export or download it again."
        ) from error
    except (OSError, RuntimeError, NotImplementedError, EOFError, zipfile.error, ValueError) as error:
        raise FmuError(f"{path}: cannot be read ({error})") from error


def _inspect(path: Path, xml: bytes) -> tuple[str, bool]:
    """FMI version, and FMI 3's providesDirectionalDerivatives, whose plural fmpy does not read."""
    from lxml import etree

    if re.search(rb"<!(DOCTYPE|ENTITY)", xml):
        raise FmuError(
            f"{path}: modelDescription.xml declares a document type, which FMI has no use for; refused"
        )
    try:
        parser = etree.XMLParser(resolve_entities=False, no_network=True)
        root = etree.parse(io.BytesIO(xml), parser).getroot()
    except etree.XMLSyntaxError as error:
        raise FmuError(f"{path}: modelDescription.xml is not well-formed XML ({error.msg})") from error
    version = root.get("fmiVersion")
    if version is None:
        raise FmuError(f"{path}: modelDescription.xml has no attribute fmiVersion")
    if not (version == "2.0" or version.startswith("3.0")):
        raise FmuError(f"{path}: FMI version {version} is not supported; supported: 2.0, 3.0")
    interface = root.find("CoSimulation")
    directional = interface is not None and interface.get("providesDirectionalDerivatives") in ("true", "1")
    return version, directional


def _indented(error: Exception) -> str:
    problems = getattr(error, "problems", None) or [str(error)]
    shown = [f"  {problem}" for problem in problems[:5]]
    if len(problems) > 5:
        shown.append(f"  and {len(problems) - 5} more")
    return "\n".join(shown)


def _interfaces(raw: Any) -> str:
    offered = [
        name
        for name, interface in (
            ("model exchange", raw.modelExchange),
            ("scheduled execution", raw.scheduledExecution),
        )
        if interface is not None
    ]
    return " and ".join(offered) or "none"


def _reduce(raw: Any, directional: bool, deviations: tuple[str, ...]) -> ModelDescription:
    units, display_units = _read_units(raw)
    variables: dict[str, Variable] = {}
    for item in raw.modelVariables:
        variables[item.name] = _variable(item, units, display_units)
    interface = raw.coSimulation
    inputs = tuple(v.name for v in variables.values() if v.causality is Causality.INPUT)
    outputs = [v.name for v in variables.values() if v.causality is Causality.OUTPUT]
    feedthrough, declared = _dependencies(raw.outputs, variables, inputs, outputs)
    at_start, declared_at_start = _dependencies(raw.initialUnknowns, variables, inputs, outputs)
    initial = {name: at_start[name] if name in declared_at_start else feedthrough[name] for name in outputs}
    for name in outputs:
        # A start value that the FMU takes as it is depends on nothing (FMI 2.0.4, 2.2.7, initial = exact).
        if variables[name].initial is Initial.EXACT:
            initial[name] = ()
    return ModelDescription(
        name=raw.modelName or "",
        fmi_version=raw.fmiVersion,
        token=raw.guid or "",
        model_identifier=interface.modelIdentifier,
        variables=variables,
        feedthrough=feedthrough,
        initial_feedthrough=initial,
        assumed=frozenset(outputs) - declared,
        capabilities=Capabilities(
            variable_step_size=bool(interface.canHandleVariableCommunicationStepSize),
            save_state=bool(interface.canGetAndSetFMUstate),
            serialise_state=bool(interface.canSerializeFMUstate),
            directional_derivatives=directional or bool(interface.providesDirectionalDerivative),
            # FMI 3 has no call for input derivatives.
            interpolate_inputs=bool(interface.canInterpolateInputs) and raw.fmiVersion.startswith("2"),
            output_derivative_order=int(interface.maxOutputDerivativeOrder or 0),
            once_per_process=bool(interface.canBeInstantiatedOnlyOncePerProcess),
            execution_tool=bool(interface.needsExecutionTool),
            fixed_internal_step=_number(interface.fixedInternalStepSize),
            event_mode=bool(interface.hasEventMode),
        ),
        description=raw.description or "",
        deviations=deviations,
    )


def _dependencies(
    unknowns: Any, variables: Mapping[str, Variable], inputs: tuple[str, ...], outputs: list[str]
) -> tuple[dict[str, tuple[str, ...]], set[str]]:
    """Per output the inputs it depends on, and the outputs for which that is declared."""
    known, declared = dict.fromkeys(outputs, inputs), set()
    for unknown in unknowns:
        name = unknown.variable.name
        if name in known and unknown.dependencies is not None:
            wanted = {dependency.name for dependency in unknown.dependencies}
            known[name] = tuple(port for port in inputs if port in wanted)
            declared.add(name)
    return known, declared


def _read_units(raw: Any) -> tuple[dict[str, Unit], dict[str, dict[str, Unit]]]:
    units: dict[str, Unit] = {}
    display_units: dict[str, dict[str, Unit]] = {}
    for item in raw.unitDefinitions:
        base = item.baseUnit
        if base is not None:
            exponents = (base.kg, base.m, base.s, base.A, base.K, base.mol, base.cd, base.rad)
            unit = Unit(item.name, exponents, _exact(base.factor), _exact(base.offset))
            if unit.factor == 0:
                continue
        else:
            try:
                unit = parse_unit(item.name)
            except UnitError:
                continue
        units[item.name] = unit
        display_units[item.name] = {
            shown.name: _display_unit(unit, shown) for shown in item.displayUnits if shown.factor
        }
    return units, display_units


def _display_unit(unit: Unit, shown: Any) -> Unit:
    # FMI: value in the display unit = factor * value in the unit + offset.
    factor, offset = _exact(shown.factor), _exact(shown.offset)
    return Unit(shown.name, unit.exponents, unit.factor / factor, unit.offset - unit.factor * offset / factor)


def _exact(number: float) -> Fraction:
    # By way of the shortest decimal, so that a declared "0.001" is a thousandth and not its neighbour.
    return Fraction(repr(float(number)))


_KINDS = {
    "Real": Kind.REAL,
    "Integer": Kind.INTEGER,
    "Boolean": Kind.BOOLEAN,
    "String": Kind.STRING,
    "Enumeration": Kind.ENUMERATION,
    "Binary": Kind.BINARY,
    "Clock": Kind.CLOCK,
}


def _kind(fmi_type: str) -> Kind:
    if fmi_type.startswith("Float"):
        return Kind.REAL
    return _KINDS[fmi_type] if fmi_type in _KINDS else Kind.INTEGER


def _variable(item: Any, units: Mapping[str, Unit], display_units: Mapping[str, dict[str, Unit]]) -> Variable:
    declared = item.declaredType
    unit_name = item.unit or (declared.unit if declared is not None else None) or ""
    unit = units.get(unit_name)
    if unit is None and unit_name:
        try:
            unit = parse_unit(unit_name)
        except UnitError:
            unit = None
    kind = _kind(item.type)
    low = item.min if item.min is not None else getattr(declared, "min", None)
    high = item.max if item.max is not None else getattr(declared, "max", None)
    return Variable(
        name=item.name,
        reference=item.valueReference,
        type=item.type,
        kind=kind,
        causality=Causality(item.causality),
        variability=Variability(item.variability),
        initial=Initial(item.initial) if item.initial else None,
        unit=unit,
        unit_name=unit_name,
        display_units=display_units.get(unit_name, {}),
        start=_start(item.start, kind, tuple(item.shape or ())),
        nominal=_nominal(item.nominal, getattr(declared, "nominal", None)),
        minimum=_number(low),
        maximum=_number(high),
        items=_items(declared) if kind is Kind.ENUMERATION else {},
        shape=tuple(item.shape or ()),
        description=item.description or "",
    )


def _items(declared: Any) -> dict[str, int]:
    return {entry.name: int(entry.value) for entry in declared.items} if declared is not None else {}


def _number(text: Any) -> float | None:
    return None if text is None else float(text)


def _nominal(*texts: Any) -> float:
    """The first that is given and usable: FMI demands more than 0, exporters also write 0."""
    for text in texts:
        value = abs(float(text)) if text is not None else 0.0
        if 0.0 < value < float("inf"):
            return value
    return 1.0


def _start(text: str | None, kind: Kind, shape: tuple[int, ...]) -> Value | None:
    if text is None or shape:
        return None
    if kind is Kind.REAL:
        return float(text)
    if kind in (Kind.INTEGER, Kind.ENUMERATION):
        return int(text)
    if kind is Kind.BOOLEAN:
        return text in ("true", "1")
    return text
