"""The diagnosis by unknown inputs: search outside and inside components, and judge the best fits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from time import perf_counter

from threadpoolctl import threadpool_limits

from ...base.errors import ConfigError
from ...system.connection import Port
from ..study.study import PortStudy, Role
from .answer import NEAR_NOISE, Answer, Judgement
from .effort import Effort
from .evaluation import Place
from .model import StateModel
from .places import Runs
from .played import PlayedModel
from .rebuilt import with_openings
from .search import Search
from .thinning import thinned, without_outliers

# An answer inside a component has to leave so much less than the best one outside.
_CLEARLY = 0.8
# Share of the residual that a law inside must explain by its score to be fitted before pairs outside.
_PROMISING = 0.3


def answer(study: PortStudy, progress: Callable[[str], None] = lambda _: None) -> Answer:
    """Find what is missing.

    Args:
        progress: takes the name of each stage.
    """
    begin, effort, opened = perf_counter(), Effort(), cache(lambda: with_openings(study))
    # With many small matrices, threads of BLAS wait for one another.
    with threadpool_limits(1):
        with _model(study, effort) as model:
            outside, has_states = _Inquiry(study, model, progress), model.filters
            found = None
            if has_states and not outside.explained and (inner := opened()):
                found = _inside(inner, effort, progress, outside.least)
            found = found or outside.answer()
        if has_states and not found.openings and found.remains > NEAR_NOISE and (inner := opened()):
            inside = _inside(inner, effort, progress) if effort.allows() else None
            if inside is not None and inside.remains < _CLEARLY * found.remains:
                found = inside
            elif not effort.allows():
                found.remarks.append("Equations inside components were not searched to the end.")
    return replace(found, seconds=perf_counter() - begin, by_master=not has_states)


def _inside(
    opened: PortStudy, effort: Effort, progress: Callable[[str], None], outside: float | None = None
) -> Answer | None:
    """The answer with places in the equations of components; None if there are no such places.

    Args:
        outside: what the best single law elsewhere leaves. If it is given, single laws in these equations
            come first, and the answer is None unless one of them leaves clearly less.
    """
    with _model(opened, effort) as model:
        inner = [one for one in model.places() if Port.of(one.name) in opened.openings]
        if not inner:
            return None
        progress("inner equations")
        made = None
        if outside is not None:
            brief = _Inquiry(opened, model, progress, inner, _PROMISING)
            if brief.least >= _CLEARLY * outside:
                return None
            made = brief.answer(further=False) if brief.explained else None
        if made is None or made.verdict != "law" or made.remains > NEAR_NOISE:
            made = _Inquiry(opened, model, progress).answer()
    laws = made.fitted.laws if made.fitted else ()
    equations = {law.place.name: opened.openings.get(Port.of(law.place.name)) for law in laws}
    remarks = [f"{name} is inside the component: {one.equation}" for name, one in equations.items() if one]
    return replace(made, remarks=[*remarks, *made.remarks], openings=opened.openings)


class _Inquiry:
    """The search for what is missing at places of a study's model, after its first stages.

    Attributes:
        explained: whether a single law explains the logs, or none is needed. least: what the best one leaves.
    """

    def __init__(
        self, study: PortStudy, model: StateModel, progress: Callable[[str], None],
        places: Sequence[Place] | None = None, promising: float = 0.0,
    ) -> None:  # fmt: skip
        progress("calibration")
        self._progress, model.study = progress, study
        model.study, self._remarks = without_outliers(model)
        self._study = model.study
        model.study = thinned(model)
        self._search = Search(Runs(model, model.study.of(Role.TRAIN, Role.VALIDATION)), progress, places)
        self._found = self._search.begun(promising)
        self.explained = not self._search.places or self._search.explained(self._found)
        self.least = min(one.remains for one in self._found)

    def answer(self, further: bool = True) -> Answer:
        """What is missing.

        Args:
            further: whether the other stages follow.
        """
        search = self._search
        weighed = search.weighed(search.further(self._found) if further else self._found)
        self._progress("judgement")
        made = Judgement(self._study, search, weighed).answer()
        remarks = [*self._remarks, *made.remarks]
        if search.left_out:
            ended = f"The search ended at its limit of work, without: {', '.join(search.left_out)}."
            remarks.insert(len(self._remarks), ended)
        return replace(made, remarks=remarks, left_out=search.left_out)


def _model(study: PortStudy, effort: Effort) -> StateModel:
    """The system in state form, or as its master simulates it, where components give no access to states."""
    try:
        return StateModel(study, effort=effort)
    except ConfigError:
        return PlayedModel(study, effort=effort)
