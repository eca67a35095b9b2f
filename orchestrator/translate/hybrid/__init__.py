"""FMUs of Modelica models with events, algebraic loops, initial equations, functions or higher index.

The compiler's DAE form becomes scalar equations (`dae`), these an order of solution (`structure`), that C
code (`code`) for the solver in runtime/hybrid. Models that the explicit route of `translate` takes never come
here.
"""
