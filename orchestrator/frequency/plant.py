"""The bundled components as transfer functions of their parameters: what the FMUs compute, linear and exact.

Each function takes a component's parameters, SI, each a number or an array of one shape, and gives the
transfer
from inputs to outputs. Signs as in modelica/DockingHIL/SignConventions.mo: a frame pushes back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..base.errors import Problem
from .transfer import Transfer, polynomial

__all__ = ["MODELS", "Paths", "controller", "force_sensor", "problems_of", "robot_response"]

Paths = dict[tuple[str, str], Transfer]
Parameters = Mapping[str, Any]

OFF, LEAD, ACTIVE = 1, 2, 3


def robot_response(p: Parameters) -> Paths:
    """Eq. (17): omega_n^2 exp(-tau_m s)/(s^2 + 2 xi_n omega_n s + omega_n^2)."""
    square = np.square(p["omega_n"])
    below = polynomial(square, 2.0 * np.asarray(p["xi_n"]) * p["omega_n"], 1.0)
    return {
        ("command", "position"): Transfer.made(polynomial(square), (below,), p["tau_m"]),
        ("command", "velocity"): Transfer.made(polynomial(0.0, square), (below,), p["tau_m"]),
    }


def docking_contact(p: Parameters) -> Paths:
    """In contact with one frame: force = -(k position + c velocity)."""
    return {
        ("position", "force"): -Transfer.gain(p["stiffness"]),
        ("velocity", "force"): -Transfer.gain(p["damping"]),
        ("position", "penetration"): Transfer.gain(1.0),
    }


def force_sensor(p: Parameters) -> Paths:
    """exp(-tau_s s)/(1 + s/(2 pi cutoff)), no low-pass where the cutoff is zero; resolution left out."""
    cutoff = np.asarray(p["cutoff"], np.float64)
    lag = np.where(cutoff > 0.0, 1.0 / (2.0 * np.pi * np.where(cutoff > 0.0, cutoff, 1.0)), 0.0)
    factors = (polynomial(1.0, lag),) if np.any(lag) else ()
    return {("force", "measured_force"): Transfer.made(np.ones(1), factors, p["tau_s"])}


def satellite_dynamics(p: Parameters) -> Paths:
    """M s^2 position = force."""
    square = np.array([0.0, 0.0, 1.0])
    inverse = 1.0 / np.asarray(p["mass"], np.float64)
    return {
        ("force", "position"): Transfer.made(polynomial(inverse), (square,)),
        ("force", "velocity"): Transfer.made(polynomial(0.0, inverse), (square,)),
    }


def controller(p: Parameters) -> Paths:
    """Eqs. (25) and (27) to (29) in contact: F_S - k_d (x_des - x) - c_d (v_des - v), held for a sample
    period.

    The hold counts as a delay of half a period, and the lead's difference as a derivative: both are the limit
    of a period short against the contact; `sampled` has them exactly. Estimates stand still:
    `stiffness_estimate`
    and `damping_estimate`. The restoration of work missed at onset is no linear law and is left out.
    """
    filtered = (polynomial(1.0, p["lead_filter_time"]),) if np.any(p["lead_filter_time"]) else ()
    derivative = Transfer.made(polynomial(0.0, p["tau_s"]), filtered)
    lead = Transfer.gain(1.0) + derivative
    mode = int(p["mode"])
    half = 0.5 * np.asarray(p["sample_period"], np.float64)
    hold = Transfer.made(np.ones(1), (), half)
    paths = {
        ("measured_force", "compensated_force"): lead,
        ("measured_force", "force"): hold if mode == OFF else hold * lead,
    }
    if mode == ACTIVE:
        k, c = p["stiffness_estimate"], np.maximum(p["damping_estimate"], 0.0)
        ahead = (half if p["hold_compensation"] else 0.0) + np.asarray(p["transfer_delay"])
        paths |= {
            ("position", "force"): hold * Transfer.gain(k),
            ("velocity", "force"): hold * Transfer.gain(c),
            ("desired_position", "force"): -(hold * Transfer.gain(k)),
            ("desired_velocity", "force"): -(hold * Transfer.gain(c + k * ahead)),
        }
    return paths


# By the last part of the FMU's model name.
MODELS: dict[str, Callable[[Parameters], Paths]] = {
    "RobotResponse": robot_response,
    "DockingContact": docking_contact,
    "ForceSensor": force_sensor,
    "SatelliteDynamics": satellite_dynamics,
    "ComplianceController": controller,
}

# What has to hold of a parameter for the model to make sense: whether zero is allowed, and the unit.
_LIMITS = {
    "RobotResponse": {"omega_n": (False, "rad/s"), "xi_n": (True, "1"), "tau_m": (True, "s")},
    "DockingContact": {"stiffness": (False, "N/m"), "damping": (True, "N.s/m")},
    "ForceSensor": {"tau_s": (True, "s"), "cutoff": (True, "Hz")},
    "SatelliteDynamics": {"mass": (False, "kg")},
    "ComplianceController": {
        "sample_period": (True, "s"),
        "tau_s": (True, "s"),
        "lead_filter_time": (True, "s"),
        "transfer_delay": (True, "s"),
        "stiffness_estimate": (True, "N/m"),
    },
}


def problems_of(name: str, model: str, p: Parameters) -> list[Problem]:
    """What is wrong with the parameters of an instance, all at once."""
    problems = []
    for key, (zero, unit) in _LIMITS[model].items():
        values = np.asarray(p[key], np.float64)
        wrong = ~np.isfinite(values) | (values < 0.0 if zero else values <= 0.0)
        if np.any(wrong):
            got = float(values[wrong].flat[0]) if values.ndim else float(values)
            allowed = "finite and not negative" if zero else "finite and positive"
            problems.append(Problem(f"{name}.{key}", f"it is {got!r} {unit}", f"allowed: {allowed}"))
    return problems
