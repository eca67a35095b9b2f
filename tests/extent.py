"""How much is tried: a part of the longest series in every run of the tests, all with FULL_TESTS=1."""

from __future__ import annotations

import os
from typing import TypeVar

FULL = os.environ.get("FULL_TESTS", "0") not in ("", "0")
Tried = TypeVar("Tried")


def all_or(part: Tried, everything: Tried) -> Tried:
    """What is to be tried in this run."""
    return everything if FULL else part
