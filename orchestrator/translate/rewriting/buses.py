"""Expandable connectors: the members that only connections declare, written into the connectors.

The compiler drops a member that nothing but other members is connected to. So all connectors that a model's
files connect with each other get the members of each other.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from orchestrator.base.errors import BuildError

from ..lexer import Token, closing
from ..sources import SourceTree
from .declared_classes import DeclaredClass, DeclaredClasses, own_tokens
from .modifiers import arguments
from .source_edits import edited, text_end

_MARK = "member of a bus: "
_TYPES = {"TypeId(0)": "Real", "TypeId(1)": "Integer", "TypeId(2)": "Boolean"}
_UNLIKE = re.compile(
    r"incompatible connector types in connection: (\S+) \(type_id: (TypeId\(\d+\))\) and "
    r"(\S+) \(type_id: (TypeId\(\d+\))\)"
)


def types_of_members(refusal: str) -> Iterator[str]:
    """What the compiler says of connections to members that `with_members` took for Reals."""
    for match in _UNLIKE.finditer(refusal):
        for path, own, other in ((match[1], match[2], match[4]), (match[3], match[4], match[2])):
            if own == "TypeId(0)" and other in _TYPES:
                yield f"{_MARK}{_TYPES[other]} {path.rpartition('.')[2]}"


def with_members(texts: Mapping[str, str], found: frozenset[str] = frozenset()) -> dict[str, str]:
    """The files whose expandable connectors get members, with these.

    Args:
        texts: path -> content of all files of a model.
        found: by `types_of_members`; members are Reals otherwise.
    """
    if not _any(texts):
        return {}
    types = dict(one.removeprefix(_MARK).split()[::-1] for one in found if one.startswith(_MARK))
    edits: dict[str, list[tuple[int, int, str]]] = {}
    for bus, members in _Buses(texts).missing():
        made = "".join(f" {kind or types.get(name, 'Real')} {name};" for name, kind in members.items())
        place = text_end(bus.tokens[bus.body - 1])
        edits.setdefault(bus.file, []).append((place, place, f"{made} "))
    return {file: edited(texts[file], some) for file, some in edits.items()}


def refuse_unknown_members(tree: SourceTree, variables: Sequence[str]) -> None:
    """Raises: BuildError for a connection of a member to a connector of a library that is no signal.

    The compiler would take such a connection for one of nothing.

    Args:
        variables: the names of all variables of the flat model.
    """
    if not _any(tree.texts):
        return
    subscripts = re.compile(r"\[[^\]]*\]")
    names = {f".{subscripts.sub('', one)}" for one in variables}
    wrong = []
    for item, token, path, other in _Buses(tree.texts, tree.label).signals():
        end = f".{'.'.join(other[-2:])}"
        if any(f"{end}." in one for one in names) and not any(one.endswith(end) for one in names):
            wrong.append(
                f"{tree.at(item.file, token)}: only this connection declares the bus member `{path[-1]}`, "
                f"and `{'.'.join(other)}` is no signal; declare `{path[-1]}` in the connector"
            )
    if wrong:
        raise BuildError("\n".join(wrong))


def _any(texts: Mapping[str, str]) -> bool:
    return any(re.search(r"\bexpandable\s+connector\b", text) for text in texts.values())


_Signal = tuple[DeclaredClass, Token, Sequence[str], Sequence[str]]


class _Buses:
    """The expandable connectors of a model's files, and what is connected to them.

    Classes are known by their last names; those of one name count as one.
    """

    def __init__(self, texts: Mapping[str, str], label: str = "") -> None:
        classes = list(DeclaredClasses(dict(texts), label, ()).all_classes())
        self._buses: list[DeclaredClass] = []
        self._components: dict[str, dict[str, str]] = {}  # class -> component -> class
        self._bases: dict[str, list[str]] = {}
        self._members: dict[str, dict[str, str]] = {}  # those that connections add
        self._signals: dict[Token, _Signal] = {}
        self._names: dict[str, str] = {}
        for one in classes:
            name, tokens = _last(one), one.tokens
            components = self._components.setdefault(name, {})
            bases = self._bases.setdefault(name, [])
            for part in one.parts:
                last = tokens[part.path[1] - 1].text
                components |= {tokens[at].text: last for at, _ in part.names}
                bases += [last] if part.kind == "extends" else []
            if one.kind == "connector":
                self._names[name] = f".{one.name}"
                prefixes = {token.text for token in tokens[one.first : one.label]}
                if one.short is None and "expandable" in prefixes:
                    self._buses.append(one)
        self._group = {_last(one): _last(one) for one in self._buses}
        for bus in list(self._group):
            for base in self._bases[bus]:
                if base in self._group:
                    self._join(bus, base)
        ends = [(one, *found) for one in classes for found in _connections(one)]
        known = -1
        while known != (
            known := len({self._of(one) for one in self._group}) + sum(map(len, self._members.values()))
        ):
            for item, token, first, second in ends:
                self._connected(item, token, first, second)
                self._connected(item, token, second, first)

    def signals(self) -> Iterator[_Signal]:
        """Connections of what counts as a signal: class and place, path of the member and of the other."""
        yield from self._signals.values()

    def missing(self) -> Iterator[tuple[DeclaredClass, dict[str, str]]]:
        """Connectors with the members that they lack: name -> type, "" for what signals are connected to.

        Those that a connected one declares are among them.
        """
        for bus in self._buses:
            group = self._of(_last(bus))
            members = dict(self._members.get(group, {}))
            for other in {one for one in self._group if self._of(one) == group}:
                for name, kind in self._components[other].items():
                    members.setdefault(name, self._full(kind))
            lacking = {
                name: kind
                for name, kind in sorted(members.items())
                if self._declared(_last(bus), name) is None
            }
            if lacking and not any(base in self._group for base in self._bases[_last(bus)]):
                yield bus, lacking

    def _full(self, kind: str) -> str:
        """How any class can name the type of a member: an expandable connector, or "" for a signal."""
        return self._names[kind] if kind in self._group else kind * (kind in _TYPES.values())

    def _is_signal(self, kind: str) -> bool:
        """Whether a connector has no parts, as far as the files show."""
        return not (self._components.get(kind) or self._bases.get(kind))

    def _of(self, bus: str) -> str:
        while self._group[bus] != bus:
            bus = self._group[bus]
        return bus

    def _join(self, one: str, other: str) -> None:
        one, other = self._of(one), self._of(other)
        if one != other:
            self._group[other] = one
            self._members[one] = self._members.pop(other, {}) | self._members.get(one, {})

    def _declared(self, owner: str, name: str, depth: int = 0) -> str | None:
        """The class of a component; None if there is none, or it is not in the files."""
        if name in self._components.get(owner, {}):
            return self._components[owner][name]
        found = (self._declared(base, name, depth + 1) for base in self._bases.get(owner, ()) if depth < 50)
        return next((one for one in found if one is not None), None)

    def _class_of(self, scope: str, path: Sequence[str]) -> str | None:
        owner: str | None = scope
        for name in path:
            if owner is None:
                return None
            found = self._declared(owner, name)
            if found is None and owner in self._group:
                found = self._members.get(self._of(owner), {}).get(name, "").rpartition(".")[2] or None
            owner = found
        return owner

    def _connected(
        self, item: DeclaredClass, token: Token, path: Sequence[str], other: Sequence[str]
    ) -> None:
        """Take up that `path` is connected to `other`."""
        kind, owner, own = (self._class_of(_last(item), one) for one in (other, path[:-1], path))
        if own in self._group:
            if kind in self._group:
                self._join(str(own), str(kind))
        elif owner in self._group and own is None and (kind in self._group or self._is_signal(kind or "")):
            members = self._members.setdefault(self._of(str(owner)), {})
            members[path[-1]] = self._full(kind or "") or members.get(path[-1], "")
            if not members[path[-1]]:
                self._signals[token] = (item, token, path, other)


def _last(one: DeclaredClass) -> str:
    return one.tokens[one.label].text


def _path(tokens: Sequence[Token], at: int) -> list[str]:
    """The names of a path that begins at a token, without subscripts."""
    at += tokens[at].text == "."
    found = []
    while tokens[at].kind == "name":
        found.append(tokens[at].text)
        at += 1
        if tokens[at].text == "[":
            at = closing(tokens, at) + 1
        if tokens[at].text != ".":
            break
        at += 1
    return found


def _connections(one: DeclaredClass) -> Iterator[tuple[Token, list[str], list[str]]]:
    tokens = one.tokens
    for at in own_tokens(one):
        if tokens[at].text == "connect" and tokens[at + 1].text == "(":
            ends = arguments(tokens, at + 1)
            first, second = ([*(_path(tokens, begin) for begin, _ in ends), [], []])[:2]
            # A member that is itself an array is left to the compiler.
            if first and second and all(tokens[last].text != "]" for _, last in ends):
                yield tokens[at], first, second
