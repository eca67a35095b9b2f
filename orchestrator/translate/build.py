"""Build an FMU from a Modelica file: read, solve, check, generate, describe, compile, pack."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

from orchestrator.base.errors import BuildError, Problem
from orchestrator.base.temporary_folders import scratch_root

from .build_report import BuildReport
from .complaints import CompilerRefusal
from .faults import faults_of, illustrated
from .package import (
    PLATFORMS,
    FmiVersion,
    binary_member,
    compile_library,
    named_platforms,
    runtime_sources,
    source_members,
    write_fmu,
)
from .rewriting.specialised import specialised
from .sources import DELAY, Location, SourceTree, library_texts, load_sources

if TYPE_CHECKING:
    from .program import Program
    from .selfcheck import CheckReport

Compiler = Literal["rumoca", "omc"]
ALL: tuple[str, ...] = tuple(PLATFORMS)
"""Every platform that binaries can be made for."""

_CHECK = "checked at {points} random points, largest relative residual {residual:.1e}"


def build(
    model_file: Path,
    output: Path,
    *,
    model: str | None = None,
    fmi_version: str = "2.0",
    platforms: Sequence[str] = ALL,
    compiler: Compiler = "rumoca",
    libraries: Sequence[Path] = (),
) -> BuildReport:
    """Build an FMU for co-simulation from a Modelica file.

    The same sources give the same bytes, wherever and whenever they are built with the same compiler.

    Args:
        model_file: a .mo file: a model on its own or a part of a structured package, which is then loaded.
        output: the .fmu to write; replaced only when complete.
        model: name of the model; needed if the file defines none or several.
        fmi_version: "2.0" or "3.0".
        platforms: names as `package.named_platforms` takes them; may be empty for an FMU of sources only.
        compiler: "rumoca" for the built-in route, "omc" for an installed OpenModelica.
        libraries: folders with further Modelica libraries, beside those of MODELICAPATH.
    Returns: what was built.
    Raises: BuildError for a model or option that is not supported, naming file and line.
    """
    model_file, output = Path(model_file), Path(output)
    version, platforms = check_options(fmi_version, platforms)
    if not output.parent.is_dir():
        raise BuildError(f"{output}: the folder {output.parent} does not exist; create it first")
    if compiler == "omc":
        from .omc import build_with_omc

        return build_with_omc(model_file, output, model=model, fmi_version=fmi_version)
    if compiler != "rumoca":
        raise BuildError(f"unknown compiler {compiler!r}; choose rumoca or omc")
    members, report = translate(model_file, model=model, fmi_version=fmi_version, libraries=libraries)
    identifier = model_identifier(report.model)
    members |= compiled(members, identifier, version, platforms)
    write_fmu(output, members)
    return BuildReport(output, report.model, fmi_version, tuple(platforms), report.counts, report.notes)


def check_options(fmi_version: str, platforms: Sequence[str]) -> tuple[FmiVersion, tuple[str, ...]]:
    """The version, and keys of `PLATFORMS`, if they can be built for. Raises: BuildError."""
    if fmi_version not in ("2.0", "3.0"):
        raise BuildError(f"FMI version {fmi_version!r} is not supported; choose 2.0 or 3.0")
    return cast(FmiVersion, fmi_version), named_platforms(platforms)


def need_casadi() -> None:
    """Raises: BuildError if CasADi, which the modules that build import, is not installed."""
    if find_spec("casadi") is None:  # importing it takes a third of a second, which not every model needs
        raise BuildError("CasADi is not installed; run `pip install 'orchestrator[build]'`")


def compiled(
    members: Mapping[str, bytes], identifier: str, version: FmiVersion, platforms: Sequence[str]
) -> dict[str, bytes]:
    """Binaries of an FMU's sources, as members; both by their paths within the FMU."""
    if not platforms:
        return {}
    with tempfile.TemporaryDirectory(prefix="fmu-sources-", dir=scratch_root()) as folder:
        for name, content in members.items():
            if name.startswith("sources/"):
                (Path(folder) / name.removeprefix("sources/")).write_bytes(content)
        libraries = compile_library(Path(folder), identifier, version, list(platforms))
    return {binary_member(one, identifier, version): content for one, content in libraries.items()}


@dataclass(frozen=True)
class TranslationReport:
    """What was translated; see BuildReport."""

    model: str
    counts: dict[str, int]
    notes: tuple[str, ...]


def translate(
    model_file: Path,
    *,
    model: str | None = None,
    fmi_version: str = "2.0",
    libraries: Sequence[Path] = (),
) -> tuple[dict[str, bytes], TranslationReport]:
    """Make everything of an FMU but its binaries.

    Models of explicit differential equations with delays take the route of `program`; what that refuses is
    tried by the route of `hybrid`.

    Args:
        model_file, model, fmi_version, libraries: as for `build`.
    Returns: path within the FMU -> content, and a report.
    Raises: BuildError for what is not supported, naming file and line.
    """
    need_casadi()
    with illustrating(None):
        tree = load_sources(model_file)
    with illustrating(tree):
        return _translated(tree, model, fmi_version, libraries)


@contextmanager
def illustrating(tree: SourceTree | None) -> Iterator[None]:
    """Errors within show the lines that they name. Raises: BuildError."""
    try:
        yield
    except BuildError as error:
        shown = BuildError(illustrated(str(error), tree))
        shown.problems = tuple(
            Problem(", ".join(str(Location(*place)) for place in fault.places), fault.what)
            for fault in faults_of(str(error))
            if fault.places
        )
        raise shown from None


def _translated(
    tree: SourceTree, model: str | None, fmi_version: str, libraries: Sequence[Path]
) -> tuple[dict[str, bytes], TranslationReport]:
    from .audit import experiment
    from .hybrid.build import counted, translate_hybrid
    from .hybrid.front_end import libraries_used, library_paths
    from .rewriting.copies import adapts
    from .stiffness import explicit_steps

    name = tree.model_name(model)
    folders = library_paths(libraries)
    identifier = model_identifier(name)
    try:
        program, checked = explicit_program(tree, name)
    except BuildError as refusal:
        if not other_route(refusal, bool(folders) or adapts(tree)):
            raise (
                counted(tree, name, folders, refusal) if isinstance(refusal, CompilerRefusal) else refusal
            ) from None
        try:
            members, counts, notes = translate_hybrid(tree, name, identifier, fmi_version, folders)
        except BuildError as error:
            raise BuildError(in_file(tree, error)) from None
        remarks = [text for one in libraries_used(tree, folders) for text in library_texts(one)[1]]
        return members, TranslationReport(name, counts, (*tree.remarks, *remarks, *notes))
    stop = experiment(tree.classes[name]).get("StopTime", 1.0)
    if steps := explicit_steps(program, stop):
        try:
            members, counts, notes = translate_hybrid(tree, name, identifier, fmi_version, folders)
        except BuildError as error:
            stiff = f"stiff: {steps:.1g} steps in {stop:g} s, since it has no implicit method: {error}"
            members, report = _explicit(tree, name, fmi_version, program, checked)
            return members, replace(report, notes=(*report.notes, stiff))
        stiff = f"stiff: an implicit method replaces {steps:.1g} explicit steps in {stop:g} s"
        return members, TranslationReport(name, counts, (*tree.remarks, stiff, *notes))
    return _explicit(tree, name, fmi_version, program, checked)


# Of refusals by the explicit route those that say what it lacks; all others name a mistake of the model.
_LACKS = re.compile(
    r"^(?!.*(the compiler |expressions of kind (?!Tuple|Array|FieldAccess))).*(?<!which are )not supported"
    r"|fixed=false, which needs|has fixed=true but is no state|only Real, Integer and Boolean"
    r"|a subscript or size has to be"
)


def other_route(refusal: BuildError, differs: bool) -> bool:
    """Whether the hybrid route may take what the explicit one refuses.

    Args:
        differs: whether the compiler reads something else there: libraries, or sources adapted for it.
    """
    from .rewriting.copies import needed_rewrites

    if isinstance(refusal, CompilerRefusal):
        return differs or bool(needed_rewrites(str(refusal)))
    return all(_LACKS.search(line) for line in str(refusal).splitlines() if not line.startswith(" "))


def in_file(tree: SourceTree, error: BuildError) -> str:
    """A message of the hybrid route, at least with the file that it is about."""
    text, place = str(error).replace(DELAY, "delay"), tree.shown(tree.main)
    named = text.startswith("--library") or any(fault.places for fault in faults_of(text))
    return text if named or text.startswith(place) else f"{place}: {text}"


def explicit_program(tree: SourceTree, name: str) -> tuple[Program, CheckReport]:
    """A model of explicit differential equations, solved, and the check of that. Raises: BuildError."""
    from .reader import read_model
    from .rewriting.adapted import has_dotted_modifiers

    for file, text in tree.texts.items():
        if has_dotted_modifiers(text, tree.shown(file)):
            raise BuildError(f"{tree.shown(file)}: modifiers with dotted names are not supported")
    if specialised(tree).texts != tree.texts:
        raise BuildError(f"{tree.shown(tree.main)}: redeclarations are not supported")
    try:
        flat = read_model(tree, name)

        from .causalise import solve
        from .program import build_program
        from .selfcheck import check
        from .symbolic import symbolic_model

        program = build_program(solve(symbolic_model(flat)))
        return program, check(program)
    except RecursionError:
        raise BuildError(
            f"{tree.shown(tree.main)}: an expression of {name} is nested too deeply; split it"
        ) from None


def _explicit(
    tree: SourceTree, name: str, fmi_version: str, program: Program, checked: CheckReport
) -> tuple[dict[str, bytes], TranslationReport]:
    """The route for explicit differential equations with delays."""
    from .description import describe
    from .documents import model_sections, sources_used
    from .generate import generate_c, variable_table
    from .presentation import dress, sources_of

    flat = program.model.symbols.flat
    identifier = model_identifier(name)
    code = generate_c(program, identifier)
    table = variable_table(program)
    sources = runtime_sources(cast(FmiVersion, fmi_version))
    files = [file for file in (*sources, "model.c") if file.endswith(".c")]

    notes: tuple[str, ...] = ()

    def description(token: str) -> bytes:
        nonlocal notes
        written = describe(
            program, table, fmi_version=fmi_version, identifier=identifier, token=token, source_files=files
        )
        notes = written.notes
        return written.xml

    members = source_members(code, sources, identifier, cast(FmiVersion, fmi_version), description)
    xml = members["modelDescription.xml"]
    made_of = sources_of(sources_used(tree.texts, tree.classes[name].file), ("rumoca", "casadi", "ziglang"))
    members |= dress(xml, model_sections(program, table, tree.classes[name]), made_of)
    counts = {
        "states": len(program.states),
        "inputs": len(program.inputs),
        "outputs": sum(1 for variable in flat.variables if variable.role == "output"),
        "parameters": sum(1 for entry in table if entry.kind == "PARAMETER" and entry.settable),
        "delays": len(program.model.delays),
        "relations": len(program.model.relations),
    }
    if flat.structural:
        notes = (
            *notes,
            f"built in, since they decide which equations there are: {', '.join(flat.structural)}",
        )
    guesses = [v.name for v in flat.variables if v.name in program.states and not v.fixed]
    if guesses:
        notes = (*notes, f"started at their start values, though not fixed: {', '.join(guesses)}")
    checked_text = _CHECK.format(points=checked.points, residual=checked.largest_residual)
    return members, TranslationReport(name, counts, (*tree.remarks, checked_text, *notes))


def model_identifier(model: str) -> str:
    """Model identifier of a qualified model name: the last part, as a C identifier."""
    return re.sub(r"\W", "_", model.rpartition(".")[2], flags=re.ASCII)
