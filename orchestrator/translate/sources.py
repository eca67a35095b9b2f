"""Modelica source files: the package around a file, a marked copy for the compiler, places in them."""

from __future__ import annotations

import re
import shutil
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

from orchestrator.base.errors import BuildError, listed, nearest
from orchestrator.base.temporary_folders import scratch_folder

from .built_in import ARRAY_FUNCTIONS, BUILT_IN
from .classes import ModelicaClass, find_classes, within_clause
from .lexer import Token, tokenise

# The compiler checks the arguments of delay() and refuses a delay that is zero or varies. It sees this
# external function instead, which has as many letters, so that every offset stays what it was.
DELAY = "dE1ay"
_DELAY_DECLARATION = (
    f"function {DELAY} input Real u; input Real T; input Real Tmax = -1; output Real y;"
    f' external "C" y = {DELAY}(u, T, Tmax); end {DELAY};\n'
)
# Names of the language: a variable that differs from one of them in case only is not taken for it.
_PREDEFINED = frozenset(
    "Real Integer Boolean String StateSelect AssertionLevel Modelica Complex time start fixed "
    "nominal unit displayUnit quantity stateSelect unbounded reinit assert terminate".split()
).union(BUILT_IN, ARRAY_FUNCTIONS)
_BEFORE_DECLARED = frozenset({"]", "Real", "Integer", "Boolean", "String", "function"})


@dataclass(frozen=True)
class Location:
    """A place in a source file, printed as file:line:column; without a column where that is not known."""

    file: str
    line: int
    column: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}" + (f":{self.column}" if self.column else "")


def location(file: str, text: str, start: int) -> Location:
    """The place of a character of a file's text."""
    begins = _line_begins(text)
    line = bisect_right(begins, start)
    return Location(file, line, start - begins[line - 1] + 1)


def line_mark(line: int) -> str:
    """A comment in a text for the compiler: what follows stands in this line of the user's file."""
    return f"/*line {line}*/"


_LINE_MARK = re.compile(re.escape(line_mark(0)).replace("0", r"(\d+)"))


@lru_cache(maxsize=64)
def _line_begins(text: str) -> list[int]:
    """Offset of the first character of each line."""
    return [0, *(found.end() for found in re.finditer("\n", text))]


@lru_cache(maxsize=64)
def _bytes_of(text: str) -> bytes | None:
    """The text in UTF-8; None where every character is one byte, so that offsets agree."""
    encoded = text.encode()
    return encoded if len(encoded) > len(text) else None


@dataclass(frozen=True)
class SourceTree:
    """The Modelica files that belong to one model.

    Attributes:
        root: folder that holds the top-level package or file.
        main: path of the given file within `root`.
        texts: path within `root` -> content, sorted.
        label: what is put before a path to show it to the user.
        remarks: what was made up for, one sentence each.
    """

    root: Path
    main: str
    texts: dict[str, str]
    label: str
    remarks: tuple[str, ...] = ()

    def shown(self, path: str) -> str:
        """Path of a file as the user would write it."""
        return self.label + path

    @cached_property
    def classes(self) -> dict[str, ModelicaClass]:
        """Every class by its qualified name; their files are paths within `root`."""
        return find_classes(self.texts, self.label)

    @cached_property
    def renamed(self) -> dict[str, str]:
        """Names that differ from another one in case only, and what the compiler sees in their place.

        Modelica distinguishes case (Language Specification 2.3.1); the compiler does not where it evaluates
        ranges and dimensions.
        """
        used = {
            token.text
            for path, text in self.texts.items()
            for token in tokenise(text, self.shown(path))
            if token.kind == "name" and token.text[0] != "'"
        }
        classes = {part for name in self.classes for part in name.split(".")}
        groups: dict[str, list[str]] = {}
        for name in sorted(used - classes - _PREDEFINED):
            groups.setdefault(name.casefold(), []).append(name)
        taken, renamed = {name.casefold() for name in used}, {}
        for names in groups.values():
            for name in names[1:]:
                number = 1
                while (new := f"{name}_case{number}").casefold() in taken:
                    number += 1
                taken.add(new.casefold())
                renamed[name] = new
        return renamed

    def restored(self, text: str) -> str:
        """A text of the compiler's with the names of the source files."""
        if not self.renamed:
            return text
        names = {new: old for old, new in self.renamed.items()}
        return re.sub(rf"\b({'|'.join(names)})\b", lambda found: names[found[1]], text)

    def restore_offset(self, path: str, offset: int) -> int:
        """The byte offset in a source file of a byte offset in the file that the compiler saw."""
        shift = 0
        for start, longer in self._shifts.get(path, ()):
            if start + shift >= offset:
                break
            shift += min(longer, offset - start - shift)
        return offset - shift

    @cached_property
    def _shifts(self) -> dict[str, list[tuple[int, int]]]:
        """Per file, byte offsets of the ends of renamed names, and by how much these became longer."""
        found: dict[str, list[tuple[int, int]]] = {}
        for path, text in self.texts.items() if self.renamed else ():
            for token in tokenise(text, self.shown(path)):
                if token.text in self.renamed:
                    end = len(text[: token.start + len(token.text)].encode())
                    longer = len(self.renamed[token.text]) - len(token.text)
                    found.setdefault(path, []).append((end, longer))
        return found

    def model_name(self, model: str | None) -> str:
        """Qualified name of the model to build.

        Args:
            model: qualified name, or a name within the package or class of the file; None: the class
                that the file defines, or of several the only one that is not partial and not part of another.
        Raises: BuildError if there is no such model or the file's class is none.
        """
        within = within_clause(tokenise(self.texts[self.main], self.shown(self.main)))
        own = [item for item in self.classes.values() if item.file == self.main]
        top = [item for item in own if item.name.rpartition(".")[0] == within]
        models = [item.name for item in self.classes.values() if item.kind in ("model", "block", "class")]
        if model is not None:
            scopes = ["", *(f"{item.name}." for item in top), f"{within}."]
            for name in (scope + model for scope in scopes):
                if name in models:
                    return name
            hint = nearest(model, models)
            raise BuildError(
                f"{self.shown(self.main)}: no model {model}; models: {listed(models)}"
                + (f". {hint}" if hint else "")
            )
        if len(top) == 1 and top[0].name in models:
            return top[0].name
        if len(alone := self._unused(own)) == 1:
            return alone[0]
        what = f"{top[0].kind} {top[0].name}" if len(top) == 1 else f"{len(top)} classes"
        raise BuildError(
            f"{self.shown(self.main)}: the file defines {what}, not one model; name the model to build "
            f"with --model; models: {listed(models)}"
        )

    def _unused(self, classes: Sequence[ModelicaClass]) -> list[str]:
        """The models among classes of one file that are not partial, and that none of the others names."""
        found = []
        for item in classes:
            last = item.name.rpartition(".")[2]
            partial = re.search(rf"\bpartial\s+{item.kind}\s+{re.escape(last)}\b", self.texts[item.file])
            others = (token.text for other in classes if other is not item for token in other.tokens)
            if item.kind in ("model", "block", "class") and not partial and last not in others:
                found.append(item.name)
        return found

    def place(self, path: str, offset: int) -> Location:
        """The place at a byte offset of a file."""
        text = self.texts[path]
        encoded = _bytes_of(text)
        at = offset if encoded is None else len(encoded[:offset].decode(errors="ignore"))
        return location(self.shown(path), text, at)

    def at(self, path: str, token: Token) -> Location:
        """The place of a token of a file."""
        return location(self.shown(path), self.texts[path], token.start)

    @contextmanager
    def marked_copy(self, renamed: bool = True) -> Iterator[Path]:
        """Write the files to a temporary folder for the compiler; yields the folder.

        Every delay() and, if asked for, every name of `renamed` has another name there.

        Raises: BuildError if a file already uses the name that stands for delay().
        """
        folder = scratch_folder("modelica-").resolve()
        try:
            for path in self.texts:
                target = folder / path
                target.parent.mkdir(parents=True, exist_ok=True)
                # Bytes: text mode would turn line ends on Windows, and with them every offset.
                target.write_bytes(self.marked(path, renamed).encode())
            (folder / f"{DELAY}.mo").write_bytes(_DELAY_DECLARATION.encode())
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def delay_calls(self, path: str) -> list[Token]:
        """The tokens `delay` of a file that call the operator."""
        tokens = tokenise(self.texts[path], self.shown(path))
        calls = []
        for index, token in enumerate(tokens[:-1]):
            if token.text == DELAY:
                raise BuildError(f"{self.at(path, token)}: the name {DELAY} is reserved; choose another")
            if token.text != "delay" or tokens[index + 1].text != "(":
                continue
            before = tokens[index - 1] if index else None
            declared = before is not None and (
                before.kind == "name" or before.text in _BEFORE_DECLARED or before.text == "."
            )
            if not declared:
                calls.append(token)
        return calls

    def marked(self, path: str, renamed: bool = True) -> str:
        """A file as the compiler sees it; see `marked_copy`."""
        text = self.texts[path]
        letters = list(text)
        for token in self.delay_calls(path):
            letters[token.start : token.start + len(DELAY)] = DELAY
        for token in reversed(tokenise(text, self.shown(path)) if renamed and self.renamed else ()):
            if token.text in self.renamed:
                letters[token.start : token.start + len(token.text)] = self.renamed[token.text]
        return "".join(letters)


@dataclass(frozen=True)
class Spans:
    """Places of what the compiler counts in bytes of the files that it saw.

    Attributes:
        tree: the source files.
        files: compiler's number of a file -> its path within the tree, or its full path; its text.
        renamed: whether the compiler saw other names; see `SourceTree.marked_copy`.
        inserted: bytes put in before the class of the model.
        adapted: paths of files that the compiler saw with other texts, but the same lines.
    """

    tree: SourceTree | None = None
    files: Mapping[int, tuple[str, str]] = field(default_factory=dict)
    renamed: bool = False
    inserted: tuple[str, int, int] = ("", 0, 0)
    adapted: frozenset[str] = frozenset()

    def __call__(self, provenance: Mapping[str, Any]) -> Location | None:
        """The place of a span, or of what holds one; None if the file is not known."""
        span = provenance.get("span") or provenance
        path, text = self.files.get(span.get("source", 0), ("", ""))
        if not path or not isinstance(span.get("start"), int):
            return None
        start = span["start"]
        if path == self.inserted[0] and start > self.inserted[1]:
            start -= self.inserted[2]
        if self.tree is not None and path in self.adapted:
            seen = location(path, text, len(text.encode()[: span["start"]].decode(errors="ignore")))
            lines = self.tree.texts[path].split("\n")
            if seen.line <= len(lines):
                whole = text.split("\n")[seen.line - 1]
                marks = _LINE_MARK.findall(whole[: seen.column])
                line = int(marks[-1]) if marks else seen.line
                return Location(self.tree.shown(path), line, _same_word(lines[line - 1], whole, seen.column))
        if self.tree is not None and path in self.tree.texts:
            return self.tree.place(path, self.tree.restore_offset(path, start) if self.renamed else start)
        return location(path, text, len(text.encode()[:start].decode(errors="ignore")))

    def name(self, declaration: Mapping[str, Any], name: str) -> Location | None:
        """The place of the name in a declaration that ends with it, else that of the declaration."""
        span = declaration.get("span") or declaration
        last = re.split(r"\.(?![^\[]*\])", name)[-1]
        text = self.files.get(span.get("source", 0), ("", ""))[1]
        end = span.get("end", 0)
        if text.encode()[:end].endswith(last.encode()):
            return self({**span, "start": end - len(last.encode())})
        return self(span)


def _same_word(line: str, seen: str, column: int) -> int:
    """The column in a line of what stands at a column of the line as it was rewritten; else its first."""
    word = re.match(r"\w+|\S", seen[column - 1 :])
    places = (
        [one.start() + 1 for one in re.finditer(rf"(?<!\w){re.escape(word[0])}(?!\w)", line)] if word else []
    )
    return min(places, key=lambda one: abs(one - column), default=len(line) - len(line.lstrip()) + 1)


def load_sources(model_file: Path) -> SourceTree:
    """Read a Modelica file with the whole package it belongs to.

    Args:
        model_file: a .mo file on its own, with those beside it whose classes it names, or a part of a
            structured package (folders with package.mo). A folder without a package.mo counts as a package
            where files in it say that they are within it, or define a class of the file's name.
    Raises: BuildError if it does not exist, or its `within` clause does not match the folders.
    """
    shown = str(model_file)
    if not model_file.is_file():
        raise BuildError(f"{shown}: no such file; give the .mo file of a model")
    path = model_file.resolve()
    packages = _within(_read(path), shown)
    folder = path.parent
    if path.name == "package.mo":
        packages = [*packages, folder.name]
    for name in reversed(packages):
        if folder.name != name:
            raise BuildError(
                f"{shown}:1: the file says `within {'.'.join(packages)}`, but its folder is called "
                f"{folder.name}, not {name}; put the file into its package or drop the clause"
            )
        folder = folder.parent
    if packages:
        top = folder / packages[0]
        paths = sorted(item for item in top.rglob("*.mo") if item.is_file())
    main = PurePosixPath(path.relative_to(folder)).as_posix()
    label = shown.replace("\\", "/")
    label = label[: -len(main)] if label.endswith(main) else f"{folder.as_posix()}/"
    if not packages:
        texts, beside = _with_siblings(path, label)
        remarks = tuple(f"{label}{one} stands beside the model, and is read with it" for one in beside)
        return SourceTree(folder, main, texts, label, remarks)
    texts, remarks = _package(folder, paths, label)
    return SourceTree(folder, main, dict(sorted(texts.items())), label, remarks)


def library_texts(library: Path) -> tuple[dict[str, str], tuple[str, ...]]:
    """The files of a library's folder, or of a folder of libraries, by their path within it, and remarks.

    As of `load_sources`, a folder without a package.mo counts as a package where files belong to it.
    """
    root = library.parent if (library / "package.mo").is_file() else library
    texts, remarks = _package(root, sorted(library.rglob("*.mo")), f"{root.as_posix()}/")
    return {str((root / place).relative_to(library)): text for place, text in texts.items()}, remarks


def _with_siblings(path: Path, label: str) -> tuple[dict[str, str], list[str]]:
    """A file and those beside it, named like the class in them, whose class it or they use; their names."""
    texts = {path.name: _read(path)}
    ahead = [path.name]
    while ahead:
        name = ahead.pop()
        tokens = tokenise(texts[name], f"{label}{name}")
        for before, token, after in zip([None, *tokens], tokens, [*tokens[1:], None], strict=False):
            if token.kind != "name" or not token.text.isidentifier() or (before and before.text == "."):
                continue
            file = path.with_name(f"{token.text}.mo")
            if file.name in texts:
                continue
            named = after is not None and (after.kind == "name" or after.text in (".", "(", "["))
            if not named and (before is None or before.text != "extends"):
                continue
            known = any(token.text in find_classes({one: text}, label) for one, text in texts.items())
            if known or not file.is_file() or (text := _alone(file, token.text)) is None:
                continue
            texts[file.name] = text
            ahead.append(file.name)
    return dict(sorted(texts.items())), sorted(texts.keys() - {path.name})


def _alone(file: Path, name: str) -> str | None:
    """The text of a file that defines one class, of this name and within no package; None of another."""
    try:
        text = _read(file)
        classes = find_classes({file.name: text})
        outside = [one for one in classes if "." not in one]
        return text if outside == [name] and not within_clause(tokenise(text, file.name)) else None
    except BuildError:
        return None


def _within(text: str, shown: str) -> list[str]:
    """The names of a file's `within` clause."""
    return [name for name in within_clause(tokenise(text, shown)).split(".") if name]


def _package(root: Path, paths: Sequence[Path], label: str) -> tuple[dict[str, str], tuple[str, ...]]:
    """The files of a package by their path within `root`, and remarks.

    A folder without a package.mo gets one where its files belong to it; other files of such folders are left
    out, as other tools leave them.
    """
    texts: dict[str, str] = {}
    added: dict[str, str] = {}
    left: list[str] = []
    for item in paths:
        place = PurePosixPath(item.relative_to(root))
        folders = place.parts[:-1]
        missing = [
            depth
            for depth in range(1, len(folders) + 1)
            if not root.joinpath(*folders[:depth], "package.mo").is_file()
        ]
        text = _belonging(item, place, label) if missing else _read(item)
        if text is None:
            left.append(f"{label}{place} is left out: its folder has no package.mo and it is no class of it")
            continue
        texts[str(place)] = text
        for depth in missing:
            *outer, name = _packages(place)[:depth]
            content = f"within {'.'.join(outer)};\npackage {name}\nend {name};\n"
            added["/".join((*folders[:depth], "package.mo"))] = content
    remarks = [
        f"{label}{place.rpartition('/')[0]}/ has no package.mo and is read as a package" for place in added
    ]
    return texts | added, (*remarks, *left)


def _packages(place: PurePosixPath) -> tuple[str, ...]:
    """The packages that the folders of a file are; a folder may carry a version, as "Modelica 4.1.0"."""
    return tuple(one.partition(" ")[0] for one in place.parts[:-1])


def _belonging(path: Path, place: PurePosixPath, label: str) -> str | None:
    """The text of a file that belongs to its folder, with its `within` clause; None if it does not.

    It does by its clause or, without one, by a class of the file's name.
    """
    packages, name = _packages(place), place.stem
    if place.name == "package.mo":
        packages, name = packages[:-1], packages[-1]
    try:
        text = _read(path)
        tokens = tokenise(text, f"{label}{place}")
        if tokens and tokens[0].text == "within":
            return text if within_clause(tokens) == ".".join(packages) else None
        return (
            f"within {'.'.join(packages)}; {text}"
            if name in find_classes({str(place): text}, label)
            else None
        )
    except BuildError:
        return None  # such as a translation of gettext, whose files are called .mo too


def _read(path: Path) -> str:
    try:
        # A backslash that begins no escape sequence, as in paths of Windows, stands for itself.
        return re.sub(
            r"\\(['\"?\\abfnrtv]?)", lambda one: one[0] if one[1] else r"\\", path.read_bytes().decode()
        )
    except UnicodeDecodeError as error:
        raise BuildError(
            f"{path}: byte {error.start} is not UTF-8, the encoding of Modelica files"
        ) from error
