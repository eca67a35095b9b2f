"""The labelled cases of a docking rig, diagnosed as studies of any system.

    python -m tests.benchmarks.docking_cases CASES OUT [NUMBER...]

CASES holds truth.json, and folders with case.yaml and logs. Each case becomes a study in OUT: software is fed
what it was given, robot and contact are driven by the commands sent. The table says how often the search of
laws names place and effect; `orchestrator challenge` checks the rig's own diagnosis.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import orchestrator as orc
from orchestrator.base.errors import ConfigError
from orchestrator.config import load_config
from orchestrator.diagnosis.unknown_input.diagnose import DiagnosedSystem

STEP = 5e-4
# Software repeats its logs to some 5 nm. No law need be as exact as that.
NOISE = {"satellite.position": "1e-6 m", "satellite.velocity": "1e-5 m/s", "controller.force": "4e-3 N"}
FED = {
    "robot.command": ("desired_position_next", "m"), "satellite.force": ("compensated_force", "N"),
    "controller.measured_force": ("sensor_force_next", "N"),
    "controller.position": ("encoder_position_next", "m"),
    "controller.desired_position": ("desired_position_next", "m"),
    "controller.desired_velocity": ("desired_velocity_next", "m/s"),
}  # fmt: skip
# The software answers within its tick, the master a step later: it is fed the next sample.
NEXT = ("desired_position", "desired_velocity", "sensor_force", "encoder_position")
# Ports at which a law names a place of the rig.
PORTS = {
    "link": ("robot.command",), "robot": ("robot.",), "structure": ("robot.position", "contact."),
    "sensor": ("sensor.",), "contact": ("contact.", "sensor.force"), "dynamics": ("satellite.",),
    "controller": ("controller.",),
}  # fmt: skip
# Families of laws, and calibrated parameters, that name an effect. Of others "outside" is right.
NAMES: dict[str, tuple[str, ...]] = {
    "link.clock-skew": ("lag", "drift"), "link.sample-and-hold": ("hold",),
    "robot.delay": ("lag", "robot.tau_m"),
    "robot.bandwidth": ("lag", "robot.omega_n"), "robot.damping": ("lag", "robot.xi_n"),
    "robot.rate-limit": ("rate limit", "saturation"),
    "robot.acceleration-limit": ("rate limit", "saturation"),
    "robot.backlash": ("play",), "robot.friction": ("dry friction",), "robot.resonance": ("lag", "resonance"),
    "robot.load-sensitivity": ("cross-talk",), "structure.compliance": ("gain", "contact.stiffness"),
    "structure.kinematic-scale": ("gain",),
    "structure.offset": ("offset", "contact.front", "contact.rear"), "sensor.delay": ("lag", "sensor.tau_s"),
    "sensor.low-pass": ("lag", "sensor.tau_s"), "sensor.bias": ("offset",), "sensor.drift": ("drift",),
    "sensor.gain": ("gain", "contact.stiffness"), "sensor.tool-inertia": ("added mass",),
    "contact.stiffness": ("gain", "contact.stiffness"),
    "contact.damping": ("viscous friction", "contact.damping"), "contact.hertz": ("stiffness", "gain curve"),
    "contact.cubic": ("stiffness", "gain curve"), "contact.hunt-crossley": ("one-sided damping",),
    "contact.wall-offset": ("offset", "contact.front"), "contact.plasticity": ("hysteresis",),
    "contact.friction": ("dry friction",), "contact.second-contact": ("stiffness", "play"),
    "contact.asymmetry": ("stiffness", "gain"), "contact.softening": ("drift", "step"),
    "contact.viscoelastic": ("relaxation", "lag"), "dynamics.mass": ("gain",),
    "dynamics.mass-offset": ("gain",),
    "dynamics.residual-gravity": ("offset",), "dynamics.cable": ("stiffness",),
    "dynamics.drag": ("viscous friction",), "dynamics.appendage": ("resonance",),
    "dynamics.slosh": ("resonance",), "controller.lead": ("lag",), "controller.stiffness-gain": ("gain",),
    # Outside the rig's catalogue, but laws of the library.
    "u_clip": ("saturation",), "u_cog": ("ripple",), "u_hum": ("periodic disturbance",),
}  # fmt: skip


def study_of(case: Path, out: Path) -> Path:
    """Write the study of a case: system, logs with what the software takes, study.yaml."""
    out.mkdir(parents=True, exist_ok=True)
    data = yaml.safe_load((case / "case.yaml").read_text(encoding="utf-8"))
    given = {name: one["value"] for name, one in data["nominal"].items()}
    robot_lag = given["damping_ratio"] / (math.pi * given["natural_frequency"]) + given["response_delay"]
    filter_lag = given["sensor_delay"] + 1.0 / (2.0 * math.pi * given["sensor_cutoff"])
    contact = {
        "stiffness": f"{given['contact_stiffness']} N/m",
        "damping": f"{given['contact_damping']} N.s/m",
    }
    walls = {"front": f"{given['front_wall']} m", "rear": f"{given['rear_wall']} m"}
    starts = {
        # The master gives the sensor the force of a step's end over the whole step.
        "robot": {
            "omega_n": f"{given['natural_frequency']} Hz", "xi_n": given["damping_ratio"],
            "tau_m": f"{given['response_delay']} s",
        },
        "contact": contact | walls,
        "sensor": {
            "tau_s": f"{given['sensor_delay'] + STEP / 2.0} s", "cutoff": f"{given['sensor_cutoff']} Hz",
        },
        "controller": contact | {"lead_time": f"{filter_lag} s"},
    }  # fmt: skip
    system = load_config("docking-lab", [f"run.step_size={STEP} s"]).model.to_data()
    del system["measures"]
    system["connections"].remove("robot.velocity -> controller.velocity")
    for name, values in starts.items():
        system["instances"][name].setdefault("start", {}).update(values)
    (out / "system.yaml").write_text(yaml.safe_dump(system), encoding="utf-8")
    runs = []
    for number, one in enumerate(data["runs"]):
        table = np.genfromtxt(case / one["file"], delimiter=",", names=True, deletechars="")
        names = [name.partition("_[")[0] for name in table.dtype.names]
        columns = np.column_stack([table[name] for name in table.dtype.names])
        later = [np.r_[column[1:], column[-1]] for column in columns[:, [names.index(one) for one in NEXT]].T]
        name = one["file"].partition(".")[0]
        np.savetxt(
            out / f"{name}.csv", np.column_stack([columns, *later]), fmt="%.10g", delimiter=",",
            header=",".join([*names, *(f"{one}_next" for one in NEXT)]), comments="",
        )  # fmt: skip
        speed = one["approach_speed"]
        begin = {"position": f"{-robot_lag * speed} m", "velocity": f"{speed} m/s"}
        role = "validation" if number == 1 else one["role"].replace("heldout", "held-out")
        runs.append({"file": f"{name}.csv", "role": role, "set": {
            "satellite.mass": f"{one['mass']} kg", "satellite.velocity": f"{speed} m/s",
            **{f"robot.{key}": value for key, value in begin.items()},
            **{f"controller.start_{key}": value for key, value in begin.items()},
        }})  # fmt: skip
        if role == "repeat":
            runs[-1]["repeats"] = name.replace("repeat", "heldout")

    def noise(what: str, unit: str) -> str:
        return f"{math.hypot(given[f'{what}_noise'], given[f'{what}_resolution'] / math.sqrt(12.0))} {unit}"

    compared = {
        "robot.position": ("encoder_position", "m", noise("encoder", "m")),
        "sensor.measured_force": ("sensor_force", "N", noise("force", "N")),
        "satellite.position": ("desired_position", "m", NOISE["satellite.position"]),
        "satellite.velocity": ("desired_velocity", "m/s", NOISE["satellite.velocity"]),
        "controller.force": ("compensated_force", "N", NOISE["controller.force"]),
    }
    tolerances = {
        "contact.stiffness": ("contact_stiffness", "N/m"), "contact.damping": ("contact_damping", "N.s/m"),
        "contact.front": ("front_wall", "m"), "contact.rear": ("rear_wall", "m"),
        "robot.omega_n": ("natural_frequency", "Hz"), "robot.xi_n": ("damping_ratio", "1"),
        "robot.tau_m": ("response_delay", "s"), "sensor.tau_s": ("sensor_delay", "s"),
    }  # fmt: skip
    study = {
        "format": "port-study/1", "system": "system.yaml", "interval": "1 ms", "settle": "50 ms",
        "runs": runs,
        "columns": {
            **{port: {"column": name, "unit": unit, "hold": True} for port, (name, unit) in FED.items()},
            **{port: {"column": name, "unit": unit, "noise": size, "feed": False}
               for port, (name, unit, size) in compared.items()},
        },
        "calibrated": {
            port: {"tolerance": f"{data['nominal'][name]['tolerance']} {unit}"}
            for port, (name, unit) in tolerances.items()
        },
    }  # fmt: skip
    (out / "study.yaml").write_text(yaml.safe_dump(study, sort_keys=False), encoding="utf-8")
    return out


def judged(truth: dict[str, Any], data: dict[str, Any]) -> tuple[bool, bool, str]:
    """Whether place and effect are named, and the answer in words.

    A parameter that leaves its tolerance names its component. The same law elsewhere counts, too, if the
    report says that it acts the same on these logs: an offset of the contact's force is one of the sensor.
    """
    laws = [(one["place"], one["family"], one["law"]) for one in data["laws"]]
    moved = [one.partition(" ")[0] for one in data["remarks"] if "leaves its tolerance" in one]
    said = [f"{law} at {place}" for place, _, law in laws] or [data["verdict"]]
    if not laws:
        laws = [(name, name, name) for name in moved]
        said += moved
    twins = [one.partition(" of ")[0].rpartition(" at ") for one in data["same_on_these_logs"]]
    ports = [port for port, *_ in laws]
    ports += [port for name, _, port in twins if name in {law for *_, law in laws}]
    places = [any(port.startswith(PORTS[place]) for port in ports) for place in truth["places"]]
    names = {family for _, family, _ in laws}
    known = [set(NAMES.get(effect, ())) for effect in (*truth["effects"], *truth["outside"])]
    if not truth["places"]:
        right = data["verdict"] == "none" and not laws
        return right, right, " + ".join(said)
    outside = data["verdict"] == "outside"
    effects = [bool(one & names) or (outside and not one) for one in known]
    return all(places), all(effects), " + ".join(said)


def main(cases: Path, out: Path, numbers: list[str]) -> None:
    """Diagnose cases that OUT has no verdict of, and print the table of all that are asked for."""
    truths = json.loads((cases / "truth.json").read_text(encoding="utf-8"))
    asked = [f"case-{int(one):03d}" for one in numbers] or sorted(truths)
    print("| case | hidden | answer | probability | place | effect | closed | time |")
    print("|" + "---|" * 8)
    rights = []
    for name in asked:
        verdict = out / name / "verdict" / "diagnosis.json"
        if not verdict.exists():
            try:
                made = orc.diagnose(study_of(cases / name, out / name), verdict.parent)
                assert isinstance(made, DiagnosedSystem)
            except ConfigError as error:
                print(f"| {name} | refused: {error.problems[0]} |")
                continue
        data = json.loads(verdict.read_text(encoding="utf-8"))
        place, effect, said = judged(truths[name], data)
        rights.append((not truths[name]["places"], place, place and effect))
        hidden = " + ".join([*truths[name]["effects"], *truths[name]["outside"]]) or "nothing"
        closed = f"{100 * data['held_out']['closed']:.0f} %"
        print(
            f"| {name} | {hidden} | {said} | {data['probability']:.2f} | {'x' if place else ''} | "
            f"{'x' if place and effect else ''} | {closed} | {data['seconds']:.0f} s |", flush=True,
        )  # fmt: skip
    hiding = [one for one in rights if not one[0]]
    print(
        f"\nplace {sum(one[1] for one in hiding)} of {len(hiding)}, effect {sum(one[2] for one in hiding)}, "
    )
    print(f"nothing hidden: {sum(one[1] for one in rights if one[0])} of {len(rights) - len(hiding)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
