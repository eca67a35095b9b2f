"""Campaigns: studies of many runs, on many cores or machines, kept in a store that can be queried.

Imports `frequency` and the packages below it.
"""

from .database import Store
from .sweep import Study, Swept, sweep

__all__ = ["Store", "Study", "Swept", "sweep"]
