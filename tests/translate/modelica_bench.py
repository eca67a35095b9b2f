"""Flat models from text, instances of FMUs by variable names, and the golden signals of the Modelica FMUs.

Run as a script to write the references anew; a change then has to be explained by the physics that moved it.
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).parents[2]
FMUS = ROOT / "fmus"


def model_file(folder: Path, text: str, name: str = "Model.mo") -> Path:
    """Write Modelica text to a file."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


class Instance:
    """One instance of a compiled FMU of either FMI version, by variable names."""

    def __init__(self, description: Any, folder: str) -> None:
        self.variables = {variable.name: variable for variable in description.modelVariables}
        second = description.fmiVersion == "2.0"
        self.fmu = (FMU2Slave if second else FMU3Slave)(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="test",
        )
        self.second = second
        self.time = 0.0
        self.fmu.instantiate()

    def initialise(self, **start: float) -> Instance:
        self.set(start)
        if self.second:
            self.fmu.setupExperiment(startTime=0.0)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=0.0)
        self.fmu.exitInitializationMode()
        return self

    def set(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            variable = self.variables[name]
            set_value = getattr(self.fmu, f"set{variable.type}")
            set_value([variable.valueReference], [value])

    def get(self, *names: str) -> list[float]:
        values = []
        for name in names:
            variable = self.variables[name]
            values += getattr(self.fmu, f"get{variable.type}")([variable.valueReference])
        return values

    def step(self, size: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=size)
        self.time += size

    def derivative(self, unknown: str, known: str) -> float:
        """Directional derivative of one variable with respect to another."""
        references = [self.variables[name].valueReference for name in (unknown, known)]
        if self.second:
            return self.fmu.getDirectionalDerivative(references[:1], references[1:], [1.0])[0]
        return self.fmu.getDirectionalDerivative(references[:1], references[1:], [1.0], 1)[0]


@contextmanager
def instance(path: Path, **start: float) -> Iterator[Instance]:
    """An initialised instance of an FMU; its folder is removed afterwards."""
    description = fmpy.read_model_description(str(path))
    with tempfile.TemporaryDirectory() as folder:
        fmpy.extract(str(path), unzipdir=folder)
        item = Instance(description, folder)
        try:
            yield item.initialise(**start)
            item.fmu.terminate()
        finally:
            item.fmu.freeInstance()


# Golden signals ---------------------------------------------------------------------------------------------


def elements(name: str, size: int) -> tuple[str, ...]:
    """Names of an array's elements."""
    return tuple(f"{name}[{index}]" for index in range(1, size + 1))


UNITS = {
    **{
        f"{name}[{axis}]": ("m" if axis == 1 else "rad") + ("/s" if name.endswith("velocity") else "")
        for name in ("joint_command", "joint_position", "joint_velocity", "measured_position")
        for axis in range(1, 8)
    },
    **{name: "m" for base in ("position_command", "position") for name in elements(base, 3)},
    **{name: "1" for base in ("orientation_command", "orientation") for name in elements(base, 4)},
    **dict.fromkeys(elements("velocity", 3), "m/s"),
    **dict.fromkeys(elements("angular_velocity", 3), "rad/s"),
    "time": "s",
    "command": "m",
    "position": "m",
    "velocity": "m/s",
    "force": "N",
    "penetration": "m",
    "measured_force": "N",
    "orientation": "1",
    "angular_velocity": "rad/s",
    "point": "m",
    "stored_energy": "J",
    "force_noise": "N",
    "torque_noise": "N.m",
    "measured_torque": "N.m",
    "reference": "m",
    "voltage": "V",
    "load": "N",
    "motor_position": "m",
    "motor_velocity": "m/s",
    "load_position": "m",
    "load_velocity": "m/s",
    "upper": "m",
    "lower": "m",
    "level": "m",
    "integral": "V",
}
# Where a name has another unit than elsewhere.
OWN_UNITS = {
    "Area": dict.fromkeys(("setpoint", "load", "deviation", "command", "exchange"), "1")
    | dict.fromkeys(("angle", "other_angle"), "rad")
}


def elements(name: str, size: int) -> tuple[str, ...]:
    """Names of an array's elements."""
    return tuple(f"{name}[{index}]" for index in range(1, size + 1))


INPUTS: dict[str, tuple[str, ...]] = {
    "RobotResponse": ("command",),
    "DockingContact": ("position", "velocity"),
    "ForceSensor": ("force",),
    "LabRobot": ("command", "force"),
    "LabContact": ("position", "velocity"),
    "LabSensor": ("force", "velocity"),
    "JointServos": elements("joint_command", 7),
    "CartesianResponse": elements("position_command", 3) + elements("orientation_command", 4),
    "PointContact": (
        *elements("position", 3),
        *elements("orientation", 4),
        *elements("velocity", 3),
        *elements("angular_velocity", 3),
    ),
    "WrenchSensor": (
        *elements("force", 3),
        *elements("point", 3),
        *elements("force_noise", 3),
        *elements("torque_noise", 3),
    ),
    "UncompensatedDocking": (),
    "SmoothMotion": (),
    "CascadeControl": ("reference", "position", "velocity"),
    "LinearDrive": ("voltage", "load"),
    "CompliantDrive": ("voltage", "load"),
    "TankPair": ("voltage",),
    "LevelControl": ("reference", "level"),
    "Area": ("setpoint", "load", "other_angle"),
    "CoulombDamper": ("velocity",),
    "FrictionForce": ("velocity",),
}
OUTPUTS: dict[str, tuple[str, ...]] = {
    "RobotResponse": ("position", "velocity"),
    "DockingContact": ("force", "penetration"),
    "ForceSensor": ("measured_force",),
    "LabRobot": ("position", "velocity"),
    "LabContact": ("force", "penetration"),
    "LabSensor": ("measured_force",),
    "JointServos": tuple(
        f"{name}[{axis}]"
        for name in ("joint_position", "joint_velocity", "measured_position")
        for axis in range(1, 8)
    ),
    "CartesianResponse": (
        *elements("position", 3),
        *elements("orientation", 4),
        *elements("velocity", 3),
        *elements("angular_velocity", 3),
    ),
    "PointContact": (*elements("force", 3), *elements("point", 3), "penetration", "stored_energy"),
    "WrenchSensor": (*elements("measured_force", 3), *elements("measured_torque", 3)),
    "UncompensatedDocking": ("position", "velocity", "force"),
    "SmoothMotion": ("position", "velocity"),
    "CascadeControl": ("voltage",),
    "LinearDrive": ("position", "velocity"),
    "CompliantDrive": ("motor_position", "motor_velocity", "load_position", "load_velocity"),
    "TankPair": ("upper", "lower"),
    "LevelControl": ("voltage", "integral"),
    "Area": ("angle", "deviation", "command", "exchange"),
    "CoulombDamper": ("force",),
    "FrictionForce": ("force",),
}
START: dict[str, dict[str, float]] = {
    "RobotResponse": {"tau_m": 2.3e-3},
    "DockingContact": {"damping": 500.0},
    "ForceSensor": {"tau_s": 1.3e-3, "cutoff": 100.0, "resolution": 0.5},
    "LabRobot": {
        "tau_m": 2.3e-3,
        "skew": 0.01,
        "friction": 0.8,
        "stribeck": 0.4,
        "load_sensitivity": 0.02,
        "acceleration_limit": 50.0,
        "rate_limit": 0.15,
        "backlash": 1e-4,
        "resonance_gain": 0.1,
    },
    "LabContact": {
        "damping": 500.0,
        "asymmetry": 0.05,
        "softening": 0.1,
        "cubic": 0.02,
        "hertz_exponent": 0.2,
        "second_stiffness": 0.3,
        "hunt_crossley": 1e5,
        "maxwell": 0.2,
        "plastic_set": 0.04,
        "friction": 0.03,
        "compliance": 5e-7,
        "adhesion": 2.0,
    },
    "LabSensor": {"tau_s": 1.3e-3, "cutoff": 100.0, "resolution": 0.5, "tool_mass": 4.0},
    "JointServos": {
        "tau_m": 2.3e-3,
        "omega_n[3]": 300.0,
        "xi_n[5]": 0.6,
        "rail_resolution": 1e-5,
        "angle_resolution": 1e-4,
    },
    "CartesianResponse": {
        "tau_m": 2.3e-3,
        "omega_n[2]": 300.0,
        "rotation_xi_n[3]": 0.6,
        "reference_orientation[1]": 0.8,
        "reference_orientation[3]": 0.6,
        "rotation_vector[2]": 0.2,
    },
    "PointContact": {
        "damping": 500.0,
        "friction": 0.2,
        "tangential_damping": 3.0,
        **dict(zip(elements("tip", 3), (0.3, 0.1, -0.05), strict=True)),
        **dict(zip(elements("normal", 3), (-2.0, 1.0, 0.5), strict=True)),
    },
    "WrenchSensor": {
        "tau_s": 1.3e-3,
        "cutoff": 100.0,
        "force_resolution": 0.5,
        "torque_resolution": 0.02,
        "tool_mass": 2.5,
        "tared": False,
        **dict(zip(elements("sensor_position", 3), (0.1, -0.2, 0.3), strict=True)),
        **dict(zip(elements("tool_center", 3), (0.0, 0.01, 0.08), strict=True)),
        **dict(zip(elements("sensor_orientation", 4), (0.8, 0.0, 0.6, 0.0), strict=True)),
    },
    "UncompensatedDocking": {"robot.tau_m": 6e-3},
    "SmoothMotion": {"stroke": 0.25, "frequency": 0.7},
    "CascadeControl": {"position_gain": 160.0, "velocity_gain": 240.0},
    "CompliantDrive": {"damping": 500.0, "load_velocity": 0.02},
    "TankPair": {"upper": 0.15},
    "LevelControl": {"gain": 30.0},
    "Area": {"tie": 0.2, "integral_gain": 0.5},
    "LinearDrive": {"mass": 95.0, "viscous_friction": 200.0, "force_per_voltage": 35.0, "velocity": 0.02},
    "CoulombDamper": {"level": 9000.0, "width": 2e-3},
    "FrictionForce": {
        "viscous": 30.0,
        "one_sided": 5.0,
        "drag": 40.0,
        "stiffness": 200.0,
        "level": 20.0,
        "excess": 0.4,
        "distance": 2e-3,
        "slip_level": 10.0,
        "slip_distance": 4e-3,
        "bearing_level": 15.0,
        "bearing_distance": 1e-3,
        "play": 2e-3,
    },
}
STEPS = {
    "RobotResponse": 5e-4,
    "DockingContact": 1e-3,
    "ForceSensor": 5e-4,
    "LabRobot": 5e-4,
    "LabContact": 1e-3,
    "LabSensor": 5e-4,
    "JointServos": 1e-3,
    "CartesianResponse": 1e-3,
    "PointContact": 1e-3,
    "WrenchSensor": 5e-4,
    "UncompensatedDocking": 1e-3,
    "SmoothMotion": 1e-3,
    "CascadeControl": 1e-3,
    "LinearDrive": 1e-3,
    "CompliantDrive": 1e-3,
    "TankPair": 1.0,
    "LevelControl": 1.0,
    "Area": 0.05,
    "CoulombDamper": 1e-3,
    "FrictionForce": 1e-3,
}
# Where the joints of JointServos stand at the start.
JOINTS = (0.0, 0.0, -1.7453292519943295, 2.2689280275926285, 0.0, -0.5235987755982988, 0.0)


def inputs(name: str) -> list[dict[str, float]]:
    """Input of every row: what acts over the step that ends there (row 0: at initialisation)."""
    step = STEPS[name]
    if name == "RobotResponse":
        # 0 until 5 ms, 1 mm until 30 ms, then -0.5 mm.
        steps = [0.0 if i <= 10 else 1e-3 if i <= 60 else -5e-4 for i in range(161)]
        return [{"command": value} for value in steps]
    if name == "LabRobot":
        # As RobotResponse, with a blow on the way.
        return [
            {
                "command": 0.0 if i <= 10 else 1e-3 if i <= 60 else -5e-4,
                "force": -90.0 if 90 < i < 100 else 0.0,
            }
            for i in range(161)
        ]
    if name in ("DockingContact", "LabContact"):
        # 8 mm to either side at 2 Hz, with the velocity that belongs to it.
        omega = 2 * np.pi * 2.0
        times = [i * step for i in range(501)]
        return [
            {"position": float(8e-3 * np.sin(omega * t)), "velocity": float(8e-3 * omega * np.cos(omega * t))}
            for t in times
        ]
    if name == "ForceSensor":
        return [{"force": 0.0 if i <= 4 else -140.2 if i <= 44 else 33.1} for i in range(121)]
    if name == "LabSensor":
        return [
            {
                "force": 0.0 if i <= 4 else -140.2 if i <= 44 else 33.1,
                "velocity": float(0.02 * np.sin(0.2 * i)),
            }
            for i in range(121)
        ]
    if name == "JointServos":
        # A jump of each axis by a size of its own, one after the other.
        return [
            {
                f"joint_command[{k + 1}]": JOINTS[k] + (1e-3 * (k + 1) if i > 5 * (k + 1) else 0.0)
                for k in range(7)
            }
            for i in range(81)
        ]
    if name == "CartesianResponse":
        # From the reference turned by 0.2 rad about y to 1 rad about a slanted axis; the position jumps, too.
        return [cartesian_command(0 if i <= 5 else 1 if i <= 40 else 2) for i in range(81)]
    if name == "PointContact":
        return _poses(step)
    if name == "WrenchSensor":
        rows = []
        for i in range(121):
            load = np.array(
                [-140.2, 20.3, -7.1] if 4 < i <= 44 else [33.1, 0.0, 11.7] if i > 44 else [0.0] * 3
            )
            values = (
                *load,
                0.31,
                0.02 * i / 120,
                -0.1,
                *(0.4 * np.sin([i, 2 * i, 3 * i])),
                *([0.03 * (i % 3)] * 3),
            )
            rows.append(dict(zip(INPUTS[name], map(float, values), strict=True)))
        return rows
    if name == "CascadeControl":
        # A reference that runs ahead of a position to and fro.
        angles = [2 * np.pi * i / 100 for i in range(101)]
        return [
            {
                "reference": float(0.1 * np.sin(a)),
                "position": float(0.1 * np.sin(a - 0.05)),
                "velocity": float(0.3 * np.cos(a - 0.05)),
            }
            for a in angles
        ]
    if name == "TankPair":
        return [{"voltage": 12.0 if i <= 100 else 6.0} for i in range(301)]
    if name == "LevelControl":
        return [{"reference": 0.25, "level": 0.2 if i <= 100 else 0.28} for i in range(201)]
    if name == "Area":
        # A load from 1 s on, the control's command 2 s later, and an angle of the other area.
        return [
            {
                "setpoint": 0.05 if i > 60 else 0.0,
                "load": 0.1 if i > 20 else 0.0,
                "other_angle": 0.2 if i > 100 else 0.0,
            }
            for i in range(201)
        ]
    if name in ("LinearDrive", "CompliantDrive"):
        # 2 V until 0.1 s, then none; a load from 50 ms on.
        return [{"voltage": 2.0 if i <= 100 else 0.0, "load": -12.0 if i > 50 else 0.0} for i in range(301)]
    if name in ("CoulombDamper", "FrictionForce"):
        return [{"velocity": float(0.05 * np.sin(2 * np.pi * i / 200))} for i in range(401)]
    return [{} for _ in range(1001)]


# Commanded position [m] and rotation vector from the reference orientation [rad].
CARTESIAN = (
    ((0.0, 0.0, 0.0), (0.0, 0.2, 0.0)),
    ((1e-3, -2e-3, 5e-3), (0.6, 0.0, 0.8)),
    ((0.0, 1e-3, 0.0), (0.0, 0.0, 0.0)),
)


def cartesian_command(number: int) -> dict[str, float]:
    """Inputs of CartesianResponse for an entry of CARTESIAN."""
    position, rotation = CARTESIAN[number]
    start = START["CartesianResponse"]
    reference = Rotation.from_quat(
        [start.get(f"reference_orientation[{k}]", 0.0) for k in (1, 2, 3, 4)], scalar_first=True
    )
    turn = (reference * Rotation.from_rotvec(rotation)).as_quat(scalar_first=True)
    values = {f"position_command[{k + 1}]": position[k] for k in range(3)}
    return values | {f"orientation_command[{k + 1}]": float(turn[k]) for k in range(4)}


def _poses(step: float) -> list[dict[str, float]]:
    """A rod that swings through both surfaces on an oblique line and turns, with its twist."""
    omega, spin = 2 * np.pi * 2.0, np.array([0.1, -0.2, 0.3])
    line = np.array([0.011, 0.004, -0.002])
    # The tip starts in the middle between the surfaces.
    middle = -np.array([0.3, 0.1, -0.05])
    rows = []
    for i in range(501):
        turn = Rotation.from_rotvec(spin * np.sin(omega * i * step) * 0.01)
        x, y, z, w = turn.as_quat()
        position = middle + line * np.sin(omega * i * step)
        velocity = line * omega * np.cos(omega * i * step)
        # The axis of rotation stays, so the angular velocity lies along it.
        rotation = spin * omega * np.cos(omega * i * step) * 0.01
        values = (*position, w, x, y, z, *velocity, *rotation)
        rows.append(dict(zip(INPUTS["PointContact"], map(float, values), strict=True)))
    return rows


def run(name: str, path: Path | None = None) -> list[dict[str, float]]:
    """Rows of signals that an FMU gives for the golden input."""
    step = STEPS[name]
    driven = inputs(name)
    rows = []
    with instance(path or FMUS / name / f"{name}.fmu", **START[name], **driven[0]) as fmu:
        for index, values in enumerate(driven):
            if index:
                fmu.set(values)
                fmu.fmu.doStep(currentCommunicationPoint=(index - 1) * step, communicationStepSize=step)
            outputs = dict(zip(OUTPUTS[name], fmu.get(*OUTPUTS[name]), strict=True))
            rows.append({"time": index * step, **values, **outputs})
    return rows


def read(name: str) -> dict[str, np.ndarray]:
    """Columns of a reference, by signal name without unit."""
    with (FMUS / name / "reference.csv").open(newline="", encoding="utf-8") as stream:
        rows = csv.reader(stream)
        names = [column.split(" [")[0] for column in next(rows)]
        values = np.array([[float(value) for value in row] for row in rows])
    return dict(zip(names, values.T, strict=True))


def write(name: str, rows: Sequence[Mapping[str, float]]) -> None:
    """Write a reference."""
    with (FMUS / name / "reference.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        own = UNITS | OWN_UNITS.get(name, {})
        units = {signal: own.get(signal, own.get(signal.split("[")[0])) for signal in rows[0]}
        writer.writerow(f"{signal} [{unit}]" for signal, unit in units.items())
        writer.writerows([repr(value) for value in row.values()] for row in rows)


def main() -> None:
    """Write every reference."""
    for name in INPUTS:
        write(name, run(name))


if __name__ == "__main__":
    main()
