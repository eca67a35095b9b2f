"""Statements and expressions of functions and algorithm sections, as nested tuples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from orchestrator.base.errors import BuildError

from ..lexer import Token, tokenise
from ..rewriting.class_bodies import function_body

Node = tuple[Any, ...]

_ENDS = {"end", "else", "elseif", "elsewhen"}
RELATIONS = {"<": "<", "<=": "<=", ">": ">", ">=": ">=", "==": "==", "<>": "!="}


@dataclass(frozen=True)
class FunctionSource:
    """A function's text and qualified name."""

    name: str
    text: str


@dataclass
class Variable:
    """A declaration of a function; a dimension of None follows from the value."""

    name: str
    role: str
    dimensions: list[Node | None]
    binding: Node | None


class Parser:
    """Reads a function, or the statements of a section.

    A node begins with its kind. Statements: assign, if, for, while, when, break, return and do (a call).
    Expressions: number, text, name, end, negative, not, binary, choice, array, matrix, range, comprehension
    and call.
    """

    def __init__(self, source: FunctionSource, what: str = "") -> None:
        self._what = what or f"the function {source.name}()"
        self._tokens: Sequence[Token] = tokenise(source.text, source.name)
        self._at = 0
        self._name = source.name

    def function(self) -> tuple[list[Variable], list[Node]]:
        first, last = function_body(self._tokens)
        self._at = first
        variables: list[Variable] = []
        protected = False
        while self._at < last and self._peek() != "algorithm":
            text = self._peek()
            if text in ("protected", "public"):
                protected = text == "protected"
                self._at += 1
            elif text in ("extends", "import", "annotation"):
                self._skip()
            elif text in (
                "function",
                "encapsulated",
                "pure",
                "impure",
                "partial",
                "package",
                "record",
                "type",
            ):
                self._at = function_body(self._tokens, self._at)[1] + 2
                self._take(";")
            else:
                variables += self._declared(protected)
        if self._at >= last:
            raise self._error("it has no algorithm")
        self._take("algorithm")
        return variables, self._statements()

    def section(self) -> list[Node]:
        """The statements of a text that holds nothing else."""
        found = self._statements()
        if self._at < len(self._tokens):
            raise self._error(f"`{self._peek()}` begins no statement")
        return found

    def _peek(self, ahead: int = 0) -> str:
        place = self._at + ahead
        return self._tokens[place].text if place < len(self._tokens) else ""

    def _take(self, text: str | None = None) -> str:
        found = self._peek()
        if text is not None and found != text:
            raise self._error(f"`{text}` is expected before `{found}`")
        self._at += 1
        return found

    def _error(self, what: str) -> BuildError:
        line = self._tokens[min(self._at, len(self._tokens) - 1)].line
        return BuildError(f"{self._what} cannot be read at its line {line}: {what}")

    def _skip(self) -> None:
        depth = 0
        while depth or self._peek() != ";":
            depth += (self._peek() in ("(", "{", "[")) - (self._peek() in (")", "}", "]"))
            self._at += 1
        self._at += 1

    def _declared(self, protected: bool) -> list[Variable]:
        role = "protected" if protected else "local"
        while self._peek() in ("input", "output", "parameter", "constant", "final"):
            word = self._take()
            role = word if word in ("input", "output") else role
        self._take()
        while self._peek() == ".":
            self._at += 2
        shape = self._dimensions() if self._peek() == "[" else []
        found = []
        while True:
            name = self._take()
            own = self._dimensions() if self._peek() == "[" else []
            if self._peek() == "(":
                self._bracket()
            binding = None
            if self._peek() in ("=", ":="):
                self._at += 1
                binding = self.expression()
            found.append(Variable(name, role, own + shape, binding))
            while self._at < len(self._tokens) and self._tokens[self._at].kind == "string":
                self._at += 1
            if self._peek() == "annotation":
                self._at += 1
                self._bracket()
            if self._take() == ";":
                return found

    def _bracket(self) -> None:
        depth = 0
        while True:
            depth += (self._peek() in ("(", "{", "[")) - (self._peek() in (")", "}", "]"))
            self._at += 1
            if not depth:
                return

    def _dimensions(self) -> list[Node | None]:
        self._take("[")
        found: list[Node | None] = []
        while True:
            if self._peek() == ":":
                self._at += 1
                found.append(None)
            else:
                found.append(self.expression())
            if self._take() == "]":
                return found

    def _statements(self) -> list[Node]:
        found = []
        while self._peek() not in _ENDS and self._peek() not in ("", "annotation", "algorithm", "external"):
            found.append(self._statement())
            while self._at < len(self._tokens) and self._tokens[self._at].kind == "string":
                self._at += 1
            if self._peek() == "annotation":
                self._at += 1
                self._bracket()
            self._take(";")
        return found

    def _statement(self) -> Node:
        match self._peek():
            case "if":
                return self._if()
            case "for" | "while":
                first, word = self._at, self._take()
                over = self._iterators() if word == "for" else self.expression()
                self._take("loop")
                body = self._statements()
                self._closed(word)
                return (word, over, body, (first, self._at))
            case "when":
                return self._when()
            case "break" | "return":
                return (self._take(),)
            case "(":
                self._at += 1
                targets: list[Node | None] = []
                while self._peek() != ")":
                    if self._peek() == ",":
                        targets.append(None)
                    else:
                        targets.append(self._reference())
                    if self._peek() == ",":
                        self._at += 1
                self._take(")")
                self._take(":=")
                return ("assign", targets, self.expression())
        target = self._reference()
        if self._peek() == ":=":
            self._at += 1
            return ("assign", [target], self.expression())
        return ("do", target)

    def text_of(self, statement: Node) -> str:
        """The text of a for or while statement."""
        first, last = statement[-1]
        return " ".join(one.text for one in self._tokens[first:last])

    def _when(self) -> Node:
        cases = []
        while self._peek() in ("when", "elsewhen"):
            self._at += 1
            condition = self.expression()
            self._take("then")
            cases.append((condition, self._statements()))
        self._closed("when")
        return ("when", cases)

    def _closed(self, word: str) -> None:
        self._take("end")
        self._take(word)

    def _if(self) -> Node:
        cases, otherwise = [], []
        word = self._take()
        while word in ("if", "elseif"):
            condition = self.expression()
            self._take("then")
            cases.append((condition, self._statements()))
            word = self._take()
        if word == "else":
            otherwise = self._statements()
            self._take("end")
        self._take("if")
        return ("if", cases, otherwise)

    def _iterators(self) -> list[tuple[str, Node]]:
        found = []
        while True:
            name = self._take()
            self._take("in")
            found.append((name, self.expression()))
            if self._peek() != ",":
                return found
            self._at += 1

    def expression(self) -> Node:
        if self._peek() == "if":
            return self._choice()
        first = self._binary(0)
        if self._peek() != ":":
            return first
        self._at += 1
        second = self._binary(0)
        if self._peek() != ":":
            return ("range", first, ("number", 1.0), second)
        self._at += 1
        return ("range", first, second, self._binary(0))

    def _choice(self) -> Node:
        self._at += 1  # "if" or "elseif"
        condition = self.expression()
        self._take("then")
        value = self.expression()
        if self._peek() == "elseif":
            return ("choice", condition, value, self._choice())
        self._take("else")
        return ("choice", condition, value, self.expression())

    _LEVELS = (("or",), ("and",), tuple(RELATIONS), ("+", "-", ".+", ".-"), ("*", "/", ".*", "./"))

    def _binary(self, level: int) -> Node:
        if level == 2 and self._peek() == "not":
            self._at += 1
            return ("not", self._binary(level))
        if level == len(self._LEVELS):
            base = self._primary()
            if self._peek() in ("^", ".^"):
                word = self._take()
                return ("binary", word, base, self._primary())
            return base
        if level == 3 and self._peek() in ("-", "+"):
            word = self._take()
            found = self._binary(4)
            found = ("negative", found) if word == "-" else found
        else:
            found = self._binary(level + 1)
        while self._peek() in self._LEVELS[level]:
            word = self._take()
            found = ("binary", word, found, self._binary(level + 1))
        return found

    def _primary(self) -> Node:
        token = self._tokens[self._at]
        if token.kind == "number":
            self._at += 1
            return ("number", float(token.text))
        if token.kind == "string":
            self._at += 1
            return ("text", token.text)
        if token.text in ("true", "false"):
            self._at += 1
            return ("number", float(token.text == "true"))
        if token.text == "end":
            self._at += 1
            return ("end",)
        if token.text == "(":
            self._at += 1
            found = self.expression()
            self._take(")")
            return found
        if token.text in "{[":
            return self._array()
        return self._reference()

    def _array(self) -> Node:
        opening = self._take()
        rows: list[list[Node]] = [[]]
        while self._peek() not in "}]":
            rows[-1].append(self.expression())
            if self._peek() == "for":
                self._at += 1
                found = ("comprehension", rows[-1][0], self._iterators())
                self._take("}")
                return found
            if self._peek() in (",", ";"):
                if self._take() == ";":
                    rows.append([])
        self._at += 1
        if opening == "{":
            return ("array", rows[0])
        return ("matrix", rows)

    def _reference(self) -> Node:
        if self._peek() == ".":  # of a name from the top
            self._at += 1
        parts: list[tuple[str, list[Node | None]]] = [(self._take(), [])]
        while True:
            if self._peek() == ".":
                self._at += 1
                parts.append((self._take(), []))
            elif self._peek() == "[":
                parts[-1][1].extend(self._dimensions())
            else:
                break
        name = ".".join(one for one, _ in parts)
        if self._peek() != "(":
            return ("name", name, [one for _, subscripts in parts for one in subscripts], parts)
        self._at += 1
        positional: list[Node] = []
        named: dict[str, Node] = {}
        while self._peek() != ")":
            if self._peek(1) == "=":
                key = self._take()
                self._at += 1
                named[key] = self.expression()
            else:
                positional.append(self.expression())
            if self._peek() == ",":
                self._at += 1
        self._at += 1
        return ("call", name, positional, named)
