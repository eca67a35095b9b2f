"""A component with laws inside it, as a Modelica model and an FMU.

The model is the flat form of the one that the FMU was built from. There each derivative that a law changes is
the law's value larger than the equations say, and each input is larger by it where equations read it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

from ...base.atomic_files import write_text
from ...base.errors import OrchestratorError
from ...fmi import CompiledFmu
from ...system.system import System
from ...translate.build import check_options, compiled, model_identifier, translate
from ...translate.flat_text import quoted
from ...translate.package import this_platform, write_fmu
from ...translate.presentation import PROVENANCE, source_digest
from ...translate.show import show_model

# The name of a component's variable in a flat model, or of its derivative.
_QUOTED = re.compile(r"""\bname="(der\()?'\w[\w.,\[\]]*'\)?\"""")
_HEAD = re.compile(r"^(?:model|block|class) ([\w']+).*\n", re.MULTILINE)


@dataclass(frozen=True)
class ModelOfLaw:
    """A law at the derivatives of states, or at an input.

    Attributes:
        name, text: of its Modelica model, whose output is y.
        shares: what of its output is added to the derivative of each state.
        reads: the component's variable for each of the model's inputs.
        input: of the component, to which the output is added; "" for none.
    """

    name: str
    text: str
    shares: Mapping[str, float]
    reads: Mapping[str, str]
    input: str = ""


def source_of(fmu: Path) -> tuple[Path, str] | str:
    """The Modelica file that an FMU was built from, with the model's name; or why it is not known.

    The FMU names its files with their digests. They are looked for beside the FMU and one folder above.
    """
    with ZipFile(fmu) as archive:
        if PROVENANCE not in archive.namelist():
            return f"{fmu.name} does not say which model it was built from"
        about = json.loads(archive.read(PROVENANCE))
    name, found = str(about["modelName"]), []
    for file, digest in about.get("sources", {}).items():
        places = (fmu.parent / file, fmu.parent / Path(file).name, fmu.parent.parent / file)
        same = [one for one in places if one.is_file() and source_digest(one.read_bytes()) == digest]
        if not same or same[0].suffix != ".mo":
            return f"{file}, from which {fmu.name} was built, is not beside it, or differs"
        found.append(same[0])
    last = name.rpartition(".")[2]
    main = [one for one in found if one.stem == last] or found
    return (main[0], name) if main else f"{fmu.name} names no file that it was built from"


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
        text = _changed(show_model(source[0], "flat", model=source[1]), name, laws)
        if not text:
            return "", f"the flat form of {source[0].name} has no such derivative or input."
        write_text(model, text)
        _build(model, folder / f"{name}.fmu", fmu.description.fmi_version)
    except (OrchestratorError, ImportError) as error:
        return "", f"the FMU of {model.name} could not be built: {str(error).splitlines()[0]}"
    return f"{name}.fmu", ""


def _build(model: Path, fmu: Path, version: str) -> None:
    """Build a flat model, whose variables get the names that they have in the model with components."""
    members, report = translate(model, fmi_version=version, model=model.stem)
    description = members["modelDescription.xml"].decode()
    members["modelDescription.xml"] = _QUOTED.sub(
        lambda found: found[0].replace("'", ""), description
    ).encode()
    checked, platforms = check_options(version, [this_platform()])
    write_fmu(fmu, members | compiled(members, model_identifier(report.model), checked, platforms))


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
