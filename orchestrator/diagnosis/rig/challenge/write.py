"""Writes a case as a lab hands it over: case.yaml and seven logs."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np

from .draw import NOISE, RUNS, Case, tolerances
from .rig import COLUMNS, FORCE_RESOLUTION, POSITION_RESOLUTION, TICK, Array

_UNITS = ("m", "m/s", "m", "N", "N", "N/m")
HEADER = ",".join(["time [s]", *(f"{name} [{unit}]" for name, unit in zip(COLUMNS, _UNITS, strict=True))])
_ROW = "%.3f,%.9f,%.9f,%.6f,%.2f,%.4f,%.1f"
_TURN = 2.0 * np.pi
# As case.yaml names them: unit, and what SI is divided by.
_UNIT = {
    "contact_stiffness": ("N/m", 1.0),
    "contact_damping": ("N.s/m", 1.0),
    "front_wall": ("m", 1.0),
    "rear_wall": ("m", 1.0),
    "natural_frequency": ("Hz", _TURN),
    "damping_ratio": ('"1"', 1.0),
    "response_delay": ("s", 1.0),
    "sensor_delay": ("s", 1.0),
    "sensor_cutoff": ("Hz", _TURN),
    "force_bias": ("N", 1.0),
}


def log_text(columns: Array) -> str:
    """A log with its header.

    Args:
        columns: rows by `COLUMNS`, shape (6, n), SI.
    """
    rows = np.vstack([TICK * np.arange(columns.shape[1]), columns]).T.tolist()
    return "\n".join([HEADER, *(_ROW % tuple(row) for row in rows), ""])


def write_case(folder: Path, case: Case, logs: list[Array]) -> None:
    """Write a case; logs by `RUNS`, each of shape (6, n).

    Raises: FileExistsError if the folder exists.
    """
    folder.mkdir(parents=True)
    for plan, columns in zip(RUNS, logs, strict=True):
        # Level and time stamp are fixed: the same case gives the same bytes.
        data = gzip.compress(log_text(columns).encode(), compresslevel=6, mtime=0)
        (folder / f"{plan.name}.csv.gz").write_bytes(data)
    (folder / "case.yaml").write_text(_yaml(case), encoding="utf-8")


def _yaml(case: Case) -> str:
    sigma = tolerances(case.lab)
    lines = [
        "format: gap-case/1",
        "rig: docking-1d",
        f"tick: {TICK}  # s",
        "nominal:  # what the lab believes, with its calibration tolerance (one standard deviation)",
    ]
    for name, (unit, factor) in _UNIT.items():
        value, tolerance = case.lab.nominal[name] / factor, sigma[name] / factor
        lines.append(f"  {name}: {{value: {value:.12g}, unit: {unit}, tolerance: {_number(tolerance)}}}")
    for name, value, unit in (
        ("force_noise", NOISE[1], "N"),
        ("force_resolution", FORCE_RESOLUTION, "N"),
        ("encoder_noise", NOISE[0], "m"),
        ("encoder_resolution", POSITION_RESOLUTION, "m"),
    ):
        lines.append(f"  {name}: {{value: {_number(value)}, unit: {unit}}}")
    lines.append("runs:")
    for plan in RUNS:
        lines.append(
            f"  - {{file: {plan.name}.csv.gz, role: {plan.role}, mass: {plan.mass:g}, "
            f"approach_speed: {plan.speed:g}}}  # kg, m/s"
        )
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """A number in the form of YAML 1.1, with a point before an exponent."""
    text = f"{value:.12g}"
    mantissa, e, exponent = text.partition("e")
    if e and "." not in mantissa:
        mantissa += ".0"
    return mantissa + e + exponent.replace("-0", "-")
