"""Modelica and Python models to FMUs.

What a Modelica model of the explicit route may hold:

- Real, Integer and Boolean variables and arrays of them; constants, parameters, parameters and start values
  that depend on parameters; components, connectors and connections, inheritance, replaceable classes.
- Equations, for-loops and if-equations; `der`, `delay` with two or three arguments and with any delay time,
  zero and state-dependent ones included; `time`; `noEvent`, `smooth`; `abs`, `sign`, `min`,
  `max`, `sqrt`, trigonometric, hyperbolic and exponential functions; `floor`, `ceil`, `integer`, `mod`, `rem`
  and `div` within `noEvent`; `sum`, `product`, `size`, `fill`, `zeros`, `ones`, `transpose`, matrix products.
- Relations, which raise events outside `noEvent`; linear algebraic loops; `assert` in the equation section.

Everything else takes the route of `hybrid`, or is refused with a message that names file, line and column.

The way of a Modelica model: `sources` reads its files, `rewriting` changes what the compiler refuses or
mistakes, `flatten` and `reader` make one flat model (`flat`). `symbolic` and `causalise` solve it,
`selfcheck` checks that, `generate` and `description` write what `package` compiles and packs.

The way of a Python model: `python_fmu` packs it as it is; for a native FMU, `component` runs it with numbers
that remember how they were computed (`traced`), `step_code` and `step_description` write it.

`build.build` makes an FMU, `check.check_model` lists a model's faults, `show.show_model` prints what
became of it; `library` rebuilds the shipped FMUs.

Imports `simulation` and the packages listed before it in CONTRIBUTING.md.
"""
