"""Everything of a hybrid model's FMU but its binaries."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from orchestrator.base.errors import BuildError

from ..audit import experiment
from ..complaints import UNBALANCED, CompilerRefusal
from ..documents import sources_used
from ..package import FmiVersion, hybrid_sources, source_members
from ..presentation import dress, sources_of
from ..sizes import refuse_other_sizes
from ..sources import SourceTree
from .code import generate_hybrid_c
from .dae import read_dae
from .description import describe_hybrid
from .front_end import FunctionTexts, dae_form
from .layout import layout_of
from .model import DaeModel
from .structure import System, solve_order, unbalanced

_DEEPEST = 12_000  # calls of Python, for expressions of recursive functions


def solved(tree: SourceTree, name: str, libraries: Sequence[Path] = ()) -> System:
    """A model in the order of its solution. Raises: BuildError for what is not supported."""
    try:
        document = dae_form(tree, name, libraries)
    except CompilerRefusal as refusal:
        raise counted(tree, name, libraries, refusal) from None
    if not libraries:  # of a library's variables only the names of the model's own would be found
        types = document["storage"]["value_types"]
        variables = document["storage"]["variables"]
        refuse_other_sizes(tree, {one["name"]: types[one["value_type"]]["dimensions"] for one in variables})
    with understood(name):
        return solve_order(read_dae(document, name, *_beside(tree, libraries)))


def _beside(tree: SourceTree, libraries: Sequence[Path]) -> tuple[list[Path], FunctionTexts]:
    """Where files that a model names may stand, and the text of functions."""
    return [(tree.root / tree.main).parent, tree.root, *libraries], FunctionTexts(tree, libraries)


def read(tree: SourceTree, name: str, libraries: Sequence[Path], *, partial: bool) -> DaeModel:
    """A model in scalars; see `dae_form`. Raises: BuildError for what is not supported."""
    with understood(name):
        return read_dae(dae_form(tree, name, libraries, partial=partial), name, *_beside(tree, libraries))


def counted(tree: SourceTree, name: str, libraries: Sequence[Path], refusal: CompilerRefusal) -> BuildError:
    """The compiler's refusal; of an unbalanced model, by the variables and equations concerned."""
    if UNBALANCED not in str(refusal):
        return refusal
    try:
        with understood(name):
            model = read(tree, name, libraries, partial=True)
            states = [one.value for one in model.variables if one.role == "state"]
            algebraics = [one.value for one in model.variables if one.role == "algebraic"]
    except BuildError:
        return refusal
    different = len(states) + len(algebraics) != len(model.equations)
    return unbalanced(model, states, algebraics) if different else refusal


@contextmanager
def understood(name: str) -> Iterator[None]:
    """Where an error within is none of the model's, say so. Raises: BuildError."""
    deepest = sys.getrecursionlimit()
    sys.setrecursionlimit(max(deepest, _DEEPEST))
    try:
        yield
    except RecursionError:
        raise BuildError(f"{name}: an expression is nested too deeply; split it") from None
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise BuildError(f"{name}: the compiler's form of the model is not understood: {error}") from error
    finally:
        sys.setrecursionlimit(deepest)


def translate_hybrid(
    tree: SourceTree,
    name: str,
    identifier: str,
    fmi_version: str,
    libraries: Sequence[Path] = (),
) -> tuple[dict[str, bytes], dict[str, int], tuple[str, ...]]:
    """Translate a model through the compiler's DAE form.

    Returns: path within the FMU -> content; counts; notes.
    Raises: BuildError for what is not supported.
    """
    system = solved(tree, name, libraries)
    layout = layout_of(system, indicators=fmi_version == "3.0")
    code = generate_hybrid_c(layout, identifier)
    version = cast(FmiVersion, fmi_version)
    sources = hybrid_sources(version)
    files = [file for file in (*sources, "model.c") if file.endswith(".c")]
    numbers = experiment(tree.classes[name]) if name in tree.classes else {}

    def description(token: str) -> bytes:
        return describe_hybrid(
            layout, numbers, fmi_version=fmi_version, identifier=identifier, token=token, source_files=files
        )

    members = source_members(code, sources, identifier, version, description)
    made_of = sources_of(sources_used(tree.texts, tree.classes[name].file), ("rumoca", "ziglang"))
    members |= dress(members["modelDescription.xml"], [], made_of)
    model = system.model
    counts = {
        "states": len(system.states),
        "inputs": len(layout.inputs),
        "outputs": sum(1 for one in model.variables if one.causality == "output"),
        "parameters": len(layout.parameters),
        "relations and steps held between events": len(model.modes),
        "discrete variables": len(model.discretes),
        "blocks of equations": sum(1 for one in system.blocks if one.value is None),
        "constraints of states": len(system.constraints),
    }
    counts["delays"] = len(model.delays)
    offered = "co-simulation, since it delays signals" if model.delays else "co-simulation and model exchange"
    return members, counts, (f"offers {offered}", *system.notes)
