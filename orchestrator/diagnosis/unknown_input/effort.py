"""How much a search has calculated, so that it ends in time without a look at the clock.

Answers must be the same on each machine and at each load. So the limit is a count, not a time.
"""

from __future__ import annotations

from multiprocessing import Value

# Evaluations after which a search begins nothing new. A core makes 3 to 8 million a second.
_LIMIT = 6e8
# What one simulation of all runs may take.
_SIMULATION = 4e5


class Effort:
    """Evaluations of components so far, those of copies of this process among them.

    Read it only where no copy is at work: the sum is then the same in each repetition.
    """

    def __init__(self) -> None:
        self._spent = Value("q", 0)

    def add(self, evaluations: float) -> None:
        """Count evaluations of components."""
        with self._spent.get_lock():
            self._spent.value += int(evaluations)

    @property
    def spent(self) -> int:
        """Evaluations so far."""
        return self._spent.value

    def allows(self, evaluations: float = 0.0) -> bool:
        """Whether so many more stay within the limit."""
        return self._spent.value + evaluations < _LIMIT

    @staticmethod
    def share(evaluations: float) -> float:
        """Of a simulation, the part of its samples that a fit may look at, at most 1."""
        return min(1.0, _SIMULATION / max(evaluations, 1.0))
