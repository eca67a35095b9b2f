"""Score verdicts by the truth: place, law, family, false alarms, calibration, closure, time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from .cases import Case
from .hidden import renamed
from .plant import Lost

GOALS = {
    "place": ">= 0.95", "law": ">= 0.85", "family": ">= 0.93", "two laws": ">= 0.6",
    "outside recognised": ">= 0.8", "false alarms": "<= 0.03", "calibration error": "<= 0.06",
    "median time [s]": "<= 30", "longest time [s]": "<= 120",
}  # fmt: skip
_TOLD = ("seed", "title", "hidden", "verdict", "said", "probability", "closed", "remains", "error")
# A law elsewhere is the same for the logs if it leaves this share of the hidden law's effect.
_SAME = 0.1
_BINS = 10


@dataclass(frozen=True)
class Scored:
    """A verdict against the truth.

    Attributes:
        verdict: of the search, or "error". said: its laws with places. hidden: those of the truth.
        expected: the verdict that would be right.
        place, law, family: whether those of every hidden law are named; None where no law is hidden that the
            library holds. first: whether one law at least is named at its place.
        spurious: laws more than the hidden ones, by family and place.
        right: whether the verdict as a whole is right. probability: as stated.
        closed: share of the gap closed on held-out runs, by the search. remains: there, over the noise.
        seconds, processor: taken, by the clock and of the processor.
    """

    verdict: str
    expected: str
    said: list[str]
    hidden: list[str]
    place: bool | None
    law: bool | None
    family: bool | None
    first: bool | None
    spurious: int
    right: bool
    probability: float
    closed: float
    seconds: float
    error: str = ""
    remains: float = 0.0
    processor: float = 0.0

    def data_of(self) -> dict[str, Any]:
        """As JSON data."""
        return asdict(self)


def _library() -> dict[str, str]:
    from ..unknown_input.laws import library

    return {one.name: one.family for one in library()}


def _plain(name: str) -> str:
    return "".join(c for c in name.lower().split(",")[0] if c.isalnum())


def _held(name: str) -> bool:
    """Whether the library holds a law."""
    wanted = {_plain(one) for one in (name, *renamed(name))}
    return any(_plain(one) in wanted for one in _library())


def scored(truth: Mapping[str, Any], verdict: Mapping[str, Any], case: Case | Callable[[], Case]) -> Scored:
    """Score one verdict.

    Args:
        case: or what makes it again, for simulating a law that is named at another place.
    """
    hidden = [one for one in truth["hidden"] if not one["outside"] and _held(one["law"])]
    names = [f"{one['law']} at {one['place']} of {one['signal']}" for one in truth["hidden"]]
    expected = "none" if not truth["hidden"] else "law" if len(hidden) == len(truth["hidden"]) else "outside"
    if "error" in verdict:
        missed = False if hidden else None
        return Scored(
            "error",
            expected,
            [],
            names,
            missed,
            missed,
            missed,
            missed,
            0,
            False,
            0.0,
            0.0,
            0.0,
            verdict["error"],
        )
    laws = verdict["laws"]
    said = [f"{one['law']} at {one['place']} of {one['signal']}" for one in laws]
    families = [
        [k for k, one in enumerate(laws) if _alike(one, each) or one["family"] in _families(each)]
        for each in hidden
    ]
    places = [
        [k for k, one in enumerate(laws) if one["place"] in each["same_place"] or _equal(one, each, case)]
        for each in hidden
    ]
    placed = [bool(one) for one in places]
    family = [bool(set(a) & set(b)) for a, b in zip(families, places, strict=True)]
    law = [any(_alike(laws[k], each) for k in some) for each, some in zip(hidden, places, strict=True)]
    # A law beside those that are matched is spurious, unless it stands for a hidden one that is not.
    known = {k for a, b in zip(families, places, strict=True) for k in a if k in b}
    spurious = max(0, len(laws) - len(known) - family.count(False))
    found = verdict["verdict"]
    named = bool(hidden) and all(law) and not spurious
    right = named if expected == "law" else found == expected
    some = bool(hidden)
    return Scored(
        found, expected, said, names, all(placed) if some else None, all(law) if some else None,
        all(family) if some else None, any(law) if some else None, spurious, right,
        float(verdict["probability"]), float(verdict["held_out"]["closed"]), float(verdict["seconds"]),
        remains=float(verdict["held_out"]["remains_over_noise"]),
        processor=float(verdict["processor_seconds"]),
    )  # fmt: skip


def _families(hidden: Mapping[str, Any]) -> set[str]:
    """The library's families of a hidden law."""
    wanted = {_plain(one) for one in (hidden["law"], *renamed(hidden["law"]))}
    return {family for name, family in _library().items() if _plain(name) in wanted}


def _alike(said: Mapping[str, Any], hidden: Mapping[str, Any]) -> bool:
    return _plain(said["law"]) in {_plain(one) for one in (hidden["law"], *renamed(hidden["law"]))}


def _equal(said: Mapping[str, Any], hidden: Mapping[str, Any], case: Case | Callable[[], Case]) -> bool:
    """Whether a law of the same name at another place does what the hidden one does, by simulation."""
    if not _alike(said, hidden):
        return False
    from .hidden import named

    made = case() if callable(case) else case
    plant = made.draft.plant
    numbers = [one["value"] for one in said["numbers"].values()]
    true = next(one for one in made.laws if one.name == hidden["law"])
    other = named(plant, said["law"], said["place"], said["acts_on"], said["signal"], numbers, true)
    if other is None:
        return False
    laws = [other if one is true else one for one in made.laws]
    first = len(plant.states) + len(plant.inputs)
    columns = [first + plant.outputs.index(one) for one in plant.compared]

    def logged(some: Any) -> Any:
        found = plant.simulate(made.drives[-1], made.parameters, made.starts[-1], some, made.size)
        return found[:, columns] / made.noise

    try:
        whole = made.signals[-1][:, columns] / made.noise
        effect = whole - logged([one for one in made.laws if one is not true])
        left = whole - logged(laws)
    except (Lost, OverflowError, ValueError):
        return False
    return bool(np.sum(left**2) <= _SAME**2 * np.sum(effect**2))


def calibration_error(stated: Sequence[float], right: Sequence[bool]) -> float:
    """Expected calibration error: mean distance of stated probabilities from shares that are right."""
    if not len(stated):
        return math.nan
    p, hit = np.array(stated, float), np.array(right, float)
    at = np.minimum((p * _BINS).astype(int), _BINS - 1)
    parts = [abs(float((p[at == k] - hit[at == k]).sum())) for k in range(_BINS)]
    return sum(parts) / len(p)


def summary(cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Figures of scored cases, and those that are wrong. Cases with clear evidence count."""
    made = [one for one in cases if "verdict" in one]
    clear = [one for one in made if one["clear"]]
    single = [one for one in clear if one["expected"] == "law" and len(one["hidden"]) == 1]
    double = [one for one in clear if one["expected"] == "law" and len(one["hidden"]) == 2]
    none = [one for one in made if one["expected"] == "none"]
    beyond = [one for one in clear if one["expected"] == "outside"]
    laws = [one for one in clear if one["verdict"] == "law"]

    def share(some: Sequence[Any], key: Callable[[Any], Any]) -> float:
        return float(np.mean([bool(key(one)) for one in some])) if some else math.nan

    times = [one["seconds"] for one in made if one["seconds"]]
    work = [one["processor"] for one in made if one["processor"]]
    figures = {
        "place": share(single, lambda one: one["place"]), "law": share(single, lambda one: one["law"]),
        "family": share(single, lambda one: one["family"]), "two laws": share(double, lambda one: one["law"]),
        "outside recognised": share(beyond, lambda one: one["right"]),
        "false alarms": share(none, lambda one: one["verdict"] == "law"),
        "calibration error": calibration_error(
            [one["probability"] for one in laws], [one["right"] for one in laws]
        ),
        "median time [s]": float(np.median(times)) if times else math.nan,
        "longest time [s]": max(times, default=math.nan),
        "median processor time [s]": float(np.median(work)) if work else math.nan,
        "longest processor time [s]": max(work, default=math.nan),
        "one of two laws": share(double, lambda one: one["first"]),
        "spurious second laws": share([*single, *double], lambda one: one["spurious"]),
        "above 60 % and wrong": share(laws, lambda one: not one["right"] and one["probability"] > 0.6),
        "median closed where right": float(
            np.median([one["closed"] for one in laws if one["right"]] or [math.nan])
        ),
    }  # fmt: skip
    counts = {
        "cases": len(cases), "one": len(single), "two": len(double), "none": len(none),
        "outside": len(beyond), "not clear": len(made) - len(clear),
        "failed": sum(one.get("verdict", "error") == "error" for one in cases),
    }  # fmt: skip
    wrong = [
        {key: one.get(key) for key in _TOLD}
        for one in cases
        if not one.get("right") and one.get("clear", True)
    ]
    rounded = {name: _number(value) for name, value in figures.items()}
    return {"format": "blind-summary/1", "counts": counts, "figures": rounded, "goals": GOALS, "wrong": wrong}


def _number(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 4)


def summary_text(found: Mapping[str, Any]) -> str:
    """The summary as a table and a list of what is wrong."""
    counts = ", ".join(f"{number} {name}" for name, number in found["counts"].items())
    lines = [f"Cases: {counts}.", "", "| figure | goal | measured |", "|---|---|---|"]
    for name, value in found["figures"].items():
        lines.append(
            f"| {name} | {found['goals'].get(name, '-')} | {'-' if value is None else f'{value:.4g}'} |"
        )
    lines += ["", "Wrong:", ""]
    for one in found["wrong"]:
        said = " + ".join(one["said"] or []) or one["error"] or "-"
        stated = (
            ""
            if one["probability"] is None
            else f" ({100 * one['probability']:.0f} %, closes {100 * one['closed']:.0f} %)"
        )
        hidden = " + ".join(one["hidden"] or ["nothing"])
        lines.append(
            f"- seed {one['seed']}, {one['title']}: hidden {hidden}; said {one['verdict']}, {said}{stated}"
        )
    return "\n".join(lines) + "\n"
