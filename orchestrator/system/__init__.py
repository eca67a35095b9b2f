"""From a config to a checked system: ports, connections, units, start values, algebraic loops, power bonds.

Imports `base`, `fmi`, `effects` and `config`.
"""
