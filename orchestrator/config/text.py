"""YAML text -> plain values with the place of each, and back.

YAML 1.2's core rules are used: `off`, `no` and `1:30` are text, `1e-3` is a number. PyYAML follows YAML 1.1,
which would turn the start value `mode: off` into false.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import yaml

from ..base.errors import ConfigError, Problem

Path = tuple[str | int, ...]

# What aliases may stand for, digits of a number, and levels of lists and mappings.
MOST_ALIASED, MOST_DIGITS, DEEPEST = 100_000, 1000, 100


@dataclass(frozen=True)
class Place:
    """Where a value was written: the file's name and the line, 0 where there is none."""

    source: str
    line: int = 0

    def __str__(self) -> str:
        return f"{self.source}:{self.line}" if self.line else self.source


def copied(value: Any) -> Any:
    """Plain values, with mappings and lists of their own all the way down."""
    if isinstance(value, Mapping):
        return {key: copied(item) for key, item in value.items()}
    return [copied(item) for item in value] if isinstance(value, list | tuple) else value


def path_text(path: Path) -> str:
    """A path as written in messages: connections[3], run.step_size."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


@dataclass
class Places:
    """Where each value of a config was written."""

    source: str
    known: dict[Path, Place] = field(default_factory=dict)

    def of(self, path: Path) -> Place:
        """Place of a value, or of the nearest enclosing one that is known."""
        for length in range(len(path), -1, -1):
            if path[:length] in self.known:
                return self.known[path[:length]]
        return Place(self.source)

    def text(self, path: Path) -> str:
        """Place and path, for Problem.place."""
        return ": ".join(part for part in (str(self.of(path)), path_text(path)) if part)


_CORE = {
    "tag:yaml.org,2002:null": (re.compile(r"null|Null|NULL|~|"), ["n", "N", "~", ""]),
    "tag:yaml.org,2002:bool": (re.compile(r"true|True|TRUE|false|False|FALSE"), list("tTfF")),
    "tag:yaml.org,2002:int": (re.compile(r"[-+]?[0-9]+"), list("-+0123456789")),
    "tag:yaml.org,2002:float": (
        re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"),
        list("-+.0123456789"),
    ),
}

_BaseLoader: Any = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


def _scalar_tag(text: str) -> str:
    for tag, (pattern, _) in _CORE.items():
        if pattern.fullmatch(text):
            return tag.rsplit(":", 1)[1]
    return "str"


def parse(text: str, source: str) -> tuple[Any, Places]:
    """Read YAML text.

    Args:
        text: the file's content.
        source: the file's name, for messages.
    Returns: plain values, and where each was written.
    Raises: ConfigError if the text is no YAML or a key is given twice.
    """
    value, places, problems = compose(text, source)
    if problems:
        raise ConfigError(problem for _, problem in problems)
    return value, places


def compose(text: str, source: str) -> tuple[Any, Places, list[tuple[Path, Problem]]]:
    """As `parse`; keys that cannot be taken, of several that are the same all but the first, are left out.

    Returns: plain values, where each was written, and the problems, each with the path that it concerns.
    Raises: ConfigError if the text is no YAML.
    """
    places = Places(source, {(): Place(source)})
    problems: list[tuple[Path, Problem]] = []
    try:
        node = yaml.compose(text, Loader=_BaseLoader)
        if node is not None:
            _check_extent(node, source)
        value = None if node is None else _construct(node, (), places, problems, ())
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = Place(source, mark.line + 1 if mark is not None else 0)
        what = " ".join(str(getattr(error, "problem", None) or error).split())
        raise ConfigError([Problem(str(place), f"not YAML: {what}")]) from error
    except RecursionError:
        raise ConfigError([_too_deep(Place(source))]) from None
    return value, places, problems


def _too_deep(place: Place) -> Problem:
    return Problem(str(place), "lists and mappings within each other", f"at most {DEEPEST} levels")


def _check_extent(root: Any, source: str) -> None:
    """Refuse what aliases or nesting make larger than any config: each alias is a copy of what it names.

    Raises: ConfigError.
    """
    sizes: dict[int, tuple[int, int]] = {}  # values that a node stands for, and its levels
    waiting, written = [root], 0
    while waiting:
        node = waiting[-1]
        if id(node) in sizes and sizes[id(node)][0] >= 0:
            waiting.pop()
            continue
        if isinstance(node, yaml.ScalarNode):
            parts = []
        elif isinstance(node, yaml.SequenceNode):
            parts = node.value
        else:
            parts = [one for pair in node.value for one in pair]
        if id(node) not in sizes:
            written += 1
            sizes[id(node)] = (-1, 0)  # begun; met again within itself it counts as nothing
            waiting += [one for one in parts if id(one) not in sizes]
            continue
        inner = [sizes[id(one)] for one in parts]
        sizes[id(node)] = (
            1 + sum(max(count, 0) for count, _ in inner),
            1 + max((level for _, level in inner), default=0),
        )
        if sizes[id(node)][1] > DEEPEST:
            raise ConfigError([_too_deep(Place(source, node.start_mark.line + 1))])
        waiting.pop()
    count = sizes[id(root)][0]
    if count - written > MOST_ALIASED:
        what = f"its aliases stand for {count - written if count < 10**15 else 'more than 1e15'} values"
        raise ConfigError([Problem(source, what, f"at most {MOST_ALIASED}", "Write out what is meant.")])


def _construct(
    node: Any, path: Path, places: Places, problems: list[tuple[Path, Problem]], above: tuple[int, ...]
) -> Any:
    line = node.start_mark.line + 1
    if path:
        places.known[path] = Place(places.source, line)
    if id(node) in above:
        problems.append((path, Problem(places.text(path), "an alias that contains itself")))
        return None
    if isinstance(node, yaml.ScalarNode):
        if len(node.value) > MOST_DIGITS and _scalar_tag(node.value) in ("int", "float"):
            what = f"a number of {len(node.value)} characters"
            problems.append((path, Problem(places.text(path), what, f"at most {MOST_DIGITS}")))
            return None
        return _scalar(node)
    above = (*above, id(node))
    if isinstance(node, yaml.SequenceNode):
        return [
            _construct(item, (*path, index), places, problems, above) for index, item in enumerate(node.value)
        ]
    mapping: dict[str, Any] = {}
    for key_node, value_node in node.value:
        if not isinstance(key_node, yaml.ScalarNode):
            problems.append((path, Problem(places.text(path), "a key that is not a name")))
            continue
        key = key_node.value
        if key in mapping:
            place = f"{places.source}:{key_node.start_mark.line + 1}: {path_text((*path, key))}"
            first = places.of((*path, key)).line
            twice = Problem(place, "given twice", f"first in line {first}", "Remove one of them.")
            problems.append(((*path, key), twice))
            continue
        mapping[key] = _construct(value_node, (*path, key), places, problems, above)
        places.known[(*path, key)] = Place(places.source, key_node.start_mark.line + 1)
    return mapping


def _scalar(node: Any) -> Any:
    text = node.value
    if node.style not in (None, ""):  # quoted or block text
        return text
    tag = _scalar_tag(text)
    if tag == "null":
        return None
    if tag == "bool":
        return text.lower() == "true"
    if tag == "int":
        return int(text)
    return float(text) if tag == "float" else text


class _Dumper(yaml.SafeDumper):
    """Quotes what either version of YAML would not read as text."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> Any:
    style = None if _scalar_tag(text) == "str" else "'"
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


def _represent_number(dumper: yaml.SafeDumper, number: float) -> Any:
    text = repr(number)
    if "e" in text and "." not in text:  # YAML 1.1 wants a point
        text = text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


_Dumper.add_representer(str, _represent_text)
_Dumper.add_representer(float, _represent_number)


def flow(value: Mapping[str, Any]) -> str:
    """Plain values as YAML in braces, on one line, for messages."""
    text = yaml.dump(
        dict(value), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=10**9, default_flow_style=True
    )
    return text.strip()


def dump(value: Mapping[str, Any]) -> str:
    """Plain values as YAML text that `parse` reads back as they are."""
    return yaml.dump(dict(value), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110)
