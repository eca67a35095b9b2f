"""The command line: one module for each command.

Imports every other package; none imports this one.
"""
