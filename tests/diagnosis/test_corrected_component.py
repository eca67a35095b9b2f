"""A law inside a component: the corrected system has a component of its own, from the same Modelica model."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import orchestrator as orc
from orchestrator.diagnosis.unknown_input.corrected_component import ModelOfLaw, build_corrected
from orchestrator.diagnosis.unknown_input.diagnose import diagnose_system
from orchestrator.simulation.run import prepare
from orchestrator.system.system import System
from orchestrator.translate.build import build
from orchestrator.translate.package import this_platform

pytest.importorskip("rumoca")
pytest.importorskip("casadi")

SWING = """model Swing "Pendulum"
  parameter Real stiffness(unit="1/s2") = 20;
  output Real angle(unit="rad", start=0.5, fixed=true);
  output Real speed(unit="rad/s", start=0, fixed=true);
  output Real acceleration(unit="rad/s2");
equation
  der(angle) = speed;
  2*der(speed) + 2*stiffness*sin(angle) = -0.1*speed;
  acceleration = -stiffness*sin(angle);
end Swing;
"""
STUDY = """format: port-study/1
system: swing.yaml
columns:
  time: {column: time, unit: s}
  swing.angle: {column: angle, unit: rad, noise: 1 mrad}
calibrated: {swing.stiffness: {tolerance: 0.2 1/s2}}
runs:
  - {file: a.csv, role: train, set: {swing.angle: 0.5 rad}}
  - {file: b.csv, role: validation, set: {swing.angle: 0.9 rad}}
  - {file: c.csv, role: held-out, set: {swing.angle: 1.3 rad}}
"""
TIME = 0.01 * np.arange(400)


def true_angle(start: float) -> np.ndarray:
    def rate(t: float, x: list[float]) -> list[float]:
        return [x[1], -20.0 * np.sin(x[0]) - 0.05 * x[1] - 0.3 * x[1] * abs(x[1])]

    return solve_ivp(rate, (0.0, TIME[-1]), [start, 0.0], t_eval=TIME, rtol=1e-9, atol=1e-10).y[0]


@pytest.fixture
def study(tmp_path: Path) -> Path:
    (tmp_path / "Swing.mo").write_text(SWING, encoding="utf-8")
    build(tmp_path / "Swing.mo", tmp_path / "Swing.fmu", platforms=[this_platform()])
    (tmp_path / "swing.yaml").write_text(
        "run: {master: gauss-seidel, step_size: 10 ms, stop_time: 3.99 s}\n"
        "instances: {swing: {fmu: Swing.fmu}}\n",
        encoding="utf-8",
    )
    random = np.random.default_rng(7)
    for name, start in (("a", 0.5), ("b", 0.9), ("c", 1.3)):
        noisy = true_angle(start) + 1e-3 * random.standard_normal(len(TIME))
        np.savetxt(
            tmp_path / f"{name}.csv", np.column_stack([TIME, noisy]), delimiter=",",
            header="time [s],angle [rad]", comments="",
        )  # fmt: skip
    (tmp_path / "study.yaml").write_text(STUDY, "utf-8")
    return tmp_path / "study.yaml"


@pytest.mark.slow
def test_the_corrected_component_moves_as_the_machine(study: Path, tmp_path: Path) -> None:
    made = diagnose_system(study, tmp_path / "out", report=False)
    (law,) = made.data["laws"]
    assert (law["law"], law["place"]) == ("quadratic drag", "der(swing.speed)")
    assert {"corrected.yaml", "Swing_corrected.mo", "Swing_corrected.fmu"} <= set(made.files)
    corrected = orc.run(tmp_path / "out" / "corrected.yaml", set={"swing.angle": 1.3}, halving=False)
    configured = orc.run(tmp_path / "swing.yaml", set={"swing.angle": 1.3}, halving=False)
    left, gap = (
        float(np.sqrt(np.mean((one["swing.angle"].values - true_angle(1.3)) ** 2)))
        for one in (corrected, configured)
    )
    assert left < 0.02 * gap


DRAG = """model law_1
  input Real u;
  output Real y;
equation
  y = -0.3*u*abs(u);
end law_1;
"""
NESTED = """model Body
  Real v(start=2, fixed=true);
equation
  der(v) = -0.1*v;
end Body;
model Sled
  Body body;
  output Real travel(start=0, fixed=true);
equation
  der(travel) = body.v;
end Sled;
"""


def built(folder: Path, name: str, text: str) -> System:
    (folder / f"{name}.mo").write_text(text, encoding="utf-8")
    build(folder / f"{name}.mo", folder / f"{name}.fmu", model=name, platforms=[this_platform()])
    return prepare(folder / f"{name}.fmu", ["run.stop_time=4 s", "run.step_size=10 ms"]).system


def test_a_state_of_a_part_takes_a_law(tmp_path: Path) -> None:
    system = built(tmp_path, "Sled", NESTED)
    law = ModelOfLaw("law_1", DRAG, {"body.v": 1.0}, {"u": "body.v"})
    assert build_corrected(system, "Sled", [law], tmp_path) == ("Sled_corrected.fmu", "")
    # Its variables have the names of the component's own.
    settings = {"run.stop_time": "4 s", "run.step_size": "10 ms", "Sled_corrected.body.v": 2.0}
    made = orc.run(tmp_path / "Sled_corrected.fmu", set=settings)
    described = fmpy.read_model_description(str(tmp_path / "Sled_corrected.fmu"))
    variables = {one.name for one in described.modelVariables}
    assert {"body.v", "der(body.v)", "travel", "added_by_law_1.y"} <= variables
    found = solve_ivp(
        lambda t, x: [-0.1 * x[0] - 0.3 * x[0] * abs(x[0]), x[0]],
        (0.0, 4.0),
        [2.0, 0.0],
        rtol=1e-10,
        atol=1e-12,
    )
    assert made["Sled_corrected.travel"].values[-1] == pytest.approx(found.y[1, -1], rel=1e-6)


PUSHED = """model Pushed "A sled that is pushed"
  input Real push(start=1.5);
  output Real travel(start=0, fixed=true);
  Real felt "What push does";
protected
  Real v(start=0, fixed=true);
equation
  felt = push/2;
  der(travel) = v;
  der(v) = felt - 0.1*v;
end Pushed;
"""


def test_an_input_takes_a_law_of_what_is_inside(tmp_path: Path) -> None:
    system = built(tmp_path, "Pushed", PUSHED)
    law = ModelOfLaw("law_1", DRAG, {}, {"u": "v"}, "push")
    assert build_corrected(system, "Pushed", [law], tmp_path) == ("Pushed_corrected.fmu", "")
    made = orc.run(tmp_path / "Pushed_corrected.fmu", set={"run.stop_time": "4 s", "run.step_size": "10 ms"})
    found = solve_ivp(
        lambda t, x: [x[1], 0.5 * (1.5 - 0.3 * x[1] * abs(x[1])) - 0.1 * x[1]],
        (0.0, 4.0), [0.0, 0.0], rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    assert made["Pushed_corrected.travel"].values[-1] == pytest.approx(found.y[0, -1], rel=1e-6)


def test_what_prevents_a_corrected_component_is_named(tmp_path: Path) -> None:
    system = built(tmp_path, "Swing", SWING)
    law = ModelOfLaw("law_1", DRAG, {"torque": 1.0}, {"u": "speed"})
    said = build_corrected(system, "Swing", [law], tmp_path)[1]
    assert said == "the flat form of Swing.mo has no such derivative or input."
    (tmp_path / "Swing.mo").write_text(SWING.replace("20;", "21;"), encoding="utf-8")
    said = build_corrected(system, "Swing", [law], tmp_path)[1]
    assert said.startswith(
        "Swing.mo, from which Swing.fmu was built, is not beside it, or differs. Add the law"
    )
