"""What a diagnosis is given: a study of a system of FMUs, its logs, and their checks.

`reader` reads `study.yaml` and the logs into a `PortStudy` (`study`). `player` plays the logs into the system
in place of its own signals, and `replay` simulates the runs so. `checks` finds what is wrong with the logs
before anything is diagnosed. `logs`, `mapping` and `mistakes` serve the docking rig as well.
"""
