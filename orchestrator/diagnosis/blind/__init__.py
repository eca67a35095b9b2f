"""Blind checks of the search on any system: hide laws in a copy that an independent solver integrates.

Owns: parts and random systems of them, laws in forms of their own, cases with logs, scores of verdicts.
Imports `translate` for the FMUs of the parts, and the search that it checks.
"""
