"""The Modelica compiler's DAE form, made in a process of its own with a time limit."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from orchestrator.base.errors import BuildError

from ..compiler import TIME_LIMIT, compile_model
from ..complaints import CompilerRefusal, explained
from ..flatten import called_partial, flatten, message_of, syntax_faults
from ..lexer import tokenise
from ..rewriting.buses import refuse_unknown_members
from ..rewriting.class_bodies import class_texts
from ..rewriting.component_arrays import refuse_single_components
from ..rewriting.copies import adapts, needed_rewrites, prepared
from ..rewriting.hidden_sections import Sections
from ..rewriting.redeclared import refuse_repeated_redeclarations
from ..rewriting.specialised import specialised
from ..sources import SourceTree, Spans
from .statements import FunctionSource


def library_paths(given: Sequence[Path] = ()) -> tuple[Path, ...]:
    """Folders with libraries: those given, then those of MODELICAPATH.

    Raises: BuildError for a given one that is no folder.
    """
    for one in given:
        if not one.is_dir():
            raise BuildError(
                f"--library {one}: no such folder; give one that holds a library's folder or package.mo"
            )
    named = [Path(one) for one in os.environ.get("MODELICAPATH", "").split(os.pathsep) if one]
    return (*given, *(one for one in named if one.is_dir()))


def dae_form(
    tree: SourceTree,
    model: str,
    libraries: Sequence[Path] = (),
    time_limit: float = TIME_LIMIT,
    *,
    partial: bool = False,
) -> dict[str, Any]:
    """Run the compiler.

    Args:
        tree: the source files.
        model: qualified name.
        libraries: folders with further libraries.
        time_limit: [s].
        partial: whether the model is called partial, so that the compiler counts no equations.
    Returns: the DAE form; its "spans" give places.
    Raises: BuildError if the compiler refuses the model, ends by itself or does not end.
    """
    forms, spans = _forms(tree, model, libraries, time_limit, partial, ("dae",))
    return {**forms["dae"], "spans": spans}


def flat_form(
    tree: SourceTree,
    model: str,
    libraries: Sequence[Path] = (),
    *,
    partial: bool = False,
    hidden: bool = False,
) -> tuple[dict[str, Any], Spans]:
    """The flat representation, and places; arguments and errors as of `dae_form`.

    Args:
        hidden: whether it may lack algorithm sections, which are then its "sections".
    """
    alone = not libraries_used(tree, libraries) and not partial and not adapts(tree)
    try:
        if alone:
            flat, paths = flatten(tree, model)
            files = {number: (path, tree.texts.get(path, "")) for number, path in paths.items()}
            return flat, Spans(tree, files)
        forms, spans = _forms(tree, model, libraries, TIME_LIMIT, partial, ("dae", "flat"))
    except CompilerRefusal as refusal:
        if not hidden or "algorithm" not in str(refusal):
            raise
        rewritten = frozenset(("functions", "sections"))
        forms, spans = _forms(tree, model, libraries, TIME_LIMIT, partial, ("dae", "flat"), rewritten)
    return {**forms["flat"], "sections": forms["dae"]["sections"]}, spans


# The compiler's last answers: a check asks for several forms of one model.
_answers: dict[tuple[object, ...], tuple[dict[str, Any], Spans]] = {}
_MOST_ANSWERS = 4
_TRANSACTIONS = "model_event_transactions"  # algorithms whose statements depend on each other at an event


def _forms(
    tree: SourceTree,
    model: str,
    libraries: Sequence[Path],
    time_limit: float,
    partial: bool,
    stages: tuple[str, ...],
    rewritten: frozenset[str] = frozenset(),
) -> tuple[dict[str, Any], Spans]:
    """The compiler's forms of a model by their names, and places; `rewritten` as of `prepared`."""
    libraries = libraries_used(tree, libraries)
    key = (tree.root, tuple(tree.texts.items()), model, tuple(libraries), partial)
    known = _answers.get(key)
    if known and set(stages) <= known[0].keys():
        return known
    special = specialised(tree, model, libraries)
    refuse_repeated_redeclarations(special, model)
    # Names of a library cannot be changed, so those of the model stay as well.
    with special.marked_copy(renamed=not libraries) as folder:
        restored = special.restored if not libraries else str
        sections: Sections = {}
        roots, changed = prepared(tree, folder, libraries, rewritten, sections)
        # Without the sections, equations are missing: the translation counts them itself.
        changed |= {path for path, text in special.texts.items() if text != tree.texts[path]}
        inserted = called_partial(special, model, folder) if partial or sections else ("", 0, 0)
        answer = compile_model(tree, model, folder, stages, roots, restored=restored, limit=time_limit)
        if answer.refusal:
            more = rewritten | needed_rewrites(answer.refusal)
            if more != rewritten and ("sections" not in more or "flat" not in stages):
                return _forms(tree, model, libraries, time_limit, partial, stages, more)
            if wrong := syntax_faults(tree.texts, tree.shown):
                raise BuildError("\n".join(wrong))
            text = _short(_of_user(answer.refusal.replace(f"{folder}/", tree.label), roots, libraries))
            asked = None if libraries else lambda other: message_of(other, model, partial)
            raise CompilerRefusal(explained(tree, model, text, asked))
        forms = answer.forms
        names = [restored(one["name"]) for one in forms["dae"]["storage"]["variables"]]
        refuse_unknown_members(tree, names)
        refuse_single_components(special, model, names)
        prefix = f"{folder.as_posix()}/"
        if "flat" not in stages and "sections" not in rewritten and forms["dae"]["storage"][_TRANSACTIONS]:
            again = rewritten | {"sections"}
            return _forms(tree, model, libraries, time_limit, partial, stages, again)
        files = {
            number: (_of_user(path.replace("\\", "/").removeprefix(prefix), roots, libraries), text)
            for number, path, text in forms["dae"]["source_map"]["files"]
        }
    restored_texts = {key: replace(one, text=restored(one.text)) for key, one in sections.items()}
    forms["dae"]["sections"] = restored_texts
    while len(_answers) >= _MOST_ANSWERS:
        _answers.pop(next(iter(_answers)))
    _answers[key] = forms, Spans(tree, files, not libraries, inserted, changed)
    return _answers[key]


def libraries_used(tree: SourceTree, libraries: Sequence[Path]) -> list[Path]:
    """The folders that hold a library whose name stands in the sources: reading one takes seconds."""
    words = {word for text in tree.texts.values() for word in re.findall(r"\w+", text)}
    found = []
    for folder in libraries:
        inside = (
            [folder.name] if (folder / "package.mo").is_file() else [one.stem for one in folder.iterdir()]
        )
        # A folder may carry a version, as "Modelica 4.1.0".
        if any(name.partition(" ")[0] in words for name in inside):
            found.append(folder)
    return found


class FunctionTexts:
    """The text of functions by their qualified names, in a model's sources and in libraries."""

    def __init__(self, tree: SourceTree, libraries: Sequence[Path]) -> None:
        self._tree = specialised(tree)
        self._libraries = libraries
        self._found: dict[str, dict[str, str]] = {}
        self._members: dict[str, list[list[str]]] = {}

    def __call__(self, name: str) -> FunctionSource | None:
        # The compiler writes the name of a function of the model itself without that of the model.
        ends = [one for one in self._tree.classes if f".{one}".endswith(f".{name}")]
        if name not in self._tree.classes and len(ends) == 1:
            name = ends[0]
        if name in self._tree.classes:
            file = self._tree.classes[name].file
            text = self._of(file, self._tree.texts[file]).get(name)
            return FunctionSource(name, text) if text else None
        for library in self._libraries:
            parts = name.split(".")
            for depth in range(len(parts), 0, -1):
                place = library.joinpath(*parts[:depth])
                for file in (place.with_suffix(".mo"), place / "package.mo"):
                    if file.is_file() and (text := self._of(str(file), file.read_text()).get(name)):
                        return FunctionSource(name, text)
        return None if "." in name else self._within_models(name)

    def members(self, kind: str, file: str) -> list[list[str]]:
        """Names of the members of each enumeration that a path in a file means, by its last name.

        Args:
            file: may import the enumeration under another name.
        """
        text = self._tree.texts.get(file) or (Path(file).read_text() if Path(file).is_file() else "")
        imported = re.search(rf"\bimport\s+{re.escape(kind)}\s*=\s*([\w.]+)\s*;", text)
        kind = (imported[1] if imported else kind).rpartition(".")[2]
        if kind in self._members:
            return self._members[kind]
        pattern = re.compile(rf"\btype\s+{re.escape(kind)}\s*=\s*enumeration\s*\(")
        files = (one.read_text() for library in self._libraries for one in library.rglob("*.mo"))
        found = self._members[kind] = []
        for text in (*self._tree.texts.values(), *files):
            for match in pattern.finditer(text):
                tokens = tokenise(text[match.end() : text.index(";", match.end())], kind)
                names = [one.text for n, one in enumerate(tokens) if n == 0 or tokens[n - 1].text == ","]
                found.append(names)
        return found

    def _within_models(self, name: str) -> FunctionSource | None:
        """A function that a model of a library holds, by its own name, if that is the only one."""
        found: dict[str, str] = {}
        for file in (one for library in self._libraries for one in library.rglob("*.mo")):
            text = file.read_text()
            if re.search(rf"\bfunction\s+{re.escape(name)}\b", text):
                functions = self._of(str(file), text).items()
                found |= {one: body for one, body in functions if one.endswith(f".{name}")}
        return FunctionSource(*next(iter(found.items()))) if len(found) == 1 else None

    def _of(self, file: str, text: str) -> dict[str, str]:
        if file not in self._found:
            self._found[file] = class_texts(text, file, "function")
        return self._found[file]


def _of_user(text: str, copies: Sequence[Path], libraries: Sequence[Path]) -> str:
    """A text with the folders of libraries in place of their copies, which the user does not know."""
    for copy, library in zip(copies, libraries, strict=True):
        text = text.replace(f"{copy.as_posix()}/", f"{library.as_posix()}/")
    return text


def _short(text: str) -> str:
    """The beginning of a message."""
    return "\n".join([line for line in text.splitlines() if line.strip()][:12])
