"""Systems whose components are driven by speeds, or kept stable by a controller whose inputs are logged."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

from orchestrator.base.errors import ConfigError
from orchestrator.diagnosis.study.channels import is_stairs
from orchestrator.diagnosis.study.checks import _hopeless, _mistake, check_logs
from orchestrator.diagnosis.study.devices import with_devices_fed
from orchestrator.diagnosis.study.keys import Role
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.study import PortRun
from orchestrator.diagnosis.unknown_input.law_fit import readable
from orchestrator.diagnosis.unknown_input.model import StateModel
from orchestrator.diagnosis.unknown_input.places import Runs
from orchestrator.diagnosis.unknown_input.polish import Replays
from orchestrator.diagnosis.unknown_input.thinning import without_outliers
from orchestrator.system.connection import Port

pytest.importorskip("rumoca")

MODELS = {
    "Craft": """model Craft "A rotor lifts a mass"
  input Real command(unit="rad/s", start=500);
  output Real altitude(unit="m", start=1, fixed=true);
  output Real climb(unit="m/s", start=0, fixed=true);
  output Real rotor(unit="rad/s", start=500, fixed=true);
equation
  der(altitude) = climb;
  0.05*der(rotor) = command - rotor;
  der(climb) = 4e-5*rotor^2 - 9.81;
end Craft;
""",
    "Rod": """model Rod "A mass on an unstable spring"
  parameter Real stiffness(unit="N/m") = -30;
  input Real force(unit="N");
  output Real position(unit="m", start=0.01, fixed=true);
  output Real velocity(unit="m/s", start=0, fixed=true);
equation
  der(position) = velocity;
  der(velocity) = force - stiffness*position;
end Rod;
""",
    "Hold": """model Hold
  parameter Real stiffness(unit="N/m") = 80;
  parameter Real damping(unit="N.s/m") = 12;
  input Real position(unit="m");
  input Real velocity(unit="m/s");
  output Real force(unit="N");
equation
  force = -stiffness*position - damping*velocity;
end Hold;
""",
    "Sampled": """model Sampled
  input Real position(unit="m");
  output Real force(unit="N");
protected
  discrete Real value(start=0, fixed=true);
equation
  when sample(0, 0.02) then
    value = -80*position;
  end when;
  force = value;
end Sampled;
""",
    "Load": """model Load "A load on a rope whose length is given"
  input Real rope(unit="m", start=2);
  input Real drive(unit="m/s2");
  output Real angle(unit="rad", start=0.1, fixed=true);
  output Real speed(unit="rad/s", start=0, fixed=true);
equation
  der(angle) = speed;
  rope*der(speed) = -9.81*sin(angle) - drive*cos(angle);
end Load;
""",
    "Roller": """model Roller "A roll on an elastic web, and a filter of the web's speed"
  input Real pull(unit="m/s", start=2);
  output Real tension(unit="N", start=150, fixed=true);
  output Real position(unit="m", start=0, fixed=true);
  output Real velocity(unit="m/s", start=0, fixed=true);
  output Real filtered(unit="m/s", start=2, fixed=true);
equation
  der(tension) = 9000*(pull - 2 + 2*velocity);
  der(position) = velocity;
  12*der(velocity) = 300 - 250*position - 2*tension - 120*velocity;
  0.1*der(filtered) = pull - filtered;
end Roller;
""",
    "Switch": """model Switch
  input Real signal(unit="1");
  output Real output_(unit="1");
equation
  output_ = if signal > 0 then 1.0 else 0.0;
end Switch;
""",
}


def written(folder: Path, system: dict, logs: dict[str, np.ndarray], columns: dict) -> Path:
    """A study with one run of logs, whose columns bear their units."""
    rows = np.column_stack(list(logs.values()))
    np.savetxt(folder / "a.csv", rows, delimiter=",", header=",".join(logs), comments="", fmt="%.9g")
    (folder / "system.yaml").write_text(yaml.safe_dump(system), encoding="utf-8")
    path = folder / "study.yaml"
    data = {
        "format": "port-study/1", "system": "system.yaml", "columns": {"time": "time", **columns},
        "runs": [{"file": "a.csv", "role": "train"}],
    }  # fmt: skip
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_drag_acts_on_a_mass_that_a_rotor_lifts(fmus: Path) -> None:
    """The speed of the rotor is no speed of the mass, which is no filter of it and no tank."""
    time = np.arange(0.0, 1.0, 0.01)
    logs = {
        "time [s]": time, "command [rad/s]": 500.0 + 5.0 * np.sin(time), "altitude [m]": 1.0 + 0.1 * time
    }  # fmt: skip
    system = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "1 s"},
        "instances": {"craft": {"fmu": "Craft.fmu"}}, "connections": [],
    }  # fmt: skip
    columns = {"craft.command": "command", "craft.altitude": {"column": "altitude", "noise": "1 mm"}}
    path = written(fmus, system, logs, columns)
    with StateModel(load_port_study(path)) as model:
        laws = {one.name: {each.law.name for each in readable(model, one)} for one in model.places()}
        sensors = [one for one in model.places() if one.name == "craft.altitude"]
        rare = [each for one in sensors for each in readable(model, one, rare=True)]
    assert {"quadratic drag", "coulomb"} <= laws["der(craft.climb)"]
    talk = {one.signal for one in rare if one.law.name == "cross-talk"}
    assert talk and "craft.altitude" not in talk
    assert not laws["der(craft.rotor)"] and "der(craft.altitude)" not in laws


def test_friction_acts_on_a_roll_that_is_given_speeds_but_not_on_a_filter(fmus: Path) -> None:
    time = np.arange(0.0, 1.0, 0.01)
    logs = {"time [s]": time, "pull [m/s]": 2.0 + 0.1 * np.sin(time), "tension [N]": 150.0 + time}
    system = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "1 s"},
        "instances": {"roller": {"fmu": "Roller.fmu"}}, "connections": [],
    }  # fmt: skip
    columns = {"roller.pull": "pull", "roller.tension": {"column": "tension", "noise": "0.1 N"}}
    with StateModel(load_port_study(written(fmus, system, logs, columns))) as model:
        laws = {one.name: {each.law.name for each in readable(model, one)} for one in model.places()}
    assert "coulomb" in laws["der(roller.velocity)"]
    assert "coulomb" not in laws["der(roller.filtered)"]


@pytest.fixture
def load(fmus: Path) -> Path:
    """A study of a load on a rope, whose drive is a held command that changes once in a second."""
    time, draw = np.arange(0.0, 8.0, 0.04), np.random.default_rng(3)
    levels = draw.uniform(-1.0, 1.0, 9)
    rope = 1.5 + 0.5 * np.sin(time)

    def rate(t: float, x: np.ndarray) -> list[float]:
        drive = levels[int(t + 1e-9)]
        return [x[1], (-9.81 * np.sin(x[0]) - drive * np.cos(x[0])) / (1.5 + 0.5 * np.sin(t))]

    x = solve_ivp(rate, (0.0, 8.0), [0.1, 0.0], t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.02).y
    logs = {
        "time [s]": time, "rope [m]": rope, "drive [m/s2]": levels[(time + 1e-9).astype(int)],
        "angle [rad]": x[0] + 1e-4 * draw.standard_normal(len(time)),
    }  # fmt: skip
    system = {
        "run": {"master": "gauss-seidel", "step_size": "40 ms", "stop_time": "8 s"},
        "instances": {"load": {"fmu": "Load.fmu"}}, "connections": [],
    }  # fmt: skip
    columns = {
        "load.rope": "rope", "load.drive": "drive",
        "load.angle": {"column": "angle", "noise": "0.1 mrad", "start": True},
    }  # fmt: skip
    return written(fmus, system, logs, columns)


def test_a_fed_length_is_never_set_to_zero_alone(load: Path) -> None:
    """Steps of the simulation suit the fastest mode, which nothing but the logged length shows."""
    with StateModel(load_port_study(load)) as model:
        runs = Runs(model, model.study.of(Role.TRAIN))
        fastest = np.sqrt(9.81 * np.cos(0.1) / 1.5)
        assert runs.sub == int(np.ceil(fastest * 0.04 / 0.7)) == 1
        assert np.isfinite(Replays(runs, ()).residual(model.nominal)).all()


def test_a_log_of_jumps_that_is_read_as_a_line_is_reported(load: Path) -> None:
    (warned,) = [one for one in check_logs(load_port_study(load))[1] if "jumps and rests" in one.what]
    assert warned.place == "load.drive" and "load.angle by" in warned.what and "hold: true" in warned.remedy
    path = load.with_name("held.yaml")
    text = load.read_text(encoding="utf-8").replace(
        "load.drive: drive", "load.drive: {column: drive, hold: true}"
    )
    path.write_text(text, encoding="utf-8")
    assert not [one for one in check_logs(load_port_study(path))[1] if "jumps and rests" in one.what]


def test_stairs_are_told_from_what_is_coarse_smooth_or_short() -> None:
    time = np.arange(1000.0)
    wave = np.sin(0.01 * time)
    assert (
        is_stairs(np.sign(wave)) and is_stairs(np.floor(time / 100.0) % 7) and is_stairs(1.0 * (time > 3.0))
    )
    for other in (wave, np.round(20.0 * wave), np.full(1000, 3.0), np.where(time % 50 == 7, 1.0, 0.0) * wave):
        assert not is_stairs(other)


@pytest.mark.parametrize("stiffness", [-30.0, 0.0])
def test_logs_that_open_the_loop_of_an_unstable_system_are_refused(fmus: Path, stiffness: float) -> None:
    """A mass without a spring only drifts away."""
    time, draw = np.arange(0.0, 8.0, 0.01), np.random.default_rng(1)

    def rate(t: float, x: np.ndarray) -> list[float]:
        return [x[1], -80.0 * x[0] - 12.0 * x[1] - stiffness * x[0] + 0.5 + np.sin(t)]

    x = solve_ivp(rate, (0.0, 8.0), [0.01, 0.0], t_eval=time, rtol=1e-8, atol=1e-10).y
    position, velocity = x + 1e-5 * draw.standard_normal(x.shape)
    logs = {"time [s]": time, "position [m]": position, "velocity [m/s]": velocity}
    system = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "1 s"},
        "instances": {
            "rod": {"fmu": "Rod.fmu", "start": {"stiffness": f"{stiffness} N/m"}},
            "hold": {"fmu": "Hold.fmu"},
        },
        "connections": [
            "rod.position -> hold.position", "rod.velocity -> hold.velocity", "hold.force -> rod.force",
        ],
    }  # fmt: skip
    columns = {"rod.position": {"column": "position", "noise": "10 um", "feed": False}}
    fed = {"hold.position": "position", "hold.velocity": "velocity"}
    refused, warned = check_logs(load_port_study(written(fmus, system, logs, columns | fed)))
    found = refused if stiffness < 0.0 else warned
    (opened,) = (one for one in found if "opens a loop that keeps the model near the logs" in one.what)
    assert opened.place == "a: hold.position and hold.velocity"
    assert (stiffness < 0.0) is bool(refused)
    assert check_logs(load_port_study(written(fmus, system, logs, columns)))[0] == []


def test_a_switch_that_is_late_is_no_outlier(fmus: Path) -> None:
    time = np.arange(0.0, 10.0, 0.01)
    signal, late = np.sin(3.0 * time), np.sin(3.0 * (time - 0.02))
    measured = np.where(late > 0.0, 1.0, 0.0)
    measured[500] += 5.0
    logs = {"time [s]": time, "signal [1]": signal, "output [1]": measured}
    system = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "1 s"},
        "instances": {"switch": {"fmu": "Switch.fmu"}}, "connections": [],
    }  # fmt: skip
    columns = {
        "switch.signal": {"column": "signal", "hold": True},
        "switch.output_": {"column": "output", "noise": 0.01},
    }
    study = load_port_study(written(fmus, system, logs, columns))
    with StateModel(study) as model:
        cleaned, remarks = without_outliers(model)
    (log,) = [values for port, values in cleaned.runs[0].logs.items() if port.variable == "output_"]
    assert np.flatnonzero(np.isnan(log)).tolist() == [500] and len(remarks) == 1


def test_a_sampled_controller_is_simulated_with_its_ticks(fmus: Path) -> None:
    """Unless its output is fed: then the other components have a state form."""
    time = np.arange(0.0, 2.0, 0.01)
    logs = {"time [s]": time, "position [m]": 0.01 * np.cos(7.0 * time), "force [N]": np.sin(time)}
    system = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "1 s"},
        "instances": {"rod": {"fmu": "Rod.fmu"}, "control": {"fmu": "Sampled.fmu"}},
        "connections": ["rod.position -> control.position", "control.force -> rod.force"],
    }  # fmt: skip
    columns = {"rod.position": {"column": "position", "noise": "10 um", "feed": False}}
    closed = load_port_study(written(fmus, system, logs, columns))
    with pytest.raises(
        ConfigError, match=r"control: its discrete variables value.*\n.*Feed all of its outputs"
    ):
        StateModel(closed)
    fed = {"control.force": {"column": "force", "hold": True, "feed": True}}
    with StateModel(load_port_study(written(fmus, system, logs, columns | fed))) as model:
        assert "der(rod.velocity)" in {one.name for one in model.places()}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_sampled_controller_that_does_what_its_logs_say_is_fed(fmus: Path, sign: float) -> None:
    """Laws can then act inside the mass; a controller that does something else stays in the loop."""
    draw, time = np.random.default_rng(2), np.arange(0.0, 6.0, 0.02)
    x, rows = np.array([0.1, 0.0]), []
    for t in time:
        force = -80.0 * x[0]
        rows.append([t, x[0] + 1e-5 * draw.standard_normal(), sign * force])

        def rate(_: float, x: np.ndarray, force: float = force) -> list[float]:
            return [x[1], force - 30.0 * x[0]]

        x = solve_ivp(rate, (0.0, 0.02), x, rtol=1e-8, atol=1e-10).y[:, -1]
    logs = dict(zip(("time [s]", "position [m]", "force [N]"), np.array(rows).T, strict=True))
    system = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "1 s"},
        "instances": {
            "rod": {"fmu": "Rod.fmu", "start": {"stiffness": "30 N/m"}}, "hold": {"fmu": "Sampled.fmu"},
        },
        "connections": ["rod.position -> hold.position", "hold.force -> rod.force"],
    }  # fmt: skip
    columns = {
        "rod.position": {"column": "position", "noise": "10 um", "feed": False, "start": True},
        "hold.force": {"column": "force", "noise": "10 mN", "feed": False},
    }
    path = written(fmus, system, logs, columns)
    path.write_text(path.read_text("utf-8") + "interval: 20 ms\n", encoding="utf-8")
    study = load_port_study(path)
    found, warned = with_devices_fed(study)
    if sign < 0.0:
        assert found is study and not warned
        return
    assert [str(one) for one in found.compared] == ["rod.position"] and warned[0].place == "hold"
    assert {str(one) for one in found.held} == {"hold.force"}
    with StateModel(found) as model:
        assert "der(rod.velocity)" in {one.name for one in model.places()}


def test_mistakes_that_make_the_model_run_away_are_seen_at_the_begin() -> None:
    """A begin of the run leaves more there than the whole may; otherwise the whole run decides."""
    port, time = Port.of("cart.angle"), np.arange(400.0)
    run = PortRun("a", Role.TRAIN, {port: np.sin(0.1 * time)})

    def replayed(rate: float) -> SimpleNamespace:
        def signals(short: PortRun) -> dict[Port, np.ndarray]:
            assert len(short) <= 160
            begin = time[: len(short)]
            return {port: np.sin(0.1 * begin) + 1e-3 * np.exp(rate * begin)}

        return SimpleNamespace(study=SimpleNamespace(settled=0), signals=signals)

    assert _hopeless(replayed(1.0), run, [port], 0.1) and _hopeless(replayed(0.1), run, [port], 0.1)
    assert not _hopeless(replayed(0.01), run, [port], 0.1)


@pytest.mark.parametrize(("limit", "delay", "exchanged"), [(0.8, 4, False), (9.0, 20, True)])
def test_a_drive_at_its_limit_is_no_exchange_of_command_and_position(
    limit: float, delay: int, exchanged: bool
) -> None:
    """Its position is limited, which changes a contact behind it much more than the position."""
    ports = command, position, force = [Port.of(one) for one in ("a.command", "a.position", "b.force")]
    steps = np.sin(0.02 * np.arange(2000.0))

    def follow(given: np.ndarray) -> dict[Port, np.ndarray]:
        late = np.roll(given, delay)
        return {command: given, position: late, force: np.maximum(late - 0.7, 0.0)}

    true = follow(np.clip(steps, -9.0, limit)) | {command: steps}
    if exchanged:
        true |= {command: true[position], position: steps}
    run = PortRun("run", Role.TRAIN, true)
    columns = {one: SimpleNamespace(column=str(one), sign=1, unit="m", start=False) for one in ports}
    study = SimpleNamespace(
        settled=0, compared=[position, force], fed=[command], columns=columns, unit=lambda port: "m"
    )
    replay = SimpleNamespace(study=study, signals=lambda one: follow(one.logs[command]))
    found = _mistake(replay, run, replay.signals(run))
    assert (found is not None) is exchanged
