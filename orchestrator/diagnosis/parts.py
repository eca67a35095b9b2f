"""The analyses that a diagnosis is made of, so that any can be replaced."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .finding import Finding
from .study import Study

__all__ = ["Parts"]


@dataclass(frozen=True)
class Parts:
    """Analyses of a study. All but `weigh` are given the finding, too; None leaves one out.

    Attributes:
        weigh: which effects cause the gap; is given training runs only.
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
    def standard() -> Parts:
        """Those of this package."""
        from .weigh import weigh

        return Parts(weigh)
