"""Algorithm sections with `when` as equations: each variable by one, from its value before or after.

The compiler takes no section in which a variable is read whose value at that statement is not the one
that the section leaves. Here the statements are carried out in symbols. Loops, and variables that several
statements of a section set by events, stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from ..lexer import Token

__all__ = ["as_equations"]


class _Unhandled(Exception):
    """What has no equations of the same meaning here."""


@dataclass
class _Statement:
    """`kind` is set (targets and value), call, if or when (conditions and bodies; of else None)."""

    kind: str
    targets: list[str] = field(default_factory=list)
    value: Sequence[Token] = ()
    branches: list[tuple[Sequence[Token] | None, list[_Statement]]] = field(default_factory=list)

    def sets(self) -> set[str]:
        """All variables that it may set."""
        inner = (name for _, body in self.branches for one in body for name in one.sets())
        return {*self.targets, *inner}


def as_equations(tokens: Sequence[Token]) -> str | None:
    """The statements of a section as equations; None where the compiler takes them, or there are none."""
    try:
        statements, end = _parsed(tokens, 0)
        if end != len(tokens) or not any(one.kind == "when" for one in statements):
            return None
        section = _Section(statements)
        text = section.equations()
    except (_Unhandled, IndexError):
        return None
    return text if section.reads else None


def _parsed(tokens: Sequence[Token], at: int) -> tuple[list[_Statement], int]:
    """Statements up to `end`, `else`, `elseif`, `elsewhen`, or the last token."""
    found: list[_Statement] = []
    while at < len(tokens) and tokens[at].text not in ("end", "else", "elseif", "elsewhen"):
        first = tokens[at]
        if first.text in ("if", "when"):
            one, at = _branched(tokens, at)
            found.append(one)
            continue
        if first.kind == "keyword" or first.kind not in ("name", "sign"):
            raise _Unhandled
        end = _until(tokens, at, ";")
        sign = next((k for k in range(at, end) if tokens[k].text == ":="), None)
        if sign is None:
            if tokens[at + 1].text != "(" or first.text not in ("reinit", "assert", "terminate"):
                raise _Unhandled
            found.append(_Statement("call", value=tokens[at:end]))
        else:
            found.append(_Statement("set", _targets(tokens[at:sign]), tokens[sign + 1 : end]))
        at = end + 1
    return found, at


def _targets(tokens: Sequence[Token]) -> list[str]:
    parts = [one.text for one in tokens]
    if parts[0] == "(" and parts[-1] == ")":
        names = "".join(parts[1:-1]).split(",")
    else:
        names = ["".join(parts)]
    if any(not name.replace(".", "").replace("_", "").isalnum() for name in names):
        raise _Unhandled  # elements, and results that are left out
    return names


def _branched(tokens: Sequence[Token], at: int) -> tuple[_Statement, int]:
    one = _Statement(tokens[at].text)
    again, close = ("elseif", "then") if one.kind == "if" else ("elsewhen", "then")
    while tokens[at].text in (one.kind, again):
        then = _until(tokens, at + 1, close)
        body, stop = _parsed(tokens, then + 1)
        one.branches.append((tokens[at + 1 : then], body))
        at = stop
    if tokens[at].text == "else" and one.kind == "if":
        body, at = _parsed(tokens, at + 1)
        one.branches.append((None, body))
    if tokens[at].text != "end" or tokens[at + 1].text != one.kind or tokens[at + 2].text != ";":
        raise _Unhandled
    return one, at + 3


def _until(tokens: Sequence[Token], at: int, text: str) -> int:
    """The next token of this text; if-expressions have a `then` of their own."""
    inner = 0
    while True:
        here = tokens[at].text
        if here == text and not inner:
            return at
        if text == "then":
            inner += (here == "if") - (here == "then")
        if here == ";":
            raise _Unhandled
        at += 1


class _Section:
    def __init__(self, statements: list[_Statement]) -> None:
        self._statements = statements
        self._all = {name for one in statements for name in one.sets()}
        self._by_events = {name for one in statements if one.kind == "when" for name in one.sets()}
        self.reads = False  # whether any is read before or after it is set

    def equations(self) -> str:
        lines: list[str] = []
        env: dict[str, str] = {}
        for one in self._statements:
            others = {name for other in self._statements if other is not one for name in other.sets()}
            if one.kind == "when":
                if one.sets() & others:
                    raise _Unhandled
                lines += self._when(one, env)
            elif one.kind == "call":
                lines.append(f"{self._text(one.value, env)};")
            else:
                made = self._carried_out(one, env)
                for name, value in made.items():
                    if name not in others:
                        lines.append(f"{name} = {value};")
                    env[name] = f"({value})"
            env |= {name: name for name in one.sets() - others}
        for name in self._all - self._by_events:
            if env[name] != name:
                lines.append(f"{name} = {env[name]};")
        return " ".join(lines)

    def _when(self, statement: _Statement, env: Mapping[str, str]) -> Iterator[str]:
        word = "when"
        for condition, body in statement.branches:
            assert condition is not None
            yield f"{word} {self._text(condition, env)} then"
            word = "elsewhen"
            here = {**env}
            for one in body:
                others = {name for other in body if other is not one for name in other.sets()}
                if one.kind == "when":
                    raise _Unhandled
                if one.kind == "call":
                    yield f"{self._text(one.value, here)};"
                elif len(one.targets) > 1:
                    if one.sets() & others:
                        raise _Unhandled
                    yield f"({', '.join(one.targets)}) = {self._text(one.value, here)};"
                else:
                    for name, value in self._carried_out(one, here).items():
                        if name not in others:
                            yield f"{name} = {value};"
                        here[name] = f"({value})"
                here |= {name: name for name in one.sets() - others}
            done = {name for one in body for name in one.sets()}
            for name in sorted(done):
                if here[name] != name:
                    yield f"{name} = {here[name]};"
            for name in sorted(statement.sets() - done):
                yield f"{name} = pre({name});"
        yield "end when;"

    def _carried_out(self, one: _Statement, env: Mapping[str, str]) -> dict[str, str]:
        """What a statement without events sets, in values of before the section or after it."""
        if one.kind == "set":
            if len(one.targets) > 1:
                raise _Unhandled
            return {one.targets[0]: self._text(one.value, env)}
        if one.kind != "if":
            raise _Unhandled
        cases: list[tuple[str | None, dict[str, str]]] = []
        for condition, body in one.branches:
            inside = dict(env)
            for statement in body:
                made = self._carried_out(statement, inside)
                inside |= {name: f"({value})" for name, value in made.items()}
            cases.append((None if condition is None else self._text(condition, env), inside))
        if cases[-1][0] is not None:
            cases.append((None, dict(env)))
        found = {}
        for name in sorted(one.sets()):
            values = [inside[name] if name in inside else self._before(name) for _, inside in cases]
            heads = [
                f"if {condition} then {value} " for (condition, _), value in zip(cases, values, strict=True)
            ]
            found[name] = f"{'else'.join(heads[:-1])}else {values[-1]}"
        return found

    def _before(self, name: str) -> str:
        if name not in self._by_events:
            raise _Unhandled  # it would start each time with its start value
        self.reads = True
        return f"pre({name})"

    def _text(self, tokens: Sequence[Token], env: Mapping[str, str]) -> str:
        """An expression with the values that variables have at this statement."""
        parts: list[str] = []
        at = 0
        while at < len(tokens):
            if tokens[at].text in ("pre", "edge", "change") and tokens[at + 1].text == "(":
                end = next(k for k in range(at, len(tokens)) if tokens[k].text == ")")
                parts += [one.text for one in tokens[at : end + 1]]
                at = end + 1
                continue
            name, end = tokens[at].text, at + 1
            if tokens[at].kind == "name":
                while end + 1 < len(tokens) and tokens[end].text == ".":
                    name += f".{tokens[end + 1].text}"
                    end += 2
                if name in self._all and (at == 0 or tokens[at - 1].text != "."):
                    if end < len(tokens) and tokens[end].text in ("[", "="):
                        raise _Unhandled
                    self.reads |= name in env
                    name = env[name] if name in env else self._before(name)
            parts.append(name)
            at = end
        return " ".join(parts)
