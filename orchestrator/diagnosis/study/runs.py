"""Reads the logged runs of a study of ports."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import Problem, listed, nearest
from ...system.connection import Port
from .channels import logged_twice
from .keys import Logged, Role, RunModel
from .log_checks import clock_of_stamps, clock_slack
from .mapping import columns_of
from .mistakes import plural
from .sheet import Sheet
from .study import Array, PortRun

# Samples may be apart by other than the communication step by this share of it.
_UNEVEN = 0.01
# Seconds that a clock's counts may be taken for.
_CLOCKS = {1e-3: "ms", 1e3: "s, not ms", 1e-6: "us", 1e6: "s, not us", 1e-9: "ns", 1e9: "s, not ns"}
# Samples of a run that are compared, at the least.
_FEWEST = 100
# Messages may come late for good by so many steps, and by so many times what the least late ones of so many
# deviate; the first and the last so many say where others should be, since any one may itself be late.
_STRAYED, _JITTERS, _ENDS = 3.0, 8.0, 20
# Messages that are apart by so much more or less of the step have another, and not a clock that is off.
_ANOTHER = 0.1


@dataclass(frozen=True)
class Columns:
    """What is known of the columns of logs.

    Attributes:
        named: signals that the study gives columns, whether those can be taken or not.
        mapping: those that can.
        units: in which signals are taken, by name.
        step: communication step [s]; None if it is not known.
        compared: signals that are compared. gappy: those that may lack a few rows.
        number: reads the value of a parameter or a start value, from its name, the value and its place; None
            if nothing is known of the system.
    """

    named: tuple[str, ...]
    mapping: Mapping[str, Logged]
    units: Mapping[str, str]
    step: float | None
    compared: tuple[str, ...] = ()
    gappy: tuple[str, ...] = ()
    number: Callable[..., float | None] | None = None


def read_runs(
    sheet: Sheet, entries: Sequence[Any] | None, columns: Columns, settled: int
) -> tuple[PortRun, ...]:
    """The runs that can be read; all that is wrong with the others, and with any, is reported.

    Args:
        entries: of the study; None if they are no list.
        settled: samples at the begin of each run that are not compared.
    """
    if entries is None:
        return ()
    taken = [sheet.taken(RunModel, entry, "runs", number) for number, entry in enumerate(entries)]
    # A run of training that cannot be read is one all the same.
    if not any(wrong or model.role is Role.TRAIN for model, wrong in taken):
        sheet.add(("runs",), "no run has the role train", "at least one")
    before = len(sheet.problems)
    read = [_Run(sheet, number, *one, columns).read() for number, one in enumerate(taken)]
    logs = [str(sheet.file.parent / one.file) for one, _ in taken if one.file is not None]
    sheet.problems[before:] = _once(sheet.problems[before:], logs)
    names = [None if one is None else one.name for one in read]
    for number, (model, wrong) in enumerate(taken):
        # Of a run with which something else is wrong the role is as written.
        repeating = model.role in (Role.REPEAT, Role.REPEAT.value)
        if repeating and model.repeats is None and "repeats" not in wrong:
            others = [name for at, name in enumerate(names) if name is not None and at != number]
            remedy = "Add it, or give the run another role."
            what = "a run of the role repeat has no `repeats`"
            sheet.add(("runs", number), what, listed(others), remedy)
    for number, run in enumerate(read):
        if run is None:
            continue
        if run.name in names[:number]:
            sheet.add(
                ("runs", number), f"two runs are called {run.name}", remedy="Give one of them a `name`."
            )
        if run.logs and len(run) - settled < _FEWEST:  # without any, its columns are the problem
            what = f"{run.name} has {len(run)} samples, {settled} of them while it settles"
            sheet.add(("runs", number), what, f"at least {_FEWEST} more", "Log longer, or settle less.")
        others = [one for one in names if one is not None and one != run.name]
        if run.repeats is not None and run.repeats not in others and None not in names:
            what = f"{run.name} repeats {run.repeats}, which is no run"
            sheet.add(("runs", number, "repeats"), what, listed(others), nearest(run.repeats, others))
    found = tuple(run for run in read if run is not None)
    sheet.problems += logged_twice([(run.name, run.logs) for run in found], sheet.place("runs"))
    return found


def _once(problems: Sequence[Problem], logs: Sequence[str]) -> list[Problem]:
    """Problems; what is the same in several logs is reported of the first."""
    kinds: dict[object, list[Problem]] = {}
    for one in problems:
        log = next((log for log in logs if f"{one.place}:".startswith(f"{log}:")), None)
        key = id(one) if log is None else replace(one, place=one.place.removeprefix(log))
        kinds.setdefault(key, []).append(one)
    return [
        replace(first, what=f"{first.what}; the same in {len(more)} more run{plural(more)}")
        if more
        else first
        for first, *more in kinds.values()
    ]


class _Run:
    """Reads one run; `wrong`: keys with which something is wrong."""

    def __init__(
        self, sheet: Sheet, number: int, model: RunModel, wrong: frozenset[str], columns: Columns
    ) -> None:
        self.sheet, self.model, self.wrong, self.columns = sheet, model, wrong, columns
        self.place = ("runs", number)
        self.path = sheet.file.parent / (model.file or "")
        self.begin = sheet.seconds(model.begin, *self.place, "from")
        self.end = sheet.seconds(model.end, *self.place, "to", absent=np.inf)
        self.first = 0

    def read(self) -> PortRun | None:
        """None if it cannot be read, which is reported."""
        model, mapping, sheet = self.model, self.columns.mapping, self.sheet
        before = len(sheet.problems)
        unknown = [name for name in model.without if name not in self.columns.named]
        if unknown:
            near = nearest(unknown[0], self.columns.named)
            what = f"{listed(unknown)} has no column"
            sheet.add((*self.place, "without"), what, listed(self.columns.named), near)
        compared = self.columns.compared
        if compared and set(compared) <= set(model.without):
            called = model.name or self.path.name
            what = f"`without` leaves nothing of {called} to compare"
            remedy = "Leave one of them in, or leave the run out."
            sheet.add((*self.place, "without"), what, f"at least one of {listed(compared)}", remedy)
        if not self.begin < self.end:
            what = f"from {model.begin} to {model.end} holds no samples"
            sheet.add((*self.place, "to"), what, "an end after the begin")
        if not self.path.exists():
            there = [one.name for one in self.path.parent.iterdir()] if self.path.parent.is_dir() else []
            what = f"no file {self.path.name} in {self.path.parent}"
            sheet.add((*self.place, "file"), what, remedy=nearest(self.path.name, there))
        values = {
            Port.of(name): found for name, value in model.values.items()
            if self.columns.number is not None
            and (found := self.columns.number(name, value, *self.place, "set", name)) is not None
        }  # fmt: skip
        if len(sheet.problems) > before or self.wrong:
            return None
        wanted = {name: one for name, one in mapping.items() if name not in model.without}
        clock = None if "time" in self.columns.named else "run.step_size"
        columns = columns_of(
            self.path, wanted, self.columns.units, self.columns.step, sheet.problems, self._part, clock,
            self.columns.gappy,
        )  # fmt: skip
        if columns is None:
            return None
        stem = Path(self.path.name.removesuffix(".gz")).stem
        logs = {Port.of(name): log for name, log in columns.items() if name != "time"}
        gaps = {port: np.isnan(log) for port, log in logs.items() if np.isnan(log).any()}
        for port, empty in gaps.items():
            rows = np.arange(len(empty))
            logs[port] = np.interp(rows, rows[~empty], logs[port][~empty])
        return PortRun(
            model.name or (stem if model.begin is None else f"{stem}-{self.first}"),
            model.role,
            logs,
            model.repeats,
            self.path,
            values,
            gaps,
        )

    def _part(self, time: Array) -> slice | None:
        """The rows from begin to end, by the times of all [s]; None if they are none, or uneven."""
        step = self.columns.step
        assert step is not None
        log_end = float(time[-1])
        if np.isfinite(self.end) and self.end > log_end + step * (1.0 + _UNEVEN):
            what = f"got {self.model.end!r}, but {self.path.name} ends before"
            remedy = "Leave it out to take all that was logged."
            self.sheet.add((*self.place, "to"), what, f"up to {log_end:.6g} s", remedy)
            return None
        if not (np.diff(time) >= 0.0).all():
            self._report_uneven(time, 0)
            return None
        # Stamps jitter: a sample is taken as at the nearest communication point.
        first, last = np.searchsorted(time, [self.begin - step / 2, self.end - step / 2]).tolist()
        if not first < last - 2:
            end = "its end" if self.model.end is None else self.model.end
            what = f"from {self.model.begin or '0 s'} to {end} holds no samples"
            self.sheet.add(self.place, what, f"up to {log_end:.6g} s, and at least three")
            return None
        taken = time[first:last]
        if not (self._even(taken, first) if "time" in self.columns.named else self._steady(taken, first)):
            return None
        self.first = first
        return slice(first, last)

    def _even(self, time: Array, first: int) -> bool:
        """Whether samples are a step apart, and stay so; says if not. first: number of the first row."""
        step = self.columns.step
        assert step is not None
        if not np.isclose(np.diff(time), step, rtol=0, atol=_UNEVEN * step).all():
            self._report_uneven(time, first)
            return False
        if abs(time[-1] - time[0] - step * (len(time) - 1)) > clock_slack(len(time), step):
            self._report_clock(time)
            return False
        return True

    def _steady(self, time: Array, first: int) -> bool:
        """Whether as many messages came as steps went by; says if not. Arguments as those of `_even`.

        Messages come early and late, or many at once after a while: how late one is counts only as far as
        none of those after it makes up for it, or all of those before it were as late.
        """
        step = self.columns.step
        assert step is not None
        late = time - time[0] - step * np.arange(len(time))
        ends = min(_ENDS, len(time))
        after = np.minimum.accumulate(late[::-1])[::-1][: len(time) - ends + 1]
        # Those that waited while the recorder began are written down at once.
        waited = int(np.argmin(np.append(np.diff(time) < step / 10.0, False)))
        first_ends = ends + waited if waited < len(time) / 2 - ends else ends
        before = np.minimum.accumulate(late)[first_ends - 1 :]
        lost, double = after[-1] - after[0], before[0] - before[-1]
        # A clock that is off makes no second differences, and a gap few.
        least = late[: len(late) // ends * ends].reshape(-1, ends).min(axis=1)
        jitter = float(np.median(np.abs(np.diff(least, 2)))) if len(least) > 2 else 0.0
        allowed = (_STRAYED - 1.0) * step + clock_slack(len(time), step) + _JITTERS * jitter
        if max(lost, double) <= allowed:
            return True
        gaps = np.diff(after)
        # Median and mean: what jitters may have either off.
        apart = np.array([np.median(np.diff(time)), np.mean(np.diff(time))])
        if lost > double and gaps.max() > lost / 4.0:
            row = int(np.argmax(gaps)) + 1
            what = f"row {first + row} comes {time[row] - time[row - 1]:.6g} s after the one before, at "
            what += f"{time[row]:.6g} s; none after it makes up for {gaps[row - 1]:.3g} s: some are missing"
            self._report_time(what, "Take the run up to there, by `to`, or the one after, by `from`.")
        elif (np.abs(apart - step) > _ANOTHER * step).all():
            self._report_uneven(time, first)
        else:
            self._report_clock(time)
        return False

    def _report_clock(self, time: Array) -> None:
        """Report that stamps are those of another clock than the step's."""
        step = self.columns.step
        assert step is not None
        mean = float(time[-1] - time[0]) / (len(time) - 1)
        remedy = f"Set run.step_size under `set`, or `interval`, so that samples are {mean:.6g} s apart; or "
        self._report_time(clock_of_stamps(time, step), remedy + "correct the clock that the stamps are of.")

    def _report_uneven(self, time: Array, first: int) -> None:
        """Report that samples are not apart as they should be, and where; first: number of the first row."""
        step, apart = self.columns.step, np.diff(time)
        assert step is not None
        usual, row = float(np.median(apart)), int(np.argmax(np.abs(apart - np.median(apart))))
        what = f"samples are {usual:.6g} s apart"
        remedy = "Set run.step_size under `set`, or resample the log."
        parts = round(usual / step)
        if parts > 1 and abs(usual - parts * step) <= _UNEVEN * step:
            remedy = f"Set the study's interval, `interval: {parts * step:.6g} s`, or resample the log."
        for factor, unit in _CLOCKS.items():
            if abs(factor * usual - step) <= _UNEVEN * step:
                remedy = f"All fits if the log's clock counts in {unit}: correct the unit of time."
        if abs(usual - step) <= _UNEVEN * step:
            wrong = int(np.sum(np.abs(apart - step) > _UNEVEN * step))
            what = f"row {first + row + 1} comes {apart[row]:.6g} s after the one before; {wrong} such in all"
            remedy = "Take the run up to there, by `to`, or the one after, by `from`; or resample the log."
        self._report_time(what, remedy)

    def _report_time(self, what: str, remedy: str) -> None:
        allowed = f"the communication step of the system, or the study's interval, {self.columns.step:.6g} s"
        self.sheet.problems.append(Problem(f"{self.path}: time", what, allowed, remedy))
