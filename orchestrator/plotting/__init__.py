"""Figures of recorded signals, and the building blocks of HTML pages.

Imports `results` and the packages below it.
"""
