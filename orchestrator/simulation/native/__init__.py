"""The communication loop without the interpreter, for compiled FMUs under masters of a fixed schedule."""

from .choice import choose_loop, schedule

__all__ = ["choose_loop", "schedule"]
