"""External C functions with their source beside the model: their text goes into the FMU's."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from .functions import as_call, native

Json = Mapping[str, Any]


def external_call(
    function: Json,
    values: Sequence[np.ndarray],
    kinds: Sequence[str],
    argument: Callable[[int], int | float],
    place: Callable[[str], Path],
) -> Any:
    """The result of an external C function.

    Args:
        function: of the compiler's form.
        values: of its inputs.
        kinds: of its inputs: "real", "integer" or "boolean".
        argument: the place of the input that an argument of the call stands for, or, as a float, its value.
        place: the file of a name in quotes, or of a modelica: address.
    Raises: BuildError for what is no function of numbers with its source beside the model.
    """
    external, name = function["external"], function["name"]
    text = _source(external["linkage"], place)
    if text is None:
        raise BuildError(
            f"the external function {name}() has no C source beside the model; "
            'give it with annotation(Include="#include \\"file.c\\""), or write it in Modelica'
        )
    if external.get("language") not in ("c", "C") or external.get("result") is None:
        raise BuildError(f"the external function {name}() does not return its result; write it so, in C")
    if any(kind not in ("real", "integer", "boolean") for kind in kinds):
        raise BuildError(f"the external function {name}() takes more than numbers and arrays of them")
    starts = np.cumsum([0, *(one.size for one in values)])
    lines, arguments = [], []
    for number, one in enumerate(external["arguments"]):
        if "input" not in one:
            raise BuildError(f"the external function {name}() writes its results into arguments")
        at = argument(one["input"])
        if isinstance(at, float):
            arguments.append(str(int(at)))
            continue
        start, real = starts[at], kinds[at] == "real"
        if not values[at].ndim:
            arguments.append(f"in[{start}]" if real else f"(int)in[{start}]")
        elif real:
            arguments.append(f"in + {start}")
        else:
            size = values[at].size
            lines += [f"int w{number}[{max(size, 1)}];"]
            lines += [f"for (int k = 0; k < {size}; k++) w{number}[k] = (int)in[{start} + k];"]
            arguments.append(f"w{number}")
    lines.append(f"out[0] = bad ? NAN : (double){external['symbol']}({', '.join(arguments)});")
    return as_call(native(name, text, lines), values)[0].item()


def _source(linkage: Json, place: Callable[[str], Path]) -> str | None:
    """The text to include, with the files that it includes in its place."""
    include = linkage.get("include")
    if not include:
        return None
    folder = linkage.get("include_directory")

    def inserted(match: re.Match[str]) -> str:
        file = match[1] if not folder else f"{folder}/{match[1]}"
        path = place(file)
        if not path.is_file():
            raise BuildError(f"{path}: no such file; an external function includes it")
        return path.read_text()

    text: str = re.sub(r'^[ \t]*#[ \t]*include[ \t]+"([^"]+)"', inserted, include, flags=re.MULTILINE)
    return text
