"""What the controller's open choices do to the system in six degrees of freedom."""

from __future__ import annotations

import pytest

from tests.benchmarks import controller_choices


def test_missed_work_has_to_be_restored():
    settings = ["run.stop_time=1.3 s"]
    chosen = controller_choices.measured(controller_choices.CHANGES["as chosen"], settings)
    without = controller_choices.measured(controller_choices.CHANGES["missed work not restored"], settings)
    assert chosen["contacts"] == without["contacts"] == 2
    assert chosen["energy"] == pytest.approx(1.0, abs=3e-4)
    assert without["energy"] > 1.05 and without["first_cor"] > chosen["first_cor"] + 0.02
    assert abs(chosen["stiffness_error"]) < 1e-3
