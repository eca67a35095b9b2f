"""Golden signals of the Python FMUs: fmus/<Name>/reference.csv, one row per communication point.

Run as a script to write them anew; a change then has to be explained by the physics that moved it.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import golden_arm
import golden_wrench

FMUS = Path(__file__).parents[2] / "fmus"
# The other controllers on a line: sockets of the ComplianceController.
PEERS = ("AdmittanceControl", "OsakiCompensation", "SmithPredictor", "PassivityControl")
LINE = ("measured_force", "position", "velocity", "desired_position", "desired_velocity")
# The step of all references [s].
STEP = 5e-4
INPUTS = {
    "SatelliteDynamics": ("force",),
    "LabSatellite": ("force",),
    "LabController": LINE,
    "ComplianceController": LINE,
    **dict.fromkeys(PEERS, LINE),
    "SatellitePair": tuple(f"{name}[{index}]" for name in ("force", "torque") for index in (1, 2, 3)),
}
# Signal -> (absolute tolerance, unit). They cover the libraries' last bits, no more: force is compared to a
# millionth of the 140 N that a contact reaches.
OUTPUTS = {
    "SatelliteDynamics": {
        "position": (1e-15, "m"),
        "velocity": (1e-15, "m/s"),
        "kinetic_energy": (1e-15, "J"),
    },
    "LabSatellite": {"position": (1e-15, "m"), "velocity": (1e-15, "m/s"), "command": (1e-15, "m")},
    "LabController": {
        "force": (1e-8, "N"),
        "stiffness_estimate": (1e-5, "N/m"),
        "damping_estimate": (1e-7, "N.s/m"),
    },
    "ComplianceController": {
        "force": (1e-4, "N"),
        "stiffness_estimate": (1e-1, "N/m"),
        "damping_estimate": (1e-3, "N.s/m"),
        "contact_state": (0, "1"),
        "energy_error": (1e-8, "J"),
    },
    "AdmittanceControl": {"force": (1e-12, "N")},
    "OsakiCompensation": {"force": (1e-10, "N"), "state.lead_time": (1e-15, "s")},
    "SmithPredictor": {"force": (1e-9, "N"), "predicted_force": (1e-9, "N"), "modelled_force": (1e-9, "N")},
    "PassivityControl": {"force": (1e-8, "N"), "energy": (1e-13, "J"), "damping": (1e-6, "N.s/m")},
    "SatellitePair": {
        **{f"position[{index}]": (1e-13, "m") for index in (1, 2, 3)},
        **{f"orientation[{index}]": (1e-13, "1") for index in (1, 2, 3, 4)},
        **{f"velocity[{index}]": (1e-13, "m/s") for index in (1, 2, 3)},
        **{f"angular_velocity[{index}]": (1e-13, "rad/s") for index in (1, 2, 3)},
        "kinetic_energy": (1e-12, "J"),
    },
}
START = {
    "SatelliteDynamics": {"velocity": 0.02},
    "LabSatellite": {"velocity": 0.02, "position": 1e-3},
    "LabController": {"sample_period": 5e-4, "lead_time": 1e-3, "stiffness": 15e4, "start_velocity": 0.05},
    "ComplianceController": {"tau_s": 1e-3},
    "AdmittanceControl": {"filter_time": 1e-3, "force_gain": 0.9, "virtual_damping": 900.0},
    "OsakiCompensation": {"restitution": 0.95},
    "SmithPredictor": {"tau_s": 1e-3, "front": 1e-3, "rear": -1e-3, "damping": 200.0, "tau_m": 2.2e-3},
    "PassivityControl": {"maximum_damping": 5e3},
    # Off the line of centres, everything turned and turning.
    "SatellitePair": {
        "inertia_a[1,2]": 2.0,
        "inertia_a[2,1]": 2.0,
        "assembly_position_a[2]": 0.2,
        "assembly_orientation_b[1]": 0.8,
        "assembly_orientation_b[4]": 0.6,
        "sensor_position[3]": 0.3,
        "start_velocity[1]": 0.02,
        "start_angular_velocity[2]": 0.05,
        "angular_velocity_b[3]": 0.03,
    },
}
# Other parameters than those of START.
OTHER = {
    "SatelliteDynamics": {"mass": 5.0},
    "LabSatellite": {"mass": 5.0, "sample_period": 2e-3},
    **{name: {"sample_period": 1e-3} for name in ("ComplianceController", *PEERS, "LabController")},
    "SatellitePair": {"mass_a": 5.0, "sensor_position[1]": 0.1},
}
UNITS = {
    "force": "N",
    "measured_force": "N",
    "velocity": "m/s",
    "desired_velocity": "m/s",
    "torque": "N.m",
}
for _more in (golden_arm, golden_wrench):
    for _table in ("INPUTS", "OUTPUTS", "START", "OTHER", "UNITS"):
        globals()[_table].update(getattr(_more, _table))
# Models around the engine of a library: no native form, last bits not ours. They have tests apart.
ENGINES = ("ArmMultibody",)
# Their outputs follow the inputs of the same instant.
ALGEBRAIC = tuple(golden_arm.INPUTS)


def read(name: str) -> list[dict[str, float]]:
    """Rows of a reference, by signal name without unit; "time" is the communication point [s]."""
    with (FMUS / name / "reference.csv").open(newline="") as stream:
        rows = csv.reader(stream)
        signals = [column.split(" [")[0] for column in next(rows)]
        return [dict(zip(signals, map(float, row), strict=True)) for row in rows]


def write(name: str, rows: list[dict[str, Any]]) -> None:
    """Write a reference; inputs hold at their communication point, outputs are those read there."""
    units = {
        "time": "s",
        **{signal: UNITS.get(signal, UNITS.get(signal.split("[")[0], "m")) for signal in INPUTS[name]},
    }
    units |= {signal: unit for signal, (_, unit) in OUTPUTS[name].items()}
    with (FMUS / name / "reference.csv").open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(f"{signal} [{unit}]" for signal, unit in units.items())
        writer.writerows([repr(row[signal]) for signal in units] for row in rows)


def replay(name: str, model: Any, inputs: list[dict[str, float]]) -> list[dict[str, Any]]:
    """Outputs of an in-process model driven by recorded inputs.

    The inputs of row i + 1 are set before the step that ends there, as a Gauss-Seidel master does.
    """
    variables = {variable.name: variable for variable in model.vars.values()}
    for signal, value in START[name].items():
        variables[signal].setter(value)
    model.setup_experiment(0.0, None, None)
    model.enter_initialization_mode()
    model.exit_initialization_mode()
    rows = []
    for index, row in enumerate(inputs):
        for signal in INPUTS[name]:
            variables[signal].setter(row[signal])
        if index:
            assert model.do_step(inputs[index - 1]["time"], STEP)
        outputs = {signal: variables[signal].getter() for signal in OUTPUTS[name]}
        rows.append({**row, **outputs})
    return rows


def _satellite_inputs() -> list[dict[str, float]]:
    # A push, a coast and a weaker push back.
    return [{"time": i * STEP, "force": -40.0 if i < 100 else 0.0 if i < 150 else 7.3} for i in range(201)]


def law_of(name: str, model: Any) -> Callable[..., float]:
    """A controller's law with the parameters of START: inputs at a sample -> force."""
    parameters, state = model.Parameters(**START[name]), model.State()
    if name == "ComplianceController":
        law = model.ComplianceLaw(parameters, state)
        return lambda *inputs: law.sample(model.Inputs(*inputs))

    def peer(*inputs: float) -> float:
        state.samples += 1
        model.sample(parameters, state, model.Inputs(*inputs))
        return state.force

    return peer


def _controller_inputs(name: str, model: Any) -> list[dict[str, float]]:
    """Both contacts of one round trip, sensor delay 1 ms, as the closed loop of the bench produces them."""
    from docking_bench import DockingBench

    law = law_of(name, model)
    samples: list[tuple[float, ...]] = []
    bench = {"speed": 0.05, "front": 1e-3, "rear": -1e-3, "tau_s": 1e-3, "damping": 200.0, "resolution": 0.5}

    def controller(*inputs: float) -> float:
        samples.append(inputs)
        return law(*inputs)

    DockingBench(**bench).run(controller, STEP, contacts=2)
    samples.insert(0, (0.0,) * 5)
    return [{"time": i * STEP, **dict(zip(LINE, row, strict=True))} for i, row in enumerate(samples)]


def _pair_inputs() -> list[dict[str, float]]:
    """An oblique push and a twist, a coast, and a push back."""
    pushes = (-40.0, 12.0, 5.0, 1.0, -2.0, 3.0), (0.0,) * 6, (7.3, 0.0, 0.0, 0.0, 0.0, 0.0)
    return [
        {"time": i * STEP, **dict(zip(INPUTS["SatellitePair"], pushes[(i >= 100) + (i >= 150)], strict=True))}
        for i in range(201)
    ]


def main() -> None:
    """Write all references."""
    from conftest import load_model

    controllers = ("ComplianceController", *PEERS, "LabController")
    line = _controller_inputs("ComplianceController", load_model("ComplianceController"))
    for name, inputs in (
        ("SatelliteDynamics", _satellite_inputs()),
        ("LabSatellite", _satellite_inputs()),
        ("SatellitePair", _pair_inputs()),
        *((name, _controller_inputs(name, load_model(name))) for name in controllers),
        *((name, golden_arm.inputs(name)) for name in golden_arm.INPUTS),
        *((name, golden_wrench.inputs(name, line)) for name in golden_wrench.INPUTS),
    ):
        write(name, replay(name, getattr(load_model(name), name)(instance_name="golden"), inputs))


if __name__ == "__main__":
    main()
