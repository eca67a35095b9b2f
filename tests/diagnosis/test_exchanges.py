"""What passes from one state of a component to another: it conserves, by capacities that the model shows."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

import orchestrator as orc
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.unknown_input.choice import choose_answer, significant
from orchestrator.diagnosis.unknown_input.diagnose import diagnose_system
from orchestrator.diagnosis.unknown_input.evaluation import Inserted, Kinds, acts_of, evaluate, past_of
from orchestrator.diagnosis.unknown_input.fits import Weighed
from orchestrator.diagnosis.unknown_input.law_fit import readable
from orchestrator.diagnosis.unknown_input.laws import library
from orchestrator.diagnosis.unknown_input.model import StateModel
from orchestrator.diagnosis.unknown_input.open_run import simulated
from orchestrator.diagnosis.unknown_input.places import Runs

pytest.importorskip("rumoca")

MODELS = {
    # Volumes change with the stroke, so that the capacities do.
    "Piston": """model Piston "Two chambers around a piston"
  input Real inflow(unit="m3/s");
  output Real stroke(unit="m", start=0.3, fixed=true);
  output Real speed(unit="m/s", start=0, fixed=true);
  output Real a(unit="Pa", start=4e6, fixed=true);
  output Real b(unit="Pa", start=6e6, fixed=true);
equation
  der(stroke) = speed;
  300*der(speed) = 15e-4*a - 10e-4*b - 2000*speed;
  der(a) = 1e9/(2e-4 + 15e-4*stroke)*(inflow - 15e-4*speed);
  der(b) = 1e9/(2e-4 + 10e-4*(0.6 - stroke))*(10e-4*speed - inflow);
end Piston;
""",
    # The mass is elsewhere: the speed and the force stand for it.
    "Chambers": """model Chambers
  input Real speed(unit="m/s");
  input Real command(unit="1", start=0.5);
  output Real force(unit="N");
  output Real a(unit="Pa", start=4e6, fixed=true);
  output Real b(unit="Pa", start=6e6, fixed=true);
equation
  der(a) = 1e9/4e-4*(1e-4*command - 15e-4*speed);
  der(b) = 1e9/5e-4*(10e-4*speed - 2e-4*command);
  force = 15e-4*a - 10e-4*b;
end Chambers;
""",
    "House": """model House
  input Real power(unit="W");
  output Real radiator(unit="degC", start=20, fixed=true);
  output Real air(unit="degC", start=20, fixed=true);
equation
  6e4*der(radiator) = power - 60*(radiator - air);
  9e5*der(air) = 60*(radiator - air) - 70*(air - 5);
end House;
""",
    # Nothing shows what one of these does to the other.
    "Apart": """model Apart
  input Real power(unit="W");
  output Real one(unit="K", start=300, fixed=true);
  output Real two(unit="K", start=300, fixed=true);
equation
  100*der(one) = power - (one - 290);
  500*der(two) = power - (two - 290);
end Apart;
""",
}


def study_of(
    folder: Path, name: str, fed: str, seen: dict[str, str], logs: dict[str, np.ndarray], step: float
) -> Path:
    """A study of one component; the last run is held out."""
    system = {
        "run": {"master": "gauss-seidel", "step_size": f"{step} s", "stop_time": f"{100 * step} s"},
        "instances": {"part": {"fmu": f"{name}.fmu"}}, "connections": [],
    }  # fmt: skip
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(system), encoding="utf-8")
    columns: dict[str, object] = {"time": "time", f"part.{fed}": fed}
    columns |= {
        f"part.{one}": {"column": one, "noise": noise, "start": True, "feed": False}
        for one, noise in seen.items()
    }
    for run, table in logs.items():
        units = load_units(name, [fed, *seen])
        np.savetxt(
            folder / f"{name}_{run}.csv", table, delimiter=",", header=f"time [s],{units}", comments="",
            fmt="%.9g",
        )  # fmt: skip
    roles = dict.fromkeys(logs, "train") | {list(logs)[-1]: "held-out"} if len(logs) > 1 else {"a": "train"}
    data = {
        "format": "port-study/1", "system": f"{name}.yaml", "columns": columns,
        "runs": [{"file": f"{name}_{run}.csv", "role": roles[run]} for run in logs],
    }  # fmt: skip
    path = folder / f"{name}.study.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def load_units(name: str, ports: list[str]) -> str:
    """Columns of a log with the units that the model has."""
    import re

    units = dict(re.findall(r'Real (\w+)\(unit="([^"]*)"', MODELS[name]))
    return ",".join(f"{one} [{units[one]}]" for one in ports)


def still(count: int, *values: float, step: float) -> dict[str, np.ndarray]:
    """A log in which hardly anything moves, for models that are only looked at."""
    random = np.random.default_rng(1)
    table = np.outer(np.ones(count), values) * (1.0 + 1e-3 * random.standard_normal((count, len(values))))
    return {"a": np.column_stack([step * np.arange(count), table])}


def test_what_leaves_one_chamber_enters_the_other_at_each_stroke(fmus: Path) -> None:
    logs = still(120, 1e-4, 4e6, 6e6, step=0.01)
    path = study_of(fmus, "Piston", "inflow", {"a": "1e4 Pa", "b": "1e4 Pa"}, logs, 0.01)
    law = next(one for one in library() if one.name == "exchange")
    with StateModel(load_port_study(path)) as model:
        (place,) = (one for one in model.places() if one.kind is Kinds.EXCHANGE)
        assert place.name == "part.a to part.b" and np.isnan(place.ratio)
        read = model.states.index, ("a", "b")
        first, second = (next(k for k, one in enumerate(model.states) if one.variable == v) for v in read[1])
        put = Inserted(place, law.address, (first, second), 1)
        none, rates = np.zeros(0), []
        x = model.start.copy()
        x[next(k for k, one in enumerate(model.states) if one.variable == "stroke")] = 0.55
        for laws in ((), (put,)):
            acts, signals = acts_of(laws, None, 0.01)
            rate, ext = np.zeros(4), np.array([1e-4])
            u, y = np.zeros(len(model.inputs)), np.zeros(len(model.outputs))
            evaluate(
                model.rows, model.wiring, x, ext, none, 0.0, acts, 0.0, signals, np.array([2.0]), none, u, y,
                rate, none, *past_of(acts, 0),
            )  # fmt: skip
            rates.append(rate)
    change = rates[1] - rates[0]
    capacity = np.array([2e-4 + 15e-4 * 0.55, 2e-4 + 10e-4 * 0.05]) / 1e9
    # At the start values, where the stroke is 0.3, the number is that of the first state.
    begin = (2e-4 + 15e-4 * 0.3) / 1e9
    flow = 2.0 * (4e6 - 6e6) * begin
    assert change[[first, second]] * capacity == pytest.approx([-flow, flow], rel=1e-5)
    assert np.abs(np.delete(change, [first, second])).max() < 1e-12


def test_capacities_that_move_within_a_step_are_simulated(fmus: Path) -> None:
    """A step takes them at its begin; SciPy solves the same equations."""
    logs = still(120, 1e-4, 4e6, 6e6, step=0.01)
    path = study_of(fmus, "Piston", "inflow", {"a": "1e4 Pa", "b": "1e4 Pa"}, logs, 0.01)
    law = next(one for one in library() if one.name == "exchange")

    def rate(t: float, x: np.ndarray) -> list[float]:
        stroke, speed, a, b = x
        volumes = 2e-4 + 15e-4 * stroke, 2e-4 + 10e-4 * (0.6 - stroke)
        leak = 3.0 * (a - b) * (2e-4 + 15e-4 * 0.3) / 1e9
        return [
            speed,
            (15e-4 * a - 10e-4 * b - 2000.0 * speed) / 300.0,
            1e9 / volumes[0] * (1e-4 - 15e-4 * speed - leak),
            1e9 / volumes[1] * (10e-4 * speed - 1e-4 + leak),
        ]

    with StateModel(load_port_study(path)) as model:
        runs = Runs(model, model.study.runs)
        (place,) = (one for one in model.places() if one.kind is Kinds.EXCHANGE)
        ports = [one.variable for one in model.states]
        put = Inserted(place, law.address, tuple(ports.index(one) for one in ("a", "b")), 1)
        start = dict(stroke=0.3, speed=0.0, a=4e6, b=6e6)
        z = np.array([*(start[one] for one in ports), 3.0])
        fed = np.full((120, 1), 1e-4)
        sub, before = 5 * runs.sub, model.effort.spent
        found, _ = simulated(model, fed, np.array([False]), z, sub, [put])
        spent = model.effort.spent - before
        compared = [one.variable for one in model.compared]
    exact = solve_ivp(
        rate, (0.0, 1.19), list(start.values()), t_eval=0.01 * np.arange(120), rtol=1e-9, atol=1e-6
    ).y  # fmt: skip
    for row, name in ((2, "a"), (3, "b")):
        assert np.abs(found[:, compared.index(name)] - exact[row]).max() < 1e-4 * np.ptp(exact[row])
    assert spent == 120 * sub * 8  # four slopes of a step, and what shows the capacities


def test_capacities_are_seen_through_a_speed_and_a_force_or_not_at_all(fmus: Path) -> None:
    found = {}
    for name, fed, values in (
        ("Chambers", "command", (0.5, 4e6, 6e6)), ("House", "power", (500.0, 20.0, 20.0)),
        ("Apart", "power", (50.0, 300.0, 300.0)),
    ):  # fmt: skip
        seen = {"Chambers": ("a", "b"), "House": ("radiator", "air"), "Apart": ("one", "two")}[name]
        noise = {"Chambers": "1e4 Pa", "House": "0.1 K", "Apart": "0.1 K"}[name]
        path = study_of(fmus, name, fed, dict.fromkeys(seen, noise), still(120, *values, step=1.0), 1.0)
        with StateModel(load_port_study(path)) as model:
            places = [one for one in model.places() if one.kind is Kinds.EXCHANGE]
            laws = {each.law.name for one in places for each in readable(model, one)}
        found[name] = [round(one.ratio, 6) for one in places], laws
    assert found["Chambers"] == ([0.8], {"exchange", "exchange through an orifice"})
    assert (
        found["House"][0] == [round(6e4 / 9e5, 6)] and "exchange by radiation from degC" in found["House"][1]
    )
    assert found["Apart"] == ([], set())


def test_a_second_path_of_heat_is_found_and_built_in(fmus: Path, tmp_path: Path) -> None:
    random, time = np.random.default_rng(5), 30.0 * np.arange(240)

    def logged(phase: float) -> np.ndarray:
        def power(t: float) -> float:
            return 1500.0 * (1.0 + np.sin(2 * np.pi * t / 3000.0 + phase))

        def rate(t: float, x: np.ndarray) -> list[float]:
            heat = 60.0 * (x[0] - x[1]) + 6e-8 * ((x[0] + 273.15) ** 4 - (x[1] + 273.15) ** 4)
            return [(power(t) - heat) / 6e4, (heat - 70.0 * (x[1] - 5.0)) / 9e5]

        x = solve_ivp(rate, (0.0, time[-1]), [20.0, 20.0], t_eval=time, rtol=1e-8, atol=1e-8).y
        x += np.array([[0.1], [0.03]]) * random.standard_normal(x.shape)
        return np.column_stack([time, power(time), *x])

    logs = {name: logged(phase) for name, phase in (("a", 0.0), ("b", 2.0), ("c", 4.0))}
    path = study_of(fmus, "House", "power", {"radiator": "0.1 K", "air": "0.03 K"}, logs, 30.0)
    made = diagnose_system(path, tmp_path / "out", report=False)
    (law,) = made.data["laws"]
    assert law["law"] == "exchange by radiation from degC" and made.data["held_out"]["closed"] > 0.95
    assert made.data["probability"] > 0.6
    assert law["numbers"]["factor"]["value"] == pytest.approx(1.06 / 6e4, rel=0.05)
    assert "corrected.yaml" in made.files
    corrected = orc.run(tmp_path / "out" / "corrected.yaml", halving=False)
    assert corrected is not None


def test_radiation_counts_from_absolute_zero() -> None:
    laws = {one.name: one for one in library()}
    for name, numbers in (("radiation", [2e-9, 290.0]), ("exchange by radiation", [2e-9])):
        kelvin, celsius = laws[name], laws[f"{name} from degC"]
        assert kelvin.fits("K", False, "temperature") and not kelvin.fits("degC", False, "temperature")
        assert celsius.fits("degC", False, "temperature") and not celsius.fits("K", False, "temperature")
        signals = np.array([[350.0, 300.0], [310.0, 340.0]])
        numbers_of_celsius = [numbers[0], *(one - 273.15 for one in numbers[1:])]
        assert celsius.values(np.zeros(2), signals - 273.15, numbers_of_celsius) == pytest.approx(
            kelvin.values(np.zeros(2), signals, numbers), rel=1e-12
        )


def test_a_law_takes_the_place_of_a_parameter_far_from_its_value() -> None:
    law = SimpleNamespace(
        law=SimpleNamespace(family="exchange", rare=False, delay=False, states=0),
        place=SimpleNamespace(component=0),
    )
    none, one = (
        Weighed(
            SimpleNamespace(laws=laws, numbers=constants[1:]),
            SimpleNamespace(remains=3.1, constants=constants), evidence,
        )
        for laws, constants, evidence in (((), [70.0], 100.0), ((law,), [60.0, 0.1], 150.0))
    )  # fmt: skip
    limited = SimpleNamespace(polished=SimpleNamespace(remains=20.0))
    search = SimpleNamespace(begins=[none, limited], far=lambda constants: constants[0] > 66.0)
    assert choose_answer(search, [none, one]) == 1
    within = SimpleNamespace(begins=[none], far=lambda constants: False)
    assert choose_answer(within, [none, one]) == 0


def test_a_second_law_whose_number_changes_nothing_does_not_count() -> None:
    def pair(sigma: float) -> SimpleNamespace:
        law = SimpleNamespace(law=SimpleNamespace(linear=True))
        laws = [(law, [2.3], [0.002]), (law, [8.7e-5], [sigma])]
        return SimpleNamespace(laws=(1, 2), by_law=lambda: laws)

    assert significant(pair(1e-6)) and not significant(pair(5e-5)) and not significant(pair(4.6e-20))
