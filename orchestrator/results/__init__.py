"""Recorded signals: recording, streams on disk, reading, file formats, measures, progress.

Imports `system`, `master` and the packages listed before them in CONTRIBUTING.md.
"""
