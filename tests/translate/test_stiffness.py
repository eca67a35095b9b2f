"""Which models the build finds stiff, and that their FMUs are right and fast."""

from __future__ import annotations

import build_extra  # noqa: F401
import fmpy
import modelica_bench as bench
import pytest
from scipy.integrate import solve_ivp

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.translate.build import build, explicit_program
from orchestrator.translate.package import this_platform
from orchestrator.translate.sources import load_sources
from orchestrator.translate.stiffness import explicit_steps

ROBERTSON = """model Model
  Real a(start=1, fixed=true), b(start=0, fixed=true), c(start=0, fixed=true);
equation
  der(a) = 1e4*b*c - 0.04*a;
  der(b) = 0.04*a - 1e4*b*c - 3e7*b*b;
  der(c) = 3e7*b*b;
  annotation(experiment(StopTime=1e4));
end Model;
"""
TWO = """model Model
  Real x(start=2, fixed=true), v(start=0, fixed=true);
equation
  der(x) = {};
  der(v) = {};
end Model;
"""


@pytest.mark.parametrize(
    ("slopes", "stop", "steps"),
    [
        (("-x", "1e6*(x - v)"), 1.0, 303_030),
        (("-x", "1e6*(x - v)"), 0.01, 0),
        (("v", "-1e10*x"), 1.0, 0),
        (("v", "1000*(1 - x*x)*v - x"), 2000.0, 900_000),
        (("-x", "if x > 1 then 1e6*(x - v) else x - v"), 1.0, 210_000),
    ],
    ids=["fast decay", "short run", "fast oscillation", "van der Pol", "fast for a while"],
)
def test_fast_decay_over_a_long_time_is_stiff(tmp_path, slopes, stop, steps):
    path = bench.model_file(tmp_path, TWO.format(*slopes))
    program, _ = explicit_program(load_sources(path), "Model")
    assert explicit_steps(program, stop) == pytest.approx(steps, rel=0.3)


def test_a_stiff_model_gets_an_implicit_method(tmp_path):
    path, fmu = bench.model_file(tmp_path, ROBERTSON), tmp_path / "Model.fmu"
    report = build(path, fmu, platforms=(this_platform(),))
    assert any("an implicit method replaces 2e+07 explicit steps" in one for one in report.notes)
    found = fmpy.simulate_fmu(str(fmu), stop_time=1e4, output_interval=1e3, output=["a", "b", "c"])
    exact = solve_ivp(
        lambda _, y: [1e4 * y[1] * y[2] - 0.04 * y[0], 0.04 * y[0] - 1e4 * y[1] * y[2] - 3e7 * y[1] ** 2,
                      3e7 * y[1] ** 2],
        (0, 1e4), [1, 0, 0], method="Radau", rtol=1e-10, atol=1e-14,
    ).y[:, -1]  # fmt: skip
    assert [found[one][-1] for one in "abc"] == pytest.approx(list(exact), rel=1e-6)
