"""The page: every number beside the source's, every figure, in one file without links to others."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from html import escape
from io import BytesIO
from shlex import quote
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .reproduce import Reproduction

__all__ = ["headline", "number", "page", "verdict"]

_DPI = 110
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1a1a1a; }
body { max-width: 76rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.25rem; margin-top: 2.6rem; }
p.about { max-width: 60rem; }
table { border-collapse: collapse; width: 100%; margin: 1rem 0; font-size: 0.9rem; }
th, td { text-align: left; vertical-align: top; padding: 0.3rem 0.6rem; border-bottom: 1px solid #ddd; }
th { background: #f3f3f3; }
td.number { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
td.yes { color: #00664b; } td.no { color: #a33c00; font-weight: 600; } td.none { color: #666; }
.note { color: #555; font-size: 0.85rem; }
.error { color: #a33c00; white-space: pre-wrap; }
figure { margin: 1.5rem 0; } img { max-width: 100%; height: auto; } figcaption { color: #333; }
nav a { margin-right: 0.9rem; }
dt { margin-top: 0.5rem; } code { font-size: 0.8rem; overflow-wrap: anywhere; }
"""


def page(made: Reproduction) -> str:
    """The whole page as HTML."""
    summary = made.summary
    images = {name: _image(figure) for name, figure in made.figures.items()}
    links = "".join(f'<a href="#{name}">{_label(name)}</a>' for name in images)
    packages = ", ".join(f"{name} {version}" for name, version in summary["packages"].items())
    parts = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        "<title>Reproduction of the source's figures and "
        f"numbers</title>\n<style>{_STYLE}</style>\n</head>\n<body>",
        "<h1>The source's figures and numbers, made again by co-simulation</h1>",
        f"<p>{escape(summary['reference'])}.</p>",
        f"<p>{headline(summary)} Every run was made twice: the last column is what changed with half the "
        "communication step. The column of the source quotes its text, with the section; its figures' "
        "curves are not read off, and where the text is silent the column is empty.</p>",
        f"<nav>{links}</nav>",
    ]
    said: set[str] = set()
    for entry in summary["experiments"]:
        parts += _section(entry, images, said)
    parts.append(
        f'<p class="note">Made {escape(summary["created"])} in {summary["wall_time"]:.0f} s with '
        f"{summary['runs']} runs; {escape(packages)}; Python {escape(summary['python'])}, "
        f"{escape(summary['platform'])}.</p>\n</body>\n</html>\n"
    )
    return "\n".join(parts)


def number(value: float | None) -> str:
    """A number as the page shows it."""
    return "" if value is None else f"{value:.5g}"


def _change(value: float | None) -> str:
    return "" if value is None else f"{value:+.2g}" if value else "0"


def verdict(agrees: bool | None) -> str:
    """A verdict as the page shows it."""
    return {True: "agrees", False: "differs", None: "not judged"}[agrees]


def headline(summary: Mapping[str, Any]) -> str:
    """How many numbers agree, with what."""
    source, theory = summary["source"], summary["theory"]
    rest = summary["numbers"] - sum(source.values()) - sum(theory.values())
    return (
        f"{summary['numbers']} numbers. Held against a statement of the source: {source['agree']} agree, "
        f"{source['differ']} differ. Held against theory or the rig model, where the source gives no number: "
        f"{theory['agree']} agree, {theory['differ']} differ. The other {rest} are told without a verdict."
    )


def _section(entry: Mapping[str, Any], images: Mapping[str, str], said: set[str]) -> Iterable[str]:
    """Heading, text, table, figures and commands; paragraphs that the page holds by now are left out."""
    yield f'<h2 id="{escape(entry["name"])}">{escape(entry["title"])}</h2>'
    for paragraph in entry["about"]:
        if paragraph not in said:
            yield f'<p class="about">{escape(paragraph)}</p>'
    said.update(entry["about"])
    for message in entry["errors"]:
        yield f'<p class="error">This run failed, so nothing is told of the experiment: {escape(message)}</p>'
    if entry["quantities"]:
        yield (
            "<table>\n<thead><tr><th>figure</th><th>quantity</th><th>source</th><th>ours</th><th>unit</th>"
            "<th>agreement</th><th>change at half the step</th></tr></thead>\n<tbody>"
        )
        yield from map(_row, entry["quantities"])
        yield "</tbody>\n</table>"
    for name, caption in entry["figures"].items():
        text = f"{_label(name)}. {caption}"
        yield (
            f'<figure id="{name}"><img alt="{escape(text)}" src="data:image/png;base64,{images[name]}">'
            f"<figcaption>{escape(text)}</figcaption></figure>"
        )
    yield f"<details><summary>The {len(entry['runs'])} runs, one by one</summary>\n<dl>"
    for name, one in entry["runs"].items():
        settings = " ".join(f"--set {quote(override)}" for override in one["overrides"])
        command = escape(f"orchestrator run {one['system']} {settings}")
        yield f"<dt>{escape(name)}</dt><dd><code>{command}</code></dd>"
    yield "</dl>\n</details>"


def _row(quantity: Mapping[str, Any]) -> str:
    kind = {True: "yes", False: "no", None: "none"}[quantity["agrees"]]
    agreement = verdict(quantity["agrees"])
    if quantity["criterion"]:
        of = "" if quantity["against"] == "source" else " with theory or model"
        agreement += f"{of}: {escape(quantity['criterion'])}"
    note = f'<div class="note">{escape(quantity["note"])}</div>' if quantity["note"] else ""
    unit = "" if quantity["unit"] == "1" else escape(quantity["unit"])
    return (
        f'<tr data-key="{escape(quantity["key"])}"><td>{_label(quantity["figure"])}</td>'
        f"<td>{escape(quantity['text'])}{note}</td><td>{escape(quantity['paper'])}</td>"
        f'<td class="number">{number(quantity["ours"])}</td><td>{unit}</td>'
        f'<td class="{kind}">{agreement}</td>'
        f'<td class="number">{_change(quantity["halving_change"])}</td></tr>'
    )


def _label(figure: str) -> str:
    return f"Fig. {escape(figure.removeprefix('fig'))}"


def _image(figure: Any) -> str:
    memory = BytesIO()
    figure.savefig(memory, format="png", dpi=_DPI)
    return base64.b64encode(memory.getvalue()).decode("ascii")
