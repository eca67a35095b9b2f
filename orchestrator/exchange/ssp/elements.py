"""Names of SSP's elements, and what fmpy's schemas say of a file."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

_BASE = "http://ssp-standard.org/SSP1/SystemStructure"
SPACES = {
    "ssc": f"{_BASE}Common",
    "ssd": f"{_BASE}Description",
    "ssv": f"{_BASE}ParameterValues",
    "ssm": f"{_BASE}ParameterMapping",
    "ssb": f"{_BASE}SignalDictionary",
}


def schema_errors(root: Any, space: str) -> list[str]:
    """What breaks the schema of SSP 1.0 that fmpy carries."""
    return [f"line {one.line}: {one.message}" for one in _schema_log(space, root)]


def _schema_log(space: str, root: Any) -> Any:
    schema = _schema(space)
    schema.validate(root)
    return schema.error_log


@cache
def _schema(space: str) -> Any:
    import fmpy
    from lxml import etree

    name = SPACES[space].rpartition("/")[2]
    return etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "ssp" / "schema" / f"{name}.xsd"))


def tag_of(space: str, name: str) -> str:
    """The tag of an element as lxml has it."""
    return f"{{{SPACES[space]}}}{name}"


def children(node: Any, space: str, name: str) -> list[Any]:
    """The child elements of a name."""
    return node.findall(tag_of(space, name))


def space_of(node: Any) -> str:
    """Short name of an element's namespace; empty if it is not SSP's."""
    if not isinstance(node.tag, str):
        return ""
    return next((short for short, space in SPACES.items() if node.tag.startswith(f"{{{space}}}")), "")


def local(node: Any) -> str:
    """The tag of an element without its namespace; empty for comments."""
    return node.tag.rpartition("}")[2] if isinstance(node.tag, str) else ""
