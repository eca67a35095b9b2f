"""FMUs: their descriptions, and instances that run."""

from .compiled import CompiledFmu, load_fmu
from .description import Capabilities, ModelDescription, read_description
from .handling import Handling, Interface
from .instance import Array, Fmu, FmuInstance, Point, StepStatus
from .variable import Causality, Initial, Kind, Value, Variability, Variable

__all__ = [
    "Array",
    "Capabilities",
    "Causality",
    "CompiledFmu",
    "Fmu",
    "FmuInstance",
    "Handling",
    "Initial",
    "Interface",
    "Kind",
    "ModelDescription",
    "Point",
    "StepStatus",
    "Value",
    "Variability",
    "Variable",
    "load_fmu",
    "read_description",
]
