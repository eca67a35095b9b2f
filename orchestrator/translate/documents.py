"""The documentation that goes into an FMU: equations, ports and parameters as one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from .flat import Role, render
from .generate import TableEntry
from .program import Program


def documentation_page(program: Program, table: Sequence[TableEntry]) -> str:
    """Return documentation/index.html: what the FMU computes, from the flat model it was built from.

    Args:
        program: the model's functions.
        table: its variables.
    """
    flat = program.model.symbols.flat
    title = escape(flat.name)
    rows = []
    for heading, roles in (
        ("Inputs", (Role.INPUT,)),
        ("Outputs", (Role.OUTPUT,)),
        ("Parameters", (Role.PARAMETER, Role.CONSTANT)),
        ("Local variables", (Role.LOCAL,)),
    ):
        entries = [
            entry
            for entry in table
            if entry.variable is not None and entry.variable.role in roles and entry.kind != "DERIVATIVE"
        ]
        if entries:
            rows.append(
                f"<h2>{heading}</h2>\n<table>\n{_row('th', ('name', 'unit', 'start', 'description'))}"
            )
            rows.extend(_row("td", _cells(entry)) for entry in entries)
            rows.append("</table>")
    equations = "\n".join(
        escape(f"{render(equation.left)} = {render(equation.right)};") for equation in flat.equations
    )
    assertions = "\n".join(
        escape(f"assert({render(assertion.condition)}, {assertion.message!r});")
        for assertion in flat.assertions
    )
    text = "\n".join(
        [
            "<!DOCTYPE html>",
            f'<html lang="en"><head><meta charset="utf-8"><title>{title}</title></head><body>',
            f"<h1>{title}</h1>",
            f"<p>{escape(flat.description)}</p>",
            *rows,
            "<h2>Equations</h2>",
            f"<pre>\n{equations}\n{assertions}</pre>",
            "</body></html>",
        ]
    )
    return text + "\n"


def _cells(entry: TableEntry) -> tuple[str, ...]:
    variable = entry.variable
    if variable is None:
        return (entry.name, "", "", "")
    start = "" if entry.start is None else f"{entry.start:.15g}"
    if entry.kind == "PARAMETER" and entry.start is None and variable.binding is not None:
        start = f"= {render(variable.binding)}"
    return (entry.name, variable.unit, start, variable.description)


def _row(tag: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"
