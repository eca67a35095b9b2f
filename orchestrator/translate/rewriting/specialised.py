"""Redeclarations carried out in the sources: a class of its own for each set of them.

rumoca 0.10.2 takes some classes for others, silently. Of two levels of redeclarations it keeps the inner one.
It mixes up packages of components, constants of packages with a common base, and functions of equal names. It
forgets modifiers of a redeclared class, and those of a base beside those of a class that extends it.

Here `S s(redeclare B part(k = 2))` becomes `S_adapted1 s(part(k = 2))`, where `S_adapted1` is a copy of S
whose `part` is a B. What concerns elements that classes of libraries declare stays.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from orchestrator.base.errors import BuildError, listed

from ..lexer import Token, closing, tokenise
from ..sources import SourceTree, line_mark, location
from .declared_classes import (
    COPIED,
    KINDS,
    PREFIXES,
    Changes,
    ClassPart,
    DeclaredClass,
    DeclaredClasses,
    Replacement,
)
from .modifiers import Modifiers, arguments, complete, modifiers_of, written
from .overloaded import overloads, with_calls
from .source_edits import edited, on_one_line, path_end, path_of, text_end, words_of
from .typed_classes import BUILT_IN_TYPES, is_overloading
from .whole_paths import WholePaths

_NAMED = re.compile(r"\b(function|package|outer)\b|\bconnect\s*\([^;]*\]\s*[,)]")
_LARGEST = 3_000_000  # characters of a library; the Modelica Standard Library has more
_CONCERNED = re.compile(r"\b(package|record|redeclare)\b|\bextends\s+[\w.]+\s*\(|=\s*[\w.]+\s*\(\s*\w+\s*\(")


@lru_cache(maxsize=8)
def _texts(
    items: tuple[tuple[str, str], ...],
    label: str,
    model: str,
    libraries: tuple[Path, ...],
    copied: bool = True,
) -> dict[str, str]:
    texts = dict(items)
    if overloads(texts, libraries):
        texts = with_calls(texts, label, libraries, model)
    if any(_CONCERNED.search(text) for text in texts.values()):
        texts = SpecialisedClasses(texts, label, libraries, copied).specialised_texts()
    if any(_NAMED.search(text) for text in texts.values()):
        texts = WholePaths(texts, label, libraries, copied).with_whole_paths(model)
    return texts


def specialised(tree: SourceTree, model: str = "", libraries: Sequence[Path] = ()) -> SourceTree:
    """The sources without redeclarations of elements of their own classes; lines stay where they are.

    Args:
        model: qualified name of what is built.
        libraries: folders with those that the sources use.
    Raises: BuildError for text that is no Modelica.
    """
    return replace(tree, texts=_texts(tuple(tree.texts.items()), tree.label, model, tuple(libraries)))


def specialised_library(texts: dict[str, str], label: str, library: Path) -> dict[str, str]:
    """As `specialised`, for the files of a library; of a large one only operators: the rest takes minutes."""
    if sum(map(len, texts.values())) > _LARGEST:
        return with_calls(texts, label, ()) if overloads(texts, ()) else texts
    # Its packages stay what constraining types of its classes name.
    return _texts(tuple(texts.items()), label, "", (library,), False)


class SpecialisedClasses(DeclaredClasses):
    """Sources whose redeclared elements become copies of their classes."""

    def specialised_texts(self) -> dict[str, str]:
        """The texts by file, with the copies beside their classes."""
        edits: dict[str, list[tuple[int, int, str]]] = {}
        for one in self._top:
            edits.setdefault(one.file, []).extend(self._edits(one, {}))
        # Copies are made while classes are written, so that only now all are known.
        for one in self._classes.values():
            if one.file in self._texts and (one.beside or one.within):
                for where, texts in ((one.end, one.beside), (one.body - 1, one.within)):
                    token = one.tokens[where]
                    place = text_end(token)
                    if texts:
                        line = token.line + token.text.count("\n")
                        edits[one.file].append((place, place, f" {' '.join(texts)} {line_mark(line)}"))
        return {file: edited(text, edits.get(file, ())) for file, text in self._texts.items()}

    def _redeclarations(self, one: DeclaredClass, opening: int, changes: Changes) -> Changes:
        """The redeclarations in a bracket of modifiers, in the scope of a class with changes."""
        found: Changes = {}
        tokens = one.tokens
        for first, last in arguments(tokens, opening) if opening >= 0 else ():
            at = first
            while tokens[at].text in PREFIXES:
                at += 1
            words = {token.text for token in tokens[first:at]}
            if "redeclare" in words:
                new = self._redeclared(one, at, last, words, changes)
                if new is not None:
                    found[new[0]] = new[1]
                continue
            behind = path_end(tokens, at)
            if one.kind == "package" and self._copied and behind == at + 1 and tokens[behind].text == "=":
                # Of packages with a common base the compiler would take the constants of one for all.
                value = self._with_whole_paths(tokens[behind : last + 1], one)
                found[tokens[at].text] = Replacement(value, "value")
            if behind > at and tokens[behind].text == "(":
                inner = self._redeclarations(one, behind, changes)
                for name in reversed(path_of(tokens, at, behind)) if inner else ():
                    inner = {name: Replacement("", "", tuple(inner.items()))}
                found = _merged(found, inner)
        return found

    def _redeclared(
        self, one: DeclaredClass, at: int, last: int, words: set[str], changes: Changes
    ) -> tuple[str, Replacement] | None:
        """A redeclaration by its name; None if it stays."""
        tokens = one.tokens
        if tokens[at].text in KINDS:
            if tokens[at + 2].text != "=":
                return None
            behind = path_end(tokens, at + 3)
            path = self._absolute_path(one, (at + 3, behind), changes)
            if path is None or tokens[behind].text == "[":
                return None
            if tokens[behind].text == "(":
                path = self._wrapped(one, tokens[at].text, path, behind, changes)
            return tokens[at + 1].text, Replacement(path, tokens[at].text)
        behind = path_end(tokens, at)
        path = self._absolute_path(one, (at, behind), changes)
        if path is None or tokens[behind].kind != "name" or words & {"inner", "outer", "flow", "stream"}:
            return None
        opening = closing(tokens, behind + 1) + 1 if tokens[behind + 1].text == "[" else behind + 1
        inner = self._redeclarations(one, opening if tokens[opening].text == "(" else -1, changes)
        return tokens[behind].text, Replacement(path, "component", tuple(inner.items()))

    def _absolute_path(self, one: DeclaredClass, place: tuple[int, int], changes: Changes) -> str | None:
        """A path that means the same in every class; None if there is none."""
        path = path_of(one.tokens, *place)
        found = self._resolved(path, one.name, changes)
        # What another class of the same name by default stands for: `redeclare package P = P`.
        while (
            found is not None and found.short is not None and found.short.opening < 0 and found.kind != "type"
        ):
            after = self._aliased(found)
            if after is None or after is found or self._is_foreign(found):
                break
            found = after
        if found is not None:
            return f".{found.name}"
        if path[0] in BUILT_IN_TYPES:
            return path[0]
        return f".{'.'.join(path)}" if path[0] == "Modelica" else None

    def _wrapped(self, one: DeclaredClass, kind: str, path: str, opening: int, changes: Changes) -> str:
        """A class that extends another with modifiers, within the class where these stand."""
        base = self._absolute(path)
        wanted = self._applicable(base, self._redeclarations(one, opening, changes))
        text = self._remaining_modifiers(one, opening, wanted, {}, changes)
        path = self._copy(base, wanted) if base is not None and wanted else path
        return self._extended_class(one, kind, path, text, one.tokens[opening].line)

    def _extended_class(self, one: DeclaredClass, kind: str, path: str, text: str, number: int) -> str:
        """The path of a class, in another or beside it, that extends one with modifiers of a line."""
        name = f"{path.rpartition('.')[2]}{COPIED}{len(self._copies) + 1}"
        inside = one.short is None and one.kind != "record"
        scope, host = (one.name, one.within) if inside else (one.name.rpartition(".")[0], one.beside)
        key = (f"{scope} {path}", f"{kind} {text}")
        if key not in self._copies:
            self._copies[key] = f".{scope}.{name}" if scope else f".{name}"
            path = self._named(path, one)
            body = f"= {path}{text};" if kind == "type" else f"extends {path}{text}; end {name};"
            written = f"{kind} {name} {body}"
            host.append(f"{line_mark(number)} {written}")
            self._read(written, "", tokenise(written, name), scope)[0].beside = host
        return self._copies[key]

    def _applicable(self, one: DeclaredClass | None, wanted: Changes) -> Changes:
        """Those changes that concern replaceable elements of a class's own sources."""
        found: Changes = {}
        for name, new in wanted.items() if one is not None and not self._is_foreign(one) else ():
            assert one is not None
            declared = self._declared(one, name)
            if declared is None or self._is_foreign(declared[0]):
                continue
            owner, part = declared
            if new.path and (part.owner is None) == (new.kind in KINDS):
                continue
            if new.kind == "value":
                found[name] = new
            elif new.path:
                if not part.prefixes & {"replaceable", "redeclare"}:
                    continue
                target = self._absolute(new.path)
                inner = self._applicable(target, dict(new.inner))
                found[name] = replace(new, inner=tuple(inner.items()))
            elif part.owner is None:
                target = self._resolved(path_of(owner.tokens, *part.path), owner.name, {})
                if inner := self._applicable(target, dict(new.inner)):
                    found[name] = replace(new, inner=tuple(inner.items()))
        return found

    def _copy(self, one: DeclaredClass, changes: Changes) -> str:
        """The path of a copy of a class with changes."""
        key = one.name, repr(sorted(changes.items(), key=lambda item: item[0]))
        if key not in self._copies:
            name = f"{one.tokens[one.label].text}{COPIED}{len(self._copies) + 1}"
            scope = one.name.rpartition(".")[0]
            self._copies[key] = f".{scope}.{name}" if scope else f".{name}"
            self._refuse_inner(one, changes)
            edits = list(self._edits(one, changes))
            start, end = one.tokens[one.first].start, one.tokens[one.end].start + 1
            head = list(_renamed(one, name, one.first))
            shifted = [(a - start, b - start, text) for a, b, text in (*edits, *head)]
            lines = one.tokens[one.first].line
            one.beside.append(on_one_line(edited(one.text[start:end], shifted, marked=lines)))
        return self._copies[key]

    def _refuse_inner(self, one: DeclaredClass, changes: Changes) -> None:
        for part in one.parts if any(new.kind in KINDS for new in changes.values()) else ():
            inner = part.owner if part.kind == "class class" else None
            words = inner.tokens[inner.first : inner.end] if inner is not None and inner.parts else ()
            if token := next((token for token in words if token.text == "redeclare"), None):
                raise BuildError(
                    f"{location(self._label + one.file, one.text, token.start)}: a redeclaration in a class "
                    f"within {one.name}, of which {listed(sorted(changes))} is redeclared itself, is not "
                    "supported; put the inner class beside the outer one"
                )

    def _edits(self, one: DeclaredClass, changes: Changes) -> Iterator[tuple[int, int, str]]:
        """What changes in the text of a class."""
        if one.short is not None:
            yield from self._base_edits(one, one.short, changes, {})
            return
        own, texts = self._body_redeclarations(one, changes)
        for part in one.parts:
            names = {one.tokens[at].text for at, _ in part.names}
            if part.owner is not None:
                names = {one.tokens[part.owner.label].text}
            if "redeclare" in part.prefixes and names and names <= own.keys():
                name = own[min(names)].path.rpartition(".")[2]
                if part.owner is not None and part.owner.short is None:
                    yield from self._edits(part.owner, {})
                    yield from _renamed(part.owner, name, part.first)
                else:
                    yield one.tokens[part.first].start, one.tokens[part.end].start + 1, ""
            elif part.kind == "extends":
                yield from self._base_edits(one, part, changes, own, texts)
            elif part.kind == "components":
                yield from self._component_edits(one, part, changes)
            elif part.owner is not None:
                label = one.tokens[part.owner.label].text
                first, end = one.tokens[part.first].start, one.tokens[part.end].start
                if part.kind == "class class" and label in changes and changes[label].path:
                    # Its default is not needed any more; what replaces it cannot be replaced again.
                    path = self._named(changes[label].path, one)
                    yield first, end, f"{part.owner.kind} {label} = {path}"
                else:
                    yield from self._edits(part.owner, {})

    def _body_redeclarations(self, one: DeclaredClass, changes: Changes) -> tuple[Changes, dict[str, str]]:
        """Elements that a class redeclares of its bases in its body, and the modifiers of those."""
        found: Changes = {}
        texts: dict[str, str] = {}
        for part in one.parts:
            if "redeclare" not in part.prefixes or len(part.names) > 1:
                continue
            at = part.first
            while one.tokens[at].text in PREFIXES:
                at += 1
            new = self._redeclared(one, at, part.end, set(part.prefixes), changes)
            if (
                part.kind == "class class"
                and part.owner is not None
                and part.owner.parts
                and one.kind != "package"
            ):
                # Written under another name, as the base gets one of its own.
                label = one.tokens[part.owner.label].text
                path = f"{one.name}.{label}{COPIED}"
                self._classes[path] = part.owner
                new = label, Replacement(f".{path}", part.owner.kind)
            if new is None:
                continue
            name = new[0]
            if any(
                base and self._applicable(base[1], {name: new[1]}) for base in self._bases_of(one, changes)
            ):
                found[name] = new[1]
                if part.names and name not in changes:
                    at, opening = part.names[0]
                    wanted = self._applicable(self._absolute(new[1].path), dict(new[1].inner))
                    behind = closing(one.tokens, opening) + 1 if opening >= 0 else at + 1
                    value = " ".join(
                        token.text for token in one.tokens[behind : part.end] if token.kind != "string"
                    )
                    brackets = (
                        self._remaining_modifiers(one, opening, wanted, {}, changes) if opening >= 0 else ""
                    )
                    if brackets or value.startswith("="):
                        texts[name] = f"{name}{brackets} {value if value.startswith('=') else ''}"
        return found, texts

    def _base_edits(
        self,
        one: DeclaredClass,
        part: ClassPart,
        changes: Changes,
        own: Changes,
        texts: dict[str, str] | None = None,
    ) -> Iterator[tuple[int, int, str]]:
        """What changes of an extends clause, or of a definition by `=`."""
        tokens = one.tokens
        base = next((found[1] for found in self._bases_of(one, changes) if found and found[0] is part), None)
        wanted = self._applicable(base, _merged(self._redeclarations(one, part.opening, changes), own))
        mine = {name for name in changes if one.short is None and self._is_own(one, name)}
        outer = {name: new for name, new in changes.items() if name not in mine or name in own}
        outer = self._applicable(base, outer)
        all_of = _merged(wanted, outer)
        begin, end = part.path
        if base is not None and all_of:
            path = self._named(self._copy(base, all_of), one)
            yield tokens[begin].start, text_end(tokens[end - 1]), path
        added = [text for name, text in (texts or {}).items() if name in wanted]
        if part.opening >= 0:
            last = closing(tokens, part.opening)
            text = self._completed(
                self._remaining_modifiers(one, part.opening, wanted, outer, changes, added), base
            )
            if _words_alone(text) != _words_alone(words_of(tokens[part.opening : last + 1])):
                yield tokens[part.opening].start, text_end(tokens[last]), text
        elif added:
            place = text_end(tokens[end - 1])
            yield place, place, f"({', '.join(added)})"

    def _completed(self, text: str, base: DeclaredClass | None) -> str:
        """Modifiers of a base, with those of its own within them, which the compiler would forget."""
        if base is None or text.count("(") < 3:
            return text
        tokens = (*tokenise(text, base.name), Token("sign", ";", len(text), 0))
        given = modifiers_of(tokens, 0, words_of)
        more = False
        for name, one in given.inner.items():
            known = self._declared_modifiers(base, name) if one.inner and name != one.value else Modifiers()
            for inner, two in one.inner.items():
                if two.inner and inner in known.inner:
                    more |= complete(two, known.inner[inner])
        return written(given) if more else text

    def _declared_modifiers(self, one: DeclaredClass, name: str, depth: int = 0) -> Modifiers:
        """The modifiers of an element in a class and its bases, with paths that derived classes find."""
        found = Modifiers()

        def with_whole_paths(tokens: Sequence[Token]) -> str:
            return self._with_whole_paths(tokens, one)

        for part in one.parts:
            for at, opening in part.names:
                if one.tokens[at].text == name:
                    return modifiers_of(one.tokens, opening, with_whole_paths) if opening >= 0 else found
        for base in self._bases_of(one, {}) if depth < 50 else ():
            if base is not None and self._declared(base[1], name):
                opening = base[0].opening
                if opening >= 0:
                    found = modifiers_of(one.tokens, opening, with_whole_paths).inner.get(name, found)
                complete(found, self._declared_modifiers(base[1], name, depth + 1))
        return found

    def _with_whole_paths(self, tokens: Sequence[Token], one: DeclaredClass) -> str:
        """The text of a value, in which classes and constants around a class have their whole paths."""
        texts = []
        for at, token in enumerate(tokens):
            text = token.text
            after = tokens[at + 1].text if at + 1 < len(tokens) else ""
            if token.kind == "name" and tokens[at - 1].text != "." and after != "=":
                scope = one.name
                while scope and self._declares_component(scope, text) is False:
                    scope = scope.rpartition(".")[0]
                found = self._found(one, text)
                if scope and scope != one.name:
                    text = f".{scope}.{text}"
                elif not scope and found is not None:
                    text = f".{found.name}"
            texts.append(text)
        return " ".join(texts)

    def _declares_component(self, scope: str, name: str) -> bool:
        one = self._get(scope)
        found = self._declared(one, name) if one is not None else None
        return found is not None and found[1].owner is None

    def _is_own(self, one: DeclaredClass, name: str) -> bool:
        return any(
            name in {one.tokens[at].text for at, _ in part.names}
            or (part.owner is not None and one.tokens[part.owner.label].text == name)
            for part in one.parts
            if "redeclare" not in part.prefixes
        )

    def _component_edits(
        self, one: DeclaredClass, part: ClassPart, changes: Changes
    ) -> Iterator[tuple[int, int, str]]:
        tokens = one.tokens
        original = self._resolved(path_of(tokens, *part.path), one.name, changes)
        clauses: list[tuple[str, str]] = []
        same = True
        dimensions = words_of(tokens[part.path[1] : part.names[0][0]])
        for number, (at, opening) in enumerate(part.names):
            new = changes.get(tokens[at].text)
            target, path = original, ""
            used, opened = opening, opening
            if new is not None and new.kind == "component":
                target, path = self._absolute(new.path), new.path
                if part.constrained >= 0:
                    used = part.opening
            wanted = self._redeclarations(one, used, changes)
            inner = dict(new.inner) if new is not None else {}
            outer = self._applicable(target, inner)
            own = self._applicable(target, wanted)
            if all_of := _merged(own, outer):
                assert target is not None
                path = self._copy(target, all_of)
            brackets = self._remaining_modifiers(one, used, own, outer, changes) if used >= 0 else ""
            if (
                new is None or new.kind != "component"
            ) and part.opening >= 0:  # also of the type that constrains it
                brackets = self._joined_modifiers(one, opening, brackets, part.opening, changes)
            behind = closing(tokens, opened) + 1 if opened >= 0 else at + 1
            end = part.names[number + 1][0] - 1 if number + 1 < len(part.names) else part.end
            if part.constrained >= 0 and number + 1 == len(part.names):
                end = part.constrained
            dims = slice(at, behind if opened < 0 else opened)
            name = words_of(tokens[dims])
            if opened < 0 and tokens[at + 1].text == "[":
                behind = closing(tokens, at + 1) + 1
                name = words_of(tokens[at:behind])
            rest = words_of(tokens[behind:end])
            held = words_of(tokens[opening : closing(tokens, opening) + 1]) if opening >= 0 else ""
            plain = used == opening >= 0 and not rest.startswith("=") and "[" not in (*dimensions, *name)
            if plain and target is not None and (derived := self._record(one, part, target, name, brackets)):
                path, brackets = derived, ""
            same &= not path and _words_alone(brackets) == _words_alone(held)
            path = self._named(path, one)
            if new is not None and new.kind == "value":
                rest, same = new.path, False
            clauses.append((path, f"{name}{brackets} {rest}".strip()))
        if same:
            return
        type_text = "".join(token.text for token in tokens[slice(*part.path)])
        before = " ".join(
            word.text
            for word in tokens[part.first : part.path[0]]
            if word.text not in ("replaceable", "redeclare")
        )
        kept = words_of(tokens[part.constrained : part.end]) if part.constrained >= 0 else ""
        keeps = " ".join(word.text for word in tokens[part.first : part.path[0]])
        texts = []
        for path, text in clauses:
            changed = any(tokens[at].text in changes for at, _ in part.names)
            prefix, suffix = (before, "") if changed or path else (keeps, kept)
            texts.append(
                " ".join(one for one in (prefix, path or type_text, dimensions, text, suffix) if one)
            )
        yield tokens[part.first].start, tokens[part.end].start, "; ".join(texts)

    def _record(
        self, one: DeclaredClass, part: ClassPart, target: DeclaredClass, name: str, brackets: str
    ) -> str:
        """A type in place of a record's modifiers, kept by the compiler where derived classes bind all of it.

        Returns: its path; "" where none binds it, or the modifiers need components of the class.
        """
        bound = re.compile(rf"[(,.]\s*(final\s+|each\s+)*{re.escape(name)}\s*=(?!=)")
        if target.kind != "record" or is_overloading(target) or one.kind == "function" or not brackets:
            return ""
        if one.kind != "record" and not any(bound.search(text) for text in self._texts.values()):
            return ""
        tokens = (*tokenise(brackets, name), Token("sign", ";", len(brackets), 0))
        if any(token.text in ("redeclare", "final") for token in tokens) or any(
            token.kind == "name"
            and after.text not in ("=", "(")
            and self._declares_component(one.name, token.text)
            for before, token, after in zip(tokens, tokens[1:], tokens[2:], strict=False)
            if before.text != "."
        ):
            return ""
        line = one.tokens[part.first].line
        return self._extended_class(
            one, "record", f".{target.name}", self._with_whole_paths(tokens[:-1], one), line
        )

    def _joined_modifiers(
        self, one: DeclaredClass, opening: int, brackets: str, other: int, changes: Changes
    ) -> str:
        """Modifiers, with those of another bracket for elements that they do not name."""
        tokens = one.tokens

        def named(place: int) -> dict[str, str]:
            found = {}
            for first, last in arguments(tokens, place) if place >= 0 else ():
                at = first
                while tokens[at].text in PREFIXES or tokens[at].text in KINDS:
                    at += 1
                found[tokens[at].text] = words_of(tokens[first : last + 1])
            return found

        more = [text for name, text in named(other).items() if name not in named(opening)]
        if not more or any("redeclare" in text for text in more):
            return brackets
        held = brackets[1:-1].strip()
        return f"({', '.join(part for part in (held, *more) if part)})"

    def _remaining_modifiers(
        self,
        one: DeclaredClass,
        opening: int,
        done: Changes,
        outer: Changes,
        changes: Changes,
        added: Sequence[str] = (),
    ) -> str:
        """A bracket of modifiers without the redeclarations that are done; "" if nothing is left.

        What an outer redeclaration replaces goes with its modifiers.
        """
        tokens, texts = one.tokens, list[str]()
        for first, last in arguments(tokens, opening):
            whole = words_of(tokens[first : last + 1])
            at = first
            while tokens[at].text in PREFIXES:
                at += 1
            words = [token.text for token in tokens[first:at]]
            each = " ".join(word for word in words if word in ("each", "final"))
            if "redeclare" in words:
                of_class = tokens[at].text in KINDS
                place = at + 1 if of_class else path_end(tokens, at)
                name = tokens[place].text
                if name not in done or not done[name].path:
                    new = self._redeclared(one, at, last, set(words), changes) if of_class else None
                    path = f"{tokens[at].text} {name} = {new[1].path}" if new else ""
                    behind = path_end(tokens, at + 3) if of_class else last
                    modified = new and behind < last and tokens[behind].text == "("
                    further_words = (
                        words_of(tokens[closing(tokens, behind) + 1 : last + 1]) if modified else ""
                    )
                    texts.append(f"{' '.join(words)} {path} {further_words}" if modified else whole)
                    continue
                if of_class or (name in outer and outer[name].path):
                    continue
                behind = closing(tokens, place + 1) + 1 if tokens[place + 1].text == "[" else place + 1
                inner = ""
                if tokens[behind].text == "(" and behind <= last:
                    further = dict(outer[name].inner) if name in outer else {}
                    inner = self._remaining_modifiers(one, behind, dict(done[name].inner), further, changes)
                    behind = closing(tokens, behind) + 1
                value = ""
                if behind <= last and tokens[behind].text == "=":
                    until = next(
                        (k for k in range(behind, last + 1) if tokens[k].text == "constrainedby"), last + 1
                    )
                    value = words_of(tokens[behind:until])
                if inner or value:
                    texts.append(f"{each} {name}{inner} {value}".strip())
                continue
            behind = path_end(tokens, at)
            names = path_of(tokens, at, behind)
            mine, further = done, outer
            for name in names:
                mine = dict(mine[name].inner) if name in mine else {}
                further = dict(further[name].inner) if name in further else {}
            if len(names) == 1 and names[0] in done and done[names[0]].kind == "value":
                continue
            if behind > at and tokens[behind].text == "(" and mine:
                inner = self._remaining_modifiers(one, behind, mine, further, changes)
                behind = closing(tokens, behind) + 1
                value = words_of(tokens[behind : last + 1])
                if inner or value:
                    texts.append(f"{each} {'.'.join(names)}{inner} {value}".strip())
                continue
            texts.append(whole)
        texts += added
        return f"({', '.join(texts)})" if texts else ""


def _merged(inner: Changes, outer: Changes) -> Changes:
    """Changes of two levels: the outer one holds."""
    found = dict(inner)
    for name, new in outer.items():
        old = found.get(name)
        if old is None:
            found[name] = new
        elif not new.path:
            found[name] = replace(old, inner=tuple(_merged(dict(old.inner), dict(new.inner)).items()))
        else:
            further = dict(old.inner) if not old.path else {}
            found[name] = replace(new, inner=tuple(_merged(further, dict(new.inner)).items()))
    return found


def _last_end(one: DeclaredClass) -> int:
    """The index of the `end` of a class."""
    ends = (at for at in range(one.end - 1, 0, -1) if one.tokens[at].text == "end")
    return next(at for at in ends if one.tokens[at + 1].text == one.tokens[one.label].text)


def _renamed(one: DeclaredClass, name: str, first: int) -> Iterator[tuple[int, int, str]]:
    """Edits that give a class another name, and let nothing replace it; its prefixes begin at `first`."""
    for token in one.tokens[first : one.label]:
        if token.text in ("replaceable", "redeclare", "final"):
            yield token.start, text_end(token), ""
    label = one.tokens[one.label]
    yield label.start, text_end(label), name
    if one.short is None:
        token = one.tokens[_last_end(one) + 1]
        yield token.start, text_end(token), name


def _words_alone(text: str) -> str:
    return text.replace(" ", "")
