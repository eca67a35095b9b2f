"""What the page in a Modelica FMU states besides its ports: the model's documentation, its equations."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from .classes import ModelicaClass
from .flat import render
from .presentation import Section

if TYPE_CHECKING:
    from .generate import TableEntry
    from .program import Program

_ESCAPED = re.compile(r"\\(.)", re.DOTALL)
_FRAME = re.compile(r"</?(?:html|head|body|script)[^>]*>", re.IGNORECASE)


def model_sections(program: Program, table: Sequence[TableEntry], model: ModelicaClass) -> list[Section]:
    """Sections of the page, from the flat model that the FMU was built from.

    Args:
        program: the model's functions.
        table: its variables.
        model: its class, whose annotation may document it.
    """
    flat = program.model.symbols.flat
    sections = []
    info = _info(model)
    if info:
        sections.append(("Documentation", _FRAME.sub("", _ESCAPED.sub(r"\1", info)).strip()))
    lines = [f"{render(equation.left)} = {render(equation.right)};" for equation in flat.equations]
    lines += [f"assert({render(one.condition)}, {one.message!r});" for one in flat.assertions]
    for entry in table:
        if entry.kind == "PARAMETER" and entry.start is None and entry.variable is not None:
            binding = entry.variable.binding
            if binding is not None:
                lines.append(f"{entry.name} = {render(binding)};")
    body = "\n".join(map(escape, lines))
    return [*sections, ("Equations", f"<pre>\n{body}</pre>")]


def _info(model: ModelicaClass) -> str:
    """The text of `Documentation(info="...")`, as it stands between the quotes; empty without one."""
    for tokens in model.annotations:
        texts = [token.text for token in tokens]
        for place, text in enumerate(texts[:-4]):
            if text == "Documentation" and texts[place + 2 : place + 4] == ["info", "="]:
                return texts[place + 4][1:-1]
    return ""


def sources_used(texts: dict[str, str], main: str) -> dict[str, bytes]:
    """The files that a model needs as far as names show: the main one, and those of classes named there.

    Args:
        texts: of all files of the package, by path.
        main: path of the model's file.
    """
    stems = {path.rpartition("/")[2].removesuffix(".mo"): path for path in texts}
    used, waiting = {main}, [main]
    while waiting:
        for word in set(re.findall(r"[A-Za-z_]\w*", texts[waiting.pop()])):
            path = stems.get(word)
            if path is not None and path not in used:
                used.add(path)
                waiting.append(path)
    return {path: texts[path].encode() for path in sorted(used)}
