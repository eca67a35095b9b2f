"""Place, cause and size of the gap between a simulation and the real machine.

Imports `campaign` and the packages below it.
"""
