"""Studies of the positioning system whose logs are made by runs of it, with or without something hidden."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from orchestrator.base.errors import Problem
from orchestrator.config import load_config
from orchestrator.diagnosis.study.checks import check_logs
from orchestrator.diagnosis.study.mistakes import Warned
from orchestrator.diagnosis.study.replay import Replay
from orchestrator.diagnosis.study.study import PortRun, PortStudy
from orchestrator.simulation.run import run
from orchestrator.system.system import Port

STEP = 2e-3
NOISE = {"drive.position": 2e-6, "controller.voltage": 5e-3}
UNITS = {"path.position": "m", "drive.position": "m", "controller.voltage": "V"}
POSITION, VELOCITY = Port("drive", "position"), Port("drive", "velocity")
VOLTAGE = Port("controller", "voltage")
# Dry friction of the drive, by a damper that `system` adds.
COULOMB = {"from": [{"port": "damper.force", "gain": -1}], "to": "drive.load"}
DAMPER = {"fmu": "CoulombDamper", "start": {"level": "12 N", "width": "1 mm/s"}}


@contextmanager
def change_log(path: Path) -> Iterator[dict[str, np.ndarray]]:
    """The columns of a log by their names, units left out; written back as they are in the end."""
    header = path.read_text().partition("\n")[0].split(",")
    names = [one.partition(" ")[0] for one in header]
    columns = dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T.copy(), strict=True))
    yield columns
    rows = zip(*(columns[name].tolist() for name in names), strict=True)
    path.write_text("\n".join([",".join(header), *(",".join(map(repr, row)) for row in rows)]) + "\n")


def system(stroke: float, connections: Sequence[Any] = ()) -> dict[str, Any]:
    """The config of the positioning system; `connections` replace those with the same target."""
    data = load_config("emps", ["run.step_size=2 ms", "run.stop_time=2 s"]).model.to_data()
    data["instances"]["path"]["start"] = {"stroke": f"{stroke} m", "frequency": "0.5 Hz"}
    own = {one["to"] for one in connections}
    kept = [one for one in data["connections"] if one.partition("->")[2].strip() not in own]
    data["connections"] = [*kept, *connections]
    if "drive.load" in own:
        del data["instances"]["drive"]["start"]["load"]
    if COULOMB in connections:
        data["instances"]["damper"] = DAMPER
        data["connections"].append("drive.velocity -> damper.velocity")
    return data


def study(
    folder: Path,
    hidden: Sequence[Any] = (),
    seed: int | None = 1,
    finer: int = 1,
    instances: dict[str, Any] | None = None,
    logged: dict[str, tuple[str, float]] | None = None,
    **more: Any,
) -> Path:
    """Write a study of three runs; without a seed, logs have no noise.

    Args:
        finer: by how much shorter steps the logs are made with than the study has.
        instances: more of them in the machine.
        logged: unit and noise of more outputs that are logged and compared.
    """
    folder.mkdir(parents=True, exist_ok=True)
    draw = np.random.default_rng(seed)
    runs = []
    for number, (role, stroke) in enumerate((("train", 0.2), ("validation", 0.14), ("held-out", 0.17))):
        overrides = [f"run.step_size={1e3 * STEP / finer!r} ms"]
        machine = system(stroke, hidden)
        machine["instances"] |= instances or {}
        results = run(machine, overrides=overrides, halving=False).results
        columns = {"time [s]": np.asarray(results.time)[::finer]}
        units = UNITS | {name: unit for name, (unit, _) in (logged or {}).items()}
        sizes = NOISE | {name: size for name, (_, size) in (logged or {}).items()}
        for name, unit in units.items():
            values = np.asarray(results[name])[::finer]
            noise = sizes.get(name, 0.0) * draw.standard_normal(len(values)) if seed is not None else 0.0
            columns[f"{name} [{unit}]"] = values + noise
        rows = np.column_stack(list(columns.values()))
        text = ",".join(columns) + "\n" + "\n".join(",".join(map(repr, row.tolist())) for row in rows) + "\n"
        (folder / f"run-{number}.csv").write_text(text)
        runs.append({"file": f"run-{number}.csv", "role": role})
    data = {
        "format": "port-study/1",
        "system": "emps",
        "set": ["run.step_size=2 ms"],
        "columns": {
            "time": "time",
            "path.position": "path.position",
            "drive.position": {"column": "drive.position", "noise": "2 um", "feed": False},
            "controller.voltage": {"column": "controller.voltage", "noise": "5 mV", "feed": False},
            **{
                name: {"column": name, "noise": f"{size} {unit}", "feed": False}
                for name, (unit, size) in (logged or {}).items()
            },
        },
        "calibrated": {
            "drive.mass": {"tolerance": "2 kg"},
            "drive.viscous_friction": {"tolerance": "10 N.s/m"},
        },
        "settle": "50 ms",
        "runs": runs,
        **more,
    }
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    return folder


def checked(study: PortStudy) -> tuple[list[Problem], list[Warned]]:
    """What checks of the logs say, but for the error of the communication step, which these logs contain."""
    refused, warned = check_logs(study)
    return refused, [one for one in warned if "half the communication step" not in one.what]


def simulated(study: PortStudy, run: PortRun | None = None) -> dict[Port, np.ndarray]:
    """Signals of a run of a study, its first one by default, as configured."""
    return Replay(study).signals(run or study.runs[0])


def residuals(study: PortStudy) -> list[np.ndarray]:
    """Residuals over the noise, of all runs and compared ports."""
    replay = Replay(study)
    return [
        (run.logs[port] - values)[study.settled :] / study.columns[port].noise
        for run in study.runs
        for port, values in replay.signals(run).items()
        if port in run.logs
    ]
