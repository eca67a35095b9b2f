"""The Modelica compiler's DAE form, made in a process of its own with a time limit."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orchestrator.base.errors import BuildError

from ..complaints import CompilerRefusal, explained
from ..sources import SourceTree, Spans

__all__ = ["dae_form", "library_paths", "modernised"]

# The compiler has models that it never ends with.
_TIME_LIMIT = 120.0


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
    time_limit: float = _TIME_LIMIT,
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
    libraries = _used(tree, libraries)
    # Names of a library cannot be changed, so those of the model stay as well.
    with tree.marked_copy(renamed=not libraries) as folder:
        restored = tree.restored if not libraries else str
        if libraries:
            modernised(folder)
        inserted = _called_partial(tree, model, folder) if partial else ("", 0, 0)
        asked = {
            "roots": [str(folder), *(str(one.resolve()) for one in libraries)],
            "file": str(folder / tree.main),
            "model": model,
        }
        try:
            done = subprocess.run(
                [sys.executable, "-m", "orchestrator.translate.hybrid.front_end"],
                input=json.dumps(asked),
                capture_output=True,
                text=True,
                timeout=time_limit,
            )
        except subprocess.TimeoutExpired:
            raise BuildError(
                f"{tree.shown(tree.main)}: the Modelica compiler did not end within {time_limit:g} s "
                f"for {model}"
            ) from None
        if done.returncode:
            text = restored(done.stderr.strip() or "it ended without a message")
            raise CompilerRefusal(explained(tree, model, _short(text.replace(f"{folder}/", tree.label))))
        document = dict(json.loads(restored(done.stdout)))
        prefix = f"{folder.as_posix()}/"
        files = {
            number: (path.replace("\\", "/").removeprefix(prefix), text)
            for number, path, text in document.get("source_map", {}).get("files", ())
        }
        document["spans"] = Spans(tree, files, renamed=not libraries, inserted=inserted)
        return document


def _called_partial(tree: SourceTree, model: str, folder: Path) -> tuple[str, int, int]:
    """Put `partial` before a model's keyword; returns the file, the byte before it, and its length."""
    item = tree.classes[model]
    path = folder / item.file
    text = path.read_text(encoding="utf-8")
    name = model.rpartition(".")[2]
    lines = text.split("\n")
    begin = len("\n".join(lines[: item.line - 1])) + (item.line > 1)
    found = re.compile(rf"\b{item.kind}\s+{re.escape(name)}\b").search(text, begin)
    if found is None or text[:begin].rstrip().endswith("partial"):
        return "", 0, 0
    path.write_text(f"{text[: found.start()]}partial {text[found.start() :]}", encoding="utf-8")
    return item.file, len(text[: found.start()].encode()), len("partial ")


def _used(tree: SourceTree, libraries: Sequence[Path]) -> list[Path]:
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


def modernised(folder: Path) -> None:
    """Name the units of version 3 of the Modelica Standard Library as version 4 does.

    As its own conversion script ConvertModelica_from_3.2.3_to_4.0.0 does.
    """
    for path in folder.rglob("*.mo"):
        text = path.read_text()
        if "Modelica.SIunits" in text:
            text = re.sub(r"\bimport\s+Modelica\.SIunits\s*;", "import SIunits = Modelica.Units.SI;", text)
            text = text.replace("Modelica.SIunits.Conversions", "Modelica.Units.Conversions")
            path.write_text(text.replace("Modelica.SIunits", "Modelica.Units.SI"))


def _short(text: str) -> str:
    """A message of the compiler without the trace of a panic."""
    lines = [line for line in text.splitlines() if line.strip()]
    panics = [line for line in lines if "panicked at" in line]
    return "\n".join(panics[:1] + lines[-1:] if panics else lines[:12])


def _main() -> int:
    import rumoca

    asked = json.loads(sys.stdin.read())
    try:
        compiled = rumoca.Session(roots=asked["roots"]).load(asked["file"], model=asked["model"])
        sys.stdout.write(compiled.to_json("dae"))
    except rumoca.RumocaError as error:
        print(str(error), file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_main())
