"""A component with laws inside it, as a Modelica model and an FMU.

The model is the flat form of the one that the FMU was built from. There each derivative that a law changes is
the law's value larger than the equations say, and each input is larger by it where equations read it. A law
in an inner equation drives an input that is opened there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...base.atomic_files import write_text
from ...base.errors import OrchestratorError
from ...fmi import CompiledFmu
from ...system.system import System
from ...translate.flat_text import quoted
from ...translate.opened import opened_model
from .rebuilt import build_flat, source_of

_HEAD = re.compile(r"^(?:model|block|class) ([\w']+).*\n", re.MULTILINE)


@dataclass(frozen=True)
class ModelOfLaw:
    """A law at the derivatives of states, at an input, or in an inner equation.

    Attributes:
        name, text: of its Modelica model, whose output is y.
        shares: what of its output is added to the derivative of each state.
        reads: the component's variable for each of the model's inputs.
        input: of the component, to which the output is added; "" for none.
        opening: input inside the component that the output drives; "" for none. See `translate.opened`.
    """

    name: str
    text: str
    shares: Mapping[str, float]
    reads: Mapping[str, str]
    input: str = ""
    opening: str = ""


def build_corrected(
    system: System, instance: str, laws: Sequence[ModelOfLaw], folder: Path
) -> tuple[str, str]:
    """Write the corrected component of an instance and build its FMU, `<name of its FMU>_corrected.fmu`.

    Returns: the file's name, and why that failed; else "".
    """
    fmu = system.instances[system.position[instance]].fmu
    if not isinstance(fmu, CompiledFmu):
        return "", "its component is no FMU. Add the law to that equation of the model."
    source = source_of(fmu.path)
    if isinstance(source, str):
        return "", f"{source}. Add the law to that equation of the model."
    name = f"{fmu.path.stem}_corrected"
    model = folder / f"{name}.mo"
    try:
        only = [one.opening for one in laws if one.opening]
        text = _changed(opened_model(source[0], model=source[1], only=only)[0], name, laws)
        if not text:
            return "", f"the flat form of {source[0].name} has no such derivative or input."
        write_text(model, text)
        build_flat(model, folder / f"{name}.fmu", fmu.description.fmi_version)
    except (OrchestratorError, ImportError) as error:
        return "", f"the FMU of {model.name} could not be built: {str(error).splitlines()[0]}"
    return f"{name}.fmu", ""


def _changed(text: str, name: str, laws: Sequence[ModelOfLaw]) -> str:
    """The flat model with laws, under another name; empty if it has no such derivative or input."""
    heads = list(_HEAD.finditer(text))
    if not heads:
        return ""
    head = heads[-1]
    before, body = text[: head.start()], text[head.end() :]
    declared, equations = "", ""
    for law in laws:
        one = f"added_by_{law.name}"
        for state, share in law.shares.items():
            derivative = f"der({_spelled(state)})"
            if derivative not in body:
                return ""
            added = f"{one}.y" if share == 1.0 else f"({share!r})*{one}.y"
            body = body.replace(derivative, f"({derivative} - {added})")
        if law.input:
            before_it, body = body, _larger(body, _spelled(law.input), f"{one}.y")
            if body == before_it:
                return ""
        if law.opening:
            driven = f"  input Real {_spelled(law.opening)}("
            if driven not in body:
                return ""
            body = body.replace(driven, driven.replace("input ", ""))
            equations += f"  {_spelled(law.opening)} = {one}.y;\n"
        declared += f"  {law.name} {one};\n"
        equations += "".join(f"  {one}.{port} = {_spelled(read)};\n" for port, read in law.reads.items())
        before += law.text + "\n"
    body = re.sub(
        rf"^end {re.escape(head[1])};", f"equation\n{equations}end {name};", body, flags=re.MULTILINE
    )
    return f"{before}{head[0].replace(head[1], name, 1)}{declared}{body}"


def _larger(body: str, port: str, added: str) -> str:
    """A flat model's text, where all that reads an input reads it with what is added."""
    reading = re.compile(rf"(?<![\w.']){re.escape(port)}(?![\w.'])")
    own = re.compile(rf"^\s*input \w+ {re.escape(port)}\b")

    def changed(line: str) -> str:
        # What stands between double quotes is text.
        parts = re.split(r'("(?:[^"\\]|\\.)*")', line)
        parts[::2] = [reading.sub(f"({port} + {added})", one) for one in parts[::2]]
        return line if own.match(line) else "".join(parts)

    return "\n".join(map(changed, body.split("\n")))


def _spelled(name: str) -> str:
    """A variable's name as flat models have it."""
    return name if re.fullmatch(r"\w+\[[\d, ]+\]", name) else quoted(name)
