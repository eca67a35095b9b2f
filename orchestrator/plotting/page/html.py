"""Pieces of pages as HTML text, and the page around them.

What is called text is plain and gets escaped here; what is called content or body is HTML already.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import resources
from typing import Any

# A page may run its own scripts and show what it holds; whatever it is made of, it reaches for nothing else.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


def document(title: str, body: Iterable[str], data: Mapping[str, Any] | None = None) -> str:
    """A complete page.

    Args:
        title: of the page, plain text.
        body: its parts, HTML; empty ones are left out.
        data: for plots and the view of motion, as JSON has it; see `SignalStore.data`.
    """
    style, scripts = _own("page.css"), [_own("page.js")]
    tail = ""
    if data:
        style = f"{_own('vendor/uPlot.min.css')}\n{style}"
        scripts = [_own("vendor/uPlot.iife.min.js"), *scripts, _own("data.js"), _own("plots.js")]
        if data.get("scene"):
            scripts.append(_own("scene.js"))
        # "<" cannot end the script early, nor begin a comment in it.
        text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
        escaped = text.replace("<", "\\u003c")
        tail = f'<script type="application/json" id="data">{escaped}</script>\n'
    tail += "".join(f"<script>\n{script}</script>\n" for script in scripts)
    parts = "\n".join(part for part in body if part)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<style>\n{style}</style>\n</head>\n<body>\n"
        f"<header><h1>{escape(title)}</h1></header>\n<main>\n{parts}\n</main>\n{tail}</body>\n</html>\n"
    )


def _own(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def number(value: Any, digits: int = 6) -> str:
    """A value as tables show it; None as a dash."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def heading(text: str, name: str = "") -> str:
    """A heading; `name` is what links lead to."""
    return f'<h2 id="{escape(name)}">{escape(text)}</h2>' if name else f"<h2>{escape(text)}</h2>"


def note(text: str) -> str:
    """A remark in small print."""
    return f"<p class=note>{escape(text)}</p>"


def card(title: str, content: str) -> str:
    """A box with a heading; several stand in a `<div class=cards>`."""
    return f"<section class=card><h2>{escape(title)}</h2>{content}</section>"


def aside(title: str, notes: Iterable[str]) -> str:
    """A warning with its points; nothing without points."""
    items = "".join(f"<li>{escape(one)}</li>" for one in notes)
    return f"<aside><b>{escape(title)}</b><ul>{items}</ul></aside>" if items else ""


def details(title: str, content: str) -> str:
    """What is folded away at first."""
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def bar(label: str, value: float, text: str, more: str = "", strong: bool = False) -> str:
    """A labelled bar of length |value|, from 0 to 1, hatched below zero; `more` stands below it."""
    width = 100 * min(max(abs(value), 0.0), 1.0)
    kind = "bar negative" if value < 0 else "bar"
    name = f"<b>{escape(label)}</b>" if strong else escape(label)
    below = f"<div class=note>{escape(more)}</div>" if more else ""
    return (
        f'<div class=row><div class=name>{name}</div><div class=track><div class="{kind}" '
        f'style="width:{width:.1f}%"></div></div><div class=value>{escape(text)}</div>{below}</div>'
    )


def figure(content: str, caption: str, name: str = "") -> str:
    """A drawing, SVG or `<img>`, with its caption."""
    identity = f' id="{escape(name)}"' if name else ""
    return f"<figure{identity}>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[Any]],
    *,
    keys: Sequence[str] = (),
    caption: str = "",
    foot: Sequence[Any] | None = None,
) -> str:
    """A table that sorts by a click on a column's head.

    Args:
        columns: their heads.
        rows: numbers, texts and None; numbers are shown with six digits and sort as they are.
        keys: a name per row, for those who look for it in the page.
        caption: stands above.
        foot: a last row that stays where it is.
    """
    rows = [list(row) for row in rows]
    head = "".join(
        f"<th scope=col{' class=number' if _numeric(rows, index) else ''}>"
        f"<button type=button>{escape(one)}</button></th>"
        for index, one in enumerate(columns)
    )
    body = "".join(
        f"<tr{_key(keys[index]) if index < len(keys) else ''}>{''.join(map(_cell, row))}</tr>\n"
        for index, row in enumerate(rows)
    )
    above = f"<caption>{escape(caption)}</caption>" if caption else ""
    last = "".join(
        f"<td{' class=number' if _numeric(rows, index) else ''}>{escape(number(one))}</td>"
        for index, one in enumerate(foot or ())
    )
    below = f"<tfoot><tr>{last}</tr></tfoot>" if foot else ""
    return (
        f"<div class=wide><table class=sorts>{above}<thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody>"
        f"{below}</table></div>"
    )


def _numeric(rows: Sequence[Sequence[Any]], column: int) -> bool:
    """Whether a column holds numbers and nothing else."""
    values = [row[column] for row in rows if column < len(row) and row[column] is not None]
    return bool(values) and all(isinstance(one, int | float) and not isinstance(one, bool) for one in values)


def _key(name: str) -> str:
    return f' data-key="{escape(name)}"'


def _cell(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"<td>{escape(number(value))}</td>"
    return f'<td class=number data-value="{value!r}">{escape(number(value))}</td>'


def provenance(kept: Mapping[str, Any], more: str = "") -> str:
    """When and with what something was made, folded; `more` is HTML that stands below."""
    versions = kept.get("packages") or {}
    packages = ", ".join(f"{name} {version}" for name, version in versions.items() if version is not None)
    facts = [
        f"made {kept['created']}" if kept.get("created") else "",
        f"Python {kept['python']}" if kept.get("python") else "",
        str(kept.get("platform") or ""),
        packages,
    ]
    text = "; ".join(part for part in facts if part)
    return details("Provenance", f"<p>{escape(text)}</p>{more}")
