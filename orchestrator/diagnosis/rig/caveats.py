"""Caveats of a verdict: where else the gap appears, and what other calibrated numbers explain."""

from __future__ import annotations

from collections.abc import Sequence

from .headline import listed_or, percent
from .verdict import Diagnosis

# The gap clearly shows at a place that has this share of it, and so many times that of any place named.
_MOST, _TIMES = 0.5, 2.0
# Closures that differ by less count as equal; tolerances by which a number must deviate to be named.
_AS_WELL, _FAR = 0.02, 3.0


def caveats(diagnosis: Diagnosis) -> list[str]:
    """Sentences to print beside the headline; empty if there is nothing to add."""
    sentences = (
        _elsewhere(diagnosis),
        _as_one(diagnosis),
        _unneeded(diagnosis) or _beyond_tolerances(diagnosis),
    )
    return [one for one in sentences if one]


def _elsewhere(diagnosis: Diagnosis) -> str:
    """Sentence if the gap shows at another place than the named effects, else "".

    Nothing is said of something outside the catalogue: its place is shown by how residuals look.
    """
    effects, places = diagnosis.verdict.effects, diagnosis.verdict.places
    noise = diagnosis.how_far is not None and diagnosis.how_far.within_floor
    if not diagnosis.where or not effects or noise or "outside" in effects:
        return ""
    shares = {one.place: one.share for one in diagnosis.where}
    first = max(shares, key=lambda place: shares[place])
    own = max(shares.get(place, 0.0) for place in places)
    if first in _indistinguishable(diagnosis) or shares[first] < _MOST or shares[first] < _TIMES * own:
        return ""
    one = len(effects) == 1
    return (
        f"The gap shows most at {first} ({percent(shares[first])}), while {_listed(effects)} "
        f"{'acts' if one else 'act'} at {_listed(places)}: if {'it is' if one else 'they are'} the cause, "
        f"{'its error travels' if one else 'their errors travel'} on."
    )


def _as_one(diagnosis: Diagnosis) -> str:
    """That something outside the catalogue may be elsewhere in a chain that logs drive as one."""
    others = sorted(_indistinguishable(diagnosis) - set(diagnosis.verdict.places))
    if diagnosis.verdict.effects != ["outside"] or not others:
        return ""
    chain, own = _listed(sorted([*diagnosis.verdict.places, *others])), _listed(diagnosis.verdict.places)
    return (
        f"Logs drive {chain} as one: that it is at the {own}, and not at {listed_or(others)}, follows only "
        "from the shape of the residuals."
    )


def _unneeded(diagnosis: Diagnosis) -> str:
    """Sentence if other values of the calibrated numbers close the gap as well as the effects, else ""."""
    gap, effects = diagnosis.how_far, diagnosis.verdict.effects
    if not effects or "outside" in effects or gap is None or gap.within_floor:
        return ""
    if gap.closure is None or gap.recalibration_only is None or not diagnosis.calibration:
        return ""
    if gap.recalibration_only < gap.closure - _AS_WELL:
        return ""
    moved = _moved(diagnosis, "recalibrated")
    name = max(moved, key=lambda name: abs(moved[name]))
    numbers = "Other values of calibrated numbers alone"
    deviation = f"{name} {moved[name]:+.1f} tolerances from its own"
    if abs(moved[name]) >= _FAR:
        return (
            f"{numbers} close {percent(gap.recalibration_only)} of the gap, {deviation}: if its tolerance "
            "can be that wrong, no effect is needed."
        )
    return ""


def _beyond_tolerances(diagnosis: Diagnosis) -> str:
    """Sentence if calibrated numbers moved farther than their tolerances allow, beside effects, else ""."""
    effects = diagnosis.verdict.effects
    if not diagnosis.doubtful_tolerances or not effects:
        return ""
    moved = _moved(diagnosis, "recalibrated" if "outside" in effects else "fitted")
    # Several numbers together are evidence, even if none deviates much.
    far = [name for name in moved if abs(moved[name]) > _FAR]
    shown = far or sorted(moved, key=lambda name: -abs(moved[name]))[:2]
    named = ", ".join(f"{name} {moved[name]:+.1f}" for name in shown)
    parenthesis = f" ({named} tolerances)" if named else ""
    return f"Calibrated numbers moved farther than their tolerances allow{parenthesis}: doubt the tolerances."


def _moved(diagnosis: Diagnosis, key: str) -> dict[str, float]:
    """By how many tolerances calibrated numbers moved in a fit, `recalibrated` or `fitted` with effects."""
    return {
        name: (one[key] - one["nominal"]) / one["tolerance"] for name, one in diagnosis.calibration.items()
    }


def _indistinguishable(diagnosis: Diagnosis) -> set[str]:
    """Places that the logs cannot separate from those named: of tied effects, and of the same component."""
    named = set(diagnosis.verdict.places)
    effects = set(diagnosis.verdict.effects)
    ties = [tie for one in diagnosis.which if set(one.effects) == effects for tie in one.ties]
    found = named | {tie.partition(".")[0] for tie in ties}
    for row in diagnosis.ledger:
        places = set(row.component.split("+"))
        if places & named:
            found |= places
    return found


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
