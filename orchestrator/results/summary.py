"""The summary of a run: a dict whose keys are attributes as well."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from ..base.errors import listed, nearest

__all__ = ["Summary"]


class Summary(dict[str, Any]):
    """Numbers and texts of a run by name, as in summary.json: `summary["run"]["steps"]`, `summary.run.steps`.

    What is nested is a `Summary` itself. In a notebook it is a table.
    """

    def __init__(self, values: Mapping[str, Any] | None = None) -> None:
        super().__init__({key: _nested(value) for key, value in (values or {}).items()})

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError:
            raise AttributeError(
                f"no {name!r}; there are {listed(self)}. {nearest(name, self)}".strip()
            ) from None

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *(key for key in self if key.isidentifier())]

    def __reduce__(self) -> tuple[type[Summary], tuple[dict[str, Any]]]:
        return Summary, (dict(self),)

    def flat(self) -> Iterator[tuple[str, Any]]:
        """Every number and text with its path, such as ("run.steps", 4000); lists are left whole."""
        for key, value in self.items():
            if isinstance(value, Summary):
                yield from ((f"{key}.{rest}", one) for rest, one in value.flat())
            else:
                yield key, value

    def _repr_html_(self) -> str:
        hidden = ("config", "parameters", "provenance")
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{escape(_short(value))}</td></tr>"
            for name, value in Summary({k: v for k, v in self.items() if k not in hidden}).flat()
        )
        return f"<table><tr><th>name</th><th>value</th></tr>{rows}</table>"


def _nested(value: Any) -> Any:
    if isinstance(value, Mapping):
        return value if isinstance(value, Summary) else Summary(value)
    return [_nested(one) for one in value] if isinstance(value, list) else value


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    text = str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
