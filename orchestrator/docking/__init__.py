"""The docking experiments: measures per contact, theory of the ideal contact, figures.

Imports `diagnosis` and the packages listed before it in CONTRIBUTING.md.
"""
