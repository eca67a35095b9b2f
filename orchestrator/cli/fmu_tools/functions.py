"""Functions that a library must export to be an FMU, by version of FMI and interface."""

from __future__ import annotations

import inspect
import re
from functools import lru_cache

from ...fmi import Interface

# Without these an FMU cannot be run by any master; of the others many masters need none.
_CORE = {
    ("1", Interface.CO_SIMULATION): (
        "fmiInstantiateSlave", "fmiInitializeSlave", "fmiDoStep", "fmiTerminateSlave", "fmiFreeSlaveInstance",
        "fmiGetReal", "fmiSetReal",
    ),
    ("1", Interface.MODEL_EXCHANGE): (
        "fmiInstantiateModel", "fmiInitialize", "fmiTerminate", "fmiFreeModelInstance", "fmiSetTime",
        "fmiGetDerivatives", "fmiSetContinuousStates", "fmiGetContinuousStates", "fmiEventUpdate",
        "fmiGetReal", "fmiSetReal",
    ),
    ("2", Interface.CO_SIMULATION): (
        "fmi2Instantiate", "fmi2SetupExperiment", "fmi2EnterInitializationMode", "fmi2ExitInitializationMode",
        "fmi2DoStep", "fmi2Terminate", "fmi2FreeInstance", "fmi2Reset", "fmi2GetReal", "fmi2SetReal",
    ),
    ("2", Interface.MODEL_EXCHANGE): (
        "fmi2Instantiate", "fmi2SetupExperiment", "fmi2EnterInitializationMode", "fmi2ExitInitializationMode",
        "fmi2Terminate", "fmi2FreeInstance", "fmi2Reset", "fmi2SetTime", "fmi2GetDerivatives",
        "fmi2SetContinuousStates", "fmi2GetContinuousStates", "fmi2NewDiscreteStates",
        "fmi2EnterContinuousTimeMode", "fmi2EnterEventMode", "fmi2GetReal", "fmi2SetReal",
    ),
    ("3", Interface.CO_SIMULATION): (
        "fmi3InstantiateCoSimulation", "fmi3EnterInitializationMode", "fmi3ExitInitializationMode",
        "fmi3DoStep", "fmi3Terminate", "fmi3FreeInstance", "fmi3Reset", "fmi3GetFloat64", "fmi3SetFloat64",
    ),
    ("3", Interface.MODEL_EXCHANGE): (
        "fmi3InstantiateModelExchange", "fmi3EnterInitializationMode", "fmi3ExitInitializationMode",
        "fmi3Terminate", "fmi3FreeInstance", "fmi3Reset", "fmi3SetTime", "fmi3GetContinuousStateDerivatives",
        "fmi3SetContinuousStates", "fmi3GetContinuousStates", "fmi3UpdateDiscreteStates",
        "fmi3EnterContinuousTimeMode", "fmi3EnterEventMode", "fmi3GetFloat64", "fmi3SetFloat64",
    ),
}  # fmt: skip


def core_functions(fmi_version: str, interface: Interface) -> frozenset[str]:
    """Functions without which an interface cannot be run."""
    return frozenset(_CORE[fmi_version[0], interface])


@lru_cache
def fmi_functions(fmi_version: str, interface: Interface) -> frozenset[str]:
    """All functions that the standard has the libraries of an interface export.

    They are those that fmpy calls; FMI 1.0's without the model's name before them.
    """
    from fmpy import fmi1, fmi2, fmi3

    exchange = interface is Interface.MODEL_EXCHANGE
    bindings = {
        "1": (fmi1.FMU1Slave, fmi1.FMU1Model),
        "2": (fmi2.FMU2Slave, fmi2.FMU2Model),
        "3": (fmi3.FMU3Slave, fmi3.FMU3Model),
    }[fmi_version[0]][exchange]
    names = {name for name, _ in inspect.getmembers(bindings, inspect.isfunction)}
    found = {name for name in names if re.match(r"fmi\d[A-Z]", name)}
    if fmi_version[0] == "1":
        found = {name.replace("fmi1", "fmi", 1) for name in found}
    return frozenset(found) | core_functions(fmi_version, interface)


def exported_name(function: str, fmi_version: str, identifier: str) -> str:
    """What the library calls a function: FMI 1.0 puts the model's name before it."""
    return f"{identifier}_{function}" if fmi_version[0] == "1" else function
