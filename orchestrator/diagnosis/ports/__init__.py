"""A study of a system of FMUs: its file, its logs, their checks, and the system driven by them.

`reader` reads `study.yaml` and the logs into a `PortStudy`. `player` plays logs into the system, in place of
its own signals, and inserts effects at ports. `given` checks the logs before anything is diagnosed.
"""
