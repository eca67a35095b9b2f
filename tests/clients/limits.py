"""What the clients are known not to do with ours, which the tests hold them to."""

from __future__ import annotations

import re
from typing import NamedTuple

from .trial import Outcome

__all__ = ["LIMITS", "Limit", "limit_of"]


class Limit(NamedTuple):
    """Where a client differs, and what that means.

    Attributes:
        client: its package.
        meaning: a sentence without its subject.
        message: an expression that its message matches; empty: it gives other values.
        jobs: an expression that the names of the jobs match.
    """

    client: str
    meaning: str
    message: str = ""
    jobs: str = ""


_UNREADABLE = "fmi2GetReal failed|fmi2SetReal failed"
_ALL_REAL = "reads and writes integers and booleans as real numbers, which FMUs refuse"
LIMITS = (
    Limit("fmpy", "couples FMUs in packages only", "runs single FMUs"),
    Limit("fmpy", "takes the first step of a package with inputs of zero", jobs=r"released \(SSP\)"),
    Limit("libcosimpy", "crashes where it is given FMI 3.0, which it does not read", "SIGSEGV", "-fmi3"),
    Limit(
        "libcosimpy", "does not set start values of states from a package", jobs=r"(1d|uncompensated) \(SSP\)"
    ),
    Limit("pathsim-fmi", _ALL_REAL, _UNREADABLE),
    Limit("cofmupy", _ALL_REAL, _UNREADABLE),
    Limit("cofmupy", "takes the least of step sizes as texts, and fails", "'minimum' did not contain a loop"),
)


def limit_of(client: str, name: str, outcome: Outcome) -> Limit | None:
    """The limit that the outcome of a job shows; None if it is none, or agrees."""
    if outcome.agrees:
        return None
    for one in LIMITS:
        reported = re.search(one.message, outcome.reason) if one.message else outcome.deviation is not None
        if one.client == client and reported and re.search(one.jobs, name):
            return one
    return None
