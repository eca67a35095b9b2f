"""The page of `orchestrator stability --out`: all of its report and its figures in one file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from ..base.provenance import origin
from ..plotting import page as pieces
from ..plotting.figures import encoded
from .system_report import later_words

# Name of a figure -> what stands below it.
_CAPTIONS = {
    "bode": "Bode diagram of the open loop at the weakest connection; dashed lines mark crossovers",
    "nyquist": "Nyquist diagram; the cross is -1, the circle has radius 1",
    "nichols": "Nichols diagram; dotted lines have equal |L/(1 + L)|",
    "step": "how the closed loop follows a step at the weakest connection",
    "roots": "roots of the machine, and as co-simulated",
    "participation": "states that take part in each mode",
    "sigma": "singular values with several loops opened at once",
    "over": "dominant root over the parameter",
    "chart": "stability over two parameters",
}


def stability_page(report: Mapping[str, Any], figures: Mapping[str, Path], words: str) -> str:
    """The page, HTML.

    Args:
        report: what `system_stability` gave, with what the command added.
        figures: PNG files by name.
        words: the report as terminals show it.
    """
    images = {
        name: pieces.figure(
            f'<img alt="{escape(name)}" src="data:image/png;base64,{encoded(one)}">',
            _CAPTIONS.get(name, name),
            name,
        )
        for name, one in figures.items()
    }
    sampled = report["sampled"]
    body = [f"<p class=headline>Machine: {escape(report['verdict'])}.</p>"]
    if "refused" not in sampled:
        body.append(f"<p class=headline>Co-simulation with its step: {escape(sampled['verdict'])}.</p>")
    body += [pieces.heading("Margins", "margins"), _margins(report)]
    body += [images.pop(name, "") for name in ("bode", "nyquist", "nichols", "step")]
    body += [pieces.heading("Modes", "modes"), _modes(report)]
    body += [images.pop(name, "") for name in ("participation", "roots")]
    body += [pieces.heading("Machine and simulation", "sampled"), _sampled(sampled)]
    body += list(images.values())
    body += [pieces.heading("Linear around", "point"), _point(report)]
    body.append(pieces.aside("What was measured, assumed or left out", report["notes"]))
    body.append(pieces.details("The report as text", f"<pre>{escape(words)}</pre>"))
    body.append(pieces.provenance(origin()))
    return pieces.document(f"Stability: {report['title']}", body)


def _margins(report: Mapping[str, Any]) -> str:
    rows = []
    for name, one in report["margins"].items():
        low, high = one["gain_margin"]
        delay = one["delay_margin"]
        crossing = ", ".join(f"{each['omega'] / 6.283185307179586:.4g}" for each in one["crossovers"])
        rows.append(
            [
                name,
                one["phase_margin"],
                None if delay is None else 1e3 * delay,
                low or None,
                high,
                one["modulus_margin"],
                one["disk_margin"],
                crossing or None,
            ]
        )
    if not rows:
        return pieces.note("No connection lies within a feedback loop.")
    columns = [
        "connection",
        "phase [deg]",
        "delay [ms]",
        "gain down to",
        "gain up to",
        "modulus",
        "disk",
        "crossovers [Hz]",
    ]
    text = (
        "The smallest modulus margin first. A dash means that nothing limits it, or that the system is "
        "unstable: then phase and gain are crossovers, no margins."
    )
    later = later_words(report["later"]) if report["later"] is not None else []
    return pieces.table(columns, rows) + pieces.note(". ".join([*later, text]))


def _modes(report: Mapping[str, Any]) -> str:
    rows = [
        [
            one["root"][0],
            one["root"][1],
            one["frequency"],
            one["damping"],
            ", ".join(f"{name} {100 * share:.0f} %" for name, share in one["participation"].items()),
            one["residual"],
        ]
        for one in report["modes"]
    ]
    columns = ["real part [1/s]", "imaginary part [rad/s]", "frequency [Hz]", "damping", "states", "residual"]
    text = f"No other root lies to the right of {report['line']:.4g} 1/s, by the argument principle."
    return pieces.table(columns, rows) + pieces.note(text)


def _sampled(sampled: Mapping[str, Any]) -> str:
    if "refused" in sampled:
        return pieces.note(f"Not known: {sampled['refused']}.")
    rows = [
        [
            one["root"][0],
            one["root"][1],
            abs(complex(*one["multiplier"])),
            None if one["machine"] is None else _root(one["machine"]),
        ]
        for one in sampled["modes"]
    ]
    columns = ["real part [1/s]", "imaginary part [rad/s]", "|z|", "root of the machine"]
    text = f"Master {sampled['master']}, step {1e3 * sampled['step']:.4g} ms."
    largest = sampled["largest_step"]
    if largest is not None and largest["value"] is not None:
        limit = "at least" if largest["refused"] else "up to"
        text += f" Stable {limit} {1e3 * largest['value']:.4g} ms."
    return pieces.table(columns, rows) + pieces.note(text)


def _root(root: Sequence[float]) -> str:
    return f"{root[0]:.6g}" + (f" +-{abs(root[1]):.6g}j" if root[1] else "")


def _point(report: Mapping[str, Any]) -> str:
    trimmed = report.get("trim") or {}
    rows = [
        [name, value, trimmed[name]["rate"] if name in trimmed else None]
        for name, value in report["point"].items()
    ]
    return pieces.table(["variable", "value, in the unit of its FMU", "remaining rate"], rows)
