"""Stamps of logs that are dates."""

from __future__ import annotations

import pytest
from ports_bench import study

from orchestrator.base.errors import ConfigError
from orchestrator.diagnosis.study.reader import load_port_study


@pytest.mark.parametrize("date", ["04.03.2026 09:15:{:06.3f}", "3/4/2026 9:15:{:06.3f}"])
def test_a_date_that_cannot_be_read_is_refused_with_the_form_that_can(tmp_path, date):
    study(tmp_path)
    header, *rows = (tmp_path / "run-0.csv").read_text().splitlines()
    dated = [f"{date.format(float(row.split(',')[0]))},{row.split(',', 1)[1]}" for row in rows]
    (tmp_path / "run-0.csv").write_text("\n".join([header, *dated]) + "\n")
    with pytest.raises(ConfigError) as error:
        load_port_study(tmp_path)
    found = next(one for one in error.value.problems if "run-0" in one.place)
    assert "a date as ISO 8601 has it, 2026-03-04T09:15:00.250" in found.allowed
    assert "year first" in found.remedy
