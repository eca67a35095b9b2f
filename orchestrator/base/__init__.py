"""What every package uses: errors, units, quantities, files written whole, locks, digests, graph algorithms.

Imports nothing else of the project.
"""

from time import time_ns

# When the package was loaded [ns]: sources that change later are not those that run.
LOADED = time_ns()
