"""The summary of a run: a dict whose keys are attributes as well."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ..base.errors import listed, nearest
from ..base.text_tables import html_table


class Summary(dict[str, Any]):
    """Numbers and texts of a run by name, as in summary.json: `summary["run"]["steps"]`, `summary.run.steps`.

    What is nested is a `Summary` itself. It prints as a table, without config, parameters and provenance.
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

    def __repr__(self) -> str:
        rows = self._shown()
        width = max((len(name) for name, _ in rows), default=0)
        return "\n".join(f"{name:<{width}}  {value}" for name, value in rows)

    def _repr_html_(self) -> str:
        return html_table(self._shown(), ("name", "value"))

    def _shown(self) -> list[tuple[str, str]]:
        hidden = ("config", "parameters", "provenance")
        shown = Summary({key: value for key, value in self.items() if key not in hidden})
        return [(name, _short(value)) for name, value in shown.flat() if value != ""]


def _nested(value: Any) -> Any:
    if isinstance(value, Mapping):
        return value if isinstance(value, Summary) else Summary(value)
    return [_nested(one) for one in value] if isinstance(value, list) else value


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list) and value and isinstance(value[0], Summary):
        return f"{len(value)} rows: {', '.join(value[0])}"
    text = str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
