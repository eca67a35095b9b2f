"""Figures of recorded signals, and the building blocks of HTML pages.

Imports `results` and the packages listed before it in CONTRIBUTING.md.
"""
