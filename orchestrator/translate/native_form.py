"""Build the native FMU of a Python component: trace it, check it, generate C, describe, compile, pack."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from orchestrator.base.errors import BuildError

from .build import ALL, check_options, compiled, need_casadi
from .build_report import BuildReport
from .package import runtime_sources, source_members, write_fmu
from .presentation import Section, dress, sources_of
from .python_fmu import described_model, docstrings, source_files
from .shared_source import assembled


def build_native_fmu(
    script: Path, output: Path, *, fmi_version: str = "2.0", platforms: Sequence[str] = ALL
) -> BuildReport:
    """Build an FMU without Python from a Python component.

    The same source gives the same bytes, wherever and whenever it is built with the same packages.

    Args:
        script: the file that the component's Python FMU is built from.
        output: the .fmu to write; replaced only when complete.
        fmi_version: "2.0" or "3.0".
        platforms: keys of `package.PLATFORMS` to compile for; may be empty for an FMU of sources only.
    Returns: what was built.
    Raises: BuildError for code that has no native form, naming the line, and for a native form that does
        not do what the Python code does.
    """
    need_casadi()
    from .component import trace_component
    from .step_check import check_component
    from .step_code import generate_step_c
    from .step_description import describe_native

    script, output = Path(script), Path(output)
    version, platforms = check_options(fmi_version, platforms)
    _, root, model = described_model(script)
    name = type(model).__name__
    program = trace_component(script.resolve(), name)
    if any(variable.name == "time" for variable in program.variables):
        raise BuildError(
            f"{script.name}: native form: the name time is taken by the simulation time; rename it"
        )
    checked = check_component(script, type(model), program)
    code = generate_step_c(program)
    sources = runtime_sources(version, stepped=True)
    files = [file for file in (*sources, "model.c") if file.endswith(".c")]

    def description(token: str) -> bytes:
        return describe_native(root, program, fmi_version, token, files)

    members = source_members(code, sources, name, version, description)
    made_of = sources_of(source_files(script), ("pythonfmu", "casadi", "ziglang"))
    members |= dress(members["modelDescription.xml"], _sections(model, script), made_of)
    members |= compiled(members, name, version, platforms)
    output.parent.mkdir(parents=True, exist_ok=True)
    write_fmu(output, members)
    counts = {
        "states": len(program.of_kind("STATE")),
        "inputs": len(program.of_kind("INPUT")),
        "parameters": len(program.of_kind("PARAMETER")),
        "computed variables": len(program.of_kind("ALGEBRAIC")),
        "ways for a step to end": program.paths,
    }
    return BuildReport(output, name, fmi_version, tuple(platforms), counts, (checked,))


def _sections(model: Any, script: Path) -> list[Section]:
    """What the FMU's page states besides its ports: what the component says of itself, and its source."""
    form = "<p>Native form: C generated from the Python source below; no Python is needed where it runs.</p>"
    return [
        *docstrings(model, script),
        ("Form", form),
        ("Source", f"<pre>\n{escape(assembled(script))}</pre>"),
    ]
