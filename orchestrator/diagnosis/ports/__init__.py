"""Diagnosis of any configured system of FMUs whose ports were logged.

Logged signals take the place of the system's own (`player`), so that each component, or chain of them
between logged ports, is driven by what was measured and compared at what it gave (`replay`). Candidates
(`candidates`) are changes of parameters, effects on ports, and laws of friction; they are fitted and weighed
by the same fitter and search as those of the docking rig.
"""
