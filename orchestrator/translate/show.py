"""What became of a model on its way to an FMU, in text for its author."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from orchestrator.base.errors import BuildError, listed

from .flatten import Json
from .sources import SourceTree, load_sources

if TYPE_CHECKING:
    from .program import Program

Stage = Literal["flat", "blocks"]


def show_model(
    model_file: Path, stage: Stage, *, model: str | None = None, libraries: Sequence[Path] = ()
) -> str:
    """The flat model as Modelica, or the sorted blocks of its equations.

    Args:
        model_file, model, libraries: as for `build`.
        stage: "flat" or "blocks".
    Raises: BuildError as a build does.
    """
    from .build import explicit_program, illustrating, in_file, need_casadi
    from .hybrid.blocks_text import blocks_text
    from .hybrid.build import solved
    from .hybrid.front_end import library_paths

    need_casadi()
    with illustrating(None):
        tree = load_sources(Path(model_file))
    with illustrating(tree):
        name = tree.model_name(model)
        folders = library_paths(libraries)
        if stage == "flat":
            flat, printed = printable(tree, name, folders)
            return printed(flat)
        try:
            return blocks_text(solved(tree, name, folders))
        except BuildError as error:
            message = in_file(tree, error)
            if "delay()" in message:
                return _explicit_text(explicit_program(tree, name)[0])
            raise BuildError(message) from None


def printable(tree: SourceTree, name: str, folders: Sequence[Path]) -> tuple[Json, Callable[[Json], str]]:
    """A model's flat representation, and what writes it, or a changed copy of it, as Modelica.

    Args:
        name: of the model. folders: of libraries.
    Raises: BuildError as a build does.
    """
    from .flat_text import flat_modelica
    from .hybrid.front_end import FunctionTexts, flat_form

    flat, spans = flat_form(tree, name, folders, hidden=True)
    functions = FunctionTexts(tree, folders)

    def printed(one: Json) -> str:
        return flat_modelica(
            one, name, spans, lambda each: found.text if (found := functions(each)) is not None else ""
        )

    return flat, printed


def _explicit_text(program: Program) -> str:
    """Of a model with delays: each value as it follows from time, states, inputs and delayed values."""
    solved, symbols = program.model, program.model.symbols
    lines = [
        f"{symbols.flat.name}: {len(symbols.states)} states, {len(symbols.inputs)} inputs, "
        f"{len(solved.delays)} delays, all explicit",
        "",
        f"Inputs: {listed(symbols.inputs, 40)}",
        f"States: {listed(symbols.states, 40)}",
        "",
        "Initial system (once, before the first step)",
        *(f"  {name} := {start}" for name, start in symbols.starts.items()),
        "",
        "Delays (from the history of their operands)",
        *(f"  {one.symbol} := delay({one.operand}, {one.time})" for one in solved.delays),
        "",
        "Values (at each evaluation; each is written out to what is known)",
        *(f"  {name} := {value}" for name, value in solved.algebraics.items()),
        *(f"  der({name}) := {value}" for name, value in solved.derivatives.items()),
    ]
    if solved.relations:
        lines += ["", "Events"]
        lines += [
            f"  {one.symbol}: state event where {one.expression} changes sign" for one in solved.relations
        ]
    return "\n".join(lines) + "\n"
