"""The page: every number beside the paper's, every figure, in one file without links to others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from ...plotting import page as pieces
from ...plotting.figures import encoded

if TYPE_CHECKING:
    from .reproduce import Reproduction

_COLUMNS = ("figure", "quantity", "source", "ours", "unit", "agreement", "change at half the step")


def page(made: Reproduction) -> str:
    """The complete page as HTML."""
    return _page(made.summary, {name: encoded(figure) for name, figure in made.figures.items()})


def page_of_folder(folder: Path, summary: Mapping[str, Any]) -> str:
    """The page of what `orchestrator reproduce` wrote to a folder; figures that are gone are left out.

    Args:
        summary: content of the folder's reproduction.json.
    """
    images = {}
    for name in summary["figures"]:
        path = folder / "figures" / f"{name}.png"
        if path.is_file():
            images[name] = encoded(path)
    return _page(summary, images)


def _page(summary: Mapping[str, Any], images: Mapping[str, str]) -> str:
    """The page with figures as PNG in base 64."""
    links = "".join(f'<a href="#{name}">{_label(name)}</a>' for name in images)
    differ = summary["source"]["differ"] + summary["theory"]["differ"]
    failed = sum(bool(entry["errors"]) for entry in summary["experiments"])
    judged = sum(summary["source"].values()) + sum(summary["theory"].values())
    sentence = f"{judged - differ} of {judged} numbers that can be judged agree"
    if failed:
        sentence += f"; {failed} experiments failed"
    parts = [
        f"<p class=headline>{sentence}.</p>",
        f"<p>{escape(summary['reference'])}.</p>",
        f"<p>{headline(summary)} Every run was made twice: the last column is what changed with half the "
        "communication step. The column of the paper quotes its text, with the section; its figures' "
        "curves are not read off, and where the text is silent the column is empty.</p>",
        f"<nav>{links}</nav>",
    ]
    said: set[str] = set()
    for entry in summary["experiments"]:
        parts += _section(entry, images, said)
    made = f"{summary['runs']} runs in {summary['wall_time']:.0f} s."
    parts.append(pieces.provenance(summary, pieces.note(made)))
    return pieces.document("The paper's figures and numbers, made again by co-simulation", parts)


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
        f"{summary['numbers']} numbers. Held against a statement of the paper: {source['agree']} agree, "
        f"{source['differ']} differ. Held against theory or the rig model, where the paper gives no number: "
        f"{theory['agree']} agree, {theory['differ']} differ. The other {rest} are stated without a verdict."
    )


def _section(entry: Mapping[str, Any], images: Mapping[str, str], said: set[str]) -> Iterable[str]:
    """Heading, text, table, figures and commands; paragraphs that the page holds by now are left out."""
    yield f'<h2 id="{escape(entry["name"])}">{escape(entry["title"])}</h2>'
    for paragraph in entry["about"]:
        if paragraph not in said:
            yield f"<p>{escape(paragraph)}</p>"
    said.update(entry["about"])
    for message in entry["errors"]:
        yield f'<p class="error">This run failed, so no result is stated: {escape(message)}</p>'
    if entry["quantities"]:
        heads = "".join(f"<th scope=col><button type=button>{one}</button></th>" for one in _COLUMNS)
        yield (f"<div class=wide><table class='facts sorts'>\n<thead><tr>{heads}</tr></thead>\n<tbody>")
        yield from map(_row, entry["quantities"])
        yield "</tbody>\n</table></div>"
    for name, caption in entry["figures"].items():
        if name not in images:
            continue
        text = f"{_label(name)}. {caption}"
        image = f'<img alt="{escape(text)}" src="data:image/png;base64,{images[name]}">'
        yield pieces.figure(image, text, name)
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
    change = quantity["halving_change"]
    return (
        f'<tr data-key="{escape(quantity["key"])}"><td>{_label(quantity["figure"])}</td>'
        f"<td>{escape(quantity['text'])}{note}</td><td>{escape(quantity['paper'])}</td>"
        f'<td class="number"{_value(quantity["ours"])}>{number(quantity["ours"])}</td><td>{unit}</td>'
        f'<td class="{kind}">{agreement}</td>'
        f'<td class="number"{_value(change)}>{_change(change)}</td></tr>'
    )


def _value(value: float | None) -> str:
    """What a table sorts by."""
    return "" if value is None else f' data-value="{value!r}"'


def _label(figure: str) -> str:
    return f"Fig. {escape(figure.removeprefix('fig'))}"
