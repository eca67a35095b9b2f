"""Python models that share code: modules of the folder shared/ beside the models' folders.

A model says `from shared.arm import Geometry`, at the top level and by plain names. Its FMU holds one file,
since FMUs of one process share Python's table of modules and two of them could bring unlike versions of one
shared module: the text of the modules it uses is put before its own.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

from orchestrator.base.errors import BuildError

_FOLDER = "shared"


@dataclass(frozen=True)
class Piece:
    """One source file of a model.

    Attributes:
        path: of the file.
        label: its name in messages: model.py, shared/arm.py.
        text: of the file, the imports of shared modules blanked; the line numbers are the file's.
    """

    path: Path
    label: str
    text: str


def pieces(script: Path) -> list[Piece]:
    """The shared modules that a model uses, each after those that it uses itself, and the model.

    Raises: BuildError for a file that cannot be read, is not Python, or imports shared code in another way
        than `from shared.NAME import a, b`.
    """
    found: dict[Path, Piece] = {}
    _collect(script, script.name, script.resolve().parents[1] / _FOLDER, found, ())
    return list(found.values())


def assembled(script: Path) -> str:
    """The model as one file; a model that shares nothing as it is. Raises: BuildError as `pieces`."""
    found = pieces(script)
    if len(found) == 1:
        return found[0].text
    parts = ["from __future__ import annotations\n"]
    for piece in found:
        future = [node for node in ast.parse(piece.text).body if _is_future(node)]
        parts.append(f"\n# --- {piece.label}\n\n{_blanked(piece.text, future).strip()}\n\n")
    return "".join(parts)


def _collect(path: Path, label: str, folder: Path, found: dict[Path, Piece], outer: tuple[Path, ...]) -> None:
    try:
        text = path.read_bytes().replace(b"\r\n", b"\n").decode("utf-8")
        tree = ast.parse(text)
    except OSError as error:
        raise BuildError(f"{path}: cannot be read: {error.strerror}") from error
    except (SyntaxError, UnicodeDecodeError) as error:
        raise BuildError(f"{label}: cannot be loaded: {type(error).__name__}: {error}") from error
    imports = [node for node in tree.body if _shared_name(node)]
    for node in ast.walk(tree):
        plain = isinstance(node, ast.Import) and any(one.name.split(".")[0] == _FOLDER for one in node.names)
        wrong = node not in imports and _shared_name(node)
        renamed = node in imports and any(one.asname or one.name == "*" for one in node.names)
        if plain or wrong or renamed:
            raise BuildError(
                f"{label}:{node.lineno}: shared code is imported at the top level and by plain names only: "
                f"from {_FOLDER}.NAME import a, b"
            )
    for node in imports:
        name = _shared_name(node)
        inner = folder / f"{name}.py"
        if inner in outer:
            raise BuildError(f"{label}:{node.lineno}: {_FOLDER}/{name}.py imports this file in turn")
        if inner not in found:
            _collect(inner, f"{_FOLDER}/{name}.py", folder, found, (*outer, inner))
    found[path] = Piece(path, label, _blanked(text, imports))


def _shared_name(node: ast.AST) -> str:
    """NAME of `from shared.NAME import ...`; "" for any other node."""
    if not isinstance(node, ast.ImportFrom) or node.level or not node.module:
        return ""
    first, _, rest = node.module.partition(".")
    return rest if first == _FOLDER else ""


def _is_future(node: ast.AST) -> bool:
    return isinstance(node, ast.ImportFrom) and node.module == "__future__"


def _blanked(text: str, nodes: list[ast.stmt]) -> str:
    """The text with the statements' lines emptied, so that all others keep their numbers."""
    if not nodes:
        return text
    lines = text.split("\n")
    for node in nodes:
        for number in range(node.lineno, (node.end_lineno or node.lineno) + 1):
            lines[number - 1] = ""
    return "\n".join(lines)
