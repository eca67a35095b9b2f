"""A long search says how far it is."""

from __future__ import annotations

import re
from itertools import pairwise
from types import SimpleNamespace

from orchestrator.cli.diagnosis import _Bar
from orchestrator.diagnosis.search import each
from orchestrator.diagnosis.search_progress import (
    SearchProgress,
    counted_calls,
    progress_reported,
    stage,
    twice,
)
from orchestrator.results.progress import Share


class Clock:
    """Seconds that pass as they are asked to."""

    now = 0.0

    def __call__(self) -> float:
        return self.now

    def work(self, seconds: float) -> None:
        self.now += seconds


def seconds(line):
    """The time left in a line; None where it tells none."""
    found = re.search(r"about (\d+) (s|min) left", line)
    return found and int(found[1]) * (60 if found[2] == "min" else 1)


def searched(clock, candidates, stages):
    """What a search tells, with the time of each line.

    Args:
        stages: name, looks and fits of each stage, and seconds that one of these takes.
    """
    told = []
    with progress_reported(SearchProgress(candidates, lambda line: told.append((clock.now, line)), clock)):
        for name, looks, look, fits, fit in stages:
            stage(name)
            each(counted_calls(lambda _, look=look: clock.work(look), False, 1), range(looks), 1)
            each(counted_calls(lambda _, fit=fit: clock.work(fit), True, 1), range(fits), 1)
    return told


def test_looks_and_fits_are_counted():
    clock, told = Clock(), []
    with progress_reported(SearchProgress(10, told.append, clock)):
        each(counted_calls(lambda _: clock.work(1.0), False, 1), range(20), 1)
        # Planned are 2 x 10 looks of the first stage, 6.5 x 10 of later ones, and 76 fits.
        assert told[0] == "weigh 2/161 candidates and fits" and seconds(told[-1]) > 0
        assert told[-1].startswith("weigh 20/161 candidates and fits, about ")
        stage("ties")
        each(counted_calls(lambda _: clock.work(2.0), True, 1), range(3), 1)
        # 2 x 10 looks and 21 fits, 3 of which are done.
        assert told[-1].startswith("weigh 23/61 candidates and fits")
        stage("step")
        each(counted_calls(lambda _: clock.work(1.0), False, 1), range(10), 1)
        assert told[-1].startswith("weigh 33/49 candidates and fits")
        stage("candidates")  # weighed anew, all is to be done once more
        each(counted_calls(lambda _: clock.work(1.0), False, 1), range(10), 1)
        assert (told[-1].stage, told[-1].done, told[-1].total) == ("weigh", 43, 194)
        again = "weigh again, the step's own error taken off: 43/194 candidates and fits"
        assert told[-1].startswith(again)
    before = len(told)
    each(counted_calls(lambda _: clock.work(9.0), False, 1), range(3), 1)
    assert len(told) == before  # nobody counts


def test_the_time_left_is_steady():
    """Fits of several effects take long, searches are made once more: nothing of that makes it jump."""
    rounds = [("single", 8, 0.1, 10, 0.4), ("pairs", 14, 0.1, 4, 0.8), ("more", 12, 0.1, 8, 1.2),
              ("exchanged", 14, 0.1, 4, 0.8)]  # fmt: skip
    stages = [("candidates", 160, 0.04, 0, 0.0), ("white", 80, 0.02, 7, 0.4), ("pairs", 160, 0.04, 3, 0.8),
              *rounds, *rounds, ("ties", 80, 0.02, 6, 0.8), ("step", 80, 0.02, 7, 0.6)]  # fmt: skip
    end = sum(looks * look + fits * fit for _, looks, look, fits, fit in stages)
    told = [(now, seconds(line)) for now, line in searched(Clock(), 80, stages)]
    told = [(now, left) for now, left in told if left is not None]
    moved = [abs(later[1] - one[1] + later[0] - one[0]) for one, later in pairwise(told)]
    assert end > 75.0 and max(moved) < 0.12 * end and sum(moved) < end
    ratios = [left / (end - now) for now, left in told if 0.25 * end < now < 0.8 * end]
    assert 0.5 < min(ratios) and max(ratios) < 2.0


def test_what_is_compiled_first_makes_no_time_left():
    clock = Clock()
    looks = [1.0] * 8 + [0.01] * 52
    told, tally = [], SearchProgress(60, lambda line: told.append(line), clock)
    each(tally.counted(clock.work, False, 1), looks, 1)
    clock.work(2.0)
    each(tally.counted(clock.work, False, 1), [0.01], 1)
    assert len(told) > 8 and seconds(told[0]) is None and seconds(told[-1]) is not None
    assert all((seconds(line) or 0) < 20 for line in told)


def test_how_far_a_search_is_stands_in_lines_where_there_is_no_terminal(capsys):
    bar = _Bar(8, shown=True)
    bar.stage("weigh")
    for done in range(0, 101, 2):
        text = f"weigh again, the error taken off: {done}/100 candidates and fits, about 9 s left"
        bar.stage(Share("weigh", done, 100, text))
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 11
    assert lines[3] == (
        "orchestrator: weigh again, the error taken off: 30/100 candidates and fits, about 9 s left"
    )
    assert bar._stages == 1
    hidden = SimpleNamespace(update=None)
    bar._bar, shown = hidden, []
    hidden.set_postfix_str = shown.append
    bar.stage(Share("practice", 7, 100))
    assert shown == ["practice 7/100"]


def test_a_second_search_counts_from_when_it_is_likely():
    clock, told = Clock(), []
    with progress_reported(SearchProgress(10, told.append, clock)):
        each(counted_calls(lambda _: clock.work(1.0), False, 1), range(20), 1)
        once = seconds(told[-1])
        twice()
        stage("candidates")
        each(counted_calls(lambda _: clock.work(1.0), False, 1), range(20), 1)
        # Told slowly, lest it jump: 5 x 10 looks and 60 fits more at least.
        assert "again" not in told[-1] and seconds(told[-1]) > 1.2 * once
        stage("step")
        each(counted_calls(lambda _: clock.work(1.0), False, 1), range(10), 1)
        before = int(re.search(r"/(\d+)", told[-1])[1])
        stage("candidates")
        each(counted_calls(lambda _: clock.work(1.0), False, 1), range(1), 1)
        assert "again" in told[-1]
        # All of it was counted, but for how the step does in the second one.
        assert abs(int(re.search(r"(\d+) cand", told[-1])[1]) - before) <= 26
