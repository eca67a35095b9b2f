"""Every notebook is kept with its outputs, and running it again gives the same numbers and pictures."""

from __future__ import annotations

import re
from typing import Any

import pytest

pytest.importorskip("nbformat", reason="needs the extra notebooks")
pytest.importorskip("nbclient", reason="needs the extra notebooks")

from tests.notebooks import NOTEBOOKS, executed, read

_NUMBER = re.compile(r"([-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)")
_LARGEST = 300_000


def texts(cell: Any) -> str:
    """All text that a cell has put out."""
    parts = [
        one.get("text", "") or one.get("data", {}).get("text/plain", "") for one in cell.get("outputs", [])
    ]
    return "".join(parts)


def pictures(cell: Any) -> int:
    return sum("image/png" in one.get("data", {}) for one in cell.get("outputs", []))


def tolerance(number: str) -> float:
    """Of a printed number: 1.5 units of its last digit, at least 1e-6 of it and 1e-7; none of an integer."""
    if number.lstrip("+-").isdigit():
        return 0.0
    mantissa, _, exponent = number.lower().partition("e")
    digits = len(mantissa.partition(".")[2])
    return max(1.5 * 10.0 ** (int(exponent or 0) - digits), 1e-6 * abs(float(number)), 1e-7)


def differing(kept: str, made: str) -> list[str]:
    """Where two texts differ in words, or in numbers by more than the tolerance."""
    ours, theirs = _NUMBER.split(kept), _NUMBER.split(made)
    if ours[::2] != theirs[::2]:
        return [f"{kept!r} became {made!r}"]
    pairs = zip(ours[1::2], theirs[1::2], strict=True)
    return [f"{a} became {b}" for a, b in pairs if not abs(float(a) - float(b)) <= tolerance(a)]


def test_there_are_notebooks():
    assert len(NOTEBOOKS) == 7


def test_numbers_are_compared_to_their_last_digit():
    assert differing("margin 5.267 ms", "margin 5.268 ms") == []
    assert differing("margin 5.267 ms", "margin 5.269 ms") == ["5.267 became 5.269"]
    assert differing("by 2.7e-13", "by 6.1e-13") == []
    assert differing("error 8.7e-04 dB", "error 9.7e-04 dB") == ["8.7e-04 became 9.7e-04"]
    assert differing("growth 1.142874208910458", "growth 1.142874208910412") == []
    assert differing("81 runs", "82 runs") == ["81 became 82"]
    assert differing("stable at 2 ms", "unstable at 2 ms") != []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook(path):
    assert path.stat().st_size < _LARGEST
    kept = read(path)
    code = [cell for cell in kept.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1)), (
        "kept without its outputs"
    )
    assert any(pictures(cell) for cell in code), "a notebook shows a figure"
    made = [cell for cell in executed(path).cells if cell.cell_type == "code"]
    for old, new in zip(code, made, strict=True):
        assert differing(texts(old), texts(new)) == [], old.source
        assert pictures(old) == pictures(new), old.source
