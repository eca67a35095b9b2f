"""What a run returns: its signals, its summary, and the folder that it wrote."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.errors import OrchestratorError
from ..base.text_tables import html_table
from ..fmi import Array
from ..results.recorders import Results, read_results
from ..results.signal import Signal
from ..results.summary import Summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .preparation import Prepared


@dataclass(repr=False)
class RunResult:
    """What a run gave. `result["contact.force"]` is a `Signal`; `result.summary` holds the numbers.

    Attributes:
        results: the recorded signals.
        summary: as in summary.json; its keys are attributes as well.
        prepared: what ran; None if the run was read back from a folder.
        folder: where files were written; None if they were not.
        files: names of the files written.
        coupling: energies of the power bonds over time, at the recorded points; None without bonds.
    """

    results: Results
    summary: Summary
    prepared: Prepared | None = None
    folder: Path | None = None
    files: list[str] = field(default_factory=list)
    coupling: Results | None = None

    @property
    def time(self) -> Array:
        """Recorded instants, shape (n,) [s]."""
        return self.results.time

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recorded signals."""
        return tuple(self.results.signals)

    def __getitem__(self, name: str) -> Signal:
        """A signal by name, instance.variable. Raises: KeyError, which says what there is."""
        return Signal(name, self.results.time, self.results[name], self.results.units.get(name, ""))

    def to_dataframe(self) -> Any:
        """The signals as a pandas DataFrame: index time [s]; units in `attrs["units"]`.

        Raises: ImportError if pandas is not installed.
        """
        import pandas as pd

        frame = pd.DataFrame(
            {name: self.results[name] for name in self.names}, index=pd.Index(self.time, name="time")
        )
        frame.attrs["units"] = dict(self.results.units)
        return frame

    def to_xarray(self) -> Any:
        """The signals as an xarray Dataset over `time`; each with its `units` attribute.

        Raises: ImportError if xarray is not installed.
        """
        import xarray as xr

        units = self.results.units
        variables = {
            name: ("time", self.results[name], {"units": units.get(name, "")}) for name in self.names
        }
        return xr.Dataset(variables, coords={"time": ("time", self.time, {"units": "s"})})

    def plot(self, *names: str) -> Figure:
        """A figure of signals over time, one pair of axes for each unit; all real signals if none is named.

        Raises: KeyError, which says what there is.
        """
        from ..plotting.figures import draw_signals

        for name in names:
            self.results[name]
        return draw_signals(self.results, str(self.summary.get("title") or ""), names or None)

    def __repr__(self) -> str:
        return "\n".join(f"{name}: {value}" for name, value in self._lines())

    def _repr_html_(self) -> str:
        return html_table(self._lines())

    def _lines(self) -> list[tuple[str, str]]:
        run = self.summary.get("run") or {}
        shown = ", ".join(self.names[:6]) + (", ..." if len(self.names) > 6 else "")
        lines = [("run", str(self.summary.get("title") or "without a title"))]
        if len(self.results):
            span = f"{self.time[0]:g} s to {self.time[-1]:g} s"
            lines.append(("time", f"{span}, {len(self.results)} recorded points"))
        if run:
            lines.append(("master", f"{run['master']}, steps of {run['step_size']:g} s"))
        lines.append((f"{len(self.names)} signals", shown))
        if error := self.summary.get("error"):
            lines.append(("error", str(error.get("message"))))
        if self.folder is not None:
            lines.append(("folder", str(self.folder)))
        return lines


def read_run(path: Path | str) -> RunResult:
    """Read a run back, one that goes on or was killed, too.

    Args:
        path: a folder that a run wrote, or a file of results: arrow, csv, parquet, mat or h5.
    Raises: OrchestratorError if it cannot be read.
    """
    path = Path(path)
    results = read_results(path)
    summary = path / "summary.json"
    content: dict[str, Any] = {}
    if summary.is_file():
        try:
            content = json.loads(summary.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise OrchestratorError(f"{summary}: cannot be read ({error})") from error
    return RunResult(results, Summary(content), folder=path if path.is_dir() else None)
