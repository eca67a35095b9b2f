"""Flatten a Modelica model with rumoca: its flat representation, or its refusal with the lines concerned."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path
from typing import Any

from orchestrator.base.errors import BuildError

from .compiler import compile_model
from .complaints import CompilerRefusal, explained
from .expressions import Json
from .lexer import Token, tokenise
from .sizes import refuse_large_sizes
from .sources import DELAY, SourceTree

# The representation carries no version, so its reader knows one release of the compiler.
RUMOCA_VERSION = "0.10.2"

_OFFSET = re.compile(r"start: BytePos\((\d+)\)")
# Of a mistake as the compiler shows it: what it is, and line and column.
_WHAT, _WHERE = re.compile("\u00d7 (.*)"), re.compile(r"\[[^\]\n]*:(\d+:\d+)\]")
# Keywords that may stand between a name and a sign, where a ; is missing before them or not.
_AFTER_NAMES = frozenset(
    "and annotation break connect constrainedby der else elseif elsewhen external extends for if in loop not "
    "or return then when while".split()
)
_DETAIL = re.compile(r'detail: "([^"]*)"')


def flatten(tree: SourceTree, model: str) -> tuple[Json, dict[int, str]]:
    """Run the compiler.

    Args:
        tree: the source files.
        model: qualified name.
    Returns: the flat representation, and the path of each source file by the compiler's number.
    Raises: BuildError if the compiler is missing, has another version or refuses the model.
    """
    try:
        installed = version("rumoca")
    except PackageNotFoundError:
        raise BuildError(
            f"Modelica compiler: rumoca is not installed; run `pip install rumoca=={RUMOCA_VERSION}`"
        ) from None
    if installed != RUMOCA_VERSION:
        raise BuildError(
            f"Modelica compiler: rumoca {installed} is installed, its representation is known for "
            f"{RUMOCA_VERSION} only; run `pip install rumoca=={RUMOCA_VERSION}`"
        )
    refuse_large_sizes(tree, model)
    with tree.marked_copy() as folder:
        answer = compile_model(tree, model, folder, ("flat", "dae"), restored=tree.restored)
        if answer.refusal:
            if wrong := syntax_faults(tree.texts, tree.shown):
                raise BuildError("\n".join(wrong))
            text = answer.refusal.replace(f"{folder.as_posix()}/", tree.label).replace(DELAY, "delay")
            if answer.panic:
                text = _panic_text(tree, model, answer.refusal)
            raise CompilerRefusal(explained(tree, model, text, lambda other: message_of(other, model)))
        flat, files = answer.forms["flat"], answer.forms["dae"]["source_map"]["files"]
        prefix = f"{folder.as_posix()}/"
        paths = {number: path.replace("\\", "/").removeprefix(prefix) for number, path, _ in files}
        if tree.renamed:
            _restore_offsets(flat, paths, tree)
        return flat, paths


def called_partial(tree: SourceTree, model: str, folder: Path) -> tuple[str, int, int]:
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


def message_of(tree: SourceTree, model: str, partial: bool = False) -> str:
    """What the compiler says about a model, called partial or not; "" if it takes it."""
    with tree.marked_copy() as folder:
        if partial:
            called_partial(tree, model, folder)
        return compile_model(tree, model, folder, ("dae",)).refusal.replace(folder.as_posix(), "")


def _restore_offsets(json: Any, paths: dict[int, str], tree: SourceTree) -> None:
    """Have all spans of a representation count in the source files, not in those that the compiler saw."""
    if isinstance(json, dict):
        path = paths.get(json.get("source"), "") if isinstance(json.get("source"), int) else ""
        for key, value in json.items():
            if path and key in ("start", "end") and isinstance(value, int):
                json[key] = tree.restore_offset(path, value)
            else:
                _restore_offsets(value, paths, tree)
    elif isinstance(json, list):
        for item in json:
            _restore_offsets(item, paths, tree)


def syntax_faults(texts: Mapping[str, str], shown: Callable[[str], str]) -> list[str]:
    """The first mistake of syntax in each file; of a folder the compiler only says that there is one.

    Args:
        texts: content of each file.
        shown: the path of a file as the user would write it.
    """
    import rumoca

    found = []
    for path, text in texts.items():
        for one in rumoca.validate_source(text):
            first = one.message.strip().split("EP001")[1:2] if one.rule == "syntax-error" else []
            what, where = (sought.search("".join(first)) for sought in (_WHAT, _WHERE))
            if what and where:
                if named := _keywords_as_names(text, shown(path)):
                    found += named
                    continue
                line, column = map(int, where[1].split(":"))
                if meaning := _meant(text, line, column, first[0]):
                    found.append(f"{shown(path)}:{where[1]}: {meaning}")
                    continue
                if twice := re.match(r"parse error: Duplicate declaration of '(\w+)'", what[1].strip()):
                    found.append(
                        f"{shown(path)}:{where[1]}: `{twice[1]}` is declared a second time; give it "
                        "another name"
                    )
                    continue
                missing = "; is a ; missing before it?" if " ;," in first[0] else ""
                found.append(f"{shown(path)}:{where[1]}: {what[1].strip()}{missing}")
    return found


def _meant(text: str, line: int, column: int, message: str) -> str:
    """What frequent mistakes of syntax mean; "" for others."""
    tokens = tokenise(text, "")
    start = sum(len(one) + 1 for one in text.split("\n")[: line - 1]) + column - 1
    at = next((n for n, one in enumerate(tokens) if one.start >= start), len(tokens) - 1)
    here, then = tokens[at].text, tokens[at + 1].text if at + 1 < len(tokens) else ""
    if then == ":=" or here == ":=":
        return "`:=` assigns in algorithms and functions; write = in an equation"
    if "Modelica only allows functional call statement" in message and "Eq {" in message:
        return "`==` compares; write = in an equation"
    if re.search(r"expected one of: else, elseif\s*$", message.partition("EP001")[0].strip()):
        return "an if-expression needs a value for all other cases; add else"
    if here == "end" and then not in _STATEMENTS and (left := _open_statement(tokens[:at])):
        return f"the `{left.text}` of line {left.line} is not closed; put `end {left.text};` behind it"
    if here == "." and at and tokens[at - 1].text == ")":
        return "a member of what a function returns is not supported; give the result a name, as R r = f(x)"
    if here in ("elsewhen", "else", "elseif") and "reserved keyword" in message:
        return f"`{here}` stands in no if or when; put one before it"
    return ""


_STATEMENTS = ("if", "for", "when", "while")


def _open_statement(tokens: Sequence[Token]) -> Token | None:
    """The last if, for, when or while that begins a statement and has no end yet."""
    left: list[Token] = []
    for before, token in pairwise(tokens):
        begins = before.text in (";", "equation", "algorithm", "loop")
        if token.text in _STATEMENTS and before.text == "end":
            del left[-1:]
        elif token.text in _STATEMENTS and begins:
            left.append(token)
    return left[-1] if left else None


def _keywords_as_names(text: str, shown: str) -> list[str]:
    """Variables called by a keyword, as in `Real flow;`: the compiler says about what stands beside them."""
    tokens = tokenise(text, shown)
    found = []
    for kind, name, then in zip(tokens, tokens[1:], tokens[2:], strict=False):
        declared = kind.kind == "name" and (then.kind == "string" or then.text in ("=", ";", ",", "(", "["))
        if declared and name.kind == "keyword" and name.text not in _AFTER_NAMES:
            column = name.start - text.rfind("\n", 0, name.start)
            what = f"`{name.text}` is a keyword of Modelica and can name no variable; take another name"
            found.append(f"{shown}:{name.line}:{column}: {what}")
    return found


def _panic_text(tree: SourceTree, model: str, text: str) -> str:
    detail, offset = _DETAIL.search(text), _OFFSET.search(text)
    what = detail[1] if detail else text
    path = tree.classes[model].file
    at = tree.restore_offset(path, int(offset[1])) if offset else -1
    if 0 <= at < len(tree.texts[path].encode()):
        return f"{tree.place(path, at)}: {what}"
    return what
