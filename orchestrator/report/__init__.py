"""Pages for a browser, of what the other commands wrote: runs, sweeps, reproductions, diagnoses.

Imports every package but `cli`.
"""
