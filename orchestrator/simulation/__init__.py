"""The loop over time: preparation, Python and native loop, pacing, runs and their folders, comparison.

Imports `plotting` and the packages below it.
"""
