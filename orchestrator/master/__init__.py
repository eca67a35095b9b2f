"""Master algorithms: how instances take turns within a communication step."""

from .base import DONE, MasterAlgorithm, StepInfo, create_master, master_names

__all__ = ["DONE", "MasterAlgorithm", "StepInfo", "create_master", "master_names"]
