"""What the clients are known not to do with ours: told by their own words, which the tests hold them to."""

from __future__ import annotations

import re
from typing import NamedTuple

from .trial import Outcome

__all__ = ["LIMITS", "Limit", "limit_of"]


class Limit(NamedTuple):
    """A reason, as an expression that the client's message matches, and what it means."""

    client: str
    message: str
    meaning: str


_UNREADABLE = "fmi2GetReal failed|fmi2SetReal failed"
LIMITS = (
    Limit("fmpy", "runs single FMUs", "couples FMUs in packages only"),
    Limit("libcosimpy", "ends by SIGSEGV", "crashes where it is given FMI 3.0, which it does not read"),
    Limit("libcosimpy", "start value of (velocity|position)", "sets no start values of outputs"),
    Limit("libcosimpy", "does not see", "does not see enumerations"),
    Limit(
        "pathsim-fmi",
        _UNREADABLE,
        "reads and writes integers and booleans as real numbers, which FMUs refuse",
    ),
    Limit(
        "cofmupy", _UNREADABLE, "reads and writes integers and booleans as real numbers, which FMUs refuse"
    ),
    Limit(
        "cofmupy", "'minimum' did not contain a loop", "takes the least of step sizes in a text, and fails"
    ),
)


def limit_of(client: str, outcome: Outcome) -> Limit | None:
    """The limit that an outcome shows; None if it is none."""
    if outcome.deviation is not None:
        return None
    return next(
        (one for one in LIMITS if one.client == client and re.search(one.message, outcome.reason)), None
    )
