"""A long search tells how far it is."""

from __future__ import annotations

from types import SimpleNamespace

from orchestrator.diagnosis.cli import _Bar
from orchestrator.diagnosis.search import each
from orchestrator.diagnosis.tally import Tally, stage, tallied, telling


class Clock:
    """Seconds that pass as they are told to."""

    now = 0.0

    def __call__(self) -> float:
        return self.now

    def work(self, seconds: float) -> None:
        self.now += seconds


def test_looks_and_fits_are_counted_and_the_time_left_is_what_the_rest_takes():
    clock, told = Clock(), []
    with telling(Tally(10, told.append, clock)):
        each(tallied(lambda _: clock.work(1.0), False, 1), range(20), 1)
        # 20 looks of 1 s; 11 x 10 looks and 49 fits are planned yet, a fit being taken for 15 looks.
        assert told[-1] == "weigh 20/169 candidates and fits, about 14 min left"
        stage("ties")
        each(tallied(lambda _: clock.work(2.0), True, 1), range(3), 1)
        # 2 x 10 looks and 10 fits, 3 of which, at 2 s each, are done.
        assert told[-1] == "weigh 23/53 candidates and fits, about 40 s left"
        stage("step")
        each(tallied(lambda _: clock.work(1.0), False, 1), range(10), 1)
        assert told[-1] == "weigh 33/40 candidates and fits, about 14 s left"
        stage("candidates")  # weighed anew, all is to be done once more
        each(tallied(lambda _: clock.work(1.0), False, 1), range(10), 1)
        assert told[-1].startswith("weigh 43/202 candidates and fits")
    assert told == sorted(told, key=lambda one: int(one.split()[1].split("/")[0]))
    before = len(told)
    each(tallied(lambda _: clock.work(9.0), False, 1), range(3), 1)
    assert len(told) == before  # nobody counts


def test_how_far_a_search_is_stands_in_lines_where_there_is_no_terminal(capsys):
    bar = _Bar(8, shown=True)
    bar.stage("weigh")
    for done in range(0, 101, 2):
        bar.stage(f"weigh {done}/100 candidates and fits, about 9 s left")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 11
    assert lines[3] == "orchestrator: weigh 30/100 candidates and fits, about 9 s left"
    assert bar._stages == 1
    hidden = SimpleNamespace(update=None)
    bar._bar, shown = hidden, []
    hidden.set_postfix_str = shown.append
    bar.stage("weigh 7/100 candidates and fits, about 9 s left")
    assert shown == ["weigh 7/100 candidates and fits, about 9 s left"]
