"""The loop over time: preparation, the Python and the native loop, pacing, runs and their folders, comparison.

Imports `plotting` and the packages below it.
"""
