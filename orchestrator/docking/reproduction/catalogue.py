"""All experiments; a new one is a module and a line here."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module

from ...base.errors import ConfigError, Problem, listed, nearest
from .experiment import Experiment

_MODULES = ("divergence", "cosimulation", "virtual_walls", "identification", "mechanisms")


def experiments() -> dict[str, Experiment]:
    """Experiments by name, in the paper's order."""
    return {name: import_module(f"{__package__}.{name}") for name in _MODULES}


def chosen_figures(only: Iterable[str] = ()) -> tuple[str, ...]:
    """Figures to make, in the paper's order.

    Args:
        only: figures ("fig6"), groups of them ("fig3" for fig3a to fig3d) or experiments; all if empty.
    Raises: ConfigError if a name is none of these.
    """
    known = experiments()
    names = {figure: (figure,) for one in known.values() for figure in one.FIGURES}
    for figure in tuple(names):
        if not figure[-1].isdigit():
            names[figure[:-1]] = (*names.get(figure[:-1], ()), figure)
    every = tuple(figure for one in known.values() for figure in one.FIGURES)
    names |= {name: tuple(one.FIGURES) for name, one in known.items()}
    wanted = list(only)
    unknown = [name for name in wanted if name not in names]
    if unknown:
        raise ConfigError(
            [
                Problem(
                    "--only",
                    f"no figure or experiment {name!r}",
                    f"allowed: {listed(names)}",
                    nearest(name, names),
                )
                for name in unknown
            ]
        )
    chosen = {figure for name in wanted for figure in names[name]}
    return tuple(figure for figure in every if not wanted or figure in chosen)
