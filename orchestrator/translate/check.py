"""All faults of a model at once, without building it: syntax, names, types, balance, start, units.

Each stage of the translation needs the one before, so a fault is repaired for the next try: an
undeclared name gets a declaration, any other faulty equation or value is left out.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from orchestrator.base.errors import BuildError

from .faults import Fault, faults_of, illustrated
from .pinpoint import statements
from .sources import Location, SourceTree, load_sources

_LONGEST = 1.5  # [s], after which no further try begins
_UNDECLARED = re.compile(r"`([A-Za-z_]\w*)` is declared nowhere")


@dataclass(frozen=True)
class Finding:
    """One fault: what kind of, in the terms of `stages`, and where."""

    kind: str
    fault: Fault


@dataclass(frozen=True)
class ModelCheck:
    """What a check found.

    Attributes:
        model: qualified name; "" if it is not known.
        findings: all faults, by file and line.
        unchecked: what could not be checked because of the faults.
        notes: what the author should know besides.
        tree: the source files; None if they cannot be read.
    """

    model: str
    findings: tuple[Finding, ...]
    unchecked: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    tree: SourceTree | None = None

    def text(self) -> str:
        """The faults with their lines and carets."""
        shown = []
        for one in self.findings:
            head = ", ".join(
                f"{file}:{line}:{column}" if column else f"{file}:{line}"
                for file, line, column in one.fault.places
            )
            message = "\n".join([f"{head}: {one.fault.what}" if head else one.fault.what, *one.fault.details])
            shown.append(illustrated(message, self.tree))
        return "\n".join(shown)


def check_model(model_file: Path, *, model: str | None = None, libraries: Sequence[Path] = ()) -> ModelCheck:
    """Check a model.

    Args:
        model_file, model, libraries: as for `build`.
    Returns: all that is found; a model without findings builds.
    Raises: BuildError if what a check needs is not installed.
    """
    from .build import need_casadi

    need_casadi()
    try:
        tree = load_sources(Path(model_file))
    except BuildError as error:
        return ModelCheck("", _findings("syntax", str(error)))
    checker = _Checker(tree, libraries)
    try:
        checker.run(model)
    except BuildError as error:
        checker.add("model", str(error))
    return checker.report()


def _findings(kind: str, text: str) -> tuple[Finding, ...]:
    return tuple(Finding(kind, fault) for fault in faults_of(text))


class _Checker:
    def __init__(self, tree: SourceTree, libraries: Sequence[Path]) -> None:
        self._tree = tree
        self._libraries = libraries
        self._name = ""
        self._found: dict[tuple[object, ...], Finding] = {}
        self._unchecked: list[str] = []
        self._notes: list[str] = []
        self._begun = time.monotonic()

    def add(self, kind: str, text: str) -> list[Fault]:
        """Note faults; returns those that are new."""
        new = []
        for one in _findings(kind, text):
            key = (one.fault.places[:1] or one.fault.what, one.fault.what)
            if key not in self._found:
                self._found[key] = one
                new.append(one.fault)
        return new

    def report(self) -> ModelCheck:
        findings = sorted(self._found.values(), key=lambda one: one.fault.places[:1])
        return ModelCheck(
            self._name, tuple(findings), tuple(dict.fromkeys(self._unchecked)), tuple(self._notes), self._tree
        )

    def run(self, model: str | None) -> None:
        tree = self._syntax()
        if tree is None:
            self._unchecked.append("names, types, equations and units")
            self._name = model or ""
            return
        self._name = tree.model_name(model)
        self._meaning(tree, whole=not self._left_out)

    def _more(self) -> bool:
        return time.monotonic() - self._begun < _LONGEST

    # Syntax

    def _syntax(self) -> SourceTree | None:
        """Note all mistakes of syntax; returns the tree without them, None if that cannot be had."""
        from .flatten import syntax_faults

        texts = dict(self._tree.texts)
        sound = True
        self._left_out = False
        for path, text in texts.items():
            seen: set[str] = set()
            for _ in range(30):
                reported = syntax_faults({path: text}, self._tree.shown)
                new = [one for one in reported if one not in seen]
                if not new or not self._more():
                    sound = sound and not reported
                    break
                seen |= set(new)
                self.add("syntax", "\n".join(new))
                repaired = _repaired(text, faults_of(new[0])[0])
                if repaired is None:
                    sound = False
                    break
                self._left_out |= repaired.count(";") <= text.count(";")
                text = repaired
            texts[path] = text
        return replace(self._tree, texts=texts) if sound else None

    # Meaning

    def _meaning(self, tree: SourceTree, whole: bool) -> None:
        """Note what the stages find. `whole`: whether no equation has been left out."""
        from .complaints import UNBALANCED

        while True:
            reported = list(self._stages(tree, whole))
            new = [
                (kind, fault)
                for kind, text in reported
                if whole or kind != "balance"
                for fault in self.add(kind, text)
            ]
            fatal = [fault for kind, fault in new if kind != "units"]
            if not fatal:
                break
            if not self._more():
                self._unchecked.append("what comes after these faults")
                break
            repaired = tree
            for fault in fatal:
                if UNBALANCED in fault.what:
                    continue
                repaired, left_out = _without(repaired, fault)
                whole = whole and not left_out
            if repaired.texts == tree.texts:
                break
            tree = repaired
        if not whole:
            self._unchecked.append("the number of equations and the initialisation")

    def _stages(self, tree: SourceTree, whole: bool) -> Iterator[tuple[str, str]]:
        """Kind and message of what each stage finds, up to the first that gives nothing to go on with."""
        from .build import explicit_program, in_file, other_route
        from .complaints import UNBALANCED, CompilerRefusal
        from .flat_units import unit_faults
        from .hybrid.build import counted, read, understood
        from .hybrid.front_end import flat_form, library_paths
        from .hybrid.structure import solve_order
        from .rewriting.copies import adapts, needed_rewrites

        folders = library_paths(self._libraries)
        name = self._name

        def place(span: Mapping[str, Any]) -> Location:
            return spans(span) or Location(tree.shown(tree.main), 1)

        try:
            flat, spans = flat_form(tree, name, folders, partial=not whole)
            yield "units", "\n".join(unit_faults(flat, place))
        except CompilerRefusal as refusal:
            if needed_rewrites(str(refusal)):  # the translation carries out what the compiler does not take
                try:
                    with understood(name):
                        solve_order(read(tree, name, folders, partial=not whole))
                except BuildError as error:
                    yield "model", str(error)
                    return
                self._unchecked.append("units, beside algorithm sections that the compiler does not take")
                return
            if UNBALANCED not in str(refusal):
                yield "model", str(refusal)
                return
            yield "balance", str(counted(tree, name, folders, refusal))
            flat, spans = flat_form(tree, name, folders, partial=True)
            yield "units", "\n".join(unit_faults(flat, place))
            return
        except BuildError as error:
            yield "model", str(error)
            return
        try:
            if whole:
                explicit_program(tree, name)
                return
        except BuildError as refusal:
            if not other_route(refusal, bool(folders) or adapts(tree)):
                yield "model", str(refusal)
                return
        try:
            system = read(tree, name, folders, partial=not whole)
        except BuildError as error:
            message = in_file(tree, error)
            # Without its delays a model may still be one of the explicit route.
            if whole or "delay()" not in message:
                yield "unsupported", message
            return
        if whole:
            try:
                with understood(name):
                    self._notes = list(solve_order(system).notes)
            except BuildError as error:
                yield "balance", in_file(tree, error)


def _repaired(text: str, fault: Fault) -> str | None:
    """A text with one mistake of syntax less: what is missing put in, what is too much taken out."""
    if not fault.places or not fault.places[0][2]:
        return None
    _, line, column = fault.places[0]
    lines = text.split("\n")
    if line > len(lines):
        return None
    at = sum(len(one) + 1 for one in lines[: line - 1]) + column - 1
    if "is a ; missing" in fault.what:
        before = text[:at].rstrip()
        # In place of a blank, so that no place on the line moves.
        blank = text[len(before) :].startswith(" ") and "\n" not in text[len(before) : at]
        return f"{before};{text[len(before) + blank :]}"
    # Otherwise without the statement: from the ; before to the one at or after.
    begin = max(text.rfind(";", 0, at), text.rfind("\n", 0, at)) + 1
    end = text.find(";", at)
    if end < 0:
        return None
    return (
        text[:begin] + "".join(one if one == "\n" else " " for one in text[begin : end + 1]) + text[end + 1 :]
    )


def _without(tree: SourceTree, fault: Fault) -> tuple[SourceTree, bool]:
    """The tree without a fault, and whether an equation is left out for it."""
    repaired, left_out = tree, False
    for file, line, column in fault.places:
        path = next((one for one in tree.texts if tree.shown(one) == file), "")
        if not path or not column:
            continue
        text = repaired.texts[path]
        start = sum(len(one) + 1 for one in text.split("\n")[: line - 1]) + column - 1
        if name := _UNDECLARED.match(fault.what):
            changed = _declaring(repaired, path, start, name[1])
        else:
            changed = _leaving_out(repaired, path, start)
            left_out = left_out or changed != text
        # A new tree: its classes are read again.
        repaired = replace(repaired, texts={**repaired.texts, path: changed})
    return repaired, left_out


def _declaring(tree: SourceTree, path: str, start: int, name: str) -> str:
    """The text with a declaration of a name at the end of the class that uses it."""
    text = tree.texts[path]
    for item in tree.classes.values():
        if item.file == path and item.kind != "function" and any(one.start == start for one in item.tokens):
            end = item.tokens[-1].start + len(item.tokens[-1].text)
            return f"{text[:end]} public parameter Real {name} = 1;{text[end:]}"
    return _leaving_out(tree, path, start)


def _leaving_out(tree: SourceTree, path: str, start: int) -> str:
    """The text with blanks for the equation or value at a place."""
    text = tree.texts[path]
    for item in tree.classes.values():
        for first, last in statements(item.tokens) if item.file == path else ():
            end = last.start + len(last.text)
            if first.start <= start < end:
                blank = "".join(one if one == "\n" else " " for one in text[first.start : end])
                return text[: first.start] + blank + text[end:]
    return text
