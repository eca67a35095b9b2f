"""The model description of an FMU, reduced to what co-simulation needs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

from ..base.errors import FmuError, listed
from .from_fmpy import elements, number, read_units, read_variable
from .run_options import Interface
from .safe_xml import read_markup
from .variable import Causality, Initial, Kind, Variability, Variable

# How fmpy says what breaks the XML schema.
_OF_SCHEMA = re.compile(r"(FATAL|ERROR|WARNING) \(line")
_UNKNOWN_ATTRIBUTE = re.compile(
    r"ERROR \(line (\d+), column \d+\): Element '[^']*', attribute '[^']*': "
    r"(The attribute '[^']*' is not allowed)\.$"
)


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What the FMU's interface declares to be able to do.

    Attributes:
        variable_step_size: whether the step size may change during a run.
        execution_tool: whether the tool that made the FMU must be installed.
        fixed_internal_step: of the FMU itself [s]; None where it has none or does not say.
        intermediate_update: whether inputs and outputs can be reached within a step (FMI 3.0).
        return_on_request: whether a step can be cut short there, and is so only on request.
    """

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
    intermediate_update: bool = False
    return_on_request: bool = False


@dataclass(frozen=True)
class ModelDescription:
    """What an FMU says of itself.

    Attributes:
        name, description: of the model.
        fmi_version: "1.0", "2.0" or "3.0".
        interface: the one of the FMU's interfaces that is run.
        token: GUID or instantiation token.
        model_identifier: stem of the binary.
        variables: by name, in the file's order.
        feedthrough: per output, the inputs on which it depends at a communication point.
        initial_feedthrough: the same during initialisation.
        assumed: outputs whose dependencies the FMU does not declare: they count as depending on every input.
        capabilities: see Capabilities.
        deviations: rules of FMI that the description breaks without harm here.
        states, event_indicators: numbers of them, for model exchange.
        completed_step: whether a model-exchange FMU needs a call after every completed integrator step.
        tolerance: relative tolerance that the FMU proposes; None where it does not.
        default_step, default_start, default_stop: step size, start and stop time that the FMU proposes [s];
            None where it does not.
        own_step: the step size [s] that the FMU is made for, where it declares that it cannot take others;
            `own_step_divides` says whether it takes whole multiples of it.
        tool: what the FMU was made with; empty where it does not say.
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
    interface: Interface = Interface.CO_SIMULATION
    states: int = 0
    event_indicators: int = 0
    completed_step: bool = False
    tolerance: float | None = None
    default_step: float | None = None
    default_start: float | None = None
    default_stop: float | None = None
    own_step: float | None = None
    own_step_divides: bool = False
    tool: str = ""

    @cached_property
    def inputs(self) -> tuple[Variable, ...]:
        """Variables of causality input."""
        return tuple(v for v in self.variables.values() if v.causality is Causality.INPUT)

    @cached_property
    def followed(self) -> frozenset[str]:
        """Inputs whose course over a step the FMU follows, where it is given one: FMI 2's interpolation of
        inputs, FMI 3's intermediate update. In model exchange it is the integration here that follows it.
        """
        if self.interface is Interface.MODEL_EXCHANGE:
            smooth = (v for v in self.inputs if v.variability is Variability.CONTINUOUS)
            return frozenset(v.name for v in smooth if v.kind is Kind.REAL)
        if self.capabilities.interpolate_inputs:
            return frozenset(v.name for v in self.inputs)
        if not self.capabilities.intermediate_update:
            return frozenset()
        return frozenset(v.name for v in self.inputs if v.intermediate and v.kind is Kind.REAL)

    @cached_property
    def outputs(self) -> tuple[Variable, ...]:
        """Variables of causality output."""
        return tuple(v for v in self.variables.values() if v.causality is Causality.OUTPUT)

    def elements(self, array: str) -> tuple[Variable, ...]:
        """Elements of an array by its name, row by row; none if that is a scalar's or nobody's."""
        pattern = re.compile(re.escape(array) + r"\[\d+(?:, ?\d+)*\]")
        return tuple(v for v in self.variables.values() if pattern.fullmatch(v.name))

    @cached_property
    def parameters(self) -> tuple[Variable, ...]:
        """Variables of causality parameter."""
        return tuple(v for v in self.variables.values() if v.causality is Causality.PARAMETER)


def read_description(
    path: Path, interface: Interface | None = None, structure: Iterable[tuple[str, int]] = ()
) -> ModelDescription:
    """Read and check an FMU's model description without unpacking the FMU.

    Args:
        path: a .fmu file.
        interface: the one to be run; None: co-simulation if the FMU offers it, else model exchange.
        structure: structural parameters with values other than their start values.
    Raises: FmuError if it is missing, no FMU, or has no such interface of FMI 1.0, 2.0 or 3.0.
    """
    if not path.is_file():
        raise FmuError(f"{path}: no such file")
    root = read_markup(path)
    version = root.get("fmiVersion")
    if version is None:
        raise FmuError(f"{path}: modelDescription.xml has no attribute fmiVersion")
    if version not in ("1.0", "2.0") and not version.startswith("3.0"):
        raise FmuError(f"{path}: FMI version {version} is not supported; supported: 1.0, 2.0, 3.0")
    raw, deviations = _parsed(path, version)
    chosen = _choose(path, raw, interface)
    negated: frozenset[str] = frozenset()
    if version == "1.0":
        from .description1 import complete

        negated = complete(raw, root)
    # fmpy does not read what may change within a step.
    within = frozenset(
        item.get("name")
        for item in root.findall("ModelVariables/*[@intermediateUpdate]")
        if item.get("intermediateUpdate") in ("true", "1")
    )
    _add_attributes(raw, root)
    _resize(raw, dict(structure))
    try:
        found = _reduce(raw, chosen, _directional(root, chosen), deviations, negated, within)
    except ValueError as error:  # what the schema lets pass and is no value of its variable
        what = f"its modelDescription.xml holds a value that cannot be read ({error})"
        raise FmuError(f"{path}: {what}") from error
    clocks = [v.name for v in found.variables.values() if v.kind is Kind.CLOCK]
    if clocks and chosen is Interface.MODEL_EXCHANGE:
        raise FmuError(
            f"{path}: has clocks, {listed(clocks, 5)}: in model exchange they are not supported, since the "
            "integration here ticks none\n  Run it in co-simulation, where an FMU ticks its clocks itself."
        )
    return found


def _resize(raw: Any, structure: Mapping[str, int]) -> None:
    """Give structural parameters their values, and arrays the sizes that follow."""
    if not structure:
        return
    for item in raw.modelVariables:
        if item.name in structure:
            item.start = str(structure[item.name])
    for item in raw.modelVariables:
        item.shape = tuple(
            int(one.variable.start if one.start is None else one.start) for one in item.dimensions
        )
    for unknowns, count in (
        (raw.derivatives, "numberOfContinuousStates"),
        (raw.eventIndicators, "numberOfEventIndicators"),
    ):
        setattr(raw, count, sum(prod(one.variable.shape or ()) for one in unknowns))


def _add_attributes(raw: Any, root: Any) -> None:
    """Set relativeQuantity of variables, which fmpy looks for among an element's children, and the range of
    unsigned integers, which it does not read.
    """
    given, ranges = {}, {}
    for item in root.findall("ModelVariables/*"):
        ranges[item.get("name")] = item.get("min"), item.get("max")
        for element in (item, item.find("Real")):
            if element is not None and "relativeQuantity" in element.attrib:
                given[item.get("name")] = element.get("relativeQuantity") in ("true", "1")
    for item in raw.modelVariables:
        item.relativeQuantity = given.get(item.name)
        if item.type.startswith("UInt"):
            item.min, item.max = ranges.get(item.name, (None, None))


def _choose(path: Path, raw: Any, wanted: Interface | None) -> Interface:
    offered = [
        interface
        for interface, element in (
            (Interface.CO_SIMULATION, raw.coSimulation),
            (Interface.MODEL_EXCHANGE, raw.modelExchange),
        )
        if element is not None
    ]
    if wanted in offered or (wanted is None and offered):
        return wanted or offered[0]
    others = ["scheduled-execution"] if raw.scheduledExecution is not None else []
    raise FmuError(
        f"{path}: the FMU offers no {wanted or 'co-simulation or model-exchange'} interface; "
        f"it offers {listed([*offered, *others])}\n  Export it again for {wanted or 'co-simulation'}."
    )


def _directional(root: Any, interface: Interface) -> bool:
    """FMI 3's providesDirectionalDerivatives, whose plural fmpy does not read."""
    element = root.find("CoSimulation" if interface is Interface.CO_SIMULATION else "ModelExchange")
    return element is not None and element.get("providesDirectionalDerivatives") in ("true", "1")


def _parsed(path: Path, version: str) -> tuple[Any, tuple[str, ...]]:
    """Fmpy's description, and where it breaks a rule of FMI without harm.

    These are the rules that are not part of the XML schema, and attributes that the schema does not know, as
    misspelt ones; both are common in the field. What else breaks the schema is refused.
    """
    # fmpy costs 0.1 s to import, which a config with a mistake in it should not have to wait for.
    from fmpy.model_description import ValidationError, read_model_description

    try:
        # The complete FMU is passed on, since FMI 3 spreads the description over several files.
        try:
            return read_model_description(str(path), validate=True), ()
        except ValidationError as error:
            broken = [problem for problem in error.problems if _OF_SCHEMA.match(problem)]
            if not all(_UNKNOWN_ATTRIBUTE.match(problem) for problem in broken):
                raise
            found = (_UNKNOWN_ATTRIBUTE.sub(r"line \1: \2, which is ignored", one) for one in error.problems)
            return read_model_description(str(path), validate=False), tuple(found)
    except Exception as error:
        raise FmuError(
            f"{path}: its modelDescription.xml is not valid FMI {version}\n{_indented(error)}"
        ) from error


def _indented(error: Exception) -> str:
    problems = getattr(error, "problems", None) or [str(error)]
    shown = [f"  {problem}" for problem in problems[:5]]
    if len(problems) > 5:
        shown.append(f"  and {len(problems) - 5} more")
    return "\n".join(shown)


def _reduce(
    raw: Any,
    chosen: Interface,
    directional: bool,
    deviations: tuple[str, ...],
    negated: frozenset[str],
    within: frozenset[str],
) -> ModelDescription:
    units, display_units = read_units(raw)
    variables: dict[str, Variable] = {}
    ports: dict[str, tuple[str, ...]] = {}
    for item in raw.modelVariables:
        whole = read_variable(item, units, display_units, item.name in negated, item.name in within)
        made = elements(whole, item.start)
        variables.update({one.name: one for one in made})
        ports[item.name] = tuple(one.name for one in made)
    exchange = chosen is Interface.MODEL_EXCHANGE
    interface = raw.modelExchange if exchange else raw.coSimulation
    inputs = tuple(v.name for v in variables.values() if v.causality is Causality.INPUT)
    outputs = [v.name for v in variables.values() if v.causality is Causality.OUTPUT]
    feedthrough, declared = _dependencies(raw.outputs, ports, inputs, outputs)
    at_start, declared_at_start = _dependencies(raw.initialUnknowns, ports, inputs, outputs)
    initial = {name: at_start[name] if name in declared_at_start else feedthrough[name] for name in outputs}
    for name in outputs:
        # A start value that the FMU takes as it is depends on nothing (FMI 2.0.4, 2.2.7, initial = exact).
        if variables[name].initial is Initial.EXACT:
            initial[name] = ()
    experiment = raw.defaultExperiment
    proposed = number(experiment.stepSize) if experiment is not None else None
    internal = None if exchange else number(interface.fixedInternalStepSize)
    free = exchange or bool(interface.canHandleVariableCommunicationStepSize)
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
            variable_step_size=free,
            save_state=bool(interface.canGetAndSetFMUstate),
            serialise_state=bool(interface.canSerializeFMUstate),
            # Derivatives of arrays are asked for whole, which is not done here.
            directional_derivatives=(directional or bool(interface.providesDirectionalDerivative))
            and all(variables[name].elements == 1 for name in (*inputs, *outputs)),
            # FMI 3 has no call for input derivatives.
            interpolate_inputs=not exchange
            and bool(interface.canInterpolateInputs)
            and raw.fmiVersion.startswith("2"),
            output_derivative_order=0 if exchange else int(interface.maxOutputDerivativeOrder or 0),
            once_per_process=bool(interface.canBeInstantiatedOnlyOncePerProcess),
            execution_tool=bool(interface.needsExecutionTool),
            fixed_internal_step=internal,
            event_mode=not exchange and bool(interface.hasEventMode),
            intermediate_update=not exchange and bool(interface.providesIntermediateUpdate),
            return_on_request=not exchange
            and bool(interface.canReturnEarlyAfterIntermediateUpdate)
            and not interface.mightReturnEarlyFromDoStep,
        ),
        description=raw.description or "",
        deviations=deviations,
        interface=chosen,
        states=int(raw.numberOfContinuousStates or 0),
        event_indicators=int(raw.numberOfEventIndicators or 0),
        completed_step=exchange and bool(interface.needsCompletedIntegratorStep),
        tolerance=number(experiment.tolerance) if experiment is not None else None,
        default_step=proposed,
        default_start=number(experiment.startTime) if experiment is not None else None,
        default_stop=number(experiment.stopTime) if experiment is not None else None,
        own_step=None if free else internal or proposed,
        own_step_divides=internal is not None,
        tool=raw.generationTool or "",
    )


def _dependencies(
    unknowns: Any, ports: Mapping[str, tuple[str, ...]], inputs: tuple[str, ...], outputs: list[str]
) -> tuple[dict[str, tuple[str, ...]], set[str]]:
    """Per output the inputs it depends on, and the outputs for which that is declared.

    FMI declares dependencies of whole arrays: every element then depends on every element.
    """
    known, declared = dict.fromkeys(outputs, inputs), set()
    for unknown in unknowns:
        if unknown.dependencies is None:
            continue
        wanted = {port for dependency in unknown.dependencies for port in ports[dependency.name]}
        for name in ports[unknown.variable.name]:
            if name in known:
                known[name] = tuple(port for port in inputs if port in wanted)
                declared.add(name)
    return known, declared
