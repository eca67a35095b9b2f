"""What an FMU holds for those who take it: a page, a picture of its ports, an icon, and where it comes from.

All of it is made of the model description and of what the builder adds, and the same for the same.
"""

from __future__ import annotations

import json
import struct
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from html import escape
from typing import Any

from orchestrator.base.provenance import versions

Section = tuple[str, str]
"""A heading and what stands below it, as HTML."""
PROVENANCE = "extra/orchestrator/provenance.json"
"""The member of an FMU that says what it was made from and with."""

_GROUPS = (
    ("Inputs", ("input",)),
    ("Outputs", ("output",)),
    ("Parameters", ("parameter", "calculatedParameter", "structuralParameter")),
    ("Local variables", ("local",)),
)
_SHOWN = 24  # ports of a side in the picture


@dataclass(frozen=True)
class _Row:
    name: str
    unit: str
    causality: str
    start: str
    description: str


def dress(
    description: bytes, sections: Iterable[Section] = (), provenance: Mapping[str, Any] | None = None
) -> dict[str, bytes]:
    """Members that show and explain an FMU.

    Args:
        description: modelDescription.xml, of FMI 2.0 or 3.0.
        sections: what the page states besides ports, parameters and structure.
        provenance: what the FMU was made from and with.
    Returns: path within the FMU -> content.
    """
    root = ET.fromstring(description)
    rows = list(_rows(root))
    inputs = [one for one in rows if one.causality == "input"]
    outputs = [one for one in rows if one.causality == "output"]
    title = root.get("modelName", "")
    icon = "model.png" if root.get("fmiVersion") == "2.0" else "terminalsAndIcons/icon.png"
    members = {
        "documentation/index.html": _page(root, title, rows, sections).encode(),
        "documentation/ports.svg": _picture(title, inputs, outputs).encode(),
        icon: _icon(len(inputs), len(outputs)),
    }
    if provenance is not None:
        content = {"generationTool": "orchestrator", "modelName": title, **provenance}
        members[PROVENANCE] = (json.dumps(content, indent=2) + "\n").encode()
    return members


def sources_of(texts: Mapping[str, bytes], packages: Sequence[str]) -> dict[str, Any]:
    """What `dress` takes as provenance: SHA-256 of each source, versions of the packages that worked on them.

    Args:
        texts: contents by name.
        packages: their names as pip knows them. Our own is not among them: the sources of what it adds are
            in the FMU, and a new version of it that adds the same makes the same FMU.
    """
    return {
        "sources": {name: source_digest(texts[name]) for name in sorted(texts)},
        "madeWith": versions(packages),
    }


def source_digest(text: bytes) -> str:
    """What identifies a source, whatever ends its lines."""
    lines = text.replace(b"\r\n", b"\n")
    return f"sha256:{sha256(lines).hexdigest()}"


def text_section(heading: str, *texts: str | None) -> list[Section]:
    """Docstrings as a section: paragraphs, and indented lines as they stand; none if there is no text."""
    parts = []
    for text in texts:
        for block in (text or "").strip().split("\n\n"):
            if block.startswith("    "):
                parts.append(f"<pre>{escape(block)}</pre>")
            elif block.strip():
                parts.append(f"<p>{escape(block)}</p>")
    return [(heading, "\n".join(parts))] if parts else []


def _rows(root: ET.Element) -> Iterable[_Row]:
    second = root.get("fmiVersion") == "2.0"
    variables = root.find("ModelVariables")
    for node in () if variables is None else variables:
        value = next((child for child in node if child.tag != "Annotations"), node) if second else node
        start = value.get("start") or ""
        if not second and not start:
            start = next((one.get("value", "") for one in node.findall("Start")), "")
        yield _Row(
            name=node.get("name", ""),
            unit=value.get("unit") or ("" if value.tag in ("Real", "Float64", "Float32") else value.tag),
            causality=node.get("causality") or "local",
            start=_short(start),
            description=node.get("description") or "",
        )


def _short(start: str) -> str:
    try:
        return f"{float(start):.15g}"
    except ValueError:
        return start


def _page(root: ET.Element, title: str, rows: Sequence[_Row], sections: Iterable[Section]) -> str:
    parts = [
        "<!DOCTYPE html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title></head><body>',
        f"<h1>{escape(title)}</h1>",
        f"<p>{escape(root.get('description') or '')}</p>",
        '<p><img src="ports.svg" alt="inputs and outputs"></p>',
    ]
    for heading, content in sections:
        parts.append(f"<h2>{escape(heading)}</h2>\n{content}")
    for heading, causalities in _GROUPS:
        group = [row for row in rows if row.causality in causalities]
        if group:
            parts.append(f"<h2>{heading}</h2>\n<table>")
            parts.append(_line("th", ("name", "unit or type", "start", "description")))
            parts += [_line("td", (row.name, row.unit, row.start, row.description)) for row in group]
            parts.append("</table>")
    parts.append(f"<h2>Structure</h2>\n{_structure(root, rows)}")
    return "\n".join([*parts, "</body></html>"]) + "\n"


def _line(tag: str, cells: Iterable[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"


def _structure(root: ET.Element, rows: Sequence[_Row]) -> str:
    """What outputs depend on at a communication point, and what derivatives the FMU gives."""
    second = root.get("fmiVersion") == "2.0"
    structure, simulation = root.find("ModelStructure"), root.find("CoSimulation")
    variables = root.find("ModelVariables")
    assert structure is not None and variables is not None
    if second:
        names = {str(number): row.name for number, row in enumerate(rows, start=1)}
        unknowns = [
            (node.get("index"), node.get("dependencies")) for node in structure.findall("Outputs/Unknown")
        ]
    else:
        names = {node.get("valueReference", ""): node.get("name", "") for node in variables}
        unknowns = [
            (node.get("valueReference"), node.get("dependencies")) for node in structure.findall("Output")
        ]
    lines = []
    for reference, dependencies in unknowns:
        shown = (
            "everything" if dependencies is None else ", ".join(names[one] for one in dependencies.split())
        )
        lines.append(_line("td", (names[reference or ""], shown or "nothing")))
    given = dict(simulation.attrib) if simulation is not None else {}
    provided = any(
        name.startswith("providesDirectional") and value == "true" for name, value in given.items()
    )
    adjoint = given.get("providesAdjointDerivatives") == "true"
    kinds = ["directional"] * provided + ["adjoint"] * adjoint
    derivatives = f"Derivatives of outputs by inputs: {' and '.join(kinds) or 'none'}."
    saved = any("GetAndSet" in name and value == "true" for name, value in given.items())
    state = "The state can be saved and restored." if saved else "The state cannot be saved."
    table = "\n".join(lines)
    return (
        "<p>At a communication point outputs depend at once on these inputs:</p>\n"
        f"<table>\n{_line('th', ('output', 'depends on'))}\n{table}\n</table>\n<p>{derivatives} {state}</p>"
    )


def _picture(title: str, inputs: Sequence[_Row], outputs: Sequence[_Row]) -> str:
    """The FMU as a box, inputs on its left and outputs on its right, as SVG."""
    sides = [_labels(inputs), _labels(outputs)]
    widths = [max((8 * len(label) for label in labels), default=0) + 12 for labels in sides]
    inner = max(9 * len(title) + 24, 120)
    height = 20 * max(len(sides[0]), len(sides[1]), 2) + 20
    left, right = widths[0] + 24, widths[0] + 24 + inner
    width = right + 24 + widths[1]
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height + 10}" '
        'font-family="sans-serif" font-size="13">',
        f'<rect x="{left}" y="5" width="{inner}" height="{height}" fill="#eef3f8" stroke="#1f4e79"/>',
        f'<text x="{left + inner // 2}" y="{height // 2 + 9}" text-anchor="middle" font-weight="bold">'
        f"{escape(title)}</text>",
    ]
    for labels, begin, anchor, place in (
        (sides[0], left - 20, "end", left - 24),
        (sides[1], right, "start", right + 24),
    ):
        for number, label in enumerate(labels):
            y = 5 + height * (2 * number + 1) // (2 * len(labels))
            parts.append(f'<path d="M{begin} {y} h14 m-4 -4 l6 4 l-6 4" fill="none" stroke="#1f4e79"/>')
            parts.append(f'<text x="{place}" y="{y + 4}" text-anchor="{anchor}">{escape(label)}</text>')
    return "\n".join([*parts, "</svg>"]) + "\n"


def _labels(rows: Sequence[_Row]) -> list[str]:
    labels = [f"{row.name} [{row.unit}]" if row.unit else row.name for row in rows[:_SHOWN]]
    return labels + ([f"and {len(rows) - _SHOWN} more"] if len(rows) > _SHOWN else [])


_SIDE = 96
_CLEAR, _LINE, _FILL = 0, 1, 2
_COLOURS = ((255, 255, 255), (31, 78, 121), (238, 243, 248))


def _icon(inputs: int, outputs: int) -> bytes:
    """A box with its ports as PNG, 96 pixels square, the ground transparent."""
    pixels = [[_CLEAR] * _SIDE for _ in range(_SIDE)]

    def fill(x: int, y: int, width: int, height: int, colour: int) -> None:
        for row in pixels[y : y + height]:
            row[x : x + width] = [colour] * width

    fill(20, 12, 56, 72, _LINE)
    fill(23, 15, 50, 66, _FILL)
    for count, left in ((min(inputs, 6), 2), (min(outputs, 6), 76)):
        for number in range(count):
            y = 15 + 66 * (2 * number + 1) // (2 * count)
            fill(left, y - 1, 17, 2, _LINE)
            for part in range(5):  # the head of an arrow
                fill(left + 12 + part, y - 5 + part, 2, 10 - 2 * part, _LINE)
    # Four pixels a byte. zlib's own output differs between builds: one stored block does not.
    data = bytearray()
    for row in pixels:
        data.append(0)
        for x in range(0, _SIDE, 4):
            data.append(row[x] << 6 | row[x + 1] << 4 | row[x + 2] << 2 | row[x + 3])
    stored = b"\x78\x01\x01" + struct.pack("<HH", len(data), 0xFFFF ^ len(data)) + bytes(data)
    stored += struct.pack(">I", zlib.adler32(bytes(data)))
    header = struct.pack(">IIBBBBB", _SIDE, _SIDE, 2, 3, 0, 0, 0)
    palette = b"".join(bytes(colour) for colour in _COLOURS)
    chunks = ((b"IHDR", header), (b"PLTE", palette), (b"tRNS", b"\x00"), (b"IDAT", stored), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        for name, content in chunks
    )
