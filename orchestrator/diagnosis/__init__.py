"""Place, cause and size of the gap between a simulation and the real machine.

`study` reads studies and logs and checks them. `unknown_input` finds the law that any system of FMUs lacks,
and `blind` checks it on systems with hidden laws. `rig` diagnoses docking rigs.

Imports `campaign` and the packages listed before it in CONTRIBUTING.md.
"""
