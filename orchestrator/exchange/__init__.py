"""Systems in and out of other tools.

Imports `translate` and the packages below it.
"""
