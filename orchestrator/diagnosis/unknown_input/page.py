"""The page of a diagnosis by unknown inputs: traces, laws, rivals, and w against the signals."""

from __future__ import annotations

from html import escape

import numpy as np
from matplotlib.figure import Figure

from ...base.provenance import origin
from ...plotting.figures import COLORS, svg
from ...plotting.page import html
from .answer import Answer
from .report import data_of, headline, judged_on

_MOST_POINTS = 3000


def page(name: str, found: Answer) -> str:
    """The page as HTML."""
    data = data_of(found)
    held = data["held_out"]
    head, runs = headline(found), judged_on(found)
    lead = f"<p class=lead>{escape(head[:1].upper() + head[1:])}.</p>"
    body = [lead, html.aside("To consider", found.remarks)]
    if found.traces:
        trace = found.traces
        body.append(
            html.figure(
                svg(_traces(found), "traces"),
                f"{trace['signal']} in {trace['run']}, of {runs} the one with the largest calibrated gap.",
            )
        )
    body.append(
        html.table(
            [runs, "residual over the noise"],
            [
                ["as configured", held["gap_over_noise"]],
                ["calibrated parameters", held["calibrated_over_noise"]],
                ["with the answer", held["remains_over_noise"]],
            ],
            caption=f"Share of the gap that is closed: {100 * held['closed']:.0f} %",
        )
    )
    laws = data["laws"] or data["nearest"]
    if laws:
        rows = [
            [one["law"], one["place"], one["signal"], key, each["value"], each["sigma"], each["unit"]]
            for one in laws
            for key, each in one["numbers"].items()
        ]
        columns = ["law", "place", "reads", "number", "value", "standard deviation", "unit"]
        caption = "The answer" if data["laws"] else "The nearest law, which does not explain the gap"
        body.append(html.table(columns, rows, caption=caption))
        sentences = {one.law.name: one.law.sentence for one in found.fitted.laws} if found.fitted else {}
        body += [html.note(f"{law}: {text}") for law, text in sentences.items()]
    if data["rivals"]:
        rows = [
            [" + ".join(law.name for law in one.fitted.laws), weighed["probability"]]
            for one, weighed in zip(found.rivals, data["rivals"], strict=False)
        ]
        body.append(html.table(["rival", "probability"], rows, caption="Other answers"))
    if data["same_on_these_logs"]:
        body.append(html.aside("These act the same on these logs", data["same_on_these_logs"]))
    if found.experiments:
        rows = [[one.what, one.rival] for one in found.experiments]
        caption = "What can be done next"
        body.append(html.table(["experiment", "separates the answer from"], rows, caption=caption))
    if data["parameters"]:
        rows = [[key, each["value"], each["sigma"], each["unit"]] for key, each in data["parameters"].items()]
        columns = ["parameter", "value", "standard deviation", "unit"]
        body.append(html.table(columns, rows, caption="Calibrated parameters"))
    if found.estimate is not None:
        where = found.places[0].place.name
        caption = (
            f"The unknown input w at {where} that explains the logs, against the signals there. A curve is a "
            "law. A cloud means that w depends on something else."
        )
        body.append(html.figure(svg(_estimate(found), "unknown-input"), caption))
    body.append(html.provenance(origin()))
    return html.document(f"Diagnosis of {name}", body)


def _traces(found: Answer) -> Figure:
    """Measured, configured, calibrated and corrected signal, and the residuals below."""
    trace = found.traces
    step = max(1, len(trace["time"]) // _MOST_POINTS)
    part = slice(None, None, step)
    figure = Figure(figsize=(9.0, 4.8), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    styles = [("measured", "#444444", 2.4), ("configured", COLORS[3], 0.9), ("calibrated", COLORS[1], 1.1)]
    if found.verdict == "law":
        styles.append(("corrected", COLORS[0], 1.1))
    for kind, color, width in styles:
        above.plot(trace["time"][part], trace[kind][part], color=color, linewidth=width, label=kind)
        if kind != "measured":
            below.plot(
                trace["time"][part], (trace["measured"] - trace[kind])[part], color=color, linewidth=0.9
            )
    finite = trace["measured"][np.isfinite(trace["measured"])]
    if len(finite):
        margin = 0.5 * (np.ptp(finite) or 1.0)
        above.set_ylim(finite.min() - margin, finite.max() + margin)
        error = trace["measured"] - trace["calibrated"]
        size = float(np.nanmax(np.abs(error[np.isfinite(error)]), initial=1e-12))
        below.set_ylim(-1.2 * size, 1.2 * size)
    above.set_ylabel(f"{trace['signal']} [{trace['unit']}]")
    below.set_ylabel(f"residual [{trace['unit']}]")
    below.set_xlabel("time [s]")
    above.legend(fontsize="small", ncols=4, loc="upper right")
    return figure


def _estimate(found: Answer) -> Figure:
    """w over time and against each signal at its place."""
    assert found.estimate is not None
    names = dict(list(found.estimate["names"].items())[:5])
    w, signals = found.estimate["w"], found.estimate["signals"]
    part = slice(None, None, max(1, len(w) // _MOST_POINTS))
    figure = Figure(figsize=(9.0, 2.6 * ((len(names) + 3) // 3)), layout="constrained")
    axes = figure.subplots((len(names) + 3) // 3, 3, squeeze=False).ravel()
    axes[0].plot(np.arange(len(w))[part], w[part], color=COLORS[0], linewidth=0.8)
    axes[0].set_xlabel("sample")
    for one, (name, index) in zip(axes[1:], names.items(), strict=False):
        one.plot(signals[part, index], w[part], ".", color=COLORS[0], markersize=2)
        one.set_xlabel(name)
    for one in axes[len(names) + 1 :]:
        one.set_visible(False)
    axes[0].set_ylabel("w")
    return figure
