"""Programs and rigs outside this process, which take and give values over UDP."""

from .component import ExternalFmu

__all__ = ["ExternalFmu"]
