"""Whole paths in place of names that the compiler would take for others."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ..lexer import closing
from .declared_classes import PREFIXES, ClassPart, DeclaredClass, DeclaredClasses, own_tokens
from .modifiers import arguments
from .source_edits import edited, path_end, path_of, text_end, words_of


class WholePaths(DeclaredClasses):
    """Sources that name functions and packages by whole paths.

    Discrete signals and outer variables are rewritten, too, where the compiler refuses them.
    """

    def with_whole_paths(self, model: str) -> dict[str, str]:
        """The texts, in which classes name functions and packages by whole paths if others are called so.

        The compiler would take one of these for all.
        """
        places: dict[str, int] = {}
        kept = set[str]()
        for one in self.all_classes():
            label = one.tokens[one.label]
            if one.kind == "function":
                places[label.text] = places.get(label.text, 0) + 1
                ahead = {token.text for token in one.tokens[one.first : one.label]}
                if "extends" in ahead or ("replaceable" in ahead and not self._copied):
                    kept.add(label.text)  # what it stands for differs from class to class
        packages = {
            one.tokens[one.label].text
            for one in self.all_classes()
            if one.kind == "package" and one.short is not None and self._copied and not self._in_package(one)
        } - kept
        shared = {name for name, count in places.items() if count > 1} - kept
        edits: dict[str, list[tuple[int, int, str]]] = {}
        for one in self.all_classes():
            if one.short is None:
                found = edits.setdefault(one.file, [])
                found += self._path_edits(one, packages, shared, model)
                found += [*self._element_edits(one), *self._outer_edits(one)]
        return {file: edited(text, edits.get(file, ())) for file, text in self._texts.items()}

    def _path_edits(
        self, one: DeclaredClass, packages: set[str], shared: set[str], model: str
    ) -> Iterator[tuple[int, int, str]]:
        """Whole paths of functions, of packages and of what packages inherit."""
        modifiers = {at for part in one.parts for at in self._modifier_names(one, part)}
        typed = dict(self._inherited_types(one)) if self._copied else {}
        for begin, (end, path) in typed.items():
            yield one.tokens[begin].start, text_end(one.tokens[end - 1]), path
        for at in own_tokens(one):
            token, before, after = one.tokens[at], one.tokens[at - 1].text, one.tokens[at + 1].text
            path = ""
            if token.text in packages and before != "." and after == "." and at not in typed:
                path = self._named(self._package(one, token.text), one)
            elif token.text in shared and after == "(" and before not in (".", "end"):
                if at not in modifiers and one.kind != "function":
                    path = self._function(one, token.text, model)
            if path and path != token.text:
                yield token.start, text_end(token), path

    def _element_edits(self, one: DeclaredClass) -> Iterator[tuple[int, int, str]]:
        """Equations in place of connections of a discrete signal to several elements, which are refused."""
        tokens = one.tokens
        found: dict[tuple[str, str], list[tuple[int, str]]] = {}
        for at in own_tokens(one):
            if tokens[at].text != "connect" or tokens[at + 1].text != "(":
                continue
            ends = [tokens[first : last + 1] for first, last in arguments(tokens, at + 1)]
            for element, other in (ends, ends[::-1]) if len(ends) == 2 else ():
                if [token.text for token in element[-3::2]] == ["[", "]"]:
                    key = "".join(token.text for token in element[:-3]), words_of(other)
                    found.setdefault(key, []).append((at, words_of(element)))
        for (vector, signal), places in found.items():
            if len(places) > 1 and self._builtin(one, vector) in ("Boolean", "Integer"):
                for at, name in places:
                    yield tokens[at].start, text_end(tokens[closing(tokens, at + 1)]), f"{name} = {signal}"

    def _outer_edits(self, one: DeclaredClass) -> Iterator[tuple[int, int, str]]:
        """Outer variables of built-in types as parameters, which stand for the inner ones all the same.

        The compiler would ask for an equation for each, too.
        """
        for part in one.parts:
            if part.prefixes == {"outer"} and part.names:
                if self._builtin(one, one.tokens[part.names[0][0]].text) in ("Real", "Integer", "Boolean"):
                    start = one.tokens[part.path[0]].start
                    yield start, start, "parameter "

    def _builtin(self, one: DeclaredClass, path: str) -> str:
        """The built-in type of a component of a class, by its path; "" for another."""
        words = [""]
        for name in re.sub(r"\[[^\]]*\]", "", path).split("."):
            found = self._declared(one, name)
            if found is None or found[1].owner is not None:
                return ""
            words = path_of(found[0].tokens, *found[1].path)
            after = self._resolved(words, found[0].name, {})
            one = after or found[0]
        while one.short is not None:
            words = path_of(one.tokens, *one.short.path)
            after = self._resolved(words, one.name.rpartition(".")[0], {})
            if after is None:
                break
            one = after
        return words[0]

    def _function(self, one: DeclaredClass, name: str, model: str) -> str:
        """How a class names a function that it calls; "" if that is none of the sources."""
        found = self._found(one, name)
        while found is not None and found.short is not None and found.short.opening < 0:
            after = self._aliased(found)
            if after is None or after is found:
                break
            found = after
        if found is None or found.kind != "function":
            return ""
        last = found.name.rpartition(".")[2]
        plain = found.name.rpartition(".")[0] == model and self._resolved([last], one.name, {}) is found
        if plain:
            return last
        top = self._resolved([found.name.partition(".")[0]], one.name, {})
        hidden = top is None or "." in top.name
        return self._named(f".{found.name}", one) if hidden else f".{found.name}"

    def _inherited_types(self, one: DeclaredClass) -> Iterator[tuple[int, tuple[int, str]]]:
        """Types that packages inherit: the first index; the one behind the last, and the path of each."""
        for part in one.parts:
            words = path_of(one.tokens, *part.path) if part.path[1] > part.path[0] + 1 else []
            found = self._found(one, words[0]) if words and words[0] else None
            inherits = False
            for word in words[1:]:
                while found is not None and found.short is not None and found.short.opening < 0:
                    found = self._aliased(found)
                outer, found = found, self._member(found.name, word) if found is not None else None
                inherits |= found is not None and outer is not None and found.name != f"{outer.name}.{word}"
            if found is not None and inherits and not self._is_foreign(found):
                yield part.path[0], (part.path[1], self._named(f".{found.name}", one))

    def _in_package(self, one: DeclaredClass) -> bool:
        outer = self._get(one.name.rpartition(".")[0])
        return outer is None or outer.kind == "package"

    def _package(self, one: DeclaredClass, name: str) -> str:
        """What a package of a model that is defined by `=` stands for; "" for another."""
        found = self._found(one, name)
        path = ""
        while found is not None and found.short is not None and found.short.opening < 0:
            if found.kind != "package" or (not path and self._in_package(found)):
                return ""
            words = path_of(found.tokens, *found.short.path)
            after = self._resolved(words, found.name.rpartition(".")[0], {})
            if after is None:
                return f".{'.'.join(words)}" if words[0] == "Modelica" else ""
            found, path = after, f".{after.name}"
            if self._is_foreign(found):
                break
        return path

    def _modifier_names(self, one: DeclaredClass, part: ClassPart) -> Iterator[int]:
        ahead = [opening for _, opening in part.names] + [part.opening]
        for opening in ahead:
            for first, last in arguments(one.tokens, opening) if opening >= 0 else ():
                at = first
                while one.tokens[at].text in PREFIXES:
                    at += 1
                behind = path_end(one.tokens, at)
                yield at
                if behind <= last and one.tokens[behind].text == "(":
                    ahead.append(behind)
