"""Master algorithms: how instances take turns within a communication step.

Imports `system` and the packages below it.
"""

from .base import DONE, MasterAlgorithm, StepInfo, create_master, master_names

__all__ = ["DONE", "MasterAlgorithm", "StepInfo", "create_master", "master_names"]
