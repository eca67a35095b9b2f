"""Write the diagnosis as JSON data and as text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from ...translate.declared_units import derivative_unit
from .answer import Answer
from .law_fit import Fitted


def _laws(one: Fitted, units: Mapping[str, str]) -> list[dict[str, Any]]:
    found = []
    for law, values, sigmas in one.by_law():
        read = units.get(law.signal, "1"), units.get(law.second, "1")
        place = _unit(law.place.name, units)
        numbers = {
            number.name: {
                "value": float(value),
                "sigma": float(sigma),
                "unit": _law_unit(number.unit, place, *read),
            }
            for number, value, sigma in zip(law.law.numbers, values, sigmas, strict=True)
        }  # fmt: skip
        where = {"place": law.place.name, "acts_on": law.place.kind.name.lower(), "signal": law.signal}
        where |= {"second": law.second} if law.second else {}
        found.append({"law": law.law.name, "family": law.law.family, **where, "numbers": numbers})
    return found


def _unit(place: str, units: Mapping[str, str]) -> str:
    """The unit at a place, of the derivative where a law acts on the derivative of a state."""
    first, exchange, _ = place.partition(" to ")
    if exchange:
        place = f"der({first})"
    if place.startswith("der("):
        return derivative_unit(units.get(place[4:-1], "1"))
    return units.get(place, "1")


def _law_unit(unit: str, place: str, signal: str, second: str) -> str:
    """A law's unit with the place's for w, the signal's for u and the second signal's for v."""
    words = {
        "w": f"({place})" if "/" in place and unit != "w" else place,
        "u": f"({signal})" if re.search(r"[/.]", signal) and unit != "u" else signal,
        "v": f"({second})" if re.search(r"[/.]", second) and unit != "v" else second,
    }
    return re.sub(r"\b([wuv])(?=\b|\d|\^)", lambda found: words[found[1]], unit)


def data_of(found: Answer) -> dict[str, Any]:
    """The answer as data, whose numbers may be infinite; see `results.file_formats.strict`."""
    return {
        "format": "unknown-input/2",
        "verdict": found.verdict,
        "headline": headline(found),
        "probability": round(found.probability, 4),
        "family_probability": round(_family(found), 4),
        "laws": _laws(found.fitted, found.units) if found.fitted and found.verdict == "law" else [],
        "nearest": _laws(found.fitted, found.units) if found.fitted and found.verdict != "law" else [],
        "parameters": {
            name: {"value": value, "sigma": sigma, "unit": found.units.get(name, "1")}
            for name, (value, sigma) in found.parameters.items()
        },
        "rivals": [
            {"laws": _laws(one.fitted, found.units), "probability": round(one.probability, 4)}
            for one in found.rivals[:5]
        ],
        "same_on_these_logs": [one.name for one in found.twins],
        "experiments": [
            {"what": one.what, "rival": one.rival, "difference": one.difference, "before": one.before}
            for one in found.experiments
        ],
        "places": [{"place": one.place.name, "gain_nats": round(float(one.gain), 1)} for one in found.places],
        "held_out": {
            "runs": found.held_out,
            "gap_over_noise": found.gap,
            "calibrated_over_noise": found.calibrated,
            "remains_over_noise": found.remains,
            "closed": found.closed,
            "worst_run": found.traces.get("run"),
        },
        "residual_over_spread": found.share,
        "remarks": found.remarks,
        "seconds": round(found.seconds, 1),
    }  # fmt: skip


def headline(found: Answer) -> str:
    """The answer in one sentence."""
    chance, whole = 100 * found.probability, 100 * _family(found)
    chances = f"probability {chance:.0f} %"
    if found.verdict == "none" and found.calibrated > 2.0:
        left = f"{found.calibrated:.3g} times the noise remains, and no law of the library explains it"
        return f"nothing that can be named is missing ({chances}); {left}"
    if found.verdict == "none":
        return f"nothing is missing beyond the calibrated parameters and the start states ({chances})"
    if found.verdict == "outside":
        where = f", near {found.places[0].place.name}" if found.places else ""
        nearest = " + ".join(one.name for one in found.fitted.laws) if found.fitted else ""
        why = "the library does not hold"
        if found.left_out:
            why = "the search did not find before its limit of work"
        return f"something is missing that {why}{where} ({chances})" + (
            f"; the nearest laws are {nearest}" if nearest else ""
        )
    assert found.fitted is not None
    laws = " + ".join(one.name for one in found.fitted.laws)
    families = " and ".join(dict.fromkeys(one.law.family for one in found.fitted.laws))
    chances += f"; {families} in any form: {whole:.0f} %" if whole > chance + 1 else ""
    return f"{laws} ({chances}); it closes {100 * found.closed:.0f} % of the gap on {judged_on(found)}"


def judged_on(found: Answer) -> str:
    """The runs by which the answer is judged."""
    return "held-out runs" if found.held_out else "the fitted runs"


def _family(found: Answer) -> float:
    """Probability of laws of the same families at the same components, whatever their form."""

    def kinds(one: Fitted) -> list[tuple[str, int]]:
        return sorted((law.law.family, law.place.component) for law in one.laws)

    if found.fitted is None or found.verdict != "law":
        return found.probability
    same = sum(one.probability for one in found.rivals if kinds(one.fitted) == kinds(found.fitted))
    return min(1.0, found.probability + same)


def text_of(name: str, found: Answer) -> str:
    """The answer in a few lines."""
    data = data_of(found)
    lines = [f"{name}: {data['headline']}"]
    for one in data["laws"]:
        lines += [
            f"  {one['law']}: {key} = {each['value']:.4g} +- {each['sigma']:.2g} [{each['unit']}]"
            for key, each in one["numbers"].items()
        ]
    lines.append(
        f"  {judged_on(found)}: the residual is {found.gap:.3g} times the noise as configured, "
        f"{found.calibrated:.3g} calibrated, {found.remains:.3g} with the answer"
    )
    others = [
        f"{' + '.join(law.name for law in one.fitted.laws)} ({100 * one.probability:.0f} %)"
        for one in found.rivals[:3]
        if one.probability > 0.01
    ]
    if others:
        lines.append("  rivals: " + "; ".join(others))
    if found.twins:
        lines.append("  the same on these logs: " + "; ".join(one.name for one in found.twins[:4]))
    lines += [f"  next: {one.what}; it separates {one.rival}" for one in found.experiments[:2]]
    lines += [f"  {one}" for one in found.remarks]
    lines.append(f"  {found.seconds:.0f} s")
    return "\n".join(lines)
