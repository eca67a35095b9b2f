"""The communication loop without the interpreter, for compiled FMUs under masters of a fixed schedule."""

from .choice import LOOPS, choose_loop, schedule

__all__ = ["LOOPS", "choose_loop", "schedule"]
