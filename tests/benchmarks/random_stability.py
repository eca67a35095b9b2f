"""Signs of stability of 500 random systems, 2 to 60 states and 1 to 6 delays, against simulations.

`python -m tests.benchmarks.random_stability`
"""

from __future__ import annotations

import sys
from time import perf_counter

from orchestrator.cli.arguments import one_matrix_thread

from ..random_systems import compared, drawn

# Systems, their states and delays: large ones are simulated apart from small ones.
CASES = ((300, (2, 20), (1, 4)), (200, (20, 60), (1, 6)))


def main() -> int:
    """Print how many signs differ. Returns: 1 if one does."""
    one_matrix_thread()
    wrong = 0
    for count, states, delays in CASES:
        begin = perf_counter()
        found = compared(drawn(count, states, delays, seed=2026))
        wrong += found.wrong
        print(
            f"{count} systems of {states[0]} to {states[1]} states, {delays[0]} to {delays[1]} delays: "
            f"{found.wrong} of {found.judged} signs wrong, {found.unstable} unstable, rates within "
            f"{found.median_error:.1e} 1/s (median); {perf_counter() - begin:.0f} s"
        )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
