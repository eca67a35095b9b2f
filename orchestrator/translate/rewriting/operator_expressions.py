"""Reads expressions of a class, with their types, and writes overloaded operators as calls."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from ..built_in import BUILT_IN
from ..lexer import closing
from .declared_classes import DeclaredClass
from .operator_calls import OperatorCalls
from .operator_values import INDEX, SUM, NotRead, Value, over_elements
from .source_edits import words_of
from .typed_classes import sizes_of

_COUNTED = re.compile(r"for (\w+) in 1 : ([^,]+)")
_LEVELS = (
    ("or",), ("and",), ("<", "<=", ">", ">=", "==", "<>"), ("+", "-", ".+", ".-"), ("*", "/", ".*", "./"),
    ("^", ".^"),
)  # fmt: skip


class Expressions(OperatorCalls):
    """Each method reads one expression from `at` onwards, and leaves `at` behind it.

    Raises: NotRead for what is no such expression; BuildError for what has no meaning.
    """

    def _expect(self, word: str) -> None:
        if self._word() != word:
            raise NotRead
        self.at += 1

    def _choice(self) -> Value:
        if self._word() != "if":
            return self._range()
        begin, words, values = self.at, list[str](), list[Value]()
        while self._word() in ("if", "elseif"):
            words.append(self._word())
            self.at += 1
            words.append(self._choice().text)
            self._expect("then")
            values.append(self._choice())
        self._expect("else")
        values.append(self._choice())

        def written(texts: Sequence[str]) -> str:
            parts = [f"{word} {condition} then {text}" for word, condition, text in
                     zip(words[::2], words[1::2], texts, strict=False)]  # fmt: skip
            return f"({' '.join(parts)} else {texts[-1]})"

        kinds = {one.kind for one in values}
        kind = kinds.pop() if len(kinds) == 1 else "Real" if kinds == {"Real", "Integer"} else ""
        sizes, element = values[0].sizes, ""
        if not kind.startswith("."):
            elements = [self._element(one).text for one in values]
            element = written(elements) if sizes and all(elements) else ""
            return Value(written([one.text for one in values])[1:-1], kind, sizes, element)
        if not sizes:
            return self._chosen(kind, values, written)
        if len(sizes) > 1 or not all(one.element for one in values):
            raise self._error(begin, "an if-expression of these arrays", "write it for their elements")
        return over_elements(self._chosen(kind, [self._element(one) for one in values], written), sizes[0])

    def _range(self) -> Value:
        first = self._or()
        if self._word() != ":":
            return first
        texts = [first.text]
        while self._word() == ":":
            self.at += 1
            texts.append(self._or().text)
        return Value(":".join(texts), "Real", (f"size({':'.join(texts)}, 1)",))

    def _or(self) -> Value:
        return self._level(0)

    def _level(self, level: int) -> Value:
        if level == len(_LEVELS):
            return self._primary()
        begin = self.at
        if _LEVELS[level][0] == "<" and self._word() == "not":
            self.at += 1
            value = self._level(level)
            return self._applied(begin, "not", [value])
        if _LEVELS[level][0] == "+" and self._word() in ("+", "-", ".+", ".-"):
            sign = self._word()
            self.at += 1
            left = self._applied(begin, sign, [self._level(level + 1)])
        else:
            left = self._level(level + 1)
        while self._word() in _LEVELS[level]:
            place, sign = self.at, self._word()
            self.at += 1
            left = self._applied(place, sign, [left, self._level(level + 1)])
        return left

    def _primary(self) -> Value:
        token = self._tokens[self.at]
        if token.kind == "number":
            self.at += 1
            return Value(token.text, "Integer" if token.text.isdigit() else "Real")
        if token.kind == "string" or token.text in ("true", "false", "end"):
            self.at += 1
            kinds = {"end": "Integer", "true": "Boolean", "false": "Boolean"}
            return Value(token.text, kinds.get(token.text, "String"))
        if token.text == "(":
            return self._bracket()
        if token.text == "{":
            return self._array()
        if token.text == "[":
            raise NotRead
        if token.text in ("der", "initial", "pure") and self._tokens[self.at + 1].text == "(":
            self.at += 1
            values, _ = self._arguments()
            texts = ", ".join(one.text for one in values)
            if token.text == "der" and values and values[0].is_record:
                return self._of_each_member("der", values, f"der({texts})")
            sizes = values[0].sizes if values else ()
            return Value(f"{token.text}({texts})", "Boolean" if token.text == "initial" else "Real", sizes)
        if token.kind == "name" or token.text == ".":
            return self._reference()
        raise NotRead

    def _bracket(self) -> Value:
        end, texts = closing(self._tokens, self.at), list[str]()
        self.at += 1
        value = None
        while self.at <= end:
            if self._word() in (",", ")"):
                texts.append("")
            else:
                value = self._choice()
                texts.append(value.text)
            if self._word() == ")":
                break
            self._expect(",")
        self._expect(")")
        if len(texts) != 1 or value is None:
            return Value(f"({', '.join(texts)})")
        element = f"({value.element})" if value.element else ""
        return replace(value, text=f"({value.text})", element=element)

    def _array(self) -> Value:
        values, over = self._arguments()
        texts = [one.text for one in values]
        if over:
            return self._comprehension(values[0], over) if values else Value("")
        kinds = {one.kind for one in values}
        kind = kinds.pop() if len(kinds) == 1 else "Real" if kinds == {"Real", "Integer"} else ""
        sizes = (str(len(values)), *(values[0].sizes if values else ()))
        text = f"{{{', '.join(texts)}}}"
        if len(sizes) > 1 or not kind:
            return Value(text, kind, sizes)

        def written(texts: Sequence[str]) -> str:
            tests = [f"if {INDEX} == {n} then {one} else" for n, one in enumerate(texts[:-1], 1)]
            return f"({' '.join([*tests, texts[-1]])})"

        if not kind.startswith("."):
            return Value(text, kind, sizes, written(texts))
        one = self._chosen(kind, values, written)
        return replace(one, text=text, sizes=sizes, element=one.text)

    def _comprehension(self, value: Value, over: str) -> Value:
        text, counted = f"{{{value.text} {over}}}", _COUNTED.fullmatch(over)
        if counted is None or value.sizes:
            return Value(text, value.kind, ("",) * (1 + over.count(" in ") + len(value.sizes)))
        name = re.compile(rf"(?<![.\w]){counted[1]}\b(?!\s*=(?!=))")

        def element(of: str) -> str:
            return name.sub(INDEX, of)

        members = (lambda one: element(self._member(value, one))) if value.is_record else None
        return Value(text, value.kind, (counted[2],), element(value.text), members)

    def _arguments(self) -> tuple[list[Value], str]:
        """Positional arguments of a call or elements of an array, and the iterators behind them, as text."""
        values, names, over = self._all_arguments()
        return [replace(one, text=f"{name} = {one.text}") if name else one for one, name in
                zip(values, names, strict=True)], over  # fmt: skip

    def _all_arguments(self) -> tuple[list[Value], list[str], str]:
        tokens, opening = self._tokens, self.at
        end = closing(tokens, opening)
        loops = len(self.loops)
        at = place = opening + 1
        while at < end:
            if tokens[at].text == "for":
                place = at
                self.loops += [tokens[k - 1].text for k in range(at, end) if tokens[k].text == "in"]
                break
            at = closing(tokens, at) + 1 if tokens[at].text in ("(", "[", "{") else at + 1
        values, names, over = list[Value](), list[str](), ""
        self.at = opening + 1
        while self.at < end:
            name = ""
            if tokens[self.at].kind == "name" and tokens[self.at + 1].text == "=":
                name = tokens[self.at].text
                self.at += 2
            if self._word() == "function":
                raise NotRead
            values.append(self._choice())
            names.append(name)
            if self._word() == "for" and self.at == place:
                over = words_of(tokens[self.at : end])
                self.at = end
            elif self.at < end:
                self._expect(",")
        self.at = end + 1
        del self.loops[loops:]
        return values, names, over

    def _reference(self) -> Value:
        """A name with subscripts, or a call."""
        tokens, begin = self._tokens, self.at
        names: list[tuple[str, list[str] | None]] = []
        if self._word() == ".":
            names.append(("", None))
            self.at += 1
        while True:
            if tokens[self.at].kind != "name":
                raise NotRead
            name = self._word()
            self.at += 1
            inside = self._subscripts() if self._word() == "[" else None
            names.append((name, inside))
            if self._word() != ".":
                break
            self.at += 1
        if self._word() == "(":
            if any(inside is not None for _, inside in names):
                raise NotRead
            return self._called(begin, [name for name, _ in names])
        text = ".".join(name + (f"[{', '.join(inside)}]" if inside else "") for name, inside in names)
        if names[0][0] in self.loops or text in ("time", "true", "false"):
            return Value(text, "Real" if text == "time" else "Integer", called=False)
        return self._component(names, text)

    def _subscripts(self) -> list[str]:
        end, texts = closing(self._tokens, self.at), list[str]()
        self.at += 1
        while self.at < end:
            if self._word() == ":":
                self.at += 1
                texts.append(":")
            else:
                texts.append(self._choice().text)
            if self.at < end:
                self._expect(",")
        self.at = end + 1
        return texts

    def _component(self, names: list[tuple[str, list[str] | None]], text: str) -> Value:
        unknown = Value(text, called=False)
        first, place = names[0][0], 0
        found = self.known.own_component(self.one, first)
        own_one = found is not None
        found = found or self.known.component(self.one, first) or self.known.constant(self.one, first)
        if found is None:
            path = [name for name, _ in names]
            for place in range(len(path) - 1, 0, -1):
                owner = self.known.kind(path[:place], self.one.name)[1] if path[:place] != [""] else None
                if owner is not None and (found := self.known.own_component(owner, path[place])):
                    break
        if found is None:
            return unknown
        before = ".".join(name for name, _ in names[:place])
        whole, element, sizes = before, before, list[str]()
        kind, cls, sliced = "", None, False
        for number, (name, inside) in enumerate(names[place:], place):
            if number > place:
                if cls is None:
                    return unknown
                found = self.known.own_component(cls, name)
                if found is None:
                    return unknown
            assert found is not None
            owner, part, _ = found
            record, (kind, cls) = kind, self.known.kind_of(owner, part)
            own = [self._size(owner, size, whole) for size in sizes_of(found)]
            before = f"{whole}.{name}" if whole else name
            own = [f"size({before}, {n})" if size == ":" else size for n, size in enumerate(own, 1)]
            sliced |= record.startswith(".") and bool(sizes)
            given = inside if inside is not None else [":"] * len(own)
            if len(given) < len(own):
                given = [*given, *[":"] * (len(own) - len(given))]
            left = [size for size, one in zip(own, given, strict=False) if ":" in one]
            sizes += left
            shown = [INDEX if one == ":" else one for one in given]
            joint = "." if whole or number > place else ""
            whole = f"{whole}{joint}{name}" + (f"[{', '.join(inside)}]" if inside else "")
            element = f"{element}{joint}{name}" + (f"[{', '.join(shown)}]" if shown else "")
            if any(":" in one and one != ":" for one in given):
                return unknown if kind.startswith(".") else replace(unknown, kind=kind, sizes=tuple(sizes))
        if len(sizes) > 1:
            element = ""
        if sliced and element:  # the compiler takes no members of all elements
            self.rewritten = True
            text = f"{{{element} for {INDEX} in 1:{sizes[0]}}}"
        # The compiler takes no members of constants of packages.
        members = (lambda name: f"{text}.{name}") if own_one else None
        return Value(text, kind, tuple(sizes), element if sizes else "", members, not own_one)

    def _size(self, owner: DeclaredClass, text: str, whole: str) -> str:
        """The size of a component of another one, as it is named here."""
        words = text.split(" ")
        prefix = f"{whole}." if whole else ""
        return " ".join(
            f"{prefix}{word}" if word.isidentifier() and (at == 0 or words[at - 1] != ".")
            and self.known.own_component(owner, word) else word
            for at, word in enumerate(words)
        )  # fmt: skip

    def _called(self, begin: int, path: list[str]) -> Value:
        name = ".".join(path)
        values, names, over = self._all_arguments()
        pairs = zip(values, names, strict=True)
        texts = [f"{label} = {one.text}" if label else one.text for one, label in pairs]
        text = f"{name}({', '.join(texts)}{f' {over}' if over else ''})"
        last = path[-1]
        found = self.known.kind(path, self.one.name)
        records = any(one.is_record for one in values)
        if found[1] is None and name.removeprefix(".") == last:
            result = BUILT_IN[last].result if last in BUILT_IN else None
            if result == "" and values:
                return self._of_each_member(last, values, text)
            if result == "Real" and not over and not records:
                return Value(text, result, next((one.sizes for one in values if one.sizes), ()))
            if result in ("Integer", "Boolean"):
                return Value(text, result)
            if last == "fill" and values:
                sizes = tuple(one.text for one in values[1:])
                return Value(text, values[0].kind, sizes, values[0].text if len(sizes) == 1 else "")
            if last == "String" and values and values[0].is_record:
                makers = self.known.operators(values[0].kind, "String")
                if len(makers) == 1:
                    return replace(self._call(makers[0], values, names), kind="String")
            vector = len(values) == 1 and len(values[0].sizes) == 1 and not over
            if last == "sum" and records and vector and self.known.sum_functions(values[0].kind[1:]):
                return Value(f"{self._path(values[0].kind)}.{SUM}({texts[0]})", values[0].kind)
            if last in ("sum", "product") and records:
                what = f"`{last}` of {values[0].kind[1:]}"
                raise self._error(begin, what, "write it with the operator")
            if last in ("sum", "product"):
                return Value(text, "Real" if values and values[0].kind in ("Real", "Integer") else "")
            return Value(text, "Integer" if last == "Integer" else "String" if last == "String" else "")
        if found[0].startswith("."):
            return self._constructed(begin, found[0], values, names, text)
        if found[1] is None or found[1].kind != "function":
            return Value(text, "other" if found[1] is not None else "")
        if len(path) == 1 and (name in ("sum", "product") or (name in BUILT_IN and BUILT_IN[name].result)):
            # The compiler would take the built-in one.
            scope = found[1].name.rpartition(".")[0]
            text = f"{self._path(f'.{scope}')}.{text}"
            name = text.partition("(")[0]
        inputs, (kind, sizes) = self.known.signature(found[1])
        deeper = [
            one for one, wanted in zip(values, inputs, strict=False)
            if one.is_record and len(one.sizes) == wanted.depth + 1 == 1
        ]  # fmt: skip
        if not deeper:
            return Value(text, kind, sizes)
        if any(names) or not all(one.element for one in deeper):
            raise self._error(begin, f"{name}() of an array, for each element,", "call it for the elements")
        self.rewritten = True
        elements = [self._element(one) if one in deeper else one for one in values]
        return over_elements(
            Value(f"{name}({', '.join(one.text for one in elements)})", kind), deeper[0].sizes[0]
        )
