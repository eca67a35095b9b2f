"""The Modelica compiler's DAE form, made in a process of its own with a time limit."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orchestrator.base.errors import BuildError

from ..sources import SourceTree

__all__ = ["dae_form", "library_paths"]

# The compiler has models that it never ends with.
_TIME_LIMIT = 120.0


def library_paths(given: Sequence[Path] = ()) -> tuple[Path, ...]:
    """Folders with libraries: those given, then those of MODELICAPATH.

    Raises: BuildError for a given one that is no folder.
    """
    for one in given:
        if not one.is_dir():
            raise BuildError(f"--library {one}: no such folder; give one that holds a library's folder or package.mo")
    named = [Path(one) for one in os.environ.get("MODELICAPATH", "").split(os.pathsep) if one]
    return (*given, *(one for one in named if one.is_dir()))


def dae_form(
    tree: SourceTree, model: str, libraries: Sequence[Path] = (), time_limit: float = _TIME_LIMIT
) -> dict[str, Any]:
    """Run the compiler.

    Args:
        tree: the source files.
        model: qualified name.
        libraries: folders with further libraries.
        time_limit: [s].
    Returns: the DAE form.
    Raises: BuildError if the compiler refuses the model, ends by itself or does not end.
    """
    with tree.marked_copy() as folder:
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
                f"{tree.shown(tree.main)}: the Modelica compiler did not end within {time_limit:g} s for {model}"
            ) from None
        if done.returncode:
            text = tree.restored(done.stderr.strip() or "it ended without a message")
            raise BuildError(_short(text.replace(f"{folder}/", tree.label)))
        return dict(json.loads(tree.restored(done.stdout)))


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
