"""The analyses of a diagnosis; each can be replaced."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from .finding import Finding
from .study import Study

# Imported when a diagnosis is made: they bring machine code along.
_HOME = {
    "weigh": "weigh:weigh",
    "where": "shapley:where",
    "ledger": "residual_ledger:ledger",
    "energy": "energy:energy",
    "how_far": "closure:how_far",
    "next_experiment": "experiments:next_experiment",
    "numerics": "numerics:numerics",
}


@dataclass(frozen=True)
class Analyses:
    """Analyses of a study. All except `weigh` also receive the finding; None omits one.

    Attributes:
        weigh: which effects cause the gap; is given all runs, and fits to train runs alone.
        where: shares of the held-out closed-loop gap by place, adding up to 1.
        ledger: excess residual energy: component, phase, band, share; the shares add up to 1.
        energy: energy balance of contacts.
        how_far: as the models `verdict.HowFar`; next_experiment: `verdict.Experiment`;
        numerics: `verdict.Numerics`.
    """

    weigh: Callable[[Study], Finding]
    where: Callable[[Study, Finding], Mapping[str, float]] | None = None
    ledger: Callable[[Study, Finding], Sequence[Mapping[str, Any]]] | None = None
    energy: Callable[[Study, Finding], Mapping[str, Any]] | None = None
    how_far: Callable[[Study, Finding], Mapping[str, Any]] | None = None
    next_experiment: Callable[[Study, Finding], Mapping[str, Any] | None] | None = None
    numerics: Callable[[Study, Finding], Mapping[str, Any]] | None = None

    @staticmethod
    def standard() -> Analyses:
        """Those of this package."""
        return Analyses(**{name: _load(home) for name, home in _HOME.items()})


def _load(home: str) -> Callable[..., Any]:
    module, _, function = home.partition(":")
    return getattr(import_module(f".{module}", __package__), function)
