"""The loop over time: preparation, Python and native loop, pacing, runs and their folders, comparison.

Imports `plotting` and the packages listed before it in CONTRIBUTING.md.
"""
