"""FMUs: their descriptions, and instances that run.

Imports `base` only.
"""

from .description import Capabilities, ModelDescription, read_description
from .instance import Array, Fmu, FmuInstance, Point, StepStatus, integration_tolerance
from .loading import CompiledFmu, load_fmu
from .run_options import DEFAULT_TOLERANCE, Interface, RunOptions
from .variable import Causality, Initial, Kind, Value, Variability, Variable

__all__ = [
    "DEFAULT_TOLERANCE",
    "Array",
    "Capabilities",
    "Causality",
    "CompiledFmu",
    "Fmu",
    "FmuInstance",
    "Initial",
    "Interface",
    "Kind",
    "ModelDescription",
    "Point",
    "RunOptions",
    "StepStatus",
    "Value",
    "Variability",
    "Variable",
    "integration_tolerance",
    "load_fmu",
    "read_description",
]
