"""Master algorithms: how instances take turns within a communication step.

Imports `system` and the packages listed before it in CONTRIBUTING.md.
"""

from .base import DONE, MasterAlgorithm, StepInfo, create_master, master_names

__all__ = ["DONE", "MasterAlgorithm", "StepInfo", "create_master", "master_names"]
