"""Campaigns: studies of many runs, on many cores or machines, kept in a store that can be queried.

Imports `frequency` and the packages listed before it in CONTRIBUTING.md.
"""

from .database import Store
from .sweep import Study, Swept, sweep

__all__ = ["Store", "Study", "Swept", "sweep"]
