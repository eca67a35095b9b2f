"""What an experiment is: runs to make, quantities to read from them, figures to draw."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ...base.arrays import Array
from ...results.recorders import Results
from ..contacts import Contact, find_contacts
from ..options import DockingOptions

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Case:
    """One run: a bundled system with overrides, as `orchestrator run NAME --set ...` takes them."""

    name: str
    system: str
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Recorded:
    """What a run gave.

    Attributes:
        results: the recorded signals.
        measures: of the measure `docking`, see `orchestrator.docking.measures`.
        options: which instances play which part.
    """

    results: Results
    measures: Mapping[str, Any]
    options: DockingOptions

    @property
    def found(self) -> list[Contact]:
        """The completed contacts."""
        return find_contacts(self.results.time, self.velocity, self.force)

    @property
    def velocity(self) -> Array:
        """Relative velocity of the satellites [m/s]."""
        return self.results[f"{self.options.satellite}.velocity"]

    @property
    def force(self) -> Array:
        """Contact force on the rod [N]."""
        return self.results[f"{self.options.contact}.force"]

    @property
    def energy(self) -> Array:
        """Kinetic energy of the relative motion [J]."""
        return self.results[f"{self.options.satellite}.kinetic_energy"]

    @property
    def ratios(self) -> Array:
        """Speed after each contact over the approach speed, positive."""
        return np.abs(self._each("rebound_velocity_ratio"))

    @property
    def ideal_ratios(self) -> Array:
        """The same of the contact without delay."""
        return np.abs(self._each("ideal_velocity_ratio"))

    @property
    def restitutions(self) -> Array:
        """Coefficient of restitution of each contact, Eq. (32), as a ratio."""
        return self._each("cor")

    @property
    def peaks(self) -> Array:
        """Largest force of each contact [N]."""
        return self._each("peak_force")

    @property
    def ideal_peak(self) -> float:
        """Largest force of the first contact without delay [N]."""
        return float(self.measures["ideal"]["first_peak_force"])

    def estimate(self, name: str) -> Array:
        """The controller's estimate, at every instant in contact, beginning with contact 2.

        The first contact holds the initial guess.

        Args:
            name: "stiffness" [N/m] or "damping" [N.s/m].
        """
        column = self.results[f"{self.options.controller}.{name}_estimate"]
        return np.concatenate([column[one.first : one.last + 1] for one in self.found[1:]])

    def _each(self, key: str) -> Array:
        return np.array([one[key] for one in self.measures["contacts"]])


@dataclass(frozen=True)
class Criterion:
    """When a number counts as agreeing with the paper, in words and as a test."""

    text: str
    holds: Callable[[float], bool]


def near(value: float, relative: float, what: str = "") -> Criterion:
    """Within a part of a value; `what` names the value where it is not the paper's own."""
    text = f"within {relative * 100:.3g} % of {what or f'{value:.5g}'}"
    return Criterion(text, lambda ours: abs(ours - value) <= relative * abs(value))


def above(limit: float) -> Criterion:
    """Larger than a limit."""
    return Criterion(f"above {limit:.5g}", lambda ours: ours > limit)


def below(limit: float) -> Criterion:
    """Smaller than a limit."""
    return Criterion(f"below {limit:.5g}", lambda ours: ours < limit)


def between(low: float, high: float) -> Criterion:
    """Within limits."""
    return Criterion(f"from {low:.5g} to {high:.5g}", lambda ours: low <= ours <= high)


@dataclass(frozen=True)
class Quantity:
    """A number beside the paper's.

    Attributes:
        key: its name in reproduction.json.
        figure: where it belongs, one of the experiment's figures.
        text: what it is.
        unit: of `ours`.
        paper: what the paper says, with the section; empty where it gives no such number.
        ours: the number found.
        criterion: when it agrees; None where there is nothing to hold it against.
        note: why it differs, or how it was found.
        source: whether the criterion asks for what the paper says; if not, for what theory or the rig
            model says, which tests us alone.
    """

    key: str
    figure: str
    text: str
    unit: str
    paper: str
    ours: float
    criterion: Criterion | None = None
    note: str = ""
    source: bool = True

    @property
    def against(self) -> str | None:
        """What it is held against: "source", "theory", or None."""
        if self.criterion is None:
            return None
        return "source" if self.source and self.paper else "theory"

    @property
    def agrees(self) -> bool | None:
        """Whether the criterion holds; None without one."""
        if self.criterion is None:
            return None
        return math.isfinite(self.ours) and self.criterion.holds(self.ours)


class Experiment(Protocol):
    """One of the paper's experiments; modules of this package are such.

    Attributes:
        TITLE: a heading, with the section.
        ABOUT: how it is done here, and what was assumed: paragraphs of plain text.
        FIGURES: captions by figure, for example {"fig6": "..."}.
    """

    TITLE: str
    ABOUT: tuple[str, ...]
    FIGURES: Mapping[str, str]

    def cases(self) -> tuple[Case, ...]:
        """The runs it needs."""

    def quantities(self, runs: Mapping[str, Recorded]) -> list[Quantity]:
        """Numbers read from the runs, by case name."""

    def draw(self, figure: str, runs: Mapping[str, Recorded]) -> Figure:
        """One of FIGURES."""


def native(*overrides: str, controller: bool = True) -> tuple[str, ...]:
    """Overrides that make a bundled docking system run without the interpreter."""
    forms = ("satellite", "controller") if controller else ("satellite",)
    return (*(f"instances.{name}.form=native" for name in forms), "run.loop=native", *overrides)
