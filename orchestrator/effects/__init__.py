"""Effects: what a connection does to the values that it carries.

An effect is a function of a signal, of the instant that its value belongs to, and of a memory. The signal
that comes out of a connection's effects stands beside the FMUs' outputs, and masters treat it like them:

- Its value at t follows from the sources' values at t and from what the effects remember of the instants
  before. Jacobi feeds an input with the effects' value at the step's begin, Gauss-Seidel with that at its
  end, if the source has stepped. Each of several sources, and of signals that an effect reads besides, counts
  with its latest known value, at the latest of their times.
- Memory is written once at every instant that is accepted: communication points, and the parts of steps that
  an adaptive master keeps. What is evaluated in between, on trial, reads the memory and leaves it as it is; a
  master that steps instances back brings the memory back with them.
- At initialisation effects are evaluated at the start, without memory, and then remember that instant.
- Masters that extrapolate or interpolate inputs do so with the values that come out of the effects. What
  comes out of one that jumps (quantise, sample-and-hold, noise) is not taken for smooth: it is held.
- An instance that steps less often than the system keeps its outputs until its step ends: effects see them
  so.

At zero size an effect gives its input, to the bit. Every effect is one file: a pydantic model of its options
and a kernel, a plain function that the native loop compiles (see `Effect`).

Imports `base` only.
"""

from .base import Effect, Kernel, OfSignal, Pure
from .choose import create_effect, effect_file, effect_names, effect_schema

__all__ = [
    "Effect",
    "Kernel",
    "OfSignal",
    "Pure",
    "create_effect",
    "effect_file",
    "effect_names",
    "effect_schema",
]
