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


LIMITS: tuple[Limit, ...] = ()


def limit_of(client: str, outcome: Outcome) -> Limit | None:
    """The limit that an outcome shows; None if it is none."""
    if outcome.deviation is not None:
        return None
    return next((one for one in LIMITS if one.client == client and re.search(one.message, outcome.reason)), None)
