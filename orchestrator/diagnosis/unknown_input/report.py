"""What the search by unknown inputs gives out: JSON and text."""

from __future__ import annotations

from typing import Any

from .law_fit import Fitted
from .search import Answer

__all__ = ["data_of", "text_of"]


def _laws(one: Fitted) -> list[dict[str, Any]]:
    found, at = [], 0
    for law in one.laws:
        end = at + len(law.law.numbers)
        numbers = {
            number.name: {"value": float(value), "sigma": float(sigma), "unit": number.unit}
            for number, value, sigma in zip(
                law.law.numbers, one.numbers[at:end], one.sigmas[at:end], strict=True
            )
        }
        where = {"place": law.place.name, "acts_on": law.place.kind.name.lower(), "signal": law.signal}
        found.append({"law": law.law.name, "family": law.law.family, **where, "numbers": numbers})
        at = end
    return found


def data_of(found: Answer) -> dict[str, Any]:
    """The answer as JSON data. In units, `w` stands for that of the place and `s` for that of the signal."""
    return {
        "format": "unknown-input/1",
        "verdict": found.verdict,
        "laws": _laws(found.fitted) if found.fitted and found.verdict == "law" else [],
        "nearest": _laws(found.fitted) if found.fitted and found.verdict == "outside" else [],
        "places": [{"place": one.place.name, "gain_nats": round(float(one.gain), 1)} for one in found.places],
        "rivals": [
            {"laws": _laws(one), "log_likelihood": round(one.loglik, 1)} for one in found.rivals[:5]
            if one.loglik > -1e300
        ],
        "held_out": {
            "gap_over_noise": found.gap,
            "calibrated_over_noise": found.calibrated,
            "remains_over_noise": found.remains,
            "closed": found.closed,
        },
        "seconds": round(found.seconds, 1),
    }  # fmt: skip


def text_of(name: str, found: Answer) -> str:
    """The answer in a few lines."""
    lead = {
        "none": "nothing is missing beyond the calibrated parameters and the start states",
        "outside": f"something that the library does not hold, near {found.places[0].place.name}",
        "law": " + ".join(one.name for one in found.fitted.laws) if found.fitted else "",
    }[found.verdict]
    lines = [f"{name}: {lead}"]
    for one in data_of(found)["laws"]:
        lines += [
            f"  {one['law']}: {key} = {each['value']:.4g} +- {each['sigma']:.2g} [{each['unit']}]"
            for key, each in one["numbers"].items()
        ]
    lines.append(
        f"  held-out runs: the residual is {found.gap:.3g} times the noise as configured, "
        f"{found.calibrated:.3g} calibrated, {found.remains:.3g} with the answer "
        f"({100 * found.closed:.0f} % closed)"
    )
    near = ", ".join(f"{one.place.name} ({one.gain:.0f} nats)" for one in found.places[:4])
    lines.append(f"  places by unknown input: {near}; {found.seconds:.0f} s")
    return "\n".join(lines)
