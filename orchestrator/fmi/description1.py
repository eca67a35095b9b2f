"""What fmpy leaves out of an FMI 1.0 model description."""

from __future__ import annotations

from typing import Any

_CAPABILITIES = (
    "canHandleVariableCommunicationStepSize",
    "canBeInstantiatedOnlyOncePerProcess",
    "canInterpolateInputs",
    "maxOutputDerivativeOrder",
)


def complete(raw: Any, root: Any) -> frozenset[str]:
    """Fill in capabilities, causalities, start values' fixedness and dependencies.

    Args:
        raw: fmpy's description, changed here.
        root: the XML it was read from.
    Returns: names of the variables that are the negative of what they are an alias of.
    """
    from fmpy.model_description import Unknown

    if raw.coSimulation is not None:
        raw.coSimulation.needsExecutionTool = root.find("Implementation/CoSimulation_Tool") is not None
        for element in root.findall("Implementation/*/Capabilities"):
            for name in _CAPABILITIES:
                text = element.get(name)
                if text is not None:
                    value = int(text) if name.startswith("max") else text in ("true", "1")
                    setattr(raw.coSimulation, name, value)
    else:
        # FMI 1.0 has no way to say that completedIntegratorStep is not needed.
        raw.modelExchange.needsCompletedIntegratorStep = True
    elements = {element.get("name"): element for element in root.findall("ModelVariables/ScalarVariable")}
    variables = {item.name: item for item in raw.modelVariables}
    negated = set()
    for item in raw.modelVariables:
        element = elements[item.name]
        # Texts and items of enumerations have no negative; FMI's own checker ignores it there, too.
        if element.get("alias") == "negatedAlias" and item.type in ("Real", "Integer", "Boolean"):
            negated.add(item.name)
        if item.causality == "none":
            item.causality = "local"
        if item.causality == "parameter" and item.start is None:
            item.causality = "calculatedParameter"
        if item.start is not None and item.causality != "input":
            guess = any(child.get("fixed") in ("false", "0") for child in element)
            item.initial = "approx" if guess else "exact"
        elif item.causality in ("output", "local"):
            item.initial = "calculated"
        needs = element.find("DirectDependency")
        if item.causality == "output" and needs is not None:
            names = [(name.text or "").strip() for name in needs.findall("Name")]
            dependencies = [variables[name] for name in names if name in variables]
            raw.outputs.append(Unknown(variable=item, dependencies=dependencies))
    return frozenset(negated)
