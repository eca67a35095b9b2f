"""What every package uses: errors, units, quantities, files written whole, locks, digests, graph algorithms.

Imports nothing else of the project.
"""
