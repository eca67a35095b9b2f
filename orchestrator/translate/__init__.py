"""Modelica and Python models to FMUs for co-simulation.

What a Modelica model may hold:

- Real, Integer and Boolean variables and arrays of them; constants, parameters, parameters and start values
  that depend on parameters; components, connectors and connections, inheritance, replaceable classes.
- Equations, for-loops and if-equations; `der`, `delay` with two or three arguments and with any delay time,
  zero and state-dependent ones included; `time`; `noEvent`, `smooth`, `homotopy`; `abs`, `sign`, `min`,
  `max`, `sqrt`, trigonometric, hyperbolic and exponential functions; `floor`, `ceil`, `integer`, `mod`, `rem`
  and `div` within `noEvent`; `sum`, `product`, `size`, `fill`, `zeros`, `ones`, `transpose`, matrix products.
- Relations, which raise events outside `noEvent`; linear algebraic loops; `assert` in the equation section.

Everything else is refused with a message that names file and line: when-equations and what belongs to them,
algorithms and functions of one's own, initial equations, conditional components, enumerations and strings,
nonlinear algebraic loops, systems that need index reduction.

`build.build` makes an FMU; `library` rebuilds the shipped ones.

Imports `simulation` and the packages below it.
"""
