"""Signals for plots within a page: as recorded, or thinned with lowest and highest values kept."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Array
from ...results.recorders import Results

# What a number takes in the page: four bytes in base 64.
_BYTES = 4 * 4 / 3


class SignalStore:
    """Gathers signals of one or several runs, and the charts that show them.

    Attributes:
        notes: what a reader has to know of the numbers, one sentence per run that was thinned.
    """

    def __init__(self, budget: int) -> None:
        """
        Args:
            budget: what all signals together may take in the page [B], about; thinned ones stay below it.
        """
        self._budget = budget
        self._arrays: dict[str, dict[str, Any]] = {}
        self._charts: list[dict[str, Any]] = []
        self._scene: dict[str, Any] | None = None
        self.notes: list[str] = []

    def add(self, results: Results, names: Sequence[str], run: str = "", share: float = 1.0) -> None:
        """Take signals of a run.

        Args:
            names: of signals.
            run: its name, where there are several.
            share: the part of the budget that is this run's.
        """
        time = results.time
        moving = {name: np.asarray(results[name], dtype=float) for name in names}
        still = {name: values[0] for name, values in moving.items() if len(values) and _is_still(values)}
        # The time is kept in eight bytes.
        width = len(moving) - len(still) + 2
        most = max(int(self._budget * share / (_BYTES * width)), 64)
        block = -(-2 * len(time) // most) if len(time) > most else 1
        self._arrays[self.key("time", run)] = _encoded(time[_first_rows(len(time), block)], "<f8")
        for name, values in moving.items():
            if name in still:
                kept = {"constant": _finite(float(still[name]))}
            else:
                kept = _encoded(values if block == 1 else extremes(values, block))
            self._arrays[self.key(name, run)] = kept
        if block > 1:
            span = float(time[block] - time[0])
            of = f"{run}: " if run else ""
            self.notes.append(
                f"{of}{len(time)} instants are too many for a page; of every {block} ({span:.3g} s) it holds "
                "the lowest and the highest value of each signal, so that no peak is lost."
            )

    def add_values(self, key: str, values: Sequence[float]) -> None:
        """Take numbers as they are, under an id of their own."""
        self._arrays[key] = _encoded(np.asarray(values, dtype=float), "<f8")

    def __len__(self) -> int:
        return len(self._arrays)

    @staticmethod
    def key(name: str, run: str = "") -> str:
        """The id of a signal in the page."""
        return f"{run}/{name}" if run else name

    def __contains__(self, key: str) -> bool:
        return key in self._arrays

    def chart(
        self,
        title: str,
        unit: str,
        series: Sequence[Mapping[str, Any]],
        static: str = "",
        *,
        x: str = "time [s]",
        joined: bool = True,
    ) -> str:
        """A chart as HTML.

        Args:
            title: stands above.
            unit: of the values.
            series: of each `label`, `x` and `y`, ids of arrays, and `shown`, whether it is so at first.
            static: SVG for readers without JavaScript and for print.
            x: what the horizontal axis shows; charts of the same are zoomed together.
            joined: whether points are joined by lines; those over something else than time are marked, too.
        """
        self._charts.append(
            {"title": title, "unit": unit, "series": [dict(one) for one in series], "x": x, "joined": joined}
        )
        return (
            f'<section class=chart data-chart="{len(self._charts) - 1}"><h3>{escape(title)}</h3>'
            f"<div class=live></div><div class=static>{static}</div></section>"
        )

    def set_scene(self, scene: Mapping[str, Any]) -> None:
        """What moves, for the view of motion; see scene.js for the keys."""
        self._scene = dict(scene)

    def data(self) -> dict[str, Any]:
        """Everything, as JSON has it."""
        return {"arrays": self._arrays, "charts": self._charts, "scene": self._scene}


def _is_still(values: Array) -> bool:
    return bool(np.all(values == values[0])) or bool(np.all(np.isnan(values)))


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _first_rows(count: int, block: int) -> NDArray[np.intp]:
    """Rows whose time stands for a block: its first, and the one in its middle."""
    if block == 1:
        return np.arange(count)
    starts = np.arange(0, count, block)
    return np.stack([starts, np.minimum(starts + block // 2, count - 1)], axis=1).ravel()


def extremes(values: Array, block: int) -> Array:
    """Lowest and highest value of every block, in the order in which they occur.

    Args:
        values: shape (n,); NaN stands aside where a block has other values.
        block: rows of a block; the last one may be shorter.
    Returns: shape (2*ceil(n/block),).
    """
    rest = -len(values) % block
    blocks = np.concatenate([values, np.full(rest, values[-1])]).reshape(-1, block)
    low = np.where(np.isnan(blocks), np.inf, blocks).argmin(axis=1)
    high = np.where(np.isnan(blocks), -np.inf, blocks).argmax(axis=1)
    pair = np.sort(np.stack([low, high], axis=1), axis=1)
    return np.take_along_axis(blocks, pair, axis=1).ravel()


def _encoded(values: Array, kind: str = "<f4") -> dict[str, Any]:
    """Numbers in base 64: seven digits, or sixteen where these do not hold the range."""
    finite = np.abs(values[np.isfinite(values)])
    if finite.size and (finite.max() > np.finfo(np.float32).max):
        kind = "<f8"
    return {
        "type": kind[1:],
        "data": base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii"),
    }
