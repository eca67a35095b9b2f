"""Campaigns: studies of many runs, on many cores or machines, kept in a store that can be queried."""

from .database import Store
from .sweep import Study, Swept, sweep

__all__ = ["Store", "Study", "Swept", "sweep"]
