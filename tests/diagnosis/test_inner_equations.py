"""Laws in the inner equations of a component: what acts on several derivatives at once."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

import orchestrator as orc
from orchestrator.base.errors import BuildError
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.unknown_input.diagnose import diagnose_system
from orchestrator.diagnosis.unknown_input.evaluation import Kinds
from orchestrator.diagnosis.unknown_input.law_fit import readable
from orchestrator.diagnosis.unknown_input.laws import library
from orchestrator.diagnosis.unknown_input.model import StateModel
from orchestrator.diagnosis.unknown_input.places import Runs
from orchestrator.diagnosis.unknown_input.rebuilt import with_openings
from orchestrator.diagnosis.unknown_input.search import imitating
from orchestrator.translate.opened import opened_model
from orchestrator.translate.show import show_model

pytest.importorskip("rumoca")
pytest.importorskip("casadi")

MODELS = {
    "Vehicle": """model Vehicle "Single-track model"
  parameter Real front(unit="N/rad")=9e4;
  parameter Real rear(unit="N/rad")=1.1e5;
  input Real steer(unit="rad");
  output Real slip(unit="m/s", start=0, fixed=true);
  output Real yaw(unit="rad/s", start=0, fixed=true);
protected
  Real force_front(unit="N");
  Real force_rear(unit="N");
  Real drag(unit="N");
equation
  force_front=front*(steer - (slip + 1.2*yaw)/22);
  force_rear=-rear*(slip - 1.5*yaw)/22;
  drag=40*slip;
  1500*(der(slip) + 22*yaw)=force_front + force_rear - drag;
  2600*der(yaw)=1.2*force_front - 1.5*force_rear;
end Vehicle;
""",
    "Trolley": """model Trolley "A pendulum hangs from a trolley"
  parameter Real m(unit="kg")=2;
  parameter Real l(unit="m")=1;
  parameter Real g(unit="m/s2")=9.81;
  input Real force(unit="N");
  output Real x(unit="m", start=0, fixed=true);
  output Real v(unit="m/s", start=0, fixed=true);
  output Real angle(unit="rad", start=0, fixed=true);
  output Real w(unit="rad/s", start=0, fixed=true);
equation
  der(x)=v;
  der(angle)=w;
  (1.0 + m)*der(v) + m*l*cos(angle)*der(w) - m*l*w^2*sin(angle)=force - v;
  0=-m*l^2*der(w) - m*l*cos(angle)*der(v) - m*g*l*sin(angle);
end Trolley;
""",
}
MODELS["Shaft"] = """model Shaft "Two inertias on a shaft, whose torque no variable holds"
  parameter Real j(unit="kg.m2")=0.1;
  parameter Real k(unit="N.m/rad")=50;
  parameter Real d(unit="N.m.s/rad")=0.2;
  input Real torque(unit="N.m");
  output Real phi1(unit="rad", start=0, fixed=true);
  output Real w1(unit="rad/s", start=0, fixed=true);
  output Real phi2(unit="rad", start=0, fixed=true);
  output Real w2(unit="rad/s", start=0, fixed=true);
equation
  der(phi1)=w1;
  der(phi2)=w2;
  der(w1)=(torque - k*(phi1 - phi2) - d*(w1 - w2))/j;
  0.2*der(w2)=k*(phi1 - phi2) + d*(w1 - w2) - 0.3*w2;
end Shaft;
"""
# The same vehicle, whose force on the front axle is an output, too.
MODELS["Measured"] = (
    MODELS["Vehicle"].replace("Vehicle", "Measured").replace("  Real force_front(unit=\"N\");\n", "")
    .replace("protected\n", "  output Real force_front(unit=\"N\");\nprotected\n")
)  # fmt: skip
STEP = 0.02


def tones(seed: int, size: float, low: float, high: float) -> Callable[[float], float]:
    random = np.random.default_rng(seed)
    speeds, phases = random.uniform(low, high, 5), random.uniform(0.0, 6.0, 5)

    def made(t: float) -> float:
        return float(size * (1.0 - np.exp(-3.0 * t)) * np.sin(speeds * t + phases).sum())

    return made


def study_of(
    folder: Path,
    name: str,
    fed: str,
    seen: dict[str, str],
    calibrated: dict[str, str],
    logs: list[np.ndarray],
) -> Path:
    """A study of one component, whose last run is held out."""
    system = {
        "run": {"master": "gauss-seidel", "step_size": "5 ms", "stop_time": "10 s"},
        "instances": {"part": {"fmu": f"{name}.fmu"}}, "connections": [],
    }  # fmt: skip
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(system), encoding="utf-8")
    units = dict(re.findall(r'put Real (\w+)\(unit="([^"]*)"', MODELS[name]))
    header = ",".join(["time [s]", *(f"{one} [{units[one]}]" for one in (fed, *seen))])
    for number, table in enumerate(logs):
        file = folder / f"{name}_{number}.csv"
        np.savetxt(file, table, delimiter=",", header=header, comments="", fmt="%.9g")
    data = {
        "format": "port-study/1", "system": f"{name}.yaml", "interval": f"{STEP} s",
        "columns": {
            "time": "time", f"part.{fed}": fed,
            **{f"part.{one}": {"column": one, "noise": noise} for one, noise in seen.items()},
        },
        "calibrated": {f"part.{one}": {"tolerance": value} for one, value in calibrated.items()},
        "runs": [
            {"file": f"{name}_{n}.csv", "role": "train" if n + 1 < len(logs) else "held-out"}
            for n in range(len(logs))
        ],
    }  # fmt: skip
    path = folder / f"{name}.study.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def vehicle_logs(seed: int, count: int) -> np.ndarray:
    """The front tyre holds 3.8 kN at most."""
    steer, time = tones(seed, 0.025, 0.8, 7.0), STEP * np.arange(count)
    random = np.random.default_rng(seed)

    def rate(t: float, x: list[float]) -> list[float]:
        front = float(np.clip(9.1e4 * (steer(t) - (x[0] + 1.2 * x[1]) / 22), -3800.0, 3800.0))
        rear = -1.09e5 * (x[0] - 1.5 * x[1]) / 22
        return [(front + rear - 40 * x[0]) / 1500 - 22 * x[1], (1.2 * front - 1.5 * rear) / 2600]

    x = solve_ivp(rate, (0.0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, atol=1e-9, max_step=0.02).y
    noisy = x + np.array([[0.01], [0.002]]) * random.standard_normal(x.shape)
    return np.column_stack([time, [steer(t) for t in time], *noisy])


def trolley_logs(seed: int, count: int) -> np.ndarray:
    """The pivot has dry friction of 0.6 N.m."""
    force, time = tones(seed, 5.0, 1.0, 6.0), STEP * np.arange(count)
    random = np.random.default_rng(seed)

    def rate(t: float, s: list[float]) -> list[float]:
        _, v, angle, w = s
        c, p = np.cos(angle), np.sin(angle)
        mass = [[3.0, 2.0 * c], [2.0 * c, 2.0]]
        dv, dw = np.linalg.solve(
            mass, [force(t) - v + 2 * w * w * p, -19.62 * p - 0.6 * np.tanh(w / 2e-3)]
        )  # fmt: skip
        return [v, dv, w, dw]

    s = solve_ivp(rate, (0.0, time[-1]), [0, 0, 0, 0], t_eval=time, rtol=1e-7, atol=1e-8, max_step=0.01).y
    noisy = s[[0, 2]] + np.array([[5e-4], [1e-3]]) * random.standard_normal((2, count))
    return np.column_stack([time, [force(t) for t in time], *noisy])


def shaft_logs(seed: int, count: int) -> np.ndarray:
    """The shaft has a play of 0.06 rad."""
    torque, time = tones(seed, 1.2, 0.8, 9.0), STEP * np.arange(count)
    random = np.random.default_rng(seed)

    def rate(t: float, x: list[float]) -> list[float]:
        twist = x[0] - x[2]
        shaft = 50.0 * (twist - float(np.clip(twist, -0.03, 0.03))) + 0.2 * (x[1] - x[3])
        return [x[1], (torque(t) - shaft) / 0.1, x[3], (shaft - 0.3 * x[3]) / 0.2]

    x = solve_ivp(rate, (0.0, time[-1]), [0, 0, 0, 0], t_eval=time, rtol=1e-8, atol=1e-9, max_step=0.005).y
    noisy = x[[1, 3]] + 0.01 * random.standard_normal((2, count))
    return np.column_stack([time, [torque(t) for t in time], *noisy])


def test_forces_between_states_are_opened(fmus: Path) -> None:
    text, openings = opened_model(fmus / "Vehicle.mo")
    front, rear, drag = openings
    assert (front.name, front.before) == ("force_front", "force_front_before")
    assert front.equation == "force_front = front*(steer - (slip + 1.2*yaw)/22)"
    assert "'slip + 1,2*yaw'" in front.signals and rear.signals == ("'slip - 1,5*yaw'",)
    assert '  input Real force_front(unit = "N", start = 0);' in text and drag.name == "drag"
    assert "= force_front_before + force_front + (force_rear_before + force_rear) - (drag" in text
    only, made = opened_model(fmus / "Vehicle.mo", only=["force_rear"])
    assert [one.name for one in made] == ["force_rear"] and "input Real force_front" not in only
    assert opened_model(fmus / "Vehicle.mo", only=[]) == (show_model(fmus / "Vehicle.mo", "flat"), ())


def test_a_balance_of_two_derivatives_is_opened_with_the_sign_of_its_inertia(fmus: Path) -> None:
    text, (opening,) = opened_model(fmus / "Trolley.mo")
    # The force adds to the other balance already. Here the inertia has a minus before it.
    assert opening.name == "torque_on_w" and not opening.before
    assert "m*g*l*sin(angle) + torque_on_w;" in text


def test_a_product_in_several_equations_is_opened_in_all_of_them(fmus: Path) -> None:
    text, (spring, damper) = opened_model(fmus / "Shaft.mo")
    assert (spring.name, damper.name) == ("torque_of_k_phi1_phi2", "torque_of_d_w1_w2")
    assert spring.equation == "k*(phi1 - phi2) and d*(w1 - w2), in 2 equations"
    assert spring.signals == damper.signals == ("'phi1 - phi2'", "'w1 - w2'")
    assert text.count("k*(phi1 - phi2) + torque_of_k_phi1_phi2") == 2
    assert "torque_of_k_phi1_phi2_before = k*(phi1 - phi2);" in text
    only, made = opened_model(fmus / "Shaft.mo", only=["torque_of_d_w1_w2"])
    assert [one.name for one in made] == ["torque_of_d_w1_w2"] and "torque_of_k" not in only


def test_a_model_that_does_not_compile_is_refused(tmp_path: Path) -> None:
    (tmp_path / "Bad.mo").write_text("model Bad\n  Real x;\nequation\n  x=y;\nend Bad;\n", encoding="utf-8")
    with pytest.raises(BuildError):
        opened_model(tmp_path / "Bad.mo")


def test_what_acts_as_a_derivative_or_an_input_is_no_place_of_its_own(fmus: Path) -> None:
    logs = [vehicle_logs(1, 120), vehicle_logs(2, 120)]
    seen = {"slip": "0.01 m/s", "yaw": "2 mrad/s"}
    study = load_port_study(study_of(fmus, "Vehicle", "steer", seen, {"front": "5e3 N/rad"}, logs))
    opened = with_openings(study)
    assert opened is not None
    with StateModel(study) as model, StateModel(opened) as inside:
        known = {one.name for one in model.places()}
        added = [one for one in inside.places() if one.name not in known]
        # The drag acts on one derivative alone.
        assert [one.name for one in added] == ["part.force_front", "part.force_rear"]
        assert {one.kind for one in added} == {Kinds.INPUT}
        front, rear = ({law.name for law in readable(inside, one)} for one in added)
        assert "saturation at part.force_front of part.force_front" in front
        assert "coulomb at part.force_rear of part.'slip - 1,5*yaw'" in rear
        assert not any("before" in name for name in front | rear)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "place"), [("Vehicle", "force_front"), ("Measured", "force_front_inside")])
def test_a_tyre_that_saturates_is_found_where_its_force_acts(
    name: str, place: str, fmus: Path, tmp_path: Path
) -> None:
    logs = [vehicle_logs(1, 400), vehicle_logs(2, 300)]
    seen = {"slip": "0.01 m/s", "yaw": "2 mrad/s"}
    calibrated = {"front": "3e3 N/rad", "rear": "3e3 N/rad"}
    made = diagnose_system(study_of(fmus, name, "steer", seen, calibrated, logs), tmp_path, report=True)
    (law,) = made.data["laws"]
    assert (law["law"], law["place"]) == ("saturation", f"part.{place}")
    assert law["numbers"]["limit"]["value"] == pytest.approx(3800.0, rel=0.02)
    assert any("inside the component: force_front = " in one for one in made.data["remarks"])
    assert {"corrected.yaml", f"{name}_corrected.fmu", "report.html"} <= set(made.files)
    # The corrected component keeps its ports, and needs no input for the law.
    steer = np.interp(0.005 * np.arange(1196), STEP * np.arange(300), logs[1][:, 1])
    (tmp_path / "inputs.csv").write_text(
        "time [s],part.steer [rad]\n"
        + "".join(f"{0.005 * k:.6g},{value:.9g}\n" for k, value in enumerate(steer)),
        encoding="utf-8",
    )
    left = []
    for config in (tmp_path / "corrected.yaml", fmus / f"{name}.yaml"):
        run = orc.run(
            config, set={"run.stop_time": 5.97}, inputs=tmp_path / "inputs.csv", halving=False
        )  # fmt: skip
        found = np.interp(STEP * np.arange(298), run.time, run["part.yaw"].values)
        left.append(float(np.sqrt(np.mean((found - logs[1][:298, 3]) ** 2))))
    assert left[0] < 1.4 * 0.002 and left[1] > 3 * left[0]


@pytest.mark.slow
def test_friction_at_a_pivot_is_found_in_the_balance_of_torques(fmus: Path, tmp_path: Path) -> None:
    logs = [trolley_logs(1, 400), trolley_logs(2, 300)]
    seen = {"x": "0.5 mm", "angle": "1 mrad"}
    path = study_of(fmus, "Trolley", "force", seen, {"m": "0.05 kg"}, logs)
    made = diagnose_system(path, tmp_path, report=False)
    (law,) = made.data["laws"]
    assert (law["place"], law["family"]) == ("part.torque_on_w", "dry friction")
    assert law["numbers"]["level"]["value"] == pytest.approx(-0.6, rel=0.05)
    text = (tmp_path / "Trolley_corrected.mo").read_text(encoding="utf-8")
    assert "  Real torque_on_w(" in text and "torque_on_w = added_by_law_1.y;" in text


@pytest.mark.slow
def test_play_of_a_shaft_is_found_in_the_equations_of_both_inertias(fmus: Path, tmp_path: Path) -> None:
    logs = [shaft_logs(1, 400), shaft_logs(2, 300)]
    seen = {"w1": "0.01 rad/s", "w2": "0.01 rad/s"}
    path = study_of(fmus, "Shaft", "torque", seen, {"j": "0.002 kg.m2"}, logs)
    made = diagnose_system(path, tmp_path, report=False)
    (law,) = made.data["laws"]
    assert (law["law"], law["place"]) == ("dead band", "part.torque_of_k_phi1_phi2")
    assert "corrected.yaml" in made.files
    assert law["numbers"]["stiffness"]["value"] == pytest.approx(-50.0, rel=0.03)
    assert "phi1 - phi2" in law["signal"] and made.data["held_out"]["closed"] > 0.95
    text = (tmp_path / "Shaft_corrected.mo").read_text(encoding="utf-8")
    assert "torque_of_k_phi1_phi2 = added_by_law_1.y;" in text


def test_another_law_of_the_same_signal_begins_where_it_does_the_same(fmus: Path) -> None:
    laws = {one.name: one for one in library()}
    logs = [vehicle_logs(1, 120), vehicle_logs(2, 120)]
    seen = {"slip": "0.01 m/s", "yaw": "2 mrad/s"}
    study = load_port_study(study_of(fmus, "Vehicle", "steer", seen, {"front": "5e3 N/rad"}, logs))
    with StateModel(study) as model:
        runs = Runs(model, study.runs)
        place = next(one for one in model.places() if one.name == "der(part.slip)")
        every = {one.law.name: one for one in readable(model, place) if one.signal == "part.slip"}
        (near,) = imitating(runs, every["viscous"], np.array([-3.0]), every["power drag"])
        assert near.law is laws["power drag"] and len(near.numbers) == 2
        signal = np.linspace(runs.low[0], runs.high[0], 50)
        found = near.law.values(np.zeros(50), signal, near.numbers)
        assert np.abs(found + 3.0 * signal).max() < 0.35 * np.abs(3.0 * signal).max()
        # A step does not come near a straight line.
        assert imitating(runs, every["viscous"], np.array([-3.0]), every["coulomb"]) == []
