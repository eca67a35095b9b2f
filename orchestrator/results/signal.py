"""One recorded signal: its values over time, with the unit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from ..config.base import seconds

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Signal(NDArrayOperatorsMixin):
    """A recorded signal. numpy functions and arithmetic work on its values and return plain arrays.

    Attributes:
        name: instance.variable.
        time: instants, shape (n,) [s].
        values: shape (n,).
        unit: as the FMU declares it; empty where it declares none.
    """

    name: str
    time: NDArray[np.float64]
    values: NDArray[Any]
    unit: str = ""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=copy)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        plain = [one.values if isinstance(one, Signal) else one for one in inputs]
        return getattr(ufunc, method)(*plain, **options)

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, index: Any) -> Any:
        return self.values[index]

    def __iter__(self) -> Iterator[Any]:
        return iter(self.values)

    def at(self, time: float | str) -> float:
        """The value at an instant, linear between recorded points, constant beyond the first and last.

        Args:
            time: number [s], or text with a unit. Raises: ValueError if it is none.
        """
        return float(np.interp(seconds(time), self.time, self.values))

    def plot(self) -> Figure:
        """A figure of the signal over time, which notebooks show."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(8.0, 3.2), layout="constrained")
        axes = figure.subplots()
        axes.plot(self.time, self.values)
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"{self.name} [{self.unit}]" if self.unit else self.name)
        axes.grid(alpha=0.3)
        return figure

    def __repr__(self) -> str:
        unit = f" [{self.unit}]" if self.unit else ""
        if not len(self):
            return f"Signal {self.name}{unit}: no points"
        low, high = np.min(self.values), np.max(self.values)
        return (
            f"Signal {self.name}{unit}: {len(self)} points from {self.time[0]:g} s to {self.time[-1]:g} s, "
            f"between {low:.6g} and {high:.6g}"
        )

    def _repr_html_(self) -> str:
        return f"<code>{escape(repr(self))}</code>"
