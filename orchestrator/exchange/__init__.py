"""Systems in and out of other tools.

Imports `translate` and the packages listed before it in CONTRIBUTING.md.
"""
